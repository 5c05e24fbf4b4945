"""How the positioner is reached: a line that streams in the newest values and takes commands out, whatever it is."""

import math
from collections.abc import Callable, Mapping
from typing import NamedTuple, Protocol

from drivers.errors import LinkLostError
from drivers.lines.serial_port import SerialPort
from drivers.lines.threads import DeviceThread, thread_start_error
from drivers.positioners.pozsol.stream import Port, TelemetryReader
from drivers.positioners.pozsol.table import FieldTable, Value
from drivers.positioners.pozsol.wire import require_allowed
from drivers.transcript import Tap, no_tap

_DEVICE = "positioner"
_OPEN_S = 5.0
_WRITE_S = 1.0
_CLOSE_S = 1.0


class LinkState(NamedTuple):
    """What has come over a line.

    Attributes
    ----------
    values
        The newest value of each field. The same object as long as nothing has changed, for a line that can tell.
    as_of_s
        Time [s] at which all that changes by itself was last repeated; -inf where each value has its own time.
    jumped_s
        When the unit last began to count from elsewhere, or None.
    restarted_s
        When the unit has last printed its banner, or None.
    moved_unseen_s
        When an axis last showed far from its place before a silence, in which it can have moved there, or None.
    """

    values: Mapping[int, Value]
    as_of_s: float = -math.inf
    jumped_s: float | None = None
    restarted_s: float | None = None
    moved_unseen_s: float | None = None


class PositionerLine(Protocol):
    """The positioner's link. Raises `drivers.errors.DeviceError` and nothing else."""

    simulated: bool
    boot_s: float
    """How long the unit may take to restart because the line was opened."""

    async def open(self) -> None:
        """Connect and begin to listen."""

    async def close(self) -> None:
        """Release the link; never raises."""

    async def send(self, packet: bytes) -> None:
        """Send one command as one packet."""

    def state(self) -> LinkState:
        """Return what has come since `open`; `LinkLostError` when the link is lost or not open."""

    def has_modem_lines(self) -> bool:
        """Tell whether there are modem lines, which are then as they were asked for."""


def open_port(path: str, tap: Tap = no_tap, *, dtr: bool = True, rts: bool = True) -> SerialPort:
    """Open the positioner's port, which lets out only commands that may be sent to the unit; see `SerialPort`."""
    return SerialPort(_DEVICE, path, require_allowed, tap, dtr=dtr, rts=rts)


class SerialLine:
    """A serial port, read by a thread.

    Parameters
    ----------
    connect
        Opens the port; called in the instrument's thread at each `open`.
    now
        The service's monotonic time [s]; also called in the reader's thread.
    boot_s
        How long the unit may take to restart because its port was opened; 0 if it does not.
    banner
        What the unit prints when it has restarted; None if nothing is known of that.
    write_s
        How long a packet may take to be written before the link counts as lost.
    """

    simulated = False

    def __init__(
        self,
        connect: Callable[[], Port],
        now: Callable[[], float],
        *,
        boot_s: float = 0.0,
        banner: str | None = None,
        write_s: float = _WRITE_S,
    ) -> None:
        self._connect = connect
        self._now = now
        self.boot_s = boot_s
        self._banner = b"" if banner is None else banner.encode("latin-1")
        self._write_s = write_s
        self._thread = DeviceThread(_DEVICE)
        self._reader: TelemetryReader | None = None

    async def open(self) -> None:
        """Open the port and begin to read it."""
        port = await self._thread.call(self._connect, _OPEN_S, lambda late: late.close())
        try:
            self._reader = TelemetryReader(port, self._now, boot_s=self.boot_s, banner=self._banner, table=FieldTable())
        except RuntimeError:
            await self._thread.finish(port.close, _CLOSE_S)
            raise thread_start_error(_DEVICE) from None

    async def close(self) -> None:
        """Release the port."""
        reader, self._reader = self._reader, None
        if reader is not None:
            reader.stop()
        await self._thread.finish(None if reader is None else reader.close, _CLOSE_S)

    async def send(self, packet: bytes) -> None:
        """Write one packet, within `write_s`."""
        reader = self._require_reader()
        reader.read_promptly()
        await self._thread.call(lambda: reader.port.write(packet), self._write_s)

    def state(self) -> LinkState:
        """Return the newest values."""
        reader = self._require_reader()
        table = reader.table
        return LinkState(
            table.snapshot(),
            jumped_s=table.jumped_s,
            restarted_s=reader.restarted_s,
            moved_unseen_s=table.moved_unseen_s,
        )

    def has_modem_lines(self) -> bool:
        """Tell whether the port has modem lines."""
        return self._require_reader().port.has_modem_lines()

    def _require_reader(self) -> TelemetryReader:
        reader = self._reader
        if reader is None:
            raise LinkLostError(_DEVICE, "has to be opened first")
        if reader.lost:
            raise LinkLostError(_DEVICE, reader.lost)
        return reader
