"""One alarm, as everybody is shown it."""

from dataclasses import dataclass

from daemon.base.alarms.kinds import AlarmKind, Severity, kind_of_alarm

_MOST_SEVERE_FIRST = tuple(Severity)


@dataclass(frozen=True, slots=True)
class Alarm:
    """One alarm that is on, or that is over and waits for a person to look.

    Attributes
    ----------
    name
        Name of its kind, such as ``unexplained-motion``; at most one of a kind is on show.
    text
        What is wrong and what to do, in a sentence.
    raised_utc_s
        When it was raised.
    acknowledged_utc_s, acknowledged_by
        When and by whom it was acknowledged; None and empty where nobody has.
    cleared_utc_s
        When the cause of a latched alarm ended; None while the alarm is on.
    """

    name: str
    text: str
    raised_utc_s: float
    acknowledged_utc_s: float | None = None
    acknowledged_by: str = ""
    cleared_utc_s: float | None = None

    @property
    def kind(self) -> AlarmKind:
        """Its kind: severity, cause, effect and remedy."""
        return kind_of_alarm(self.name)

    @property
    def on(self) -> bool:
        """Whether its cause lasts."""
        return self.cleared_utc_s is None

    @property
    def state(self) -> str:
        """``raised``, ``acknowledged``, or ``cleared`` where the cause has ended and nobody has acknowledged it."""
        if not self.on:
            return "cleared"
        return "raised" if self.acknowledged_utc_s is None else "acknowledged"

    @property
    def sort_key(self) -> tuple[bool, int, float]:
        """Sorts alarms as people are shown them: those that are on first, then the most severe, then the oldest."""
        return not self.on, _MOST_SEVERE_FIRST.index(self.kind.severity), self.raised_utc_s
