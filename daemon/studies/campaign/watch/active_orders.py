"""Which motion of an axis is explained: what counts as an order, and for how long after it an axis may run out."""

import math
from typing import Literal, NamedTuple

from drivers.interfaces import AxisName
from drivers.positioners.pozsol import wire
from drivers.positioners.pozsol.wire import Field
from drivers.positioners.rotctld.protocol import SET_POSITION

RUN_OUT_S = 3.0
AT_TARGET_DEG = 0.3
"""This close to its destination, an axis may turn either way."""
_SAME_DESTINATION = 0.5
# A reference run first drives an axis this far off its end switch if it may stand on the switch.
_LEAVES_SWITCH_DEG = 6.0

_TARGETS: dict[int, AxisName] = {
    Field.A_ANGLE: "a", Field.B_ANGLE: "b", Field.A_DESTINATION: "a", Field.B_DESTINATION: "b"
}  # fmt: skip
_ROTCTLD = b"+"
_HOMES: dict[bytes, AxisName] = {wire.HOME_A.encode(): "a", wire.HOME_B.encode(): "b"}

MotionReason = Literal["hand", "home", "order", "run-out"]


class AxisCount(NamedTuple):
    """What the unit itself says of an axis: position and destination in the unit that it counts in.

    `per_deg` is the largest count that a degree can have.
    """

    position: float
    destination: float
    per_deg: float

    @property
    def left_deg(self) -> float:
        """How far it is to the destination at the least [deg]."""
        return abs(self.destination - self.position) / self.per_deg


class ActiveOrders:
    """The orders of each axis that have not been taken back.

    An order counts from when the driver has seen the unit take it, as long as the unit's own destination stays the
    same, and only for motion towards it. A destination that somebody else has set is no order of the service.

    Attributes
    ----------
    packets
        How many packets have reached the unit.
    by_position
        Whether the unit shows where it is and not where it heads: while it turns towards the target of the service,
        nobody can know that it has another one.
    """

    def __init__(self) -> None:
        self._destination: dict[AxisName, float | None] = {"a": None, "b": None}
        self._homing: set[AxisName] = set()
        self._ordered_axes: set[AxisName] = set()
        self._run_out_s = -math.inf
        self._button_held = False
        self._released_s = -math.inf
        self.by_position = False
        self.packets = 0

    def note_packet(self, data: bytes, now_s: float) -> None:
        """Note a packet: a target or a reference run begins an order; a stop or a new status takes orders back."""
        self.packets += 1
        if data.startswith(_ROTCTLD):
            self.by_position = True
            if SET_POSITION.encode() in data:
                self._begin_order("a", now_s)
                self._begin_order("b", now_s)
            else:
                self._cancel_orders(now_s)
            return
        at = data.find(b"$")
        if not 0 <= at < len(data) - 1:
            return
        code, value = data[at + 1], data[at + 2 : at + 3].lower()
        if code in _TARGETS:
            self._begin_order(_TARGETS[code], now_s)
        elif code == Field.ACTION and value in _HOMES:
            self._cancel_orders(now_s)
            self._homing.add(_HOMES[value])
        elif code == Field.STATUS or (code == Field.ACTION and value == wire.STOP.encode()):
            self._cancel_orders(now_s)

    def _begin_order(self, axis: AxisName, now_s: float) -> None:
        if self._destination[axis] is not None:
            # An axis that reverses runs on the old way first.
            self._run_out_s = now_s + RUN_OUT_S
        self._destination[axis] = None
        self._ordered_axes.add(axis)

    def _cancel_orders(self, now_s: float) -> None:
        if self._homing or any(destination is not None for destination in self._destination.values()):
            self._run_out_s = now_s + RUN_OUT_S
        self._destination = {"a": None, "b": None}
        self._homing.clear()
        self._ordered_axes.clear()

    def confirm(self, a: AxisCount, b: AxisCount) -> None:
        """Take the unit's destinations for ours from now on: the driver has seen it take a target."""
        self._destination = {"a": a.destination, "b": b.destination}

    def note_button(self, *, is_held: bool, now_s: float) -> None:
        """Note that a person holds a button at the unit, or lets it go."""
        self._button_held = is_held
        self._released_s = now_s

    def by_hand(self, now_s: float) -> bool:
        """Tell whether a person's hand may move an axis."""
        return self._button_held or now_s - self._released_s < RUN_OUT_S

    def why(
        self, axis: AxisName, counted: AxisCount, now_s: float, *, counts_up: bool, homing: bool, heading: bool
    ) -> MotionReason | None:
        """Return why an axis may move, or None.

        Parameters
        ----------
        axis, counted
            The axis, and what the unit says of it.
        now_s
            The time.
        counts_up
            Whether it truly turns to where its counted position is greater.
        homing, heading
            Whether the service itself says that a reference run, or a move to a target, is on.
        """
        if self.by_hand(now_s):
            return "hand"
        if axis in self._homing and homing:
            return "home"
        off_switch = 0.0 < counted.destination <= _LEAVES_SWITCH_DEG * counted.per_deg
        if homing and axis in self._ordered_axes and off_switch and counts_up:
            return "order"
        if heading and self._is_ordered(axis, counted, counts_up=counts_up):
            return "order"
        return "run-out" if now_s < self._run_out_s else None

    def _is_ordered(self, axis: AxisName, counted: AxisCount, *, counts_up: bool) -> bool:
        destination = self._destination[axis]
        if destination is None or (not self.by_position and abs(counted.destination - destination) > _SAME_DESTINATION):
            return False
        way = destination - counted.position
        return abs(way) <= AT_TARGET_DEG * counted.per_deg or (way > 0) is counts_up
