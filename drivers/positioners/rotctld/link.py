"""How rotctld is reached: a line that carries one command after the other and brings the replies in the same order."""

import asyncio
import errno
import socket
from collections import deque
from typing import Protocol

from drivers.errors import ConnectError, DeadlineError, LinkLostError, ProtocolError
from drivers.positioners.rotctld.protocol import ReplyStream, RotctldReply
from drivers.transcript import Tap, no_tap

_DEVICE = "positioner"
_CONNECT_S = 3.0


class RotctldLine(Protocol):
    """The line to a rotctld. Raises `drivers.errors.DeviceError` and nothing else."""

    simulated: bool

    async def open(self) -> None:
        """Connect."""

    async def close(self) -> None:
        """Release the line; never raises."""

    async def ask(self, command: bytes, within_s: float) -> RotctldReply:
        """Send one command at once, whatever is still unanswered, and return its reply; `DeadlineError` if it is late.

        After a late reply the line has to be closed: that reply would go to the wrong command.
        """


class TcpLine:
    """A TCP connection.

    Parameters
    ----------
    host, port
        Where rotctld listens.
    tap
        Told what is sent and received.
    """

    simulated = False

    def __init__(self, host: str, port: int, tap: Tap = no_tap) -> None:
        self._host = host
        self._port = port
        self._tap = tap
        self._peer: _Peer | None = None

    async def open(self) -> None:
        """Connect, within three seconds."""
        place = f"{self._host}:{self._port}"
        loop = asyncio.get_running_loop()
        try:
            async with asyncio.timeout(_CONNECT_S):
                _, self._peer = await loop.create_connection(lambda: _Peer(place, self._tap), self._host, self._port)
        except TimeoutError:
            raise ConnectError(
                _DEVICE, f"{place} does not answer: is the machine on, and does its network work?"
            ) from None
        except socket.gaierror:
            raise ConnectError(_DEVICE, f"there is no host {self._host}: is the name right?") from None
        except OSError as error:
            if error.errno == errno.ECONNREFUSED:
                message = f"nothing listens at {place}: is rotctld running there, with -T and -t?"
                raise ConnectError(_DEVICE, message) from None
            raise ConnectError(_DEVICE, f"{place} cannot be reached: {error.strerror}") from None

    async def close(self) -> None:
        """Release the connection."""
        peer, self._peer = self._peer, None
        if peer is not None:
            await peer.end()

    async def ask(self, command: bytes, within_s: float) -> RotctldReply:
        """Send one command and return its reply."""
        if self._peer is None:
            raise LinkLostError(_DEVICE, "has to be opened first")
        try:
            async with asyncio.timeout(within_s):
                return await self._peer.ask(command)
        except TimeoutError:
            name = command.decode("ascii").strip(" +\\\n").partition(" ")[0]
            raise DeadlineError(_DEVICE, f"did not answer {name} within {within_s:g} s") from None


class _Peer(asyncio.Protocol):
    """The connection's end: replies go to the callers in the order of their commands."""

    def __init__(self, place: str, tap: Tap) -> None:
        self._place = place
        self._tap = tap
        self._stream = ReplyStream()
        self._pending_replies: deque[asyncio.Future[RotctldReply]] = deque()
        self._transport: asyncio.Transport | None = None
        self._lost: Exception | None = None
        self._end_event = asyncio.Event()

    async def ask(self, command: bytes) -> RotctldReply:
        if self._lost is not None or self._transport is None:
            raise self._lost or LinkLostError(_DEVICE, "has to be opened first")
        future: asyncio.Future[RotctldReply] = asyncio.get_running_loop().create_future()
        self._pending_replies.append(future)
        self._transport.write(command)
        self._tap(">", command)
        return await future

    async def end(self) -> None:
        if self._transport is not None:
            self._transport.abort()
            await self._end_event.wait()

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        assert isinstance(transport, asyncio.Transport)  # noqa: S101 - narrowing for the type checker
        self._transport = transport

    def data_received(self, data: bytes) -> None:
        self._tap("<", data)
        try:
            replies = self._stream.feed(data)
        except ValueError as error:
            self._fail(ProtocolError(_DEVICE, f"{self._place} is not a rotctld: {error}"))
            return
        for reply in replies:
            if not self._pending_replies:
                self._fail(ProtocolError(_DEVICE, f"{self._place} sent an answer that nobody asked for"))
                return
            future = self._pending_replies.popleft()
            if not future.done():
                future.set_result(reply)

    def connection_lost(self, error: Exception | None) -> None:
        reason = f": {error.strerror}" if isinstance(error, OSError) and error.strerror else ""
        self._fail(LinkLostError(_DEVICE, f"rotctld at {self._place} has closed the connection{reason}"))
        self._end_event.set()

    def _fail(self, error: Exception) -> None:
        self._lost = self._lost or error
        while self._pending_replies:
            future = self._pending_replies.popleft()
            if not future.done():
                future.set_exception(error)
        if self._transport is not None:
            self._transport.abort()
