"""The multiplexer on digital lines of an NI USB-6008, through NI-DAQmx here or an NI gRPC Device Server elsewhere.

After power-up, a reset and a loss of USB the lines of a USB-6008 are inputs that read high, so the switch is on its
last input until the first write. Every failed write therefore counts as a lost link. NI's software is loaded at the
first `open`. The gRPC connection is not encrypted. Inferred and not measured on a rig: which error a USB-6008 raises
when it is unplugged, and that one write of all lines changes them together.
"""

import contextlib
import os
from collections.abc import Callable, Sequence
from typing import Any, NoReturn

from drivers.errors import ConnectError, DeviceError, DriverMissingError, LinkLostError, RefusedError
from drivers.lines.threads import DeviceThread
from drivers.transcript import Tap, no_tap

_DEVICE = "multiplexer"
_HELD = (-50103, -200587)
_NO_SUCH_DEVICE = (-200220, -88705, -88708, -88718, -89130, -201003)
_CLOSE_S = 1.0


class NiMultiplexer:
    """One of several inputs on one output, addressed through a digital port.

    Parameters
    ----------
    digital_port
        Device and port, such as ``Dev1/port0``. Its lines from 0 to the highest one used are driven.
    addresses
        Value on the lines that selects input 0, 1, 2 and so on.
    enable_line, enable_level
        Line that switches the multiplexer on at this level; None if its enable is wired fast.
    server
        ``host:port`` of an NI gRPC Device Server; None for the device on this PC.
    deadline_s
        Longest wait for one write.
    tap
        Told each value that is written.
    """

    def __init__(
        self,
        digital_port: str = "Dev1/port0",
        addresses: Sequence[int] = tuple(range(8)),
        *,
        enable_line: int | None = None,
        enable_level: bool = True,
        server: str | None = None,
        deadline_s: float = 2.0,
        tap: Tap = no_tap,
    ) -> None:
        enable = 0 if enable_line is None else 1 << enable_line
        self._values = [address | (enable if enable_level else 0) for address in addresses]
        highest = max([*self._values, enable, 1]).bit_length() - 1
        self._port = digital_port
        self._lines = f"{digital_port}/line0:{highest}" if highest else f"{digital_port}/line0"
        self._server = server
        self._deadline_s = deadline_s
        self._tap = tap
        self._thread = DeviceThread(_DEVICE)
        self._session: _Session | None = None

    async def open(self) -> str:
        """Reserve the lines; nothing is written, so the selection stays as it is."""
        await self.close()

        def connect() -> _Session:
            return _Session(self._port, self._lines, self._server, self._deadline_s)

        try:
            self._session = await self._thread.call(connect, 3 * self._deadline_s + 5.0, _Session.close)
        except BaseException:
            await self.close()
            raise
        return self._session.identity

    async def close(self) -> None:
        """Release the lines; they keep their state."""
        session, self._session = self._session, None
        await self._thread.finish(None if session is None else session.close, _CLOSE_S)
        if session is not None:
            # What waits for a server that has gone silent comes back now.
            session.interrupt()

    async def select(self, channel: int) -> None:
        """Write the address of an input in one value."""
        if not 0 <= channel < len(self._values):
            raise RefusedError(_DEVICE, f"has the inputs 0 to {len(self._values) - 1}, not {channel}")
        session = self._session
        if session is None:
            raise LinkLostError(_DEVICE, "has to be opened first")
        value = self._values[channel]
        try:
            await self._thread.call(lambda: session.write(value), 2 * self._deadline_s)
        except DeviceError:
            await self.close()
            raise
        self._tap(">", b"%d" % value)


class _Session:
    """A task that drives the lines; blocking, for use in one thread."""

    def __init__(self, port: str, lines: str, server: str | None, deadline_s: float) -> None:
        self._server = server
        self._deadline_s = deadline_s
        self._task: Any = None
        self._channel: Any = None
        self._place = lines if server is None else f"{lines} at {server}"
        # NI's package takes a fifth of a second to load and is needed by nobody else.
        import nidaqmx  # noqa: PLC0415
        from nidaqmx.constants import LineGrouping  # noqa: PLC0415
        from nidaqmx.stream_writers import DigitalSingleChannelWriter  # noqa: PLC0415

        self._nidaqmx = nidaqmx
        try:
            self._task = self._new_task(port)
            self._task.do_channels.add_do_chan(
                lines, name_to_assign_to_lines="address", line_grouping=LineGrouping.CHAN_FOR_ALL_LINES
            )
            self._task.start()
            writer = DigitalSingleChannelWriter(self._task.out_stream, auto_start=False)
            self._write: Callable[..., object] = writer.write_one_sample_port_uint32
        except nidaqmx.errors.Error as error:
            self.close()
            self._refuse_open(error)
        except BaseException:
            self.close()
            raise
        self.identity = f"{self._product(port)} with the lines {self._place}"

    def write(self, value: int) -> None:
        """Put a value on the lines."""
        try:
            self._write(value, timeout=self._deadline_s)
        except self._nidaqmx.errors.Error as error:
            message = f"the lines {self._place} did not take the address: {_reason(error)}"
            raise LinkLostError(_DEVICE, message) from error
        except ValueError as error:
            # What gRPC says of a channel that has been closed under a call.
            raise LinkLostError(_DEVICE, f"{self._place}: {error}") from error

    def interrupt(self) -> None:
        """End a call that waits for the server; safe from another thread."""
        if self._channel is not None:
            self._channel.close()

    def close(self) -> None:
        """Release the lines; never raises."""
        task, self._task = self._task, None
        if task is not None:
            with contextlib.suppress(self._nidaqmx.errors.Error, ValueError):
                task.close()
        if self._channel is not None:
            self._channel.close()

    def _new_task(self, port: str) -> Any:
        if self._server is None:
            return self._nidaqmx.Task()
        # gRPC's own library writes to stderr what is told here as an error anyway; it looks only when it is loaded.
        os.environ.setdefault("GRPC_VERBOSITY", "ERROR")
        import grpc  # noqa: PLC0415 - only where a server is used

        self._channel = grpc.insecure_channel(self._server)
        try:
            grpc.channel_ready_future(self._channel).result(timeout=self._deadline_s)
        except grpc.FutureTimeoutError:
            message = f"no NI gRPC Device Server answers at {self._server}: is it running, is the port open?"
            raise ConnectError(_DEVICE, message) from None
        name = f"heliocube {port.replace('/', ' ')}"
        options = self._nidaqmx.GrpcSessionOptions(self._channel, name)
        # A program that died leaves its session on the server with the lines reserved: take it over, and end it.
        try:
            self._nidaqmx.Task(name, grpc_options=options).close()
            return self._nidaqmx.Task(name, grpc_options=options)
        except self._nidaqmx.errors.DaqError:
            # Its device was unplugged under it, and it cannot even be asked for its name: leave it, it holds nothing.
            return self._nidaqmx.Task(grpc_options=self._nidaqmx.GrpcSessionOptions(self._channel, ""))

    def _product(self, port: str) -> str:
        """Return the device's type; older servers cannot tell, and after a replug NI's driver sometimes cannot."""
        options = None
        if self._channel is not None:
            options = self._nidaqmx.GrpcSessionOptions(self._channel, "")
        with contextlib.suppress(self._nidaqmx.errors.Error):
            device = self._nidaqmx.system.System(grpc_options=options).devices[port.partition("/")[0]]
            return f"NI {device.product_type}"
        return "NI device of unknown type"

    def _refuse_open(self, error: Exception) -> NoReturn:
        errors = self._nidaqmx.errors
        code = getattr(error, "error_code", None)
        if isinstance(error, errors.DaqNotFoundError | errors.DaqNotSupportedError):
            raise DriverMissingError(
                _DEVICE,
                "NI-DAQmx is not installed on this PC; install it, or name the PC that has it in"
                " instruments.multiplexer.server",
            ) from error
        if code in _HELD:
            raise ConnectError(_DEVICE, f"{self._place} is held by another program") from error
        if code in _NO_SUCH_DEVICE:
            message = f"there is no device for {self._place}: is it plugged in, and is this its name in NI MAX?"
            raise ConnectError(_DEVICE, message) from error
        raise ConnectError(_DEVICE, f"{self._place} cannot be used: {_reason(error)}") from error


def _reason(error: Exception) -> str:
    """Return the first sentence of NI's many lines, with the number."""
    code = getattr(error, "error_code", None)
    first = (str(error).strip().splitlines() or ["no reason given"])[0]
    return first if code is None else f"{first} ({code})"
