"""The state machine of the tracker: which mode follows from the situation, and why.

A positioner that cannot move at all comes first, because then nothing can be done; a request to stow stays latched
meanwhile and is the first thing carried out after it. A person's stop comes next, because somebody may be in reach of
the axes. Stow pre-empts everything else, homing and doubts included.
"""

from dataclasses import dataclass
from enum import Enum, auto

from daemon.records import Mode


class Data(Enum):
    """What the cube's data is good for."""

    FRESH = auto()
    WAITING = auto()
    BAD = auto()


@dataclass(frozen=True, slots=True)
class Situation:
    """Everything that the choice of mode depends on.

    Attributes
    ----------
    connected
        The positioner sends telemetry.
    blocked_why
        Why the positioner can move nothing, or None.
    doubt_why
        Why it must not be moved but to stow, or None.
    homing
        A reference run is on.
    stop_why
        Why an operator has stopped the axes, or None.
    stow_why
        The first reason to stow, or None.
    hold_why
        Why an operator holds the tracker, or None.
    night_why
        Why it counts as night, or None.
    data, data_why
        Whether the cube's scans can be used, and in words.
    """

    connected: bool
    blocked_why: str | None
    doubt_why: str | None
    homing: bool
    stop_why: str | None
    stow_why: str | None
    hold_why: str | None
    night_why: str | None
    data: Data
    data_why: str


def next_mode(current: Mode, situation: Situation) -> tuple[Mode, str]:
    """Return the mode that the situation calls for, and the reason in words."""
    s = situation
    if s.blocked_why is not None:
        return Mode.FAULT, s.blocked_why
    if not s.connected:
        return Mode.STARTING, "waiting for the positioner"
    if s.stop_why is not None:
        return Mode.HOLD, s.stop_why
    if s.stow_why is not None:
        return Mode.STOW, s.stow_why
    if s.homing:
        return Mode.STARTING, "homing"
    if s.doubt_why is not None:
        return Mode.FAULT, s.doubt_why
    if s.hold_why is not None:
        return Mode.HOLD, s.hold_why
    if s.night_why is not None:
        return Mode.NIGHT, s.night_why
    if s.data is Data.FRESH:
        return Mode.TRACKING, s.data_why
    if s.data is Data.BAD:
        return Mode.FALLBACK, s.data_why
    # Data may yet come: what the tracker did with data or without it goes on, anything else waits for it.
    return (current if current in (Mode.TRACKING, Mode.FALLBACK) else Mode.STARTING), s.data_why
