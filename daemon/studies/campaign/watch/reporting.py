"""Whether what the unit does by itself is reported, and nothing is reported that never happened."""

import math
from collections.abc import Callable
from dataclasses import dataclass
from itertools import islice

from daemon.base.records import Event, Mode, ModeChange, Record
from daemon.rigs.campaign.plant import PlantTracker
from daemon.studies.campaign.watch.count_check import COUNT_TOLERANCE_DEG

WORTH_REPORTING_DEG, WORTH_BY_POSITION_DEG = 0.5, 1.2
"""The second is for a unit that reports positions alone: motion shows half a second and a quarter degree later."""
REPORTED_WITHIN_S = 10.0
"""The unit shows some things in its slow screens only, and control decides every 5 s."""
MOVE_ENDS_WITHIN_S, ATTEMPT_ENDS_WITHIN_S = 60.0, 20.0
"""What goes wrong in a move is reported when the move ends, after its attempts."""
CAUSE_WITHIN_S = 30.0
_JUMPED = "the count jumped"
_SUBJECTS = ("alarm", "positioner", "control")
_LATE_RECORDS = 500


@dataclass(frozen=True, slots=True)
class Violation:
    """A broken promise: its name, when, and what was seen."""

    promise: str
    at_s: float
    text: str

    def __str__(self) -> str:
        return f"{self.promise} at {self.at_s:.2f} s: {self.text}"


class Reporting:
    """Compares what the axes did without an order with what the service has reported.

    Parameters
    ----------
    fails
        Called with a promise and a text.
    """

    def __init__(self, fails: Callable[[str, str], None]) -> None:
        self._fails = fails
        self._turned_deg = 0.0
        self._turned_s = -math.inf
        self._begun_s: float | None = None
        self._unreported: list[tuple[float, float]] = []
        self._cause_s = -math.inf
        self._blocked: str | None = None
        self._jumped = False

    @property
    def is_pending(self) -> bool:
        """Whether a report is due, or an axis turns so that one may become due."""
        return bool(self._unreported) or self._begun_s is not None

    def note_cause(self, now_s: float) -> None:
        """Note that a fault begins or ends, or that a hand is at the unit."""
        self._cause_s = now_s

    def note_unexplained_motion(self, turned_deg: float, now_s: float, *, by_position: bool = False) -> None:
        """Note that an axis turns without an order, and the service could know; `by_position`: by positions alone."""
        self._cause_s = now_s
        if self._begun_s is None or now_s - self._turned_s > REPORTED_WITHIN_S:
            self._begun_s, self._turned_deg = now_s, 0.0
        self._turned_s = now_s
        self._turned_deg += abs(turned_deg)
        if self._turned_deg >= (WORTH_BY_POSITION_DEG if by_position else WORTH_REPORTING_DEG):
            self._unreported.append((self._begun_s, self._turned_deg))
            self._begun_s = None

    def note_standstill(self) -> None:
        """Note that both axes stand, or move by an order."""
        self._begun_s = None

    def check(self, mount: PlantTracker, now_s: float, *, by_hand: bool) -> None:
        """Compare with what has been reported by now."""
        blocked = mount.motion.unexplained_motion
        if by_hand:
            self._cause_s = now_s
        if blocked is not None and self._blocked is None and now_s - self._cause_s > CAUSE_WITHIN_S:
            self._fails("false-alarm", f"nothing has moved by itself, but: {blocked}")
        self._blocked = blocked
        jumped = _JUMPED in (mount.motion.doubt or "")
        if jumped and not self._jumped and now_s - self._cause_s > CAUSE_WITHIN_S and _has_true_count(mount, now_s):
            self._fails("false-alarm", f"the unit has kept its count, but: {mount.motion.doubt}")
        self._jumped = jumped
        ends_s = max(MOVE_ENDS_WITHIN_S, mount.settings.motion.attempts * ATTEMPT_ENDS_WITHIN_S)
        within_s = REPORTED_WITHIN_S if mount.motion.target is None else ends_s
        while self._unreported and now_s - self._unreported[0][0] > within_s:
            begun_s, turned_deg = self._unreported.pop(0)
            late = islice(reversed(mount.records), _LATE_RECORDS)
            if not blocked and not any(_is_report_since(record, begun_s) for record in late):
                self._fails(
                    "unreported",
                    f"from {begun_s:.1f} s on an axis turned {turned_deg:.1f} deg, and nothing was reported",
                )

    def forget(self) -> None:
        """Expect no report of what has turned: the service is gone, or out of reach of its unit."""
        self._unreported.clear()
        self._begun_s = None


def _has_true_count(mount: PlantTracker, now_s: float) -> bool:
    at = mount.axes()
    shown_deg = mount.unit.shown_deg("a", now_s), mount.unit.shown_deg("b", now_s)
    return max(abs(shown_deg[0] - at.a_deg), abs(shown_deg[1] - at.b_deg)) < COUNT_TOLERANCE_DEG


def _is_report_since(record: Record, since_s: float) -> bool:
    told = isinstance(record, Event) and record.subject in _SUBJECTS
    # A fault may be over before its alarm is raised, for example on a reference run: then only the mode tells of it.
    faulty = isinstance(record, ModeChange) and record.after is Mode.FAULT
    return (told or faulty) and record.time_monotonic_s >= since_s - 1.0
