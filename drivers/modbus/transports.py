"""Ways to a device that speaks Modbus: a serial port, and TCP with either kind of frame.

A line is named by one text: a serial port's name, ``tcp:192.168.1.40:502`` for Modbus TCP, or
``rtu-over-tcp:192.168.1.40:4001`` for a box that passes the bytes of a serial line on as they are.
"""

import asyncio
import os
import re
from collections.abc import Callable
from functools import partial
from typing import Annotated, Literal, NamedTuple, Protocol

from pydantic import AfterValidator

from drivers.errors import ConnectError, DeadlineError, LinkLostError
from drivers.lines.serial_port import SerialForm, SerialPort
from drivers.lines.threads import DeviceThread
from drivers.modbus.framing import BrokenStreamError, ClientFraming, RtuClient, TcpClient
from drivers.modbus.pdu import ModbusRequest
from drivers.settings import check_host, stable_port, text_schema
from drivers.transcript import Tap, no_tap

_NETWORK = re.compile(r"(?P<kind>tcp|rtu-over-tcp):(?P<host>[A-Za-z0-9._-]+|\[[0-9A-Fa-f:]+\]):(?P<port>\d{1,5})")
_OPEN_S = 15.0
_CLOSE_S = 1.0
# A deadline is missed by this much at most.
_READ_S = 0.01
# A call that has not returned so long after its own deadline never will.
_HUNG_S = 2.0


class Endpoint(NamedTuple):
    """Where TCP leads to, and in which frames it carries Modbus."""

    kind: Literal["tcp", "rtu-over-tcp"]
    host: str
    port: int


def endpoint(line: str) -> Endpoint | None:
    """Return what a line's name says of the network; None for a serial port. `ValueError` for neither."""
    found = _NETWORK.fullmatch(line)
    if found is None:
        stable_port(line)
        return None
    port = int(found["port"])
    if not 0 < port <= 65535:
        raise ValueError("not a port")
    check_host(found["host"])
    return Endpoint("tcp" if found["kind"] == "tcp" else "rtu-over-tcp", found["host"].strip("[]"), port)


def _line_name(text: str) -> str:
    endpoint(text)
    return text


ModbusLine = Annotated[str, AfterValidator(_line_name), text_schema("modbus-line")]


class ModbusTransport(Protocol):
    """Carries questions to devices and their replies back, one at a time."""

    async def open(self, within_s: float = _OPEN_S) -> None:
        """Connect; `ConnectError` if that is not possible in time."""

    async def close(self) -> None:
        """Release the line; never raises."""

    async def exchange(self, request: ModbusRequest, within_s: float) -> bytes:
        """Send a question and return its reply's function and data.

        Raises `DeadlineError` if none came in time, whose message is empty when nothing came at all, and
        `LinkLostError` when the line itself is gone.
        """


class SerialTransport:
    """A serial port with RTU; it lives in a thread of its own.

    Parameters
    ----------
    device
        Role of what is behind it, for errors.
    port, baud_rate, form
        Its name, and how it is set.
    monotonic_s
        Monotonic time, also in its thread.
    tap
        Told what goes over it.
    """

    def __init__(
        self,
        device: str,
        port: str,
        baud_rate: int,
        form: SerialForm,
        monotonic_s: Callable[[], float],
        tap: Tap = no_tap,
    ) -> None:
        self._device = device
        self._now = monotonic_s
        self._connect = partial(
            SerialPort, device, port, _allow_anything, tap, baud_rate=baud_rate, form=form, read_s=_READ_S
        )
        self._framing = RtuClient()
        self._thread = DeviceThread(device)
        self._port: SerialPort | None = None

    async def open(self, within_s: float = _OPEN_S) -> None:
        """Open the port."""
        await self.close()
        self._port = await self._thread.call(self._connect, max(within_s, _HUNG_S), lambda late: late.close())

    async def close(self) -> None:
        """Release the port."""
        port, self._port = self._port, None
        await self._thread.finish(None if port is None else port.close, _CLOSE_S)

    async def exchange(self, request: ModbusRequest, within_s: float) -> bytes:
        """Send a question and return its reply."""
        if self._port is None:
            raise LinkLostError(self._device, "has to be opened first")
        work = partial(self._exchange, self._port, request, within_s)
        return await self._thread.call(work, within_s + _HUNG_S)

    def _exchange(self, port: SerialPort, request: ModbusRequest, within_s: float) -> bytes:
        port.discard()
        port.write(self._framing.begin(request))
        until_s = self._now() + within_s
        came = b""
        while self._now() < until_s:
            data = port.read()
            came += data
            if (reply := self._framing.feed(data)) is not None:
                return reply
        raise DeadlineError(self._device, "sent something that is not an answer" if came else "")


def _allow_anything(_data: bytes) -> None:
    """Let every frame pass: `drivers.modbus.client.ModbusBus` decides which functions may be sent."""


class TcpTransport:
    """A connection over TCP.

    Parameters
    ----------
    device
        Role of what is behind it, for errors.
    where
        Where it leads to, and its frames.
    tap
        Told what goes over it.
    """

    def __init__(self, device: str, where: Endpoint, tap: Tap = no_tap) -> None:
        self._device = device
        self._where = where
        self._tap = tap
        self._stream: _Stream | None = None

    async def open(self, within_s: float = _OPEN_S) -> None:
        """Connect."""
        await self.close()
        framing: ClientFraming = TcpClient() if self._where.kind == "tcp" else RtuClient()
        name = f"{self._where.host} port {self._where.port}"
        try:
            async with asyncio.timeout(within_s):
                _, self._stream = await asyncio.get_running_loop().create_connection(
                    lambda: _Stream(framing, self._tap), self._where.host, self._where.port
                )
        except TimeoutError:
            raise ConnectError(self._device, f"{name} does not answer within {within_s:g} s; is it on?") from None
        except OSError as error:
            # asyncio's own text names the address again, and not the reason.
            code = error.errno or 0
            reason = os.strerror(code) if code > 0 else error.strerror or str(error)
            raise ConnectError(self._device, f"{name} takes no connection ({reason}); is it on?") from error

    async def close(self) -> None:
        """Disconnect."""
        stream, self._stream = self._stream, None
        if stream is not None:
            stream.close()

    async def exchange(self, request: ModbusRequest, within_s: float) -> bytes:
        """Send a question and return its reply."""
        stream = self._stream
        if stream is None or stream.lost:
            raise LinkLostError(self._device, f"the connection to {self._where.host} is gone")
        reply = stream.ask(request)
        try:
            async with asyncio.timeout(within_s):
                return await reply
        except TimeoutError:
            raise DeadlineError(self._device, "sent something that is not an answer" if stream.came else "") from None
        except ConnectionError:
            raise LinkLostError(self._device, f"the connection to {self._where.host} is gone") from None


class _Stream(asyncio.Protocol):
    """A connection: what comes goes to the framing at once, whether it is waited for or not."""

    def __init__(self, framing: ClientFraming, tap: Tap) -> None:
        self.lost = False
        self.came = False
        self._framing = framing
        self._tap = tap
        self._transport: asyncio.Transport
        self._reply: asyncio.Future[bytes] | None = None

    def ask(self, request: ModbusRequest) -> "asyncio.Future[bytes]":
        frame = self._framing.begin(request)
        self.came = False
        self._reply = asyncio.get_running_loop().create_future()
        self._transport.write(frame)
        self._tap(">", frame)
        return self._reply

    def close(self) -> None:
        self._transport.abort()

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        self._transport = transport  # type: ignore[assignment]

    def data_received(self, data: bytes) -> None:
        self._tap("<", data)
        self.came = True
        try:
            reply = self._framing.feed(data)
        except BrokenStreamError:
            self.close()
            return
        if reply is not None and self._reply is not None and not self._reply.done():
            self._reply.set_result(reply)

    def connection_lost(self, exc: Exception | None) -> None:  # noqa: ARG002
        self.lost = True
        if self._reply is not None and not self._reply.done():
            self._reply.set_exception(ConnectionResetError())


def build_transport(
    device: str,
    line: str,
    baud_rate: int,
    form: SerialForm,
    monotonic_s: Callable[[], float],
    tap: Tap = no_tap,
) -> ModbusTransport:
    """Return the way that a line's name says, not yet open; speed and form are those of a serial port."""
    where = endpoint(line)
    if where is None:
        return SerialTransport(device, line, baud_rate, form, monotonic_s, tap)
    return TcpTransport(device, where, tap)
