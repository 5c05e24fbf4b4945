"""When the watch need not look closely: nothing has changed since its last close look, and no promise waits for time.

Every sample still sees where the axes are and which way they turn. The other questions of a close look have the same
answers as long as nothing that they depend on has changed, and no axis can have come to where an answer differs.
"""

import math
from typing import NamedTuple

from daemon.rigs.campaign.plant import PlantTracker
from solar.frames import Angles

FASTEST_COUNTED_DEG_PER_S, FASTEST_DEG_PER_S = 2.0, 5.0
"""No axis turns so fast: in the unit's count, divided by the largest count that a degree can have; and in degrees.

Full speed is a third of these.
"""


class Turning(NamedTuple):
    """Which way each axis turns: 1, -1, or 0 for one that stands."""

    a: int
    b: int


STANDS = Turning(0, 0)


def turning(before: Angles, after: Angles, least_deg: float) -> Turning:
    """Return which way the axes turn that have turned by more than the least angle [deg]."""
    return Turning(_way(after.a_deg - before.a_deg, least_deg), _way(after.b_deg - before.b_deg, least_deg))


def _way(turned_deg: float, least_deg: float) -> int:
    return 0 if abs(turned_deg) <= least_deg else 1 if turned_deg > 0.0 else -1


class ChangeDetector:
    """Knows what the last close look depended on."""

    def __init__(self) -> None:
        self._last_state: tuple[object, ...] | None = None
        self._turning = STANDS
        self._until_s = -math.inf

    def forget(self) -> None:
        """Look closely next: something is about to change."""
        self._last_state = None

    def note(self, mount: PlantTracker, now_s: float, turns: Turning, until_s: float) -> None:
        """Take note of a close look, whose findings hold until `until_s` if nothing changes."""
        self._last_state, self._turning, self._until_s = _watched_state(mount, now_s), turns, until_s

    def is_unchanged(self, mount: PlantTracker, turns: Turning, now_s: float) -> bool:
        """Tell whether a close look would find what the last one did."""
        if self._last_state is None or now_s >= self._until_s or turns != self._turning:
            return False
        return self._last_state == _watched_state(mount, now_s)


def _watched_state(mount: PlantTracker, now_s: float) -> tuple[object, ...]:
    motion = mount.motion
    return (
        motion.connected,
        motion.homing,
        motion.target is None,
        motion.unexplained_motion,
        mount.is_served,
        mount.wind_m_s,
        mount.unit.changes(now_s),
    )
