"""A digital port of an NI device, through NI-DAQmx here or an NI gRPC Device Server elsewhere.

NI's software is loaded at the first `open`. The gRPC connection is not encrypted.
"""

import contextlib
import os
from collections.abc import Callable, Iterator
from typing import Any

from drivers.errors import ConnectError, DriverMissingError, LinkLostError
from drivers.lines.threads import DeviceThread
from drivers.switches.digital_port import DaqError

_DEVICE = "multiplexer"
_CLOSE_S = 1.0


class NiPort:
    """Output lines of one port.

    Parameters
    ----------
    digital_port
        Device and port, such as ``Dev1/port0``.
    server
        ``host:port`` of an NI gRPC Device Server; None for the device on this PC.
    deadline_s
        Longest wait for one write.
    """

    def __init__(self, digital_port: str = "Dev1/port0", *, server: str | None = None, deadline_s: float = 2.0) -> None:
        self._port = digital_port
        self._server = server
        self._deadline_s = deadline_s
        self._thread = DeviceThread(_DEVICE)
        self._session: _Session | None = None

    async def open(self, highest_line: int) -> str:
        """Reserve the lines and return the device's type."""

        def connect() -> _Session:
            return _Session(self._port, self._lines(highest_line), self._server, self._deadline_s)

        self._session = await self._thread.call(connect, 3 * self._deadline_s + 5.0, _Session.close)
        return self._session.product

    async def close(self) -> None:
        """Release the lines; they keep their state."""
        session, self._session = self._session, None
        await self._thread.finish(None if session is None else session.close, _CLOSE_S)
        if session is not None:
            # This ends a call that still waits for a server that has gone silent.
            session.interrupt()

    async def write(self, value: int) -> None:
        """Put a value on the lines."""
        session = self._session
        if session is None:
            raise LinkLostError(_DEVICE, "has to be opened first")
        await self._thread.call(lambda: session.write(value), 2 * self._deadline_s)

    def place(self, highest_line: int) -> str:
        """Return the name of the lines, and of the server that has them."""
        lines = self._lines(highest_line)
        return lines if self._server is None else f"{lines} at {self._server}"

    def _lines(self, highest_line: int) -> str:
        return f"{self._port}/line0:{highest_line}" if highest_line else f"{self._port}/line0"


class _Session:
    """A task that drives the lines; blocking, for use in one thread."""

    def __init__(self, port: str, lines: str, server: str | None, deadline_s: float) -> None:
        self._server = server
        self._deadline_s = deadline_s
        self._task: Any = None
        self._channel: Any = None
        # NI's package takes a fifth of a second to load and is needed nowhere else.
        import nidaqmx  # noqa: PLC0415
        from nidaqmx.constants import LineGrouping  # noqa: PLC0415
        from nidaqmx.stream_writers import DigitalSingleChannelWriter  # noqa: PLC0415

        self._nidaqmx = nidaqmx
        try:
            with self._translate_errors():
                self._task = self._new_task(port)
                self._task.do_channels.add_do_chan(
                    lines, name_to_assign_to_lines="address", line_grouping=LineGrouping.CHAN_FOR_ALL_LINES
                )
                self._task.start()
                writer = DigitalSingleChannelWriter(self._task.out_stream, auto_start=False)
                self._write: Callable[..., object] = writer.write_one_sample_port_uint32
        except BaseException:
            self.close()
            raise
        self.product = self._product(port)

    def write(self, value: int) -> None:
        """Put a value on the lines."""
        try:
            with self._translate_errors():
                self._write(value, timeout=self._deadline_s)
        except ValueError as error:
            # gRPC raises this for a channel that was closed during a call.
            raise DaqError(None, str(error)) from error

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
        # gRPC writes to stderr what is raised here as an error anyway; it reads this variable only when it is loaded.
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
            # The old session's device was unplugged: it cannot even be asked for its name. Leave it, it holds nothing.
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

    @contextlib.contextmanager
    def _translate_errors(self) -> Iterator[None]:
        errors = self._nidaqmx.errors
        try:
            yield
        except (errors.DaqNotFoundError, errors.DaqNotSupportedError) as error:
            message = (
                "NI-DAQmx is not installed on this PC; install it, or name the PC that has it in"
                " instruments.multiplexer.server"
            )
            raise DriverMissingError(_DEVICE, message) from error
        except errors.Error as error:
            # NI's text has many lines.
            first = (str(error).strip().splitlines() or ["no reason given"])[0]
            raise DaqError(getattr(error, "error_code", None), first) from error
