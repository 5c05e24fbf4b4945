"""Noticing that the machine's clock has been set, and not trusting the sun's position until the time is known again."""

import math
from collections.abc import Callable

from daemon.base.alarms.alarms import Alarms
from daemon.base.clock import Clock, minute_utc

_STEP_S = 2.0
_DISTRUST_S = 30.0
# Smaller steps are added up for so long only: what daily corrections add up to in a year is no reason for doubt.
_ADD_UP_S = 3600.0
# A program that synchronises the clock needs some time after a start of the machine, or after somebody has set it.
_SYNCHRONISE_WITHIN_S = 120.0
_ASK_EVERY_S = 60.0

_NEVER_SYNCHRONISED_TEXT = (
    "the clock of this machine has not been synchronised since it was started or set, and the sun's position comes from"
    " it: see 'timedatectl' and the network"
)


class ClockWatch:
    """Compares UTC with time that nobody sets: monotonic time, and the sleeps of the machine.

    Where the clock does not tell of sleeps, a sleep counts as a step forward.

    Parameters
    ----------
    clock
        The service's time.
    alarms
        Told while the clock is in doubt; None for nobody.
    synchronised
        Whether anything has synchronised the clock since it was set last; None where that cannot be known.
    ran_utc_s
        When the service ran before [s], by this clock: an earlier time is doubted like one that was set back.

    Attributes
    ----------
    trusted
        Whether the time of day may be used to find the sun, by the last look.
    corrections
        How many times a new time was believed in place of the old one: findings by the sun until then are void.
    """

    def __init__(
        self,
        clock: Clock,
        alarms: Alarms | None = None,
        synchronised: Callable[[], bool | None] = lambda: None,
        ran_utc_s: float = -math.inf,
    ) -> None:
        self._clock = clock
        self._alarms = alarms
        self._synchronised = synchronised
        self._offset_s = self._believed_s = clock.utc() - self._monotonic_with_sleep_s()
        self._believed_at_s = clock.monotonic()
        self._ask_s = clock.monotonic() + _SYNCHRONISE_WITHIN_S
        # None: not asked yet, and nothing to tell of.
        self._never_synchronised: bool | None = None
        self.trusted = True
        self.corrections = 0
        # Why the time of the start is doubted; None once a time has been believed.
        self._wrong_start: str | None = None
        if ran_utc_s - clock.utc() > _DISTRUST_S and synchronised() is not True:
            self.trusted, self._never_synchronised = False, False
            self._believed_s = ran_utc_s - self._monotonic_with_sleep_s()
            self._wrong_start = _start_doubt_text(clock.utc(), ran_utc_s)

    def step_s(self) -> float | None:
        """Return by how much UTC has stepped since the last call [s], or None if it has not.

        Slow corrections (slewing) add up unnoticed; a step of more than 30 s, or steps that make as much within an
        hour, make the sun's position doubtful. That the clock has run on since then proves nothing: it is trusted again
        when it is back where it would be without the step, or synchronised.
        """
        now_s = self._clock.monotonic()
        offset_s = self._clock.utc() - self._monotonic_with_sleep_s()
        step_s = offset_s - self._offset_s
        self._offset_s = offset_s
        if self.trusted and abs(step_s) < _STEP_S:
            self._believed_s += step_s
        if abs(step_s) > _DISTRUST_S or (self.trusted and self._deviation_s > _DISTRUST_S):
            self.trusted, self._never_synchronised = False, bool(self._never_synchronised)
            self._ask_s = now_s + _SYNCHRONISE_WITHIN_S
        self._ask(now_s)
        if now_s - self._believed_at_s >= _ADD_UP_S if self.trusted else self._deviation_s <= _DISTRUST_S:
            self._believe(now_s)
        self._report()
        return step_s if abs(step_s) >= _STEP_S else None

    @property
    def believed_utc_s(self) -> float:
        """UTC [s] as last believed: what the clock would show if nobody had set it, within 30 s while not in doubt."""
        return self._monotonic_with_sleep_s() + self._believed_s

    @property
    def trusted_now(self) -> bool:
        """Whether the time of day is right as far as is known at this instant, and not only at the last look."""
        return self.trusted and abs(self._clock.utc() - self.believed_utc_s) <= _DISTRUST_S

    def _monotonic_with_sleep_s(self) -> float:
        return self._clock.monotonic() + (self._clock.asleep_s() or 0.0)

    def _ask(self, now_s: float) -> None:
        if now_s < self._ask_s:
            return
        synchronised = self._synchronised()
        self._never_synchronised = synchronised is False
        if synchronised is True and not self.trusted:
            self._believe(now_s)
            self.corrections += 1
        # Once synchronised, a clock of this machine keeps time well enough for the sun.
        self._ask_s = now_s + _ASK_EVERY_S if self._never_synchronised or not self.trusted else math.inf

    @property
    def _deviation_s(self) -> float:
        return abs(self._offset_s - self._believed_s)

    def _believe(self, now_s: float) -> None:
        self.trusted, self._believed_s, self._believed_at_s = True, self._offset_s, now_s
        self._wrong_start = None

    def _report(self) -> None:
        if self._alarms is None:
            return
        if not self.trusted:
            self._alarms.set("clock", self._wrong_start or _doubt_text(self._offset_s - self._believed_s))
        elif self._never_synchronised is not None:
            self._alarms.set("clock", _NEVER_SYNCHRONISED_TEXT if self._never_synchronised else None)


_UNITS = (("s", 1.0, 120.0), ("min", 60.0, 7200.0), ("h", 3600.0, 172_800.0), ("days", 86_400.0, 63_115_200.0))
_YEAR_S = 31_557_600.0


def step_words(step_s: float) -> str:
    """Return a step of the clock [s] as a person says it: ``set forward by 52 years``, ``set back by 61 min``."""
    return f"set {'forward' if step_s > 0 else 'back'} by {_duration_words(abs(step_s))}"


def _duration_words(size_s: float) -> str:
    found = next((f"{size_s / of_s:.3g} {unit}" for unit, of_s, below_s in _UNITS if size_s < below_s), None)
    return found or f"{size_s / _YEAR_S:.0f} years"


def sleep_text(slept_s: float) -> str:
    """Return the sentence for a sleep of the machine of so long [s]."""
    return f"the machine slept for {_duration_words(slept_s)}: readings and wind from before the sleep no longer count"


def clock_step_text(step_s: float, now_utc_s: float) -> str:
    """Return the sentence for a step of the clock [s] to this UTC [s], from when to when where minutes tell it."""
    before, now = minute_utc(now_utc_s - step_s), minute_utc(now_utc_s)
    return f"the clock was {step_words(step_s)}{f', from {before} to {now}' if before != now else ''}"


def _doubt_text(off_s: float) -> str:
    return (
        f"the clock was {step_words(off_s)}, and nothing confirms the new time: the sun's position is not used until"
        " the clock is synchronised (see 'timedatectl') or the step undone; if the time is right, restart the service"
    )


def _start_doubt_text(utc_s: float, ran_utc_s: float) -> str:
    return (
        f"by the clock this start of the service was at {minute_utc(utc_s)}, before the last one at"
        f" {minute_utc(ran_utc_s)}, and nothing confirms its time: the sun's position is not used until the clock is"
        " synchronised (see 'timedatectl'); where nothing synchronises it, set it right and restart the service"
    )
