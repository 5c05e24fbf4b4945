"""A simulated instrument that answers questions, on its line: every byte takes its time, in both directions."""

import asyncio
from collections import deque
from collections.abc import Callable
from pathlib import Path
from typing import Generic, Protocol, TypeVar

from sim_drivers.bench.pty_port import PtyPort
from sim_drivers.voltmeter.core import VoltmeterCore


class Instrument(Protocol):
    """A core that is fed bytes."""

    aborts: int

    def feed(self, data: bytes, now: float) -> list[tuple[float, bytes]]:
        """Take in bytes and return the replies that they cause, each with the time [s] at which it is complete."""

    def power_cycle(self, now: float) -> None:
        """Switch it off and on."""


Core = TypeVar("Core", bound=Instrument)


class LineHost(Generic[Core]):
    """An instrument behind its port.

    Parameters
    ----------
    core
        The simulated instrument.
    link
        Path of the port.
    now
        The event loop's time [s].
    byte_s
        How long one byte takes.

    Attributes
    ----------
    delay_s
        How long replies take over the line beyond their transmission. What is on its way comes late even if the
        instrument has dropped all its output meanwhile.
    """

    def __init__(self, core: Core, link: Path, now: Callable[[], float], byte_s: float) -> None:
        self.core = core
        self.port = PtyPort(link, self._receive)
        self.delay_s = 0.0
        self._now = now
        self._byte_s = byte_s
        self._frozen = False
        self._in_free_s = self._out_free_s = now()
        self._arriving: deque[tuple[float, bytes]] = deque()
        self._leaving: deque[tuple[float, bytes]] = deque()
        self._on_line: deque[tuple[float, bytes]] = deque()
        self._wake = asyncio.Event()
        self._failure: Exception | None = None

    async def run(self) -> None:
        """Receive and send until cancelled; raises what the instrument raises."""
        while True:
            self._wake.clear()
            if self._failure is not None:
                raise self._failure
            if not self._frozen:
                self._move_due_bytes(self._now())
            due = [queue[0][0] for queue in (self._arriving, self._leaving, self._on_line) if queue]
            if self._frozen or not due:
                await self._wake.wait()
            else:
                await self._wait(min(due) - self._now())

    def fail(self, failure: Exception) -> None:
        """End `run` with an error that the instrument raised for a user who is not on this line."""
        self._failure = failure
        self._wake.set()

    def freeze(self) -> None:
        """Neither send nor take anything."""
        self._frozen = True
        self.port.pause()

    def thaw(self) -> None:
        """Go on with what has waited."""
        self._frozen = False
        self.port.resume()
        self._wake.set()

    def power_cycle(self) -> None:
        """Switch the instrument off and on."""
        now = self._now()
        self._arriving.clear()
        self._leaving.clear()
        self._out_free_s = now
        self.core.power_cycle(now)

    def _move_due_bytes(self, now: float) -> None:
        while self._arriving and self._arriving[0][0] <= now:
            self._feed(*self._arriving.popleft())
        while self._leaving and self._leaving[0][0] <= now:
            left_s, data = self._leaving.popleft()
            before_s = self._on_line[-1][0] if self._on_line else left_s
            self._on_line.append((max(left_s + self.delay_s, before_s), data))
        while self._on_line and self._on_line[0][0] <= now:
            self.port.send(self._on_line.popleft()[1])

    def _receive(self, data: bytes) -> None:
        self._in_free_s = max(self._in_free_s, self._now()) + len(data) * self._byte_s
        self._arriving.append((self._in_free_s, data))
        self._wake.set()

    def _feed(self, arrived_s: float, data: bytes) -> None:
        aborts = self.core.aborts
        replies = self.core.feed(data, arrived_s)
        if self.core.aborts != aborts:
            self._leaving.clear()
            self._out_free_s = arrived_s
        for due_s, reply in replies:
            self._out_free_s = max(self._out_free_s, due_s)
            for byte in reply:
                self._out_free_s += self._byte_s
                self._leaving.append((self._out_free_s, bytes((byte,))))

    async def _wait(self, seconds: float) -> None:
        if seconds > 0:
            timer = asyncio.get_running_loop().call_later(seconds, self._wake.set)
            try:
                await self._wake.wait()
            finally:
                timer.cancel()


BAUD_RATES = (300, 600, 1200, 2400, 4800, 9600, 19200)
_BITS_PER_BYTE = 10


class VoltmeterHost(LineHost[VoltmeterCore]):
    """The meter behind its port.

    Parameters
    ----------
    core
        The simulated instrument.
    link
        Path of the port.
    now
        The event loop's time [s].
    baud_rate
        As chosen on the front panel. The port has no rate of its own, so a user's is not compared with it.
    """

    def __init__(self, core: VoltmeterCore, link: Path, now: Callable[[], float], baud_rate: int) -> None:
        if baud_rate not in BAUD_RATES:
            raise ValueError(f"the meter has the baud rates {BAUD_RATES}, not {baud_rate}")
        super().__init__(core, link, now, _BITS_PER_BYTE / baud_rate)
