"""Bringing the tracker to a fixed position and keeping it there."""

import math
from collections.abc import Callable

from daemon.base.records import Target
from daemon.motion.motion import Motion

# A parked tracker that is not where it should be is sent there again this often.
_REPARK_S = 60.0


class Parking:
    """Sends the tracker to fixed positions: stow, night, snow, and where a person wants it.

    Parameters
    ----------
    motion
        Tells where the tracker is and where it is going.
    tolerance_deg
        Distance from a position that counts as being there.
    order
        Orders a move; returns whether it was taken.
    """

    def __init__(self, motion: Motion, tolerance_deg: float, order: Callable[[Target], bool]) -> None:
        self._motion = motion
        self._tolerance_deg = tolerance_deg
        self._order = order
        self._parked_s = -math.inf

    def forget(self) -> None:
        """Let the next position be ordered at once."""
        self._parked_s = -math.inf

    def park(self, target: Target, now_s: float) -> None:
        """Order a move to a position unless the tracker is there, on its way, or was sent there a moment ago.

        A refused order is given again at the next call.
        """
        if now_s - self._parked_s < _REPARK_S or self._heads_for(target) or self.stands_at(target.a_deg, target.b_deg):
            return
        if self._order(target):
            self._parked_s = now_s

    def _heads_for(self, target: Target) -> bool:
        heading = self._motion.heading
        return heading is not None and (heading.a_deg, heading.b_deg) == (target.a_deg, target.b_deg)

    def stands_at(self, a_deg: float, b_deg: float) -> bool:
        """Whether the tracker was seen to rest at a position; False while its pose is not known."""
        pose = self._motion.pose
        if self._motion.target is not None or self._motion.homing or pose is None:
            return False
        off_deg = abs(pose.a_deg - a_deg), abs(pose.b_deg - b_deg)
        return all(each_deg <= self._tolerance_deg for each_deg in off_deg)
