"""The line in memory to a simulated instrument that answers questions."""

import asyncio
import math
from collections import deque
from collections.abc import Callable, Coroutine
from typing import Any, NoReturn, Protocol

from drivers.errors import DeadlineError
from sim_drivers.transports.cable import Cabled

_INTERRUPT = b"\x03"


class AnsweringCore(Protocol):
    """A simulated instrument that is fed bytes; `aborts` grows when it drops what it had to say."""

    aborts: int

    def feed(self, data: bytes, now: float) -> list[tuple[float, bytes]]:
        """Take in bytes and return the replies that they cause, each with the time [s] at which it is complete."""


class InMemoryLine(Cabled):
    """A `drivers.scpi.ScpiLine` whose bytes take no time; replies come when the instrument has them ready.

    Parameters
    ----------
    device
        Role of the instrument, for errors.
    core
        The simulated instrument.
    now
        The event loop's time [s].
    """

    def __init__(self, device: str, core: AnsweringCore, now: Callable[[], float]) -> None:
        super().__init__(device)
        self._core = core
        self._now = now
        self._aborts = core.aborts
        self._due_replies: deque[tuple[float, bytes]] = deque()

    async def open(self) -> None:
        """Connect; what was still to come over an earlier connection is gone."""
        self._connect()
        self._due_replies.clear()

    async def close(self) -> None:
        """Release the line."""
        self._disconnect()

    async def send(self, text: str) -> None:
        """Hand one line to the instrument."""
        self._hand_over(text)

    def ask(self, text: str, within_s: float) -> Coroutine[Any, Any, str]:
        """Hand one line over and return the next one that comes."""
        self._hand_over(text)
        # Not a coroutine around another: a simulated day asks 70,000 times.
        return self.receive(within_s)

    async def receive(self, within_s: float) -> str:
        """Return the next line."""
        self._require_open()
        now_s = self._now()
        wait_s = self._due_replies[0][0] - now_s if self._due_replies else math.inf
        if wait_s > within_s:
            await self._miss_deadline(within_s)
        if wait_s > 0.0:
            await asyncio.sleep(wait_s)
            self._require_open()
            if not self._due_replies:
                await self._miss_deadline(within_s - wait_s)
        return self._due_replies.popleft()[1].decode("latin-1").strip("\r\n")

    async def interrupt(self) -> None:
        """Send control-C."""
        self._require_open()
        self._core.feed(_INTERRUPT, self._now())

    async def drain(self, quiet_s: float) -> None:
        """Throw away what comes."""
        self._require_open()
        begun_s = last_s = self._now()
        while self._due_replies and self._due_replies[0][0] <= last_s + quiet_s:
            last_s = max(last_s, self._due_replies.popleft()[0])
        await asyncio.sleep(last_s + quiet_s - begun_s)
        self._require_open()

    async def discard_unsolicited(self) -> bool:
        """Throw away what has come and was not read."""
        self._require_open()
        found = False
        while self._due_replies and self._due_replies[0][0] <= self._now():
            found |= bool(self._due_replies.popleft()[1].strip())
        return found

    async def _miss_deadline(self, wait_s: float) -> NoReturn:
        await asyncio.sleep(wait_s)
        self._require_open()
        raise DeadlineError(self._device, "no line came in time")

    def _hand_over(self, text: str) -> None:
        self._require_open()
        self._due_replies.extend(self._core.feed(text.encode("ascii") + b"\n", self._now()))

    def _require_open(self) -> None:
        """Raise where the line is not open; forget what the instrument has dropped since the last call."""
        super()._require_open()
        if self._core.aborts != self._aborts:
            self._aborts = self._core.aborts
            self._due_replies.clear()
