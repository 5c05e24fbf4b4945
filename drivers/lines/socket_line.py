"""An instrument's network socket as a line of text: `drivers.scpi.ScpiLine` over TCP, such as port 5025.

PyVISA-py has such sockets too, but takes a refused connection for an open one.
"""

import asyncio
import contextlib
import re
import socket

from drivers.errors import ConnectError, DeadlineError, LinkLostError, ProtocolError
from drivers.lines.serial_port import LONGEST_DRAIN_S, unsolicited_data_error
from drivers.transcript import Tap, no_tap

SOCKET_RESOURCE = re.compile(r"TCPIP\d*::(?P<host>[A-Za-z0-9._-]+)::(?P<port>\d{1,5})::SOCKET", re.IGNORECASE)
"""The name by which VISA knows such a socket."""

_CONNECT_S = 5.0
_LONGEST_LINE = 65536


class SocketLine:
    """A TCP connection, line by line.

    Parameters
    ----------
    device
        Role of the instrument, for errors.
    host, port
        Where it listens.
    tap
        Told what is sent and received.
    """

    def __init__(self, device: str, host: str, port: int, tap: Tap = no_tap) -> None:
        self._device = device
        self._host = host
        self._port = port
        self._tap = tap
        self._reader: asyncio.StreamReader | None = None
        self._writer: asyncio.StreamWriter | None = None

    async def open(self) -> None:
        """Connect, within five seconds."""
        place = f"{self._host}:{self._port}"
        try:
            async with asyncio.timeout(_CONNECT_S):
                self._reader, self._writer = await asyncio.open_connection(self._host, self._port, limit=_LONGEST_LINE)
        except TimeoutError:
            raise ConnectError(self._device, f"{place} does not answer: is it on, and does its network work?") from None
        except socket.gaierror:
            raise ConnectError(self._device, f"there is no host {self._host}: is the name right?") from None
        except (OSError, OverflowError) as error:
            raise ConnectError(
                self._device, f"{place} cannot be reached: {getattr(error, 'strerror', None) or error}"
            ) from None

    async def close(self) -> None:
        """Release the connection."""
        writer, self._reader, self._writer = self._writer, None, None
        if writer is not None:
            writer.transport.abort()
            with contextlib.suppress(OSError):
                await writer.wait_closed()

    async def send(self, text: str) -> None:
        """Send one line."""
        writer = self._writer
        if writer is None:
            raise LinkLostError(self._device, "has to be opened first")
        if writer.transport.is_closing():
            raise self._closed_error()
        data = f"{text}\n".encode("ascii")
        writer.write(data)
        self._tap(">", data)

    async def ask(self, text: str, within_s: float) -> str:
        """Send one line and return the next one that comes."""
        await self.send(text)
        return await self.receive(within_s)

    async def receive(self, within_s: float) -> str:
        """Return the next line; what has come of one that is not complete in time stays for the next call."""
        reader = self._reader
        if reader is None:
            raise LinkLostError(self._device, "has to be opened first")
        try:
            async with asyncio.timeout(within_s):
                data = await reader.readuntil(b"\n")
        except TimeoutError:
            raise DeadlineError(self._device, "no line came in time") from None
        except (asyncio.IncompleteReadError, OSError):
            raise self._closed_error() from None
        except asyncio.LimitOverrunError:
            raise ProtocolError(self._device, "sends without end, but never ends a line") from None
        self._tap("<", data)
        return data.decode("latin-1").strip("\r\n")

    async def interrupt(self) -> None:
        """Do nothing: a raw socket has no device clear."""

    async def drain(self, quiet_s: float) -> None:
        """Throw away what comes until nothing has come for a time; `ConnectError` if it never ends."""
        reader = self._reader
        if reader is None:
            raise LinkLostError(self._device, "has to be opened first")
        now = asyncio.get_running_loop().time
        until_s = now() + LONGEST_DRAIN_S
        try:
            while now() < until_s:
                async with asyncio.timeout(quiet_s):
                    data = await reader.read(_LONGEST_LINE)
                if not data:
                    raise self._closed_error()
                self._tap("<", data)
        except TimeoutError:
            return
        except OSError:
            raise self._closed_error() from None
        raise unsolicited_data_error(self._device)

    async def discard_unsolicited(self) -> bool:
        """Throw away what has come and was not read; return whether it was more than the end of a line."""
        reader = self._reader
        if reader is None:
            raise LinkLostError(self._device, "has to be opened first")
        try:
            async with asyncio.timeout(0):
                data = await reader.read(_LONGEST_LINE)
        except TimeoutError:
            return False
        except OSError:
            raise self._closed_error() from None
        if not data:
            raise self._closed_error()
        self._tap("<", data)
        return bool(data.strip())

    def _closed_error(self) -> LinkLostError:
        return LinkLostError(self._device, f"{self._host}:{self._port} has closed the connection")
