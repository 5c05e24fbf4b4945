"""The asking end of Modbus: one question at a time, a pause before each, nothing written unless allowed."""

import asyncio
import math
from collections.abc import Callable

from drivers.errors import RefusedError, UnavailableError
from drivers.modbus.pdu import READ_INPUT_REGISTERS, ModbusRequest, exception_text, read_registers, registers_of
from drivers.modbus.transports import ModbusTransport

# The device or its gateway is busy, or the gateway does not reach the device: that counts as silence.
_UNREACHED_CODES = (5, 6, 10, 11)


class ModbusBus:
    """A line and the devices on it.

    Parameters
    ----------
    path
        The line, owned from here on.
    device
        Role of what is on it, for errors.
    gap_s
        Silence between a reply and the next question; some devices miss a question that comes sooner.
    monotonic_s
        The service's monotonic time.
    writes
        Whether anything may be written: a reading cube never writes.
    """

    def __init__(
        self,
        path: ModbusTransport,
        device: str,
        gap_s: float,
        monotonic_s: Callable[[], float],
        *,
        writes: bool = False,
    ) -> None:
        self._path = path
        self._device = device
        self._gap_s = gap_s
        self._now = monotonic_s
        self._writes = writes
        self._quiet_since_s = -math.inf
        self._line_lock = asyncio.Lock()

    async def open(self, within_s: float = 15.0) -> None:
        """Connect; raises `ConnectError`."""
        await self._path.open(within_s)
        # A program that had the line before may have got a reply just now.
        self._quiet_since_s = self._now()

    async def close(self) -> None:
        """Release the line; never raises."""
        await self._path.close()

    async def ask(self, request: ModbusRequest, within_s: float) -> bytes:
        """Return the reply to a question.

        Raises
        ------
        DeadlineError
            No reply came in time; `UnavailableError` where the device or its gateway said so.
        RefusedError
            The device answers that it cannot do that.
        LinkLostError
            The line is gone.
        ValueError
            The question would write, and that was not allowed.
        """
        if request.pdu[0] > READ_INPUT_REGISTERS and not self._writes:
            raise ValueError(f"function {request.pdu[0]} writes, but this line is only for reading")
        async with self._line_lock:
            wait_s = self._quiet_since_s + self._gap_s - self._now()
            if wait_s > 0:
                await asyncio.sleep(wait_s)
            try:
                reply = await self._path.exchange(request, within_s)
            finally:
                self._quiet_since_s = self._now()
        if text := exception_text(reply):
            if reply[1] in _UNREACHED_CODES:
                raise UnavailableError(self._device, f"address {request.unit} {text}")
            raise RefusedError(self._device, f"address {request.unit} {text}")
        return reply

    async def read(self, unit: int, function: int, register: int, count: int, within_s: float) -> tuple[int, ...]:
        """Return holding (function 3) or input (4) registers of a device; raises as `ask` does."""
        return registers_of(await self.ask(read_registers(unit, function, register, count), within_s))
