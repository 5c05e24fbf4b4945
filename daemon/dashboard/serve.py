"""Running the dashboard: its address, its signals, and its reports to the service manager."""

import asyncio
import contextlib
import errno
import logging
import math
import os
import socket
from collections.abc import Callable, Collection, Iterator, Sequence
from pathlib import Path
from threading import Thread

import h11
import httpx
import uvicorn
from anyio.to_thread import current_default_thread_limiter

from daemon.base.addresses import DEFAULT_DASHBOARD, DROP_UNSENT_ON_CLOSE, Address, parse_address
from daemon.base.clock import Clock
from daemon.base.errors import UserError
from daemon.base.piecewise import LONGEST_HEAD, READ_AT_ONCE, PiecewiseProtocol
from daemon.base.process import SystemdNotifier, on_signals
from daemon.config.links import DashboardSettings, read_client_section
from daemon.dashboard.app import KEEP_OPEN_KEY, Dashboard
from daemon.dashboard.upstream import Fleet

_GRACE_S = 1
_CONNECTIONS = 256
# More than the five seconds for which the server keeps a connection for the next request.
_REQUEST_WITHIN_S = 10.0
_READ_WITHIN_S = 10.0
# Each file of the page is read in a thread, and a browser asks for six at once; the systemd unit allows 16 threads.
_FILES_AT_ONCE = 8
_WHY_NOT_BOUND = {
    errno.EADDRINUSE: "is another dashboard running? Else set dashboard.listen or --listen to another port",
    errno.EADDRNOTAVAIL: "it is not an address of this machine now; if it will be one later, start the dashboard again"
    " then, as its unit does every 5 s, else set dashboard.listen or --listen to an address of this machine",
    errno.EAFNOSUPPORT: "this system has no IPv6: set dashboard.listen or --listen to an address such as"
    f" {DEFAULT_DASHBOARD}",
    errno.EACCES: "a port below 1024 needs an administrator's rights: set dashboard.listen or --listen to another port",
}


class _Server(uvicorn.Server):
    """A server that leaves signals to the process."""

    @contextlib.contextmanager
    def capture_signals(self) -> Iterator[None]:
        yield


class _Connection(PiecewiseProtocol):
    """A connection with limits: clients that send nothing, or much at once, or do not read keep nobody else out.

    It is closed if no whole request comes, or if nothing of an answer is read. If a new connection is one too many, the
    one on which no request or answer has begun or ended for longest is closed.
    """

    _wait_timer: asyncio.TimerHandle | None = None
    _reading: asyncio.TimerHandle | None = None
    _since_s = 0.0

    def buffer_updated(self, nbytes: int) -> None:
        answered = self.cycle
        super().buffer_updated(nbytes)
        if self.cycle is not answered:
            self._since_s = self.loop.time()
        if nbytes < READ_AT_ONCE or self.conn.their_state is not h11.SEND_BODY:
            return
        # The request has more body. Read it only while the handler asks for it; after the answer, close the connection.
        if self.conn.our_state is h11.DONE:
            self.transport.abort()
        else:
            self.flow.pause_reading()

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        super().connection_made(transport)
        self._wait()
        if len(self.connections) >= _CONNECTIONS:
            others = (one for one in self.connections if isinstance(one, _Connection) and one is not self)
            given_up = min((one for one in others if not one.is_kept), key=_Connection.since_s, default=self)
            # The server would count it until `connection_lost`, which comes after all other new ones of this turn.
            self.connections.discard(given_up)
            given_up.transport.abort()

    @property
    def is_waited_for(self) -> bool:
        """Whether the next request has not come yet, or not as a whole."""
        return self.cycle is None or self.cycle.response_complete or self.conn.their_state is h11.SEND_BODY

    @property
    def is_kept(self) -> bool:
        """Whether it must not be closed in favour of a new connection, because it is being answered."""
        return not self.is_waited_for and self.scope["state"].get(KEEP_OPEN_KEY, False)

    def since_s(self) -> float:
        """Return when a request or an answer last began or ended here, by the loop's clock [s]."""
        return self._since_s

    def connection_lost(self, exc: Exception | None) -> None:
        self._end_wait()
        self._end_reading()
        super().connection_lost(exc)

    def pause_writing(self) -> None:
        super().pause_writing()
        self._await_reading(math.inf)

    def resume_writing(self) -> None:
        super().resume_writing()
        self._end_reading()

    def _await_reading(self, unread_before: float) -> None:
        unread = self.transport.get_write_buffer_size()
        if unread < unread_before:
            self._reading = self.loop.call_later(_READ_WITHIN_S, self._await_reading, unread)
        else:
            self.transport.abort()

    def _end_reading(self) -> None:
        if self._reading is not None:
            self._reading.cancel()

    def on_response_complete(self) -> None:
        super().on_response_complete()
        self._wait()

    def _wait(self) -> None:
        self._end_wait()
        self._since_s = self.loop.time()
        self._wait_timer = self.loop.call_later(
            _REQUEST_WITHIN_S, self._check_progress, self.transport.get_write_buffer_size()
        )

    def _end_wait(self) -> None:
        if self._wait_timer is not None:
            self._wait_timer.cancel()

    def _check_progress(self, unread_before: int) -> None:
        unread = self.transport.get_write_buffer_size()
        if 0 < unread < unread_before:
            self._wait_timer = self.loop.call_later(_REQUEST_WITHIN_S, self._check_progress, unread)
        elif self.is_waited_for:
            self.transport.abort()


def settings_of_file(path: Path | None) -> DashboardSettings:
    """Return the section [dashboard] of a file; raises `UserError`."""
    return read_client_section(path, "dashboard", DashboardSettings)


def bind(listen: str) -> socket.socket:
    """Return a socket that listens there; raises `UserError` where it cannot."""
    try:
        address = parse_address(listen)
    except ValueError as error:
        raise UserError(f"--listen: {error}") from None
    bound: socket.socket | None = None
    try:
        bound = socket.socket(address.family, socket.SOCK_STREAM)
        if os.name == "posix":  # Windows would let two programs share the port
            bound.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        bound.bind((address.host, address.port))
        bound.listen()
    except OSError as error:
        if bound is not None:
            bound.close()
        why = _WHY_NOT_BOUND.get(error.errno or 0, "set dashboard.listen or --listen to another address or port")
        raise UserError(f"cannot listen on {address}: {error.strerror}; {why}") from None
    return bound


def url_of(bound: socket.socket) -> str:
    """Return the URL by which a browser of this machine reaches a listening socket."""
    host, port = bound.getsockname()[:2]
    return f"http://{Address(host, port).reachable_address}"


def addresses(texts: Sequence[str]) -> list[Address]:
    """Return the services' addresses; raises `UserError` for one that is not valid."""
    try:
        return [parse_address(text).reachable_address for text in texts]
    except ValueError as error:
        raise UserError(f"--api: {error}") from None


async def serve(
    bound: socket.socket,
    services: Sequence[Address],
    hosts: Collection[str],
    clock: Clock,
    notifier: SystemdNotifier,
    parent: int | None = None,
) -> None:
    """Serve the dashboard of some services until SIGINT, SIGTERM or SIGHUP.

    Parameters
    ----------
    bound
        Listens already; is closed at the end.
    services
        Addresses of their local interfaces.
    hosts
        Names under which browsers reach the dashboard.
    parent
        A file descriptor that ends when the dashboard is to end; None where there is none.
    """
    loop = asyncio.get_running_loop()
    current_default_thread_limiter().total_tokens = _FILES_AT_ONCE
    # None is kept alive: the service may close a connection at the instant in which an order uses it.
    limits = httpx.Limits(max_connections=None, max_keepalive_connections=0)
    # The clients ignore the environment (`trust_env`): its proxies are for the world outside, not for the services.
    once = httpx.AsyncHTTPTransport(limits=limits, socket_options=[DROP_UNSENT_ON_CLOSE])
    async with (
        httpx.AsyncClient(trust_env=False, limits=limits) as client,
        httpx.AsyncClient(trust_env=False, transport=once) as orders,
    ):
        fleet = Fleet(services, client, clock, orders)
        dashboard = Dashboard(fleet, clock, hosts)
        server = _server(dashboard)

        def end() -> None:
            dashboard.close()
            server.should_exit = True

        def end_from_outside() -> None:
            with contextlib.suppress(RuntimeError):  # the loop has ended already
                loop.call_soon_threadsafe(end)

        if parent is not None:
            Thread(target=_await_end, args=(parent, end_from_outside), daemon=True).start()
        with on_signals(end_from_outside):
            following, watching = asyncio.create_task(fleet.run()), asyncio.create_task(_watchdog(notifier))
            # If this task ends, the dashboard ends: its pages would show the last state for ever.
            following.add_done_callback(lambda _: end())
            notifier.ready()
            try:
                await server.serve(sockets=[bound])
            finally:
                notifier.stopping()
                following.cancel()
                watching.cancel()
                with contextlib.suppress(asyncio.CancelledError):
                    await following


def _server(dashboard: Dashboard) -> _Server:
    return _Server(
        uvicorn.Config(
            dashboard.app,
            http=_Connection,
            ws="none",
            lifespan="off",
            log_config=None,
            # A flood of requests, or bytes that are not HTTP, would log a line each.
            log_level=logging.ERROR,
            access_log=False,
            server_header=False,
            date_header=False,
            h11_max_incomplete_event_size=LONGEST_HEAD,
            # There are fewer connections than this: it bounds the requests whose connection is lost.
            limit_concurrency=2 * _CONNECTIONS,
            timeout_graceful_shutdown=_GRACE_S,
        )
    )


def _await_end(descriptor: int, ended: Callable[[], None]) -> None:
    while os.read(descriptor, 1):
        pass
    ended()


async def _watchdog(notifier: SystemdNotifier) -> None:
    while notifier.watchdog_interval_s is not None:
        notifier.watchdog()
        await asyncio.sleep(notifier.watchdog_interval_s)
