"""Turns for those who only read: together they cost the event loop a bounded share, however many ask."""

import asyncio
from collections import deque
from collections.abc import Callable

_SHARE = 0.25
_FREE_DEBT_S = 0.05
_MOST_WAITING = 64
_REFUSED_AFTER_S = 0.25
# What a request with a connection of its own costs besides its page: accepting, parsing, closing.
_OVERHEAD_S = 0.001
# The most that is charged for a page, which may have waited for a thread.
_LONGEST_S = 0.02


class CrowdedError(Exception):
    """So many wait for a turn already that another would wait for too long."""


class ReadThrottle:
    """Gives one turn after the other, at a pace that depends on what each has cost.

    After a rest some fifty cheap pages are served at once; then a quarter of the loop's time is spent on pages, and
    further requests wait. Commands take no turn.

    Parameters
    ----------
    now_s
        Returns the event loop's time [s].
    speed
        The event loop's clock runs this many times as fast as the machine's.
    """

    def __init__(self, now_s: Callable[[], float], speed: float) -> None:
        self.now_s = now_s
        self._speed = speed
        self._debt_s = 0.0
        self._at_s = now_s()
        self._waiting: deque[asyncio.Future[None]] = deque()
        self._timer: asyncio.TimerHandle | None = None

    async def take(self) -> None:
        """Wait for a turn; raises `CrowdedError` if too many wait, but after a pause, as asking again costs too."""
        if not self._waiting and self._debt() <= _FREE_DEBT_S:
            self._debt_s += _OVERHEAD_S
            return
        if len(self._waiting) >= _MOST_WAITING:
            await asyncio.sleep(_REFUSED_AFTER_S * self._speed)
            raise CrowdedError
        turn = asyncio.get_running_loop().create_future()
        self._waiting.append(turn)
        self._schedule_next_turn()
        try:
            await turn
        except asyncio.CancelledError:
            if turn in self._waiting:
                self._waiting.remove(turn)
            raise

    def charge(self, cost_s: float) -> None:
        """Count what a turn has cost, in the loop's seconds."""
        self._debt_s = self._debt() + min(max(cost_s / self._speed, 0.0), _LONGEST_S)

    def close(self) -> None:
        """Let nobody wait any longer."""
        if self._timer is not None:
            self._timer.cancel()
            self._timer = None
        while self._waiting:
            turn = self._waiting.popleft()
            if not turn.done():
                turn.set_exception(CrowdedError())

    def _debt(self) -> float:
        now_s = self.now_s()
        self._debt_s = max(self._debt_s - (now_s - self._at_s) / self._speed * _SHARE, 0.0)
        self._at_s = now_s
        return self._debt_s

    def _schedule_next_turn(self) -> None:
        if self._timer is None and self._waiting:
            pause_s = max(self._debt() - _FREE_DEBT_S, _OVERHEAD_S) / _SHARE * self._speed
            self._timer = asyncio.get_running_loop().call_later(pause_s, self._grant_turn)

    def _grant_turn(self) -> None:
        self._timer = None
        if self._waiting and self._debt() <= _FREE_DEBT_S:
            turn = self._waiting.popleft()
            if not turn.done():
                self._debt_s += _OVERHEAD_S
                turn.set_result(None)
        self._schedule_next_turn()
