"""Noticing that the machine's clock has been set, and not trusting the sun's position until it has settled."""

import math

from daemon.clock import Clock

_STEP_S = 2.0
_DISTRUST_S = 30.0
_SETTLE_S = 900.0


class ClockWatch:
    """Compares UTC with monotonic time.

    Parameters
    ----------
    clock
        The service's time.
    """

    def __init__(self, clock: Clock) -> None:
        self._clock = clock
        self._offset_s = clock.utc() - clock.monotonic()
        self._distrust_until_s = -math.inf

    def step_s(self) -> float | None:
        """Return by how much UTC has stepped since the last call [s], or None if it has not.

        Slow corrections (slewing) add up unnoticed; a step of more than 30 s makes the sun's position doubtful for the
        next 15 minutes, in which a wrong time would be set right again.
        """
        now_s = self._clock.monotonic()
        offset_s = self._clock.utc() - now_s
        step_s = offset_s - self._offset_s
        self._offset_s = offset_s
        if abs(step_s) < _STEP_S:
            return None
        if abs(step_s) > _DISTRUST_S:
            self._distrust_until_s = now_s + _SETTLE_S
        return step_s

    @property
    def trusted(self) -> bool:
        """Whether the time of day may be used to find the sun."""
        return self._clock.monotonic() >= self._distrust_until_s
