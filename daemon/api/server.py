"""Serving the local interface within the service's own event loop."""

import asyncio
import contextlib
import logging
import os
import socket
from collections.abc import Callable, Iterator
from typing import cast

import uvicorn

from daemon.api.app import Api
from daemon.api.port.connections import Connections
from daemon.api.port.doorkeeper import Doorkeeper
from daemon.base.addresses import Address, parse_address
from daemon.base.clock import Clock
from daemon.base.piecewise import LONGEST_HEAD
from daemon.base.reconnect import Outage
from daemon.config.links import ApiSettings

log = logging.getLogger("heliocube.api")

_RETRY_EVERY_S = 10.0
_GRACE_S = 1
_KEEP_ALIVE_S = 5


class _Server(uvicorn.Server):
    """A server that leaves signals alone and rests until it is told to end."""

    def __init__(self, config: uvicorn.Config, doorkeeper: Doorkeeper, bound: socket.socket) -> None:
        super().__init__(config)
        self._doorkeeper = doorkeeper
        self._bound = bound
        self._ended = asyncio.Event()

    @contextlib.contextmanager
    def capture_signals(self) -> Iterator[None]:
        yield

    async def main_loop(self) -> None:
        with self._doorkeeper.open(self._bound, self._connect):
            await self._ended.wait()

    def end(self) -> None:
        self._ended.set()

    async def _connect(self, caller: socket.socket) -> None:
        await asyncio.get_running_loop().connect_accepted_socket(self._protocol, caller)

    def _protocol(self) -> asyncio.Protocol:
        return cast("Callable[..., asyncio.Protocol]", self.config.http_protocol_class)(
            config=self.config, server_state=self.server_state, app_state=self.lifespan.state
        )


class ApiServer:
    """The local interface as a companion of the service.

    A port that cannot be bound does not stop the service: it is tried again every few seconds, and meanwhile an alarm
    tells of it by all other ways.

    Parameters
    ----------
    settings
        Where to listen.
    api
        What the routes do.
    clock
        The service's time.
    alarm
        Raises an alarm, or ends it with None.
    tell
        Takes the URL as soon as the port is bound.
    speed
        The clock runs this many times as fast as the machine's.
    """

    def __init__(
        self,
        settings: ApiSettings,
        api: Api,
        clock: Clock,
        alarm: Callable[[str, str | None], None],
        tell: Callable[[str], None],
        speed: float,
    ) -> None:
        self._address = parse_address(settings.listen)
        self._api = api
        self._clock = clock
        self._alarm = alarm
        self._tell = tell
        self._speed = speed
        self._connections = Connections(api.token, api.refusals, speed)
        self._outage = Outage(log, "the local interface")
        self._bound: socket.socket | None = None
        self._try_to_bind()

    @property
    def url(self) -> str | None:
        """Where it is served; None while it is not."""
        return None if self._bound is None else _url_of(self._bound)

    async def run(self) -> None:
        """Serve until cancelled."""
        try:
            while self._bound is None:
                await asyncio.sleep(_RETRY_EVERY_S * self._speed)
                self._try_to_bind()
            await self._serve(self._bound)
        finally:
            self.close()

    def close(self) -> None:
        """Give the port back; needed only if `run` was never called."""
        if self._bound is not None:
            self._bound.close()
            self._bound = None

    def _try_to_bind(self) -> None:
        now_s = self._clock.monotonic()
        bound: socket.socket | None = None
        try:
            bound = socket.socket(self._address.family, socket.SOCK_STREAM)
            if os.name == "posix":  # Windows would let two programs share the port
                bound.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            bound.bind((self._address.host, self._address.port))
            bound.listen()
        except OSError as error:
            if bound is not None:
                bound.close()
            reason = f"cannot listen on {self._address}: {error.strerror}"
            self._outage.down(now_s, f"{reason}; set api.listen to another port or address")
            self._alarm("api-down", f"the local interface {reason}: 'heliocube stop' cannot reach the service")
            return
        self._outage.up(now_s)
        self._alarm("api-down", None)
        self._bound = bound
        self._tell(_url_of(bound))

    async def _serve(self, bound: socket.socket) -> None:
        pace = max(round(self._speed), 1)
        server = _Server(
            uvicorn.Config(
                self._api.app,
                http=self._connections.protocol(),
                ws="none",
                lifespan="off",
                log_config=None,
                # What is not HTTP is reported by the connections, within a budget.
                log_level=logging.ERROR,
                access_log=False,
                server_header=False,
                date_header=False,
                h11_max_incomplete_event_size=LONGEST_HEAD,
                # These are counted on the loop's clock, which may run fast.
                timeout_keep_alive=_KEEP_ALIVE_S * pace,
                timeout_graceful_shutdown=_GRACE_S * pace,
            ),
            Doorkeeper(self._api.token, self._api.refusals, self._speed),
            bound,
        )
        # No sockets, because the server gets its connections from the doorkeeper.
        serving = asyncio.create_task(server.serve(sockets=[]))
        watching = asyncio.create_task(self._connections.run())
        try:
            await asyncio.shield(serving)
        finally:
            watching.cancel()
            self._api.close()
            server.end()
            await serving


def _url_of(bound: socket.socket) -> str:
    host, port = bound.getsockname()[:2]
    return f"http://{Address(host, port)}"
