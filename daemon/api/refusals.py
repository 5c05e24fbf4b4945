"""What the local interface refuses: each kind is counted, and logged a few times and then by its number."""

import logging
from collections.abc import Callable, Mapping

from daemon.base.recurrence import LogBudget

log = logging.getLogger("heliocube.api")

_KINDS = {
    "garbage": "requests that are not HTTP",
    "slow": "connections that did not finish their request, or did not read their answer",
    "crowded": "connections and requests above the limit",
    "host": "requests for a host that is not served",
    "token": "commands without the token",
    "error": "requests that failed by an error of the service",
}


class ApiRefusals:
    """Counts and logs what is refused.

    Parameters
    ----------
    clock_s
        Returns the monotonic time [s].
    """

    def __init__(self, clock_s: Callable[[], float]) -> None:
        self._clock_s = clock_s
        self._budgets = {kind: LogBudget(subject) for kind, subject in _KINDS.items()}

    @property
    def counts(self) -> Mapping[str, int]:
        """How many of each kind."""
        return {kind: budget.count for kind, budget in self._budgets.items()}

    def note(self, kind: str, sentence: str, error: Exception | None = None) -> None:
        """Take note of one refusal in a sentence, or of an error of the service's own."""
        line = self._budgets[kind].spend(self._clock_s(), sentence)
        if line:
            log.log(logging.WARNING if error is None else logging.ERROR, "%s", line, exc_info=error)

    def log_ended_floods(self) -> None:
        """Log how many refusals a flood had, once it is over; to be called now and then."""
        for budget in self._budgets.values():
            line = budget.poll_flood_summary(self._clock_s())
            if line:
                log.warning("%s", line)
