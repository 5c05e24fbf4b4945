"""The one policy of telling an outage: once when it begins, seldom while it lasts, once with its length at its end."""

import logging

# At most 9 reminders in a day: 10 min, 1 h, 6 h, then every 6 h.
_REMIND_AFTER_S = (600.0, 3600.0, 21600.0)


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
        self._remind_s = 0.0
        self._reminders = 0
        self.since: float | None = None
        self.reason = ""
        self.repeats = 0

    @property
    def is_down(self) -> bool:
        """Whether the outage lasts."""
        return self.since is not None

    def down(self, now_s: float, reason: str) -> bool:
        """Take note of one failure at a monotonic time [s]; return whether that was worth a warning.

        The first failure is, and so is a reminder after 10 min, 1 h, 6 h and every 6 h from then on. All others are
        debug lines.
        """
        self.reason = reason
        if self.since is None:
            self.since = now_s
            self.repeats = 0
            self._reminders = 0
            self._remind_s = now_s + _REMIND_AFTER_S[0]
            self._logger.warning("%s is down: %s", self._subject, reason)
            return True
        self.repeats += 1
        if now_s < self._remind_s:
            self._logger.debug("%s is still down: %s", self._subject, reason, extra=self._fields(now_s))
            return False
        self._logger.warning("%s is still down: %s", self._subject, reason, extra=self._fields(now_s))
        self._reminders += 1
        self._remind_s = self._next_reminder(now_s)
        return True

    def up(self, now_s: float) -> bool:
        """Take note that it works at a monotonic time [s]; return whether that ended an outage."""
        if self.since is None:
            return False
        self._logger.info("%s is back", self._subject, extra=self._fields(now_s))
        self.since = None
        self.reason = ""
        return True

    def _next_reminder(self, now_s: float) -> float:
        longest_s = _REMIND_AFTER_S[-1]
        if self.since is not None and self._reminders < len(_REMIND_AFTER_S):
            return max(self.since + _REMIND_AFTER_S[self._reminders], now_s + _REMIND_AFTER_S[0])
        return now_s + longest_s

    def _fields(self, now_s: float) -> dict[str, dict[str, float]]:
        length_s = 0.0 if self.since is None else now_s - self.since
        return {"fields": {"down_s": round(length_s, 1), "repeats": self.repeats}}
