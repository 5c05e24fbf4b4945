"""What is shown of the link to the broker and of the safety inputs that come over it."""

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class InputStatus:
    """How a safety input is.

    Attributes
    ----------
    name
        ``wind`` or ``safe``.
    age_s
        Time since the newest message that proves a living source; None before the first.
    stowing
        Whether it keeps the tracker in its stow position.
    """

    name: str
    topic: str
    age_s: float | None
    stowing: bool


@dataclass(frozen=True, slots=True)
class LinkStatus:
    """How the link is.

    Attributes
    ----------
    broker
        Host and port.
    connected, since_utc_s
        Whether there is a connection now, and since when that has been so.
    down_why
        Why there is no connection, or None.
    connections
        How many there have been; every one but the first is a reconnection.
    waiting, sent, received, dropped
        Messages in the queue, handed over, heard, and lost for want of room.
    dropped_since_utc_s
        When the first was lost, or None.
    troubles
        One sentence each for what does not work although the link may.
    inputs
        The safety inputs.
    """

    broker: str
    connected: bool
    since_utc_s: float
    down_why: str | None
    connections: int
    waiting: int
    sent: int
    received: int
    dropped: int
    dropped_since_utc_s: float | None
    troubles: tuple[str, ...]
    inputs: tuple[InputStatus, ...] = ()
