"""Which motion of an axis is explained: what counts as an order, and for how long after it an axis may run out."""

import math

from drivers.positioners.pozsol import wire
from drivers.positioners.pozsol.wire import Field

RUN_OUT_S = 3.0
AT_TARGET = 1.5
"""Units of position within which direction says nothing any more."""

_TARGETS = {Field.A_ANGLE: "a", Field.B_ANGLE: "b", Field.A_DESTINATION: "a", Field.B_DESTINATION: "b"}
_HOMES = {wire.HOME_A.encode(): "a", wire.HOME_B.encode(): "b"}


class Explained:
    """What has been ordered of each axis and not been taken back.

    An order counts from when the driver has seen the unit take it, as long as the unit's own destination stays what it
    was then, and in its direction only. Nobody else's destination is ours.
    """

    def __init__(self):
        self._destination = {"a": None, "b": None}
        self._homing = set()
        self._run_out_s = -math.inf
        self._held = False
        self._released_s = -math.inf
        self.packets = 0

    def packet(self, data, now):
        """A packet reaches the unit: whatever it was about, the last order is over, or there is a new one to come."""
        self.packets += 1
        at = data.find(b"$")
        if not 0 <= at < len(data) - 1:
            return
        code, value = data[at + 1], data[at + 2 : at + 3].lower()
        if code in _TARGETS:
            axis = _TARGETS[code]
            if self._destination[axis] is not None:
                # On a reversal it runs the old way first.
                self._run_out_s = now + RUN_OUT_S
            self._destination[axis] = None
        elif code == Field.ACTION and value in _HOMES:
            self._take_back(now)
            self._homing.add(_HOMES[value])
        elif code == Field.STATUS or (code == Field.ACTION and value == wire.STOP.encode()):
            self._take_back(now)

    def _take_back(self, now):
        if self._homing or any(destination is not None for destination in self._destination.values()):
            self._run_out_s = now + RUN_OUT_S
        self._destination = {"a": None, "b": None}
        self._homing.clear()

    def confirmed(self, target, readings, now):
        """The driver has seen the unit take a target; its destinations are ours from now on."""
        self._destination = {axis: readings[axis][1] for axis in "ab"}

    def held(self, *, is_held, now):
        """A person holds a button at the unit, or lets it go."""
        self._held = is_held
        self._released_s = now

    def by_hand(self, now):
        return self._held or now - self._released_s < RUN_OUT_S

    def why(self, axis, turned_deg, readings, now, *, homing, heading):
        """Return why an axis may move, or None.

        Parameters
        ----------
        homing, heading
            Whether the service itself says that a reference run, or a move to a target, is on.
        """
        if self.by_hand(now):
            return "hand"
        if axis in self._homing and homing:
            return "home"
        if heading and self._is_ordered(axis, turned_deg, readings):
            return "order"
        return "run-out" if now < self._run_out_s else None

    def _is_ordered(self, axis, turned_deg, readings):
        destination = self._destination[axis]
        position, heads_for = readings[axis]
        if destination is None or abs(heads_for - destination) > 0.5:
            return False
        way = destination - position
        return abs(way) <= AT_TARGET or (way > 0) == (turned_deg > 0)
