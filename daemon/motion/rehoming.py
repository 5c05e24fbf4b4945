"""When the service makes a reference run without being asked: once for a doubt, and then after ever longer pauses."""

import math

_PAUSES_S = (600.0, 3600.0, 21600.0)


class Rehoming:
    """Whether it is time for an automatic reference run.

    Parameters
    ----------
    enabled
        False: never.
    """

    def __init__(self, *, enabled: bool) -> None:
        self.enabled = enabled
        self._runs = 0
        self._last_run_was_good = False
        self._due_s = -math.inf

    def due(self, doubt: str | None, now_s: float) -> bool:
        """Tell whether to home for this doubt now."""
        if doubt is None:
            if now_s >= self._due_s:
                self._runs = 0
            return False
        # A new doubt after a first run that ended the last one has a cause of its own. Still more doubts mean that the
        # unit cannot keep its count.
        another = self._last_run_was_good and self._runs == 1
        return self.enabled and (now_s >= self._due_s or another)

    def began(self, now_s: float) -> None:
        """Take note that a run begins."""
        self._last_run_was_good = False
        self._due_s = now_s + _PAUSES_S[min(self._runs, len(_PAUSES_S) - 1)]
        self._runs += 1

    def ended(self, *, good: bool) -> None:
        """Take note of how the run ended: `good` where it left no doubt."""
        self._last_run_was_good = good
