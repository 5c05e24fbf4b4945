"""The one policy of telling what keeps happening: the first few times, then ever more seldom that it does."""

import math
from collections import deque
from enum import Enum

REMIND_AFTER_S = (600.0, 3600.0, 21600.0)
"""At most 9 reminders in a day: 10 min, 1 h, 6 h, then every 6 h."""
_HOUR_S, _WINDOW_S = 3600.0, 43200.0
# More than a device can be lost within an hour.
_MOST = 10_000
_FIRST_CALM_S, _LONGEST_CALM_S = 1800.0, 21600.0


class Wording(Enum):
    """How to tell of one more time: by itself, as one of many, or not at all."""

    PLAINLY = "plainly"
    OFTEN = "often"
    QUIETLY = "quietly"


class Recurrence:
    """How often one thing has happened lately.

    The first few in twelve hours are told each for itself. After that only the number is told: at once, 10 min, 1 h and
    6 h later and then every 6 h, until it has been calm for half an hour; if it begins anew soon after that, for twice
    as long, so that no rhythm gets round it.

    Parameters
    ----------
    few
        How many are told each for itself.
    reminds
        Whether the number is told again and again, and not only once.
    """

    def __init__(self, few: int, *, reminds: bool = True) -> None:
        self._few = few
        self._reminds = reminds
        self._times: deque[float] = deque(maxlen=_MOST)
        self._often = self._new_chance = False
        self._spells = self._reminders = self._reported = self._count = 0
        self._due_s = -math.inf

    def note(self, now_s: float) -> Wording:
        """Take note of one more time, at a monotonic time [s]; return how to tell it."""
        self._forget_old(now_s)
        self._times.append(now_s)
        self._count += 1
        if len(self._times) <= (self._few // 2 if self._often else self._few):
            self._begin()
            self._count = len(self._times)
            return Wording.PLAINLY
        if not self._often:
            if self._new_chance:
                self._new_chance = False
                return Wording.PLAINLY
            self._often, self._reported = True, 0
            self._spells += 1
        if now_s < self._due_s or (self._reported and not self._reminds):
            return Wording.QUIETLY
        self._due_s = now_s + self._pause_s()
        self._reminders += 1
        self._reported += 1
        return Wording.OFTEN

    def over(self, now_s: float, calm_since_s: float) -> int:
        """Return how often it had happened, once it has been calm for long enough and if that was told, else 0.

        The next time is told plainly again.
        """
        if not self._often or now_s - calm_since_s < min(_FIRST_CALM_S * 2.0 ** (self._spells - 1), _LONGEST_CALM_S):
            return 0
        self._often, self._new_chance = False, True
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
        self._often = self._new_chance = False
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
