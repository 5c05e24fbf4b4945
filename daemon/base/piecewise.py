"""Connections to our HTTP servers, of each of which little is looked at in one go."""

import asyncio
from typing import Any

from uvicorn.protocols.http.h11_impl import H11Protocol

READ_AT_ONCE = 1024
"""Of what a connection has sent, at one turn of the loop [bytes]: the limit of a head holds only for what does not come
at once, and hundreds of small parts of a body would be taken apart in one go."""


class PiecewiseProtocol(H11Protocol, asyncio.BufferedProtocol):
    """The server's own connection, which takes in what was sent by `READ_AT_ONCE`."""

    def __init__(self, *args: Any, **server: Any) -> None:
        super().__init__(*args, **server)
        self._read = bytearray(READ_AT_ONCE)

    def get_buffer(self, sizehint: int) -> bytearray:  # noqa: ARG002 - the event loop's
        """Return what the next bytes are to be read into."""
        return self._read

    def buffer_updated(self, nbytes: int) -> None:
        """Take in what was read."""
        self.data_received(bytes(self._read[:nbytes]))
