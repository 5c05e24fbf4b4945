"""Connections to our HTTP servers, which take in only a little of each at one turn of the loop."""

import asyncio
import os
import socket
from contextlib import suppress
from typing import Any

from uvicorn.protocols.http.h11_impl import H11Protocol

READ_AT_ONCE = 1024
"""Most bytes that are read from a connection in one turn of the loop. If more were read at once, a head longer than the
limit would pass, and hundreds of small parts of a body would be taken apart in one go."""

LONGEST_HEAD = 16 << 10
"""Most bytes of a request's head."""
HEAD_TOO_LONG_TEXT = (
    f"the head of this request is longer than {LONGEST_HEAD} bytes; a browser sends fewer without its cookies"
)
# Room for what comes at once with a head that is too long: three times as much, and more.
_MOST_UNREAD = 1 << 16
# Otherwise the kernel would grow this buffer to megabytes for a client that does not read.
_SEND_BUFFER = 1 << 16


class PiecewiseProtocol(H11Protocol, asyncio.BufferedProtocol):
    """The server's own connection, which takes in what was sent in parts of `READ_AT_ONCE`."""

    def __init__(self, *args: Any, **server: Any) -> None:
        super().__init__(*args, **server)
        self._read = bytearray(READ_AT_ONCE)

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        """Begin."""
        super().connection_made(transport)
        transport.get_extra_info("socket").setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, _SEND_BUFFER)

    def get_buffer(self, sizehint: int) -> bytearray:  # noqa: ARG002 - the event loop passes it
        """Return what the next bytes are to be read into."""
        return self._read

    def buffer_updated(self, nbytes: int) -> None:
        """Take in what was read."""
        self.data_received(bytes(self._read[:nbytes]))

    @property
    def head_is_too_long(self) -> bool:
        """Whether a head longer than `LONGEST_HEAD` was refused; otherwise what was refused is not HTTP."""
        return len(self.conn.trailing_data[0]) > LONGEST_HEAD

    def drop_unread(self) -> None:
        """Drop what has been sent and not read: at the close the kernel would discard our answer because of it."""
        with suppress(OSError):
            os.read(self.transport.get_extra_info("socket").fileno(), _MOST_UNREAD)

    def send_400_response(self, msg: str) -> None:
        """Answer a request that cannot be read, and close."""
        self.drop_unread()
        super().send_400_response(HEAD_TOO_LONG_TEXT if self.head_is_too_long else msg)
