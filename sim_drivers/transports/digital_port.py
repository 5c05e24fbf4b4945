"""The digital port in memory that a simulated multiplexer hangs on."""

import asyncio
from collections.abc import Callable

from drivers.switches.digital_port import DaqError
from sim_drivers.multiplexer import DEVICE_LOST, ENABLE_LINE, DaqWriteError, MultiplexerCore
from sim_drivers.transports.cable import Cabled

_NO_SUCH_LINE = -200170


class InMemoryPort(Cabled):
    """A `drivers.switches.digital_port.DigitalPort`.

    Parameters
    ----------
    core
        The simulated switch and its port.
    now
        The event loop's time [s].
    """

    def __init__(self, core: MultiplexerCore, now: Callable[[], float]) -> None:
        super().__init__("multiplexer")
        self._core = core
        self._now = now

    async def open(self, highest_line: int) -> str:
        """Reserve the lines."""
        if not self.link_up:
            raise DaqError(DEVICE_LOST, "the device is unplugged")
        if highest_line > ENABLE_LINE:
            raise DaqError(_NO_SUCH_LINE, f"the port has the lines 0 to {ENABLE_LINE}")
        self._connect()
        return "simulated USB-6008"

    async def close(self) -> None:
        """Release the lines."""
        self._disconnect()

    async def write(self, value: int) -> None:
        """Put a value on the lines."""
        self._require_plugged()
        try:
            self._core.write(value, self._now())
        except DaqWriteError as error:
            raise DaqError(error.code, "the port reports an error") from error
        if self._core.latency_s:
            await asyncio.sleep(self._core.latency_s)
            self._require_plugged()

    def place(self, highest_line: int) -> str:
        """Return the name of the lines."""
        return f"Dev1/port0/line0:{highest_line}"

    def _require_plugged(self) -> None:
        if not self._is_open:
            raise DaqError(DEVICE_LOST, "the device is unplugged")

    def _pulled(self) -> None:
        # Without USB the lines go high, which selects the last input.
        self._core.power_cycle(self._now())
