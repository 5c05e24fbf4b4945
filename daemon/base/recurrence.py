"""The one policy for reporting what keeps happening: the first few times singly, then by number; and rate limits."""

import math
from collections import deque
from enum import Enum

REMIND_AFTER_S = (600.0, 3600.0, 21600.0)
"""When reminders follow the first report: 10 min, 1 h and 6 h later, then every 6 h; at most 6 come in a day."""
_HOUR_S, _WINDOW_S = 3600.0, 43200.0
# More than a device can be lost within an hour.
_MOST = 10_000
_FIRST_CALM_S, _LONGEST_CALM_S = 1800.0, 21600.0


class ReportStyle(Enum):
    """How to tell of one more occurrence: by itself, as one of many, or not at all."""

    INDIVIDUAL = "plainly"
    SUMMARY = "often"
    SILENT = "quietly"


class Recurrence:
    """How often one thing has happened lately.

    The first few times in twelve hours are told one by one. After that only the number is told: at once, 10 min, 1 h
    and 6 h later and then every 6 h, until it has been calm for half an hour. If it begins anew soon after that, the
    calm has to last twice as long, so that no rhythm gets round the rule.

    Parameters
    ----------
    few
        How many times are told one by one.
    reminds
        Whether the number is told again and again, and not only once.
    """

    def __init__(self, few: int, *, reminds: bool = True) -> None:
        self._few = few
        self._reminds = reminds
        self._times: deque[float] = deque(maxlen=_MOST)
        self._is_frequent = self._tell_next_plainly = False
        self._spells = self._reminders = self._reported = self._count = 0
        self._due_s = -math.inf

    def note(self, now_s: float) -> ReportStyle:
        """Take note of one more time, at a monotonic time [s]; return how to tell it."""
        self._forget_old(now_s)
        self._times.append(now_s)
        self._count += 1
        if len(self._times) <= (self._few // 2 if self._is_frequent else self._few):
            self._begin()
            self._count = len(self._times)
            return ReportStyle.INDIVIDUAL
        if not self._is_frequent:
            if self._tell_next_plainly:
                self._tell_next_plainly = False
                return ReportStyle.INDIVIDUAL
            self._is_frequent, self._reported = True, 0
            self._spells += 1
        if now_s < self._due_s or (self._reported and not self._reminds):
            return ReportStyle.SILENT
        self._due_s = now_s + self._pause_s()
        self._reminders += 1
        self._reported += 1
        return ReportStyle.SUMMARY

    def end_if_calm(self, now_s: float, calm_since_s: float) -> int:
        """Return how often it had happened, once it has been calm for long enough; 0 before, or if nothing was told.

        The next time is told plainly again.
        """
        if not self._is_frequent or now_s - calm_since_s < min(
            _FIRST_CALM_S * 2.0 ** (self._spells - 1), _LONGEST_CALM_S
        ):
            return 0
        self._is_frequent, self._tell_next_plainly = False, True
        count, self._count = self._count, 0
        return count if self._reported else 0

    def how_often(self, now_s: float) -> str:
        """Return the number of times lately, in words."""
        self._forget_old(now_s)
        last_hour = sum(time_s > now_s - _HOUR_S for time_s in self._times)
        if last_hour > self._few:
            return f"{last_hour} times in the last hour"
        return f"{len(self._times)} times in the last 12 hours"

    def _begin(self) -> None:
        self._is_frequent = self._tell_next_plainly = False
        self._spells = self._reminders = self._reported = self._count = 0
        self._due_s = -math.inf

    def _forget_old(self, now_s: float) -> None:
        while self._times and self._times[0] <= now_s - _WINDOW_S:
            self._times.popleft()

    def _pause_s(self) -> float:
        """Return the pause to the next reminder; together they come at the times of `REMIND_AFTER_S`."""
        if self._reminders >= len(REMIND_AFTER_S):
            return REMIND_AFTER_S[-1]
        before_s = REMIND_AFTER_S[self._reminders - 1] if self._reminders else 0.0
        return REMIND_AFTER_S[self._reminders] - before_s


class LogBudget:
    """How much of the log one outside source may fill, however fast it sends: the first few lines, then numbers.

    Parameters
    ----------
    subject
        What comes from it, in the plural, as a sentence begins: ``requests that are not HTTP``.
    few
        How many are logged one by one.
    """

    def __init__(self, subject: str, few: int = 5) -> None:
        self._subject = subject
        self._recurrence = Recurrence(few)
        self._unreported = 0
        self._last_s = -math.inf
        self.count = 0

    def spend(self, now_s: float, sentence: str) -> str:
        """Take note of one more at a monotonic time [s]; return the line that the log may have, empty without one.

        After the first few there is a line with the number of those since the last one, at the times of `Recurrence`:
        a flood that lasts a whole day makes about six of those.
        """
        self.count += 1
        self._unreported += 1
        self._last_s = now_s
        wording = self._recurrence.note(now_s)
        if wording is ReportStyle.SILENT:
            return ""
        number, self._unreported = self._unreported, 0
        if wording is ReportStyle.INDIVIDUAL and number == 1:
            return sentence
        return f"{self._subject}: {number} more, and only their number is logged while they go on; latest: {sentence}"

    def poll_flood_summary(self, now_s: float) -> str:
        """Return the line that ends a flood once it has been over for half an hour, else nothing; to be polled."""
        if not self._recurrence.end_if_calm(now_s, self._last_s) or not self._unreported:
            return ""
        number, self._unreported = self._unreported, 0
        return f"{self._subject}: {number} more, the last {(now_s - self._last_s) / 60.0:.0f} min ago"


class RateLimit:
    """How often something may be done: so many at once, and then one every so often.

    Parameters
    ----------
    per_s
        How many a second in the long run.
    burst
        How many at once after a rest.
    """

    def __init__(self, per_s: float, burst: int) -> None:
        self._per_s = per_s
        self._burst = burst
        self._tokens_left = float(burst)
        self._refilled_at_s = -math.inf

    def admit(self, now_s: float) -> bool:
        """Return whether one more may be done at a monotonic time [s], and count it if so."""
        self._tokens_left = min(self._tokens_left + (now_s - self._refilled_at_s) * self._per_s, float(self._burst))
        self._refilled_at_s = now_s
        if not self._tokens_left >= 1.0:
            return False
        self._tokens_left -= 1.0
        return True
