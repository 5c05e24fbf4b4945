"""When a notice is sent: at once, after the quiet hours, or gathered with others if there are too many."""

from dataclasses import replace
from datetime import time

from daemon.base.recurrence import RateLimit
from daemon.notify.notices import Notice, combine_notices

_RETRY_PAUSES_S = (30.0, 60.0, 300.0, 900.0)
_MOST_WAITING = 200


class QuietHours:
    """A span of the local day; it may go over midnight.

    Parameters
    ----------
    begin, end
        Hours and minutes such as ``22:00``; None for no quiet hours.
    """

    def __init__(self, begin: str | None, end: str | None) -> None:
        self._span = None if begin is None or end is None else (time.fromisoformat(begin), time.fromisoformat(end))

    def is_quiet_at(self, local: time) -> bool:
        """Whether it is quiet at this local time."""
        if self._span is None:
            return False
        begin, end = self._span
        return begin <= local < end if begin <= end else local >= begin or local < end


class Backlog:
    """The notices for one recipient. Those that cannot be sent are tried again, by halves; none is sent twice.

    Parameters
    ----------
    quiet
        When only urgent notices are sent.
    most_per_hour
        Messages; further notices are gathered into one, which is sent as soon as the rate allows. Urgent notices have
        as many messages more for themselves, so that they never wait because others have used up the rate.
    """

    def __init__(self, quiet: QuietHours, most_per_hour: int) -> None:
        self._quiet = quiet
        self._limit, self._limit_of_urgent = (RateLimit(most_per_hour / 3600.0, most_per_hour) for _ in range(2))
        self._waiting: list[Notice] = []
        self._lost = self._lost_in_message = 0
        self._failures = 0
        self._send_short = False
        self._not_before_s = 0.0

    @property
    def is_empty(self) -> bool:
        """Whether all was sent."""
        return not self._waiting

    def put(self, notice: Notice) -> None:
        """Take a notice; if there are too many, the oldest that is not urgent is lost, and the next message says so."""
        self._waiting.append(notice)
        if len(self._waiting) > _MOST_WAITING:
            self._waiting.remove(next((old for old in self._waiting if not old.urgent), self._waiting[0]))
            self._lost += 1

    def due(self, now_s: float, local: time) -> tuple[Notice, list[Notice]] | None:
        """Return the message to send now and the notices that it stands for, or None.

        Parameters
        ----------
        now_s, local
            Monotonic time, and the local time of the day.
        """
        if now_s < self._not_before_s:
            return None
        chosen = self._admit_by_rate(
            [each for each in self._waiting if each.urgent or not self._quiet.is_quiet_at(local)], now_s
        )
        if not chosen:
            return None
        # A message that was not taken may have been too long for its way. Urgent notices must not wait with the rest.
        chosen = sorted(chosen, key=lambda notice: not notice.urgent)[: max(len(chosen) >> self._failures, 1)]
        self._lost_in_message = self._lost
        return self._with_loss_note(combine_notices(chosen, short=self._send_short)), chosen

    def _admit_by_rate(self, chosen: list[Notice], now_s: float) -> list[Notice]:
        """Return the notices for which the rate allows a message: all, the urgent ones or none."""
        if not chosen or self._limit.admit(now_s):
            return chosen
        urgent = [notice for notice in chosen if notice.urgent]
        return urgent if urgent and self._limit_of_urgent.admit(now_s) else []

    def _with_loss_note(self, notice: Notice) -> Notice:
        if not self._lost:
            return notice
        lost = f"Older changes were lost because more than {_MOST_WAITING} waited: {self._lost}."
        return replace(notice, body=f"{lost}\n{notice.body}")

    def remove_sent(self, notices: list[Notice]) -> None:
        """Take off the notices that were sent."""
        self._failures = 0
        # Some of them may have been counted as lost while they were on their way.
        on_the_way = sum(all(notice is not each for each in self._waiting) for notice in notices)
        self._lost -= self._lost_in_message + on_the_way
        self._lost_in_message = 0
        self._waiting = [notice for notice in self._waiting if all(notice is not each for each in notices)]
        # The rest of a message that was too long would be too long again.
        self._send_short = self._send_short and bool(self._waiting)

    def note_failure(self, now_s: float) -> float:
        """Note that the message could not be sent, and return the pause [s] until the next try."""
        pause_s = _RETRY_PAUSES_S[min(self._failures, len(_RETRY_PAUSES_S) - 1)]
        self._failures += 1
        self._send_short = True
        self._not_before_s = now_s + pause_s
        return pause_s
