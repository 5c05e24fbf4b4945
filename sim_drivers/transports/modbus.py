"""The way in memory to simulated devices on Modbus."""

import asyncio
import math
from collections import deque
from collections.abc import Callable
from typing import Protocol

from drivers.errors import DeadlineError
from drivers.modbus.framing import RtuClient
from drivers.modbus.pdu import ModbusRequest
from sim_drivers.transports.cable import Cabled


class FramedCore(Protocol):
    """A line of simulated devices that is fed frames."""

    def feed(self, data: bytes, now: float) -> list[tuple[float, bytes]]:
        """Take in bytes and return the replies that they cause, each with the time [s] at which it comes."""


class InMemoryModbus(Cabled):
    """A `drivers.modbus.transports.ModbusTransport` whose bytes take no time; devices reply when they are ready.

    Parameters
    ----------
    device
        Role of the instrument, for errors.
    core
        The simulated devices.
    now
        The event loop's time [s].
    """

    def __init__(self, device: str, core: FramedCore, now: Callable[[], float]) -> None:
        super().__init__(device)
        self._core = core
        self._now = now
        self._framing = RtuClient()
        self._due_replies: deque[tuple[float, bytes]] = deque()

    async def open(self, within_s: float = 0.0) -> None:  # noqa: ARG002 - it takes no time
        """Connect."""
        self._connect()

    async def close(self) -> None:
        """Release the line."""
        self._disconnect()

    async def exchange(self, request: ModbusRequest, within_s: float) -> bytes:
        """Send a question and return its reply."""
        self._require_open()
        begun_s = self._now()
        while self._due_replies and self._due_replies[0][0] <= begun_s:
            self._due_replies.popleft()
        frame = self._framing.begin(request)
        self._due_replies = deque(sorted([*self._due_replies, *self._core.feed(frame, begun_s)]))
        until_s, came = begun_s + within_s, False
        while (next_s := self._due_replies[0][0] if self._due_replies else math.inf) <= until_s:
            await asyncio.sleep(next_s - self._now())
            self._require_open()
            came = True
            if (reply := self._framing.feed(self._due_replies.popleft()[1])) is not None:
                return reply
        await asyncio.sleep(until_s - self._now())
        self._require_open()
        raise DeadlineError(self._device, "sent something that is not an answer" if came else "")
