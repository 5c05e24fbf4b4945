"""The simulated rotator behind a rotctld that listens on loopback."""

import asyncio
from collections.abc import Callable
from typing import Any

from sim_drivers.rotctld.core import RotatorCore, RotctldSession
from solar.frames import Angles

HOST = "127.0.0.1"


class RotatorHost:
    """A rotctld.

    Parameters
    ----------
    core
        Its rotator.
    truth
        Returns the true angles A and B at a time.
    now
        The event loop's time [s].

    Attributes
    ----------
    tcp_port
        Where it listens; 0 before the first `plug`.
    frozen
        Whether it hangs: it takes everything and answers nothing.
    """

    def __init__(self, core: RotatorCore, truth: Callable[[float], Angles], now: Callable[[], float]) -> None:
        self.core = core
        self.truth = truth
        self.tcp_port = 0
        self.frozen = False
        self._now = now
        self._server: asyncio.Server | None = None
        self._clients: set[_Client] = set()

    async def plug(self) -> None:
        """Listen, at the same port every time."""
        if self._server is None:
            loop = asyncio.get_running_loop()
            self._server = await loop.create_server(lambda: _Client(self, self._clients), HOST, self.tcp_port)
            self.tcp_port = self._server.sockets[0].getsockname()[1]

    def unplug(self) -> None:
        """Leave the port and every client; the rotator goes on to its last target."""
        server, self._server = self._server, None
        if server is not None:
            server.close()
        for client in list(self._clients):
            client.leave()

    def freeze(self) -> None:
        """Hang."""
        self.frozen = True

    def thaw(self) -> None:
        """Go on; what was sent meanwhile is lost."""
        self.frozen = False

    def now(self) -> float:
        """Return the time [s]."""
        return self._now()

    def state(self, now_s: float) -> dict[str, Any]:
        """Return where it truly is, and what it was sent."""
        return {
            "plugged": self._server is not None,
            "in_use": bool(self._clients),
            "tcp_port": self.tcp_port,
            "position": list(self.core.position(now_s)),
            "destination": list(self.core.destination()),
            "received": dict(sorted(self.core.received.items())),
            "faults": sorted(self.core.faults),
        }


class _Client(asyncio.Protocol):
    def __init__(self, host: RotatorHost, clients: set["_Client"]) -> None:
        self._host = host
        self._clients = clients
        self._session = RotctldSession(host.core)
        self._transport: asyncio.Transport | None = None

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        assert isinstance(transport, asyncio.Transport)  # noqa: S101 - narrowing for the type checker
        self._transport = transport
        self._clients.add(self)

    def data_received(self, data: bytes) -> None:
        if self._host.frozen or self._transport is None:
            return
        self._transport.write(self._session.feed(data, self._host.now()))
        if self._session.closed:
            self._transport.close()

    def connection_lost(self, _error: Exception | None) -> None:
        self._clients.discard(self)

    def leave(self) -> None:
        if self._transport is not None:
            self._transport.abort()
