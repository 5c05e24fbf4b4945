"""Serving the local interface within the service's own event loop."""

import asyncio
import contextlib
import logging
import os
import socket
from collections.abc import Callable, Iterator

import uvicorn

from daemon.api.app import Api
from daemon.base.addresses import parse_address
from daemon.base.reconnect import Outage
from daemon.base.records import Event
from daemon.config.links import ApiSettings
from daemon.service.recent import Recent
from daemon.service.service import Service
from daemon.service.status import LinkStatus
from daemon.store.store import StoreStatus

log = logging.getLogger("heliocube.api")

_AGAIN_S = 10.0
_GRACE_S = 1
_CONNECTIONS = 64
_KEEP_ALIVE_S = 5


class _Server(uvicorn.Server):
    """A server that leaves signals alone and rests until it is told to end."""

    def __init__(self, config: uvicorn.Config) -> None:
        super().__init__(config)
        self._ended = asyncio.Event()

    @contextlib.contextmanager
    def capture_signals(self) -> Iterator[None]:
        yield

    async def main_loop(self) -> None:
        await self._ended.wait()

    def end(self) -> None:
        self._ended.set()


class ApiServer:
    """The local interface as a companion of the service.

    A port that is taken does not stop the service: that is told once, and tried again every few seconds.

    Parameters
    ----------
    service, recent, token, speed, store, mqtt
        As for `daemon.api.app.Api`.
    settings
        Where to listen.
    """

    def __init__(
        self,
        settings: ApiSettings,
        service: Service,
        recent: Recent,
        token: str,
        speed: float,
        store: Callable[[], StoreStatus | None],
        mqtt: Callable[[], LinkStatus | None] = lambda: None,
    ) -> None:
        self._address = parse_address(settings.listen)
        self._service = service
        self._speed = speed
        self._recent, self._token, self._store, self._mqtt = recent, token, store, mqtt
        self._outage = Outage(log, "the local interface")
        self._bound: socket.socket | None = None
        self._try_to_bind()

    @property
    def url(self) -> str | None:
        """Where it is served; None while it is not."""
        if self._bound is None:
            return None
        host, port = self._bound.getsockname()[:2]
        return f"http://[{host}]:{port}" if ":" in host else f"http://{host}:{port}"

    async def run(self) -> None:
        """Serve until cancelled."""
        try:
            while self._bound is None:
                await asyncio.sleep(_AGAIN_S * self._speed)
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
        now_s = self._service.clock.monotonic()
        bound = socket.socket(self._address.family, socket.SOCK_STREAM)
        try:
            if os.name == "posix":  # Windows would let two programs share the port
                bound.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            bound.bind((self._address.host, self._address.port))
            bound.listen()
        except OSError as error:
            bound.close()
            first = not self._outage.is_down
            reason = f"{self._address} cannot be listened on: {error.strerror}; set api.listen to another port"
            told = self._outage.down(now_s, reason)
            if first and told:
                clock = self._service.clock
                self._service.bus.publish(Event(clock.utc(), clock.monotonic(), "api", reason))
            return
        self._outage.up(now_s)
        self._bound = bound

    async def _serve(self, bound: socket.socket) -> None:
        api = Api(self._service, self._recent, self._token, self._speed, self._store, self._mqtt)
        pace = max(round(self._speed), 1)
        server = _Server(
            uvicorn.Config(
                api.app,
                http="h11",
                ws="none",
                lifespan="off",
                log_config=None,
                log_level=logging.WARNING,
                access_log=False,
                server_header=False,
                date_header=False,
                limit_concurrency=_CONNECTIONS,
                # These are counted on the loop's clock, which may be a fast one.
                timeout_keep_alive=_KEEP_ALIVE_S * pace,
                timeout_graceful_shutdown=_GRACE_S * pace,
            )
        )
        serving = asyncio.create_task(server.serve(sockets=[bound]))
        try:
            await asyncio.shield(serving)
        finally:
            api.close()
            server.end()
            await serving
