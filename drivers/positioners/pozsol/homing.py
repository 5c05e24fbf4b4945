"""Whether a reference run has begun, whether it is over, and whether it ended on its switch.

The unit reports a run late, and only while Hall pulses come, and it aborts a run without a report when its supply
dips. So the verdict takes the homing bit, the position and the end switch together.
"""

import math
from dataclasses import dataclass, field
from typing import NamedTuple

from drivers.interfaces import AxisName
from drivers.positioners.pozsol.geometry import AxisSetup
from drivers.positioners.pozsol.wire import StatusWord

# More than an axis runs out on its ramp, in the unit's position units.
_MOVED = 1.0
_STILL_S = 0.5
# While homing the unit aims at ten units inwards of where it is.
_AIM_INWARDS_UNITS = 2.0
# An axis coasts past its switch; a count that differs from 0 by more was not set there.
_COAST_DEG = 0.4
# How far off a count may be since the last run without anything being wrong, and how far an axis may have turned since
# it was last seen if its count was lost in motion.
_SLIP_DEG, _LOST_DEG = 0.5, 5.0


class AxisObservation(NamedTuple):
    """What one look shows of one axis; `time_s` is that of its position, `status_s` that of the status."""

    position: float
    destination: float
    remain: float
    time_s: float
    status: StatusWord
    status_s: float


@dataclass
class HomingRun:
    """One axis on its way to the low end switch, where the unit sets position and destination to 0.

    Parameters
    ----------
    axis, setup
        The axis, and how it is built.
    start
        Position just before the command.
    sent_s
        Time from which telemetry may show the command's effect.
    trusted
        The count was not in doubt before.
    last_trusted_position
        Where the axis stood by the last count that could be trusted; `start` if `trusted`, None if unknown.

    Attributes
    ----------
    begun, over
        Whether telemetry has shown that the run began, and that it is over.
    failure
        Once over: why the run did not find the switch; empty if it did.
    mismatch
        Once over without failure: how the switch contradicts the count; empty if it does not.
    position_if_switch_wrong
        Once over, if the count and the switch contradict each other: where the axis stands if the switch is wrong.
    """

    axis: AxisName
    setup: AxisSetup
    start: float
    sent_s: float
    trusted: bool
    last_trusted_position: float | None
    begun: bool = False
    over: bool = False
    failure: str = ""
    mismatch: str = ""
    position_if_switch_wrong: float | None = None
    travelled: bool = False
    _last: float | None = field(default=None, repr=False)
    _changed_s: float = field(default=0.0, repr=False)

    def update(self, seen: AxisObservation) -> None:
        """Take note of the newest telemetry."""
        if self.over or seen.time_s <= self.sent_s:
            return
        if self._last is None or abs(seen.position - self._last) > self.setup.step:
            self._last, self._changed_s = seen.position, seen.time_s
        self.travelled = self.travelled or self._moved(seen)
        fresh = seen.status_s > self.sent_s
        self.begun = self.begun or self._begins(seen, fresh)
        rested = seen.time_s - self._changed_s >= _STILL_S and seen.status_s >= self._changed_s
        aims_here = abs(seen.destination - seen.position) <= _MOVED
        if self.begun and rested and aims_here and not self._bit(seen.status):
            self.over = True
            self._judge(seen)

    def _moved(self, seen: AxisObservation) -> bool:
        return abs(seen.position - self.start) > _MOVED and not self._is_at_zero(seen)

    def _begins(self, seen: AxisObservation, fresh: bool) -> bool:
        inwards = seen.destination < seen.position - _AIM_INWARDS_UNITS
        # An axis that stands on its switch is home before anybody can look.
        return (fresh and bool(self._bit(seen.status))) or self._moved(seen) or inwards or self._is_at_zero(seen)

    def _bit(self, status: StatusWord) -> bool | None:
        return status.a_homing if self.axis == "a" else status.b_homing

    def _is_at_zero(self, seen: AxisObservation) -> bool:
        coast = self.setup.units(_COAST_DEG)
        return abs(seen.position) <= coast and abs(seen.destination) <= coast

    def _judge(self, seen: AxisObservation) -> None:
        name, faults = self.axis.upper(), [fault for fault in seen.status.faults if fault.startswith(self.axis)]
        if faults:
            self.failure = f"the reference run of {name} ended with {', '.join(faults)}"
        elif not self._is_at_zero(seen):
            self.failure = f"the reference run of {name} ended at {seen.position:g}, not on its end switch"
        elif f"{self.axis}_low" not in seen.status.end_switches:
            self.failure = f"after the reference run of {name} its low end switch does not show as closed"
        else:
            self.mismatch = self._mismatch(seen)

    def _mismatch(self, seen: AxisObservation) -> str:
        slip, name = self.setup.units(_SLIP_DEG), self.axis.upper()
        stood = self.start if self.last_trusted_position is None else self.last_trusted_position
        if not self.travelled and not (abs(stood) <= slip):
            return (
                f"axis {name} did not move on its reference run although it stood at {stood:g}:"
                " its low end switch may be stuck"
            )
        if f"{self.axis}_high" in seen.status.end_switches:
            return f"axis {name} shows both of its end switches closed"
        expected, allowed = self.start - stood, slip if self.trusted else self.setup.units(_LOST_DEG)
        if self.last_trusted_position is not None and not (abs(seen.remain - expected) <= allowed):
            self.position_if_switch_wrong = seen.remain - expected if math.isfinite(seen.remain - expected) else None
            return (
                f"axis {name} met its end switch where its count was {seen.remain:g}, not {expected:g}: home it again"
                " to see whether count or switch is wrong"
            )
        return ""
