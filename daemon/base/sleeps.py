"""When the machine slept, for how long: its steady clock stands still meanwhile, and what is old seems fresh by it."""

import sys
import time
from collections import deque
from collections.abc import Callable, Sequence
from typing import NamedTuple

from daemon.base.clock import Clock

# Below what a person would see in an age.
_LEAST_S = 0.5
_MOST = 1000


class Sleep(NamedTuple):
    """One sleep: the monotonic time [s] at which the steady clock stood, and how long that lasted [s]."""

    at_s: float
    lasted_s: float


def asleep_s() -> float:
    """Return for how long this machine has slept since it was started [s]; always 0 where that cannot be known."""
    if not sys.platform.startswith("linux"):
        return 0.0
    # clock_gettime(2): CLOCK_BOOTTIME goes on in a sleep. In this order a pause between the two can only make it less.
    return time.clock_gettime(time.CLOCK_BOOTTIME) - time.monotonic()


def slept_since(since_s: float, sleeps: Sequence[Sleep]) -> float:
    """Return for how long the machine has slept since a monotonic time [s]."""
    return sum((each.lasted_s for each in sleeps if since_s <= each.at_s), 0.0)


class SleepWatch:
    """Finds the sleeps of the machine.

    Parameters
    ----------
    clock
        The service's time.
    asleep_s
        Returns for how long the machine has slept in all [s].
    """

    def __init__(self, clock: Clock, asleep_s: Callable[[], float]) -> None:
        self._clock = clock
        self._asleep_s = asleep_s
        self._known_s = asleep_s()
        self._looked_s = clock.monotonic()
        self._sleeps: deque[Sleep] = deque(maxlen=_MOST)

    def look(self) -> tuple[Sleep, ...]:
        """Return all sleeps until now; to be called often: what comes between two looks is taken to come after one."""
        slept_s = self._asleep_s() - self._known_s
        if slept_s > _LEAST_S:
            self._known_s += slept_s
            self._sleeps.append(Sleep(self._looked_s, slept_s))
        self._looked_s = self._clock.monotonic()
        return tuple(self._sleeps)
