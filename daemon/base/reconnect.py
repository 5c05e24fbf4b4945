"""The one way to keep a device in use, and the one policy of reporting an outage.

An outage is reported once when it begins, seldom while it lasts, once with its length at its end. A device that comes
and goes is reported as such: the first few times one by one, then by number (`daemon.base.recurrence`).
"""

import asyncio
import logging
import math
from collections.abc import Awaitable, Callable
from random import Random

from daemon.base.recurrence import REMIND_AFTER_S, Recurrence, ReportStyle

# People may plug a device in and out several times in a row.
_FEW = 6
# An outage this long counts as a true one, even in the middle of coming and going.
_LONG_S = 3600.0


class Outage:
    """Whether one thing works, and since when it does not.

    Parameters
    ----------
    logger
        Where the lines go.
    subject
        What works or not, as a sentence begins: ``the positioner``.
    """

    def __init__(self, logger: logging.Logger, subject: str) -> None:
        self._logger = logger
        self._subject = subject
        self._recurrence = Recurrence(_FEW)
        self._up_s = -math.inf
        self.since: float | None = None
        self.reason = ""
        self.repeats = 0

    def _begin(self, now_s: float) -> str:
        self.since = self._began_s = now_s
        self.repeats = 0
        said = self._recurrence.note(now_s)
        self._reported_plainly = said is ReportStyle.INDIVIDUAL
        # In the middle of coming and going, skip the reminders that come before an outage counts as a true one.
        self._reminders = 0 if self._reported_plainly else REMIND_AFTER_S.index(_LONG_S)
        self._remind_s = now_s + REMIND_AFTER_S[self._reminders]
        if said is ReportStyle.INDIVIDUAL:
            return self._warn(f"{self._subject} is down: {self.reason}", now_s)
        often = f"{self._subject} comes and goes: {self._recurrence.how_often(now_s)}: {self.reason}"
        if said is ReportStyle.SUMMARY:
            return self._warn(often, now_s)
        self._logger.debug("%s", often)
        return ""

    @property
    def is_down(self) -> bool:
        """Whether the outage lasts."""
        return self.since is not None

    def down(self, now_s: float, reason: str) -> str:
        """Take note of one failure at a monotonic time [s]; return the sentence of a warning, empty without one.

        The first failure is worth a warning, and so is a reminder after 10 min, 1 h, 6 h and every 6 h from then on.
        All others are debug lines. More than six outages within twelve hours are told by their number, at the same
        pauses; one of these is told by itself once it has lasted for an hour.
        """
        self.reason = reason
        if self.since is None:
            return self._begin(now_s)
        self.repeats += 1
        text = f"{self._subject} is still down: {self.reason}"
        if now_s < self._remind_s:
            self._logger.debug("%s", text, extra=self._fields(now_s))
            return ""
        self._reminders += 1
        self._remind_s = self._next_reminder(now_s)
        return self._warn(text, now_s)

    def up(self, now_s: float, how: str = "") -> str:
        """Take note that it works at a monotonic time [s]; return the sentence that ends an outage, empty without one.

        To be called as long as it works, and not only when it works again: after coming and going, the end is told only
        once it has worked for half an hour.

        Parameters
        ----------
        how
            What to tell of it when it is back.
        """
        if self.since is None:
            return self._report_steady_again(now_s)
        back = f"{self._subject} is back{': ' if how else ''}{how}"
        level = logging.INFO if self._reported_plainly else logging.DEBUG
        self._logger.log(level, "%s", back, extra=self._fields(now_s))
        self.since = None
        self.reason = ""
        self._up_s = now_s
        return back if self._reported_plainly else ""

    def _report_steady_again(self, now_s: float) -> str:
        count = self._recurrence.end_if_calm(now_s, self._up_s)
        if not count:
            return ""
        worked_min = round((now_s - self._up_s) / 60.0)
        text = f"{self._subject} is steady again: it has worked for {worked_min} min, after {count} outages"
        self._logger.info("%s", text)
        return text

    def _warn(self, text: str, now_s: float) -> str:
        self._logger.warning("%s", text, extra=self._fields(now_s) if self.repeats else None)
        return text

    def _next_reminder(self, now_s: float) -> float:
        if self._reminders < len(REMIND_AFTER_S):
            return max(self._began_s + REMIND_AFTER_S[self._reminders], now_s + REMIND_AFTER_S[0])
        return now_s + REMIND_AFTER_S[-1]

    def _fields(self, now_s: float) -> dict[str, dict[str, float]]:
        return {"fields": {"down_s": round(now_s - self._began_s, 1), "repeats": self.repeats}}


class Backoff:
    """Growing delays with jitter and a cap, the same for every device.

    Parameters
    ----------
    random
        Source of the jitter: each delay is shortened by up to a fifth, so that devices lost together do not all come
        back in the same instant.
    first_s, factor, cap_s
        The first delay, what each following one is multiplied by, and the longest.
    """

    def __init__(self, random: Random, first_s: float = 0.5, factor: float = 1.8, cap_s: float = 8.0) -> None:
        self._random = random
        self._first_s = first_s
        self._factor = factor
        self._cap_s = cap_s
        self._delay_s = first_s

    def next_s(self) -> float:
        """Return the delay before the next try and lengthen the one after."""
        delay_s = self._delay_s * (1.0 - 0.2 * self._random.random())
        self._delay_s = min(self._delay_s * self._factor, self._cap_s)
        return delay_s

    def reset(self) -> None:
        """Start again from the first delay; to be called once the device has proven itself."""
        self._delay_s = self._first_s


class PeriodicSchedule:
    """Beats at whole multiples of a period from its start, so that delays do not add up.

    Attributes
    ----------
    skipped
        How many beats were left out because the one before took too long.
    """

    def __init__(self, period_s: float) -> None:
        self._period_s = period_s
        self._due_s = math.nan
        self.skipped = 0

    def start(self, now_s: float) -> None:
        """Let the first beat be now; earlier ones are no longer waited for."""
        self._due_s = now_s

    def wait_s(self, now_s: float) -> float:
        """Return how long it is to the next beat; beats that are due already are left out and counted."""
        self._due_s += self._period_s
        if self._due_s <= now_s:
            missed = math.floor((now_s - self._due_s) / self._period_s) + 1
            self.skipped += missed
            self._due_s += missed * self._period_s
        return self._due_s - now_s


class Reconnection:
    """Keeps one device in use: after every loss it is closed, and used anew after a growing pause.

    Parameters
    ----------
    outage
        Reports the losses.
    random
        For the jitter of the pauses.
    now_s
        Returns monotonic time [s].
    notify
        Called with the sentence that begins an outage, and with the one that ends it.
    lost
        The errors that mean that the device is lost.
    hopeless
        Those among them that only a new process can mend.
    """

    def __init__(
        self,
        outage: Outage,
        random: Random,
        now_s: Callable[[], float],
        notify: Callable[[str], None],
        *,
        lost: type[Exception],
        hopeless: tuple[type[Exception], ...] = (),
    ) -> None:
        self._outage = outage
        self._backoff = Backoff(random)
        self._now_s = now_s
        self._notify = notify
        self._loss_errors = lost
        self._hopeless_errors = hopeless

    async def run(
        self,
        use: Callable[[], Awaitable[None]],
        close: Callable[[], Awaitable[None]],
        forget: Callable[[], None] = lambda: None,
    ) -> None:
        """Use the device until cancelled; raises the errors that are hopeless.

        Parameters
        ----------
        use
            Opens the device and works with it; `note_working` is to be called as soon as it has proven itself.
        close
            Releases it, after every loss.
        forget
            Called at every loss before it is reported: what was wanted of the device is wanted no longer.
        """
        while True:
            try:
                await use()
            except self._hopeless_errors:
                raise
            except self._loss_errors as error:
                forget()
                self._report(str(error))
                await close()
                await asyncio.sleep(self._backoff.next_s())

    def note_working(self, how: str = "") -> bool:
        """Take note that the device works, to be called as long as it does; return whether that was worth telling.

        Parameters
        ----------
        how
            What to tell of it when it is back.
        """
        self._backoff.reset()
        text = self._outage.up(self._now_s(), how)
        if text:
            self._notify(text)
        return bool(text)

    def _report(self, reason: str) -> None:
        begins = not self._outage.is_down
        text = self._outage.down(self._now_s(), reason)
        if begins and text:
            self._notify(text)
