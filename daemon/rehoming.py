"""When the service makes a reference run without being asked: once per cause, and then after ever longer pauses."""

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
        self._enabled = enabled
        self._runs = 0
        self._due_s = -math.inf

    def due(self, doubt: str | None, now_s: float) -> bool:
        """Tell whether to home for this doubt now; the answer yes counts as a run."""
        if doubt is None:
            if now_s >= self._due_s:
                self._runs = 0
            return False
        if not self._enabled or now_s < self._due_s:
            return False
        self._due_s = now_s + _PAUSES_S[min(self._runs, len(_PAUSES_S) - 1)]
        self._runs += 1
        return True
