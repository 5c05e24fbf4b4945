"""The connections of the local interface: how many there may be, and how long one may send or read nothing.

The HTTP server answers connections above its limit with 503, commands as well, and waits for ever for the end of a
request. So this module keeps account of them. If there is one too many, the connection that has been idle for longest
is closed, or else the oldest whose request bears no token. A connection that makes no progress is closed, too.
"""

import asyncio
import ipaddress
from functools import partial
from typing import Any, cast

import h11
from starlette.datastructures import Headers

from daemon.api.gate import CLIENT_GONE_KEY, Token
from daemon.api.refusals import ApiRefusals
from daemon.base.addresses import unmap_ipv4
from daemon.base.piecewise import HEAD_TOO_LONG_TEXT, READ_AT_ONCE, PiecewiseProtocol

_MOST = 384
MOST_PER_ADDRESS = 32
_CHECK_EVERY_S = 1.0
# Until the end of the first request's head. A later request has five seconds to begin, and its head as long again.
_HEAD_WITHIN_S = 5.0
_NEXT_HEAD_WITHIN_S = 10.0
_BODY_WITHIN_S = 5.0
_READ_WITHIN_S = 10.0
# This slows down a client that sends garbage over and over.
_GARBAGE_PAUSE_S = 0.25


class Connections:
    """All connections of the interface.

    Parameters
    ----------
    token
        A request that bears it is not given up for another.
    refusals
        Takes note of the connections that are closed.
    speed
        The event loop's clock runs this many times as fast as the machine's.
    """

    def __init__(self, token: Token, refusals: ApiRefusals, speed: float) -> None:
        self.token = token
        self.refusals = refusals
        self.speed = speed
        self._open: dict[HttpConnection, None] = {}

    @property
    def count(self) -> int:
        """How many are open."""
        return len(self._open)

    def protocol(self) -> type[asyncio.Protocol]:
        """Return the protocol factory for the server: the connections that it makes belong to these."""
        return cast("type[asyncio.Protocol]", partial(HttpConnection, self))

    def admit(self, new: "HttpConnection") -> bool:
        """Take a new connection in, at the cost of one without the token if need be; return whether there was room."""
        own = [one for one in self._open if one.address == new.address]
        # All clients behind a tunnel or a proxy on this machine come from loopback, which has no limit of its own.
        crowd = own if len(own) >= MOST_PER_ADDRESS and not new.from_loopback else list(self._open)
        if len(crowd) >= (MOST_PER_ADDRESS if crowd is own else _MOST):
            idle = (one for one in crowd if one.is_idle)
            given_up = next(idle, None) or next((one for one in crowd if not one.bears_the_token), None)
            whose = f"from {new.address}" if crowd is own else "in all"
            self.refusals.note("crowded", f"more than {len(crowd)} connections {whose}: one of them is closed")
            if given_up is None:
                return False
            self.drop(given_up)
            given_up.abort()
        self._open[new] = None
        return True

    def mark_used(self, one: "HttpConnection") -> None:
        """Take note that a connection has got a whole request: it is the last to be given up."""
        if one in self._open:
            del self._open[one]
            self._open[one] = None

    def drop(self, one: "HttpConnection") -> None:
        """Forget a connection that has ended."""
        self._open.pop(one, None)

    async def run(self) -> None:
        """Close connections that make no progress, until cancelled."""
        while True:
            await asyncio.sleep(_CHECK_EVERY_S * self.speed)
            for one in list(self._open):
                one.check()
            self.refusals.log_ended_floods()


class HttpConnection(PiecewiseProtocol):
    """One connection: the server's own, with a limit to each of its waits, and to the bytes that are read at once.

    Parameters
    ----------
    all_of_them
        The connections that it belongs to.
    """

    def __init__(self, all_of_them: Connections, **server: Any) -> None:
        super().__init__(**server)
        self._connections = all_of_them
        self._refusals = all_of_them.refusals
        self._waiting_since_s = self._last_progress_s = 0.0
        self._unread = 0
        self._garbage_timer: asyncio.TimerHandle | None = None
        self._garbled = False
        self.address = ""
        self.from_loopback = False

    @property
    def is_idle(self) -> bool:
        """Whether it has sent no whole request and bears no token, or does not read its answer."""
        waits_for_a_body = self.conn.their_state is h11.SEND_BODY
        return self._waits_for_a_head or self._unread > 0 or (waits_for_a_body and not self.bears_the_token)

    @property
    def bears_the_token(self) -> bool:
        """Whether the request that it has sent is one with the token."""
        return self.headers is not None and self._connections.token.refusal(Headers(raw=self.headers)) is None

    @property
    def _waits_for_a_head(self) -> bool:
        return self.conn.their_state is h11.IDLE and (self.cycle is None or self.cycle.response_complete)

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        """Begin, if there is room."""
        super().connection_made(transport)
        self._waiting_since_s = self._last_progress_s = self.loop.time()
        # A socket for all of IPv6 shows the address of an IPv4 client wrapped in IPv6.
        if self.server is not None:
            self.server = (unmap_ipv4(self.server[0]), self.server[1])
        if self.client is not None:
            self.client = (unmap_ipv4(self.client[0]), self.client[1])
            self.address = self.client[0]
            self.from_loopback = ipaddress.ip_address(self.address).is_loopback
        if not self._connections.admit(self):
            transport.abort()

    def connection_lost(self, exc: Exception | None) -> None:
        """End."""
        self._connections.drop(self)
        if self._garbage_timer is not None:
            self._garbage_timer.cancel()
        if isinstance(exc, ConnectionResetError) and self.cycle is not None:
            self.cycle.scope.setdefault("extensions", {})[CLIENT_GONE_KEY] = {}
        super().connection_lost(exc)

    def data_received(self, data: bytes) -> None:
        """Take in what was sent; a client that sends more of a body after the answer is cut off."""
        if self._garbled:
            return
        waited = self._waits_for_a_head
        super().data_received(data)
        if waited and not self._waits_for_a_head:
            self._waiting_since_s = self.loop.time()
            self._connections.mark_used(self)
        if self.conn.their_state is not h11.SEND_BODY:
            return
        if self.conn.our_state is h11.DONE:
            self.abort()
        elif len(data) == READ_AT_ONCE and not self.bears_the_token:
            # The request has more body. Read on only when the handler takes it, to throw it away.
            self.flow.pause_reading()

    def on_response_complete(self) -> None:
        """Wait for the next request."""
        self._waiting_since_s = self.loop.time()
        super().on_response_complete()

    def send_400_response(self, msg: str) -> None:  # noqa: ARG002 - the server's
        """Answer a request that is not HTTP, after a pause."""
        what = "is a head that is too long" if self.head_is_too_long else "is not HTTP"
        self._refusals.note("garbage", f"what {self.address} sends {what}")
        self._garbled = True
        if self.cycle is not None and not self.cycle.response_complete:
            self.abort()
            return
        self.flow.pause_reading()
        self._garbage_timer = self.loop.call_later(_GARBAGE_PAUSE_S * self._connections.speed, self._answer_garbage)

    def check(self) -> None:
        """Close it if it makes no progress."""
        now_s, transport = self.loop.time(), self.transport
        unread = transport.get_write_buffer_size()
        if unread == 0 or unread < self._unread:
            self._last_progress_s = now_s
        self._unread = unread
        waited_s = (now_s - self._waiting_since_s) / self._connections.speed
        if (now_s - self._last_progress_s) / self._connections.speed > _READ_WITHIN_S:
            self._give_up(f"{self.address} does not read its answer")
        elif self._waits_for_a_head and waited_s > (_HEAD_WITHIN_S if self.cycle is None else _NEXT_HEAD_WITHIN_S):
            self._give_up(f"{self.address} has sent no whole request in {waited_s:.0f} s")
        elif self.conn.their_state is h11.SEND_BODY and waited_s > _BODY_WITHIN_S:
            self._give_up(f"{self.address} has not sent the whole body of a request in {waited_s:.0f} s")

    def abort(self) -> None:
        """Close it at once."""
        self.transport.abort()

    def _give_up(self, why: str) -> None:
        self._refusals.note("slow", why)
        self.abort()

    def _answer_garbage(self) -> None:
        if not self.transport.is_closing():
            status, why = "400 Bad Request", "this is not HTTP"
            if self.head_is_too_long:
                status, why = "431 Request Header Fields Too Large", HEAD_TOO_LONG_TEXT
            content = f'{{"error":"{why}"}}'
            head = f"HTTP/1.1 {status}\r\ncontent-type: application/json\r\ncontent-length: {len(content)}\r\n"
            self.drop_unread()
            self.transport.write(f"{head}connection: close\r\n\r\n{content}".encode())
            self.transport.close()
