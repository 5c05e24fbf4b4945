"""The door of the local interface: a new connection waits before it until the client has sent something.

A connection costs the server many times what it costs the client. So the server gets none before its first bytes have
come: a connection that is closed without a byte, as thousands a second may be, costs a few system calls. The rest get
in at a bounded rate, but a client that bears the token gets in at once.
"""

import asyncio
import ipaddress
import re
import socket
from collections import Counter
from collections.abc import Awaitable, Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass

from daemon.api.gate import Token
from daemon.api.port.connections import MOST_PER_ADDRESS
from daemon.api.refusals import ApiRefusals
from daemon.base.addresses import unmap_ipv4
from daemon.base.recurrence import RateLimit

# The kernel's queue, at most net.core.somaxconn; when it is full, a new client has to wait for a second.
_QUEUE = 4096
# Accepted at one turn of the loop, so that other tasks get their turn within some milliseconds.
_AT_ONCE = 64
_ADMITTED_PER_S, _ADMITTED_AT_ONCE = 200.0, 100
_MOST_SILENT, _MOST_WAITING = 192, 128
_SILENT_FOR_S, _LOOK_EVERY_S = 5.0, 1.0
_AGAIN_AFTER_S = 1.0
_LONGEST_LOOK = 4096
_BEARER_HEADER = re.compile(rb"\r\nauthorization:[ \t]*bearer[ \t]+([^\r\n]+)\r\n", re.IGNORECASE)
_SORRY = b'{"error":"too many programs ask at once; ask again in a second"}'
_CROWDED = (
    b"HTTP/1.1 503 Service Unavailable\r\ncontent-type: application/json\r\nretry-after: 1\r\nconnection: close\r\n"
    b"content-length: %d\r\n\r\n%s" % (len(_SORRY), _SORRY)
)


@dataclass(eq=False, slots=True)
class _Caller:
    """A client before the door."""

    socket: socket.socket
    address: str
    since_s: float


class Doorkeeper:
    """Accepts connections, and lets those through whose clients have sent something.

    Parameters
    ----------
    token
        A client that bears it does not wait.
    refusals
        Takes note of clients that are sent away.
    speed
        The event loop's clock runs this many times as fast as the machine's.
    """

    def __init__(self, token: Token, refusals: ApiRefusals, speed: float) -> None:
        self._token = token
        self._refusals = refusals
        self._speed = speed
        self._rate = RateLimit(_ADMITTED_PER_S / speed, _ADMITTED_AT_ONCE)
        self._silent: dict[_Caller, None] = {}
        self._waiting: dict[_Caller, None] = {}
        self._callers_per_address: Counter[str] = Counter()
        self._timers: dict[Callable[[], None], asyncio.TimerHandle] = {}
        self._entering: set[asyncio.Task[None]] = set()

    @contextmanager
    def open(self, bound: socket.socket, serve: Callable[[socket.socket], Awaitable[object]]) -> Iterator[None]:
        """Let callers of a bound socket through to `serve`, for as long as the context lasts."""
        self._loop, self._bound, self._serve = asyncio.get_running_loop(), bound, serve
        bound.setblocking(False)
        bound.listen(_QUEUE)
        self._start_accepting()
        try:
            yield
        finally:
            self._loop.remove_reader(bound)
            for timer in self._timers.values():
                timer.cancel()
            for caller in [*self._silent, *self._waiting]:
                self._forget(caller)
                caller.socket.close()

    def _start_accepting(self) -> None:
        self._loop.add_reader(self._bound, self._accept)

    def _accept(self) -> None:
        for _ in range(_AT_ONCE):
            try:
                accepted, address = self._bound.accept()
            except (BlockingIOError, ConnectionAbortedError):
                return
            except OSError as error:
                self._refusals.note("crowded", f"no connection can be accepted: {error.strerror}")
                self._loop.remove_reader(self._bound)
                self._after(_AGAIN_AFTER_S, self._start_accepting)
                return
            accepted.setblocking(False)
            self._handle_new_caller(_Caller(accepted, unmap_ipv4(address[0]), self._loop.time()))

    def _handle_new_caller(self, caller: _Caller) -> None:
        said = _peek(caller)
        if said is None:
            self._keep_silent_caller(caller)
        else:
            self._admit_or_refuse(caller, said)

    def _keep_silent_caller(self, caller: _Caller) -> None:
        """Keep a client that has sent nothing yet, at the cost of the one that has been silent longest if need be."""
        alone = self._too_many_from(caller.address)
        if alone or len(self._silent) >= _MOST_SILENT:
            longest = next((one for one in self._silent if not alone or one.address == caller.address), caller)
            whose = f"from {caller.address}" if alone else "in all"
            self._refusals.note("crowded", f"too many connections that send nothing {whose}: the longest is closed")
            self._forget(longest)
            longest.socket.close()
            if longest is caller:
                return
        self._callers_per_address[caller.address] += 1
        self._silent[caller] = None
        self._loop.add_reader(caller.socket, self._on_readable, caller)
        self._after(_LOOK_EVERY_S, self._close_silent_callers)

    def _too_many_from(self, address: str) -> bool:
        # All clients behind a tunnel or a proxy on this machine come from loopback, which has no limit of its own.
        return self._callers_per_address[address] >= MOST_PER_ADDRESS and not ipaddress.ip_address(address).is_loopback

    def _on_readable(self, caller: _Caller) -> None:
        said = _peek(caller)
        if said is not None:
            self._forget(caller)
            self._admit_or_refuse(caller, said)

    def _admit_or_refuse(self, caller: _Caller, said: bytes) -> None:
        if not said:
            caller.socket.close()
        elif self._bears_the_token(said) or (not self._waiting and self._rate.admit(self._loop.time())):
            self._admit(caller)
        elif len(self._waiting) < _MOST_WAITING and not self._too_many_from(caller.address):
            self._callers_per_address[caller.address] += 1
            self._waiting[caller] = None
            self._after(1.0 / _ADMITTED_PER_S, self._admit_waiting)
        else:
            self._refuse(caller)

    def _bears_the_token(self, said: bytes) -> bool:
        bearer = _BEARER_HEADER.search(said)
        return bearer is not None and self._token.matches(bearer[1])

    def _admit_waiting(self) -> None:
        while self._waiting and self._rate.admit(self._loop.time()):
            caller = next(iter(self._waiting))
            self._forget(caller)
            self._admit(caller)
        if self._waiting:
            self._after(1.0 / _ADMITTED_PER_S, self._admit_waiting)

    def _admit(self, caller: _Caller) -> None:
        entering = self._loop.create_task(self._serve_caller(caller))
        self._entering.add(entering)
        entering.add_done_callback(self._entering.discard)

    async def _serve_caller(self, caller: _Caller) -> None:
        try:
            await self._serve(caller.socket)
        except OSError:
            caller.socket.close()

    def _refuse(self, caller: _Caller) -> None:
        self._refusals.note("crowded", "more new connections than are accepted")
        # To close with unread bytes would reset the connection, and the answer would be lost.
        with suppress(OSError):
            caller.socket.recv(_LONGEST_LOOK)
            caller.socket.send(_CROWDED)
        caller.socket.close()

    def _forget(self, caller: _Caller) -> None:
        if caller in self._silent:
            self._loop.remove_reader(caller.socket)
            del self._silent[caller]
        elif caller in self._waiting:
            del self._waiting[caller]
        else:
            return
        self._callers_per_address[caller.address] -= 1
        if not self._callers_per_address[caller.address]:
            del self._callers_per_address[caller.address]

    def _close_silent_callers(self) -> None:
        """Send clients away that have been silent for too long."""
        now_s = self._loop.time()
        for caller in list(self._silent):
            silent_s = (now_s - caller.since_s) / self._speed
            if silent_s < _SILENT_FOR_S:
                self._after(_LOOK_EVERY_S, self._close_silent_callers)
                return
            self._refusals.note("slow", f"{caller.address} has sent nothing for {silent_s:.0f} s")
            self._forget(caller)
            caller.socket.close()

    def _after(self, wall_s: float, call: Callable[[], None]) -> None:
        """Call after so many seconds of the machine's clock, and only once however often this is asked for."""
        if call not in self._timers:
            self._timers[call] = self._loop.call_later(wall_s * self._speed, self._call, call)

    def _call(self, call: Callable[[], None]) -> None:
        del self._timers[call]
        call()


def _peek(caller: _Caller) -> bytes | None:
    """Return the first bytes of a caller, empty if it has gone, or None if it has sent nothing yet."""
    try:
        return caller.socket.recv(_LONGEST_LOOK, socket.MSG_PEEK)
    except (BlockingIOError, InterruptedError):
        return None
    except OSError:
        return b""
