"""Whether a reference run has begun and whether it is over, from telemetry that says so late or not at all."""

from dataclasses import dataclass, field

from drivers.interfaces import Axis, Telemetry
from drivers.pozsol_wire import Status

# More than an axis runs out on its ramp, in the unit's position units.
_MOVED = 1.0
_STILL_S = 5.0


@dataclass
class HomingRun:
    """One axis on its way to the low end switch, where its position and destination become 0.

    Parameters
    ----------
    axis
        Which one.
    before
        Telemetry just before the command.
    sent_s
        Time from which telemetry may show the command's effect.
    status_shows
        The status word is known to tell of this axis' homing.

    Attributes
    ----------
    begun, over
        What has shown so far.
    """

    axis: Axis
    before: Telemetry
    sent_s: float
    status_shows: bool
    begun: bool = False
    over: bool = False
    _last: float | None = field(default=None, repr=False)
    _changed_s: float = field(default=0.0, repr=False)
    _moved: bool = field(default=False, repr=False)

    def look(
        self,
        positions: tuple[float, float],
        destinations: tuple[float, float],
        status: Status,
        status_s: float,
        now_s: float,
    ) -> None:
        """Take note of the newest positions and destinations of A and B, and of the status with its time [s]."""
        index = 0 if self.axis == "a" else 1
        position, at_zero = positions[index], positions[index] == destinations[index] == 0.0
        start = self.before.position_a if self.axis == "a" else self.before.position_b
        if position != self._last:
            self._last, self._changed_s = position, now_s
        self._moved = self._moved or abs(position - start) > _MOVED
        fresh = status_s > self.sent_s
        if fresh and self.status_shows:
            self.begun = self.begun or status.homing or at_zero
            self.over = not status.homing
            return
        # An axis that stands on its switch is home before anybody can look.
        self.begun = self.begun or self._moved or (at_zero and (start != 0.0 or fresh))
        if self.status_shows:
            return
        still = now_s - max(self._changed_s, self.sent_s) > _STILL_S
        self.over = self.begun and ((at_zero and (self._moved or still)) or (still and fresh))
