"""Noticing that the machine's clock has been set, and not trusting the sun's position until it has settled."""

import math
from collections.abc import Callable

from daemon.base.alarms.alarms import Alarms
from daemon.base.clock import Clock

_STEP_S = 2.0
_DISTRUST_S = 30.0
_SETTLE_S = 900.0
# What synchronises the clock needs some time after a start of the machine.
_SYNCHRONISE_WITHIN_S = 120.0
_ASK_EVERY_S = 60.0

_NEVER = (
    "the clock of this machine has not been synchronised since it started, and the sun's position comes from it:"
    " see 'timedatectl' and the network"
)


class ClockWatch:
    """Compares UTC with monotonic time.

    Parameters
    ----------
    clock
        The service's time.
    alarms
        Told while the clock is in doubt; None for nobody.
    synchronised
        Whether anything has synchronised the clock; None where that cannot be known.
    """

    def __init__(
        self, clock: Clock, alarms: Alarms | None = None, synchronised: Callable[[], bool | None] = lambda: None
    ) -> None:
        self._clock = clock
        self._alarms = alarms
        self._synchronised = synchronised
        self._offset_s = clock.utc() - clock.monotonic()
        self._distrust_until_s = -math.inf
        self._why = ""
        self._ask_s = clock.monotonic() + _SYNCHRONISE_WITHIN_S
        self._never = False

    def step_s(self) -> float | None:
        """Return by how much UTC has stepped since the last call [s], or None if it has not.

        Slow corrections (slewing) add up unnoticed; a step of more than 30 s makes the sun's position doubtful for the
        next 15 minutes, in which a wrong time would be set right again.
        """
        now_s = self._clock.monotonic()
        offset_s = self._clock.utc() - now_s
        step_s = offset_s - self._offset_s
        self._offset_s = offset_s
        if abs(step_s) > _DISTRUST_S:
            self._distrust_until_s = now_s + _SETTLE_S
            self._why = (
                f"the clock was set by {step_s:+z.0f} s: the sun's position is not used before it has kept time for"
                f" {_SETTLE_S / 60:.0f} minutes; check the time"
            )
        self._report(now_s)
        return step_s if abs(step_s) >= _STEP_S else None

    @property
    def trusted(self) -> bool:
        """Whether the time of day may be used to find the sun."""
        return self._clock.monotonic() >= self._distrust_until_s

    def _report(self, now_s: float) -> None:
        if now_s >= self._ask_s:
            self._never = self._synchronised() is False
            # Once synchronised, a clock of this machine keeps time well enough for the sun.
            self._ask_s = now_s + _ASK_EVERY_S if self._never else math.inf
        if self._alarms is not None:
            never = _NEVER if self._never else None
            self._alarms.set("clock", self._why if now_s < self._distrust_until_s else never)
