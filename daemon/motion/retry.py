"""When a move that failed is tried again: after pauses that grow, and told ever more seldom."""

import math

from daemon.base.alarms.alarms import Alarms

_STOW_PAUSES_S = (60.0, 120.0, 300.0, 600.0)
_PAUSE_FACTORS = (1.0, 2.0, 4.0, 8.0, 16.0)
# So many moves in a row have to end by a loss of the link: a cable pulled once or twice is no failure of the move.
_LOSSES_TOLD_FROM = 3


class Retries:
    """Failures in a row.

    Parameters
    ----------
    first_pause_s
        Pause after the first failure of an ordinary move; a stow is tried again after 1, 2, 5 and then every 10 min.
    alarms
        Where `move-failed` is raised, until a move arrives.
    """

    def __init__(self, first_pause_s: float, alarms: Alarms) -> None:
        self._alarms = alarms
        self._first_pause_s = first_pause_s
        self._stows = 0
        self._others = 0
        self._losses = 0
        self._stow_failed_s = self._other_failed_s = -math.inf
        self.text: str | None = None

    def note_failure(self, now_s: float, text: str, *, stow: bool) -> bool:
        """Take note of a failure; return whether it is worth a warning: the first, second, fourth, eighth ... are."""
        if stow:
            self._stows += 1
            self._stow_failed_s = now_s
        else:
            self._others += 1
            self._other_failed_s = now_s
        self._raise_alarm(text, stow=stow)
        count = self._stows + self._others
        return count & (count - 1) == 0

    def note_link_loss(self, text: str, *, stow: bool) -> None:
        """Take note of a move that ended because the link was lost; the third in a row is told. No pause follows."""
        self._losses += 1
        if self._losses >= _LOSSES_TOLD_FROM:
            self._raise_alarm(text, stow=stow)

    def _raise_alarm(self, text: str, *, stow: bool) -> None:
        self.text = text
        what = "the stow" if stow else "a move"
        self._alarms.set("move-failed", f"{what} failed and waits to be tried again: {text}")

    def forget(self) -> None:
        """Begin anew: a move has arrived, or a person has looked."""
        self._stows = self._others = self._losses = 0
        self._stow_failed_s = self._other_failed_s = -math.inf
        self.text = None
        self._alarms.set("move-failed", None)

    def due_s(self, *, stow: bool) -> float:
        """Return the monotonic time from which a move may be tried."""
        if stow:
            pause_s = _STOW_PAUSES_S[min(self._stows, len(_STOW_PAUSES_S)) - 1] if self._stows else 0.0
            return self._stow_failed_s + pause_s
        factor = _PAUSE_FACTORS[min(self._others, len(_PAUSE_FACTORS)) - 1] if self._others else 0.0
        return self._other_failed_s + factor * self._first_pause_s
