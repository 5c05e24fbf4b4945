"""The multiplexer on digital lines of an NI USB-6008.

After power-up, a reset and a loss of USB the lines of a USB-6008 are inputs that read high, so the multiplexer is at
its last input until the first write. Every failed write therefore counts as a lost link. Inferred and not measured on a
rig: which error a USB-6008 raises when it is unplugged, and that one write of all lines changes them together.
"""

from collections.abc import Sequence

from drivers.errors import ConnectError, DeviceError, LinkLostError, RefusedError
from drivers.switches.digital_port import DaqError, DigitalPort
from drivers.transcript import Tap, no_tap

_DEVICE = "multiplexer"
_LINES_HELD_CODES = (-50103, -200587)
_NO_SUCH_DEVICE = (-200220, -88705, -88708, -88718, -89130, -201003)


class NiMultiplexer:
    """One of several inputs on one output, addressed through a digital port.

    Parameters
    ----------
    port
        Its lines from 0 to the highest one used are driven.
    addresses
        Value on the lines that selects input 0, 1, 2 and so on.
    enable_line, enable_level
        Line that switches the multiplexer on at this level; None if its enable input is wired to be on.
    tap
        Told each value that is written.
    """

    def __init__(
        self,
        port: DigitalPort,
        addresses: Sequence[int] = tuple(range(8)),
        *,
        enable_line: int | None = None,
        enable_level: bool = True,
        tap: Tap = no_tap,
    ) -> None:
        enable = 0 if enable_line is None else 1 << enable_line
        self._values = [address | (enable if enable_level else 0) for address in addresses]
        self._highest_line = max([*self._values, enable, 1]).bit_length() - 1
        self._port = port
        self._tap = tap
        self._is_open = False

    async def open(self) -> str:
        """Reserve the lines; nothing is written, so the selection stays as it is."""
        await self.close()
        place = self._port.place(self._highest_line)
        try:
            product = await self._port.open(self._highest_line)
        except DaqError as error:
            await self._port.close()
            raise _cannot_open(place, error) from error
        except BaseException:
            await self._port.close()
            raise
        self._is_open = True
        return f"{product} with the lines {place}"

    async def close(self) -> None:
        """Release the lines; they keep their state."""
        self._is_open = False
        await self._port.close()

    async def select(self, channel: int) -> None:
        """Write the address of an input in one value."""
        if not 0 <= channel < len(self._values):
            raise RefusedError(_DEVICE, f"has the inputs 0 to {len(self._values) - 1}, not {channel}")
        if not self._is_open:
            raise LinkLostError(_DEVICE, "has to be opened first")
        value = self._values[channel]
        try:
            await self._port.write(value)
        except DaqError as error:
            await self.close()
            message = f"the lines {self._port.place(self._highest_line)} did not take the address: {error}"
            raise LinkLostError(_DEVICE, message) from error
        except DeviceError:
            await self.close()
            raise
        self._tap(">", b"%d" % value)


def _cannot_open(place: str, error: DaqError) -> ConnectError:
    if error.code in _LINES_HELD_CODES:
        return ConnectError(_DEVICE, f"{place} is held by another program")
    if error.code in _NO_SUCH_DEVICE:
        message = f"there is no device for {place}: is it plugged in, and is this its name in NI MAX?"
        return ConnectError(_DEVICE, message)
    return ConnectError(_DEVICE, f"{place} cannot be used: {error}")
