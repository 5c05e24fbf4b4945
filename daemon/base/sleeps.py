"""When and how long the machine slept: its monotonic clock stands still meanwhile, so that old values seem fresh."""

from collections import deque
from collections.abc import Sequence
from typing import NamedTuple

from daemon.base.clock import Clock

# Shorter than what a person would notice in an age.
_LEAST_S = 0.5
_MOST = 1000


class Sleep(NamedTuple):
    """One sleep: the time [s] at which the monotonic clock stood still, and how long that lasted [s]."""

    at_s: float
    lasted_s: float


def slept_since(since_s: float, sleeps: Sequence[Sleep]) -> float:
    """Return for how long the machine has slept since a monotonic time [s]."""
    return sum((each.lasted_s for each in sleeps if since_s <= each.at_s), 0.0)


class SleepGauge:
    """Tells how long the machine has slept since somebody asked last.

    Where the clock does not tell of sleeps, UTC that was set forward counts as a sleep: it looks the same.

    Parameters
    ----------
    clock
        The service's time.
    """

    def __init__(self, clock: Clock) -> None:
        self._clock = clock
        self._asleep_s = self._gauge_reading_s()

    def take_s(self) -> float:
        """Return for how long it has slept since the last call [s]."""
        before_s, self._asleep_s = self._asleep_s, self._gauge_reading_s()
        return max(self._asleep_s - before_s, 0.0)

    def _gauge_reading_s(self) -> float:
        asleep_s = self._clock.asleep_s()
        return self._clock.utc() - self._clock.monotonic() if asleep_s is None else asleep_s


class SleepWatch:
    """Finds the sleeps of the machine.

    Parameters
    ----------
    clock
        The service's time.
    """

    def __init__(self, clock: Clock) -> None:
        self._clock = clock
        self._gauge = SleepGauge(clock)
        self._looked_s = clock.monotonic()
        self._sleeps: deque[Sleep] = deque(maxlen=_MOST)

    def sleeps_until_now(self) -> tuple[Sleep, ...]:
        """Return all sleeps until now; to be called often, for a sleep is dated to the look before it."""
        slept_s = self._gauge.take_s()
        if slept_s > _LEAST_S:
            self._sleeps.append(Sleep(self._looked_s, slept_s))
        self._looked_s = self._clock.monotonic()
        return tuple(self._sleeps)
