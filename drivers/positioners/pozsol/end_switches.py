"""What shows only while axes move: where the status has axis B's bits, and whether end switches make sense."""

import math
from dataclasses import dataclass

from drivers.interfaces import AxisName, Telemetry
from drivers.positioners.pozsol.geometry import AxisSetup
from drivers.positioners.pozsol.reference import DESTINATION_TOLERANCE
from drivers.positioners.pozsol.refusals import likely_cause
from drivers.positioners.pozsol.wire import B_OUT_BIT_LPC, B_OUT_BIT_STM, SWITCH_BITS, StatusWord

# A step by which B moves for certain, and how near in time a status has to be to show that motion.
_CERTAIN_STEP = 0.1
_STATUS_WITHIN_S = 0.7
# An axis cannot get so far from a switch while the status is under way.
_FAR_DEG = 4.0
# How far an axis may run on beyond its target.
_RUN_OUT_UNITS = 1.0
# An axis is driven so far off its switch, further than _FAR_DEG, to see whether the switch opens.
_OFF_DEG = 5.0
# An axis this near to its target has left the switch.
_NEAR_DEG = 0.5


def leave_switch_position(setup: AxisSetup, here: float, possible_position: float | None) -> int | None:
    """Return the whole position to send for an axis to leave the end switch that it stands on, or seems to stand on.

    None if it need not leave it (`possible_position` is None), if it is off it already, and if the way might take it
    beyond its limit, either from `here`, its position by the count that began on the switch, or from
    `possible_position`, its position by the count before that.
    """
    if possible_position is None:
        return None
    way = setup.units(_OFF_DEG)
    # The unit adds its offset to what is sent, which is 0 at the least.
    whole = max(math.ceil(way - setup.zero_offset), 0)
    goes_to = whole + setup.zero_offset
    highest = max(setup.geometry.position(end_deg) for end_deg in (setup.minimum_deg, setup.maximum_deg))
    stays_inside = all(place + goes_to + _RUN_OUT_UNITS <= highest for place in (here, possible_position))
    return whole if stays_inside and here <= 0.5 * way else None


class LeaveSwitchMove:
    """The way of an axis off its end switch: whether it is over, and whether the unit has gone astray on it.

    Parameters
    ----------
    axis, setup
        The axis, and how it is built.
    whole
        The position that it is sent to, as `leave_switch_position` returns it.

    Attributes
    ----------
    destination
        The destination that the unit has to show.
    trouble
        Why it does not get there; empty as long as nothing speaks against it.
    """

    def __init__(self, axis: AxisName, setup: AxisSetup, whole: int) -> None:
        self._axis, self._near = axis, setup.units(_NEAR_DEG)
        self.destination = whole + setup.zero_offset
        self.trouble = ""
        self._taken = False

    def is_over(self, seen: Telemetry) -> bool:
        """Take in one look; the way is over too if something else, such as the unit's tracking, sends the axis off."""
        a, b = (seen.position_a, seen.destination_a), (seen.position_b, seen.destination_b)
        position, destination = a if self._axis == "a" else b
        aims = abs(destination - self.destination) <= DESTINATION_TOLERANCE
        if seen.faults or seen.autonomous:
            self.trouble = likely_cause(seen)
        elif self._taken and not aims:
            self.trouble = f"it heads for position {destination:g}, but was sent to {self.destination:g}"
        self._taken = self._taken or aims
        return bool(self.trouble) or abs(position - self.destination) <= self._near


@dataclass
class AxisBBitDetector:
    """Finds out where axis B's three bits (out, in, homing) begin; `bit` is None as long as that is not known."""

    bit: int | None
    _position: float | None = None
    _time_s: float = 0.0
    _direction: int = 0

    def update(self, position: float, time_s: float, word: int, status_s: float) -> None:
        """Take in one look: B's position with its time, and the status word with its own."""
        if self._position is None or time_s > self._time_s:
            way = 0
            if self._position is not None and time_s - self._time_s <= 1.0:
                step = position - self._position
                way = (step > _CERTAIN_STEP) - (step < -_CERTAIN_STEP)
            if way == self._direction and abs(time_s - status_s) <= _STATUS_WITHIN_S:
                self._conclude(way, word)
            if way or self._position is None or time_s - self._time_s > 1.0:
                self._direction, self._position, self._time_s = way, position, time_s

    def _conclude(self, way: int, word: int) -> None:
        first, second, third = (word >> (B_OUT_BIT_STM + place) & 1 for place in range(3))
        if way > 0 and first != second:
            self.bit = B_OUT_BIT_STM if first else B_OUT_BIT_LPC
        elif way < 0 and not first and (second or third):
            self.bit = B_OUT_BIT_STM if second else B_OUT_BIT_LPC


@dataclass
class SwitchCheck:
    """Compares the low end switch of an axis with the count whenever a new status has come."""

    axis: AxisName
    setup: AxisSetup
    _status_s: float = 0.0
    _last_misfit: bool = False

    @property
    def is_pending(self) -> bool:
        """Whether the next status decides."""
        return self._last_misfit

    def update(self, position: float, status: StatusWord, status_s: float) -> str:
        """Return what does not fit, seen in two statuses one after the other; empty if all fits."""
        if status_s <= self._status_s:
            return ""
        self._status_s = status_s
        closed = status.word >> SWITCH_BITS[f"{self.axis}_low"] & 1
        misfit = bool(closed) and abs(position) > self.setup.units(_FAR_DEG)
        twice, self._last_misfit = misfit and self._last_misfit, misfit
        if not twice:
            return ""
        return f"axis {self.axis.upper()} shows its low end switch closed although its count is {position:.0f}"
