"""The services that the dashboard shows: one stream of events from each, handed on to any number of browsers."""

import asyncio
import json
import logging
from collections.abc import AsyncIterator, Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import cast

import httpx
from httpx_sse import SSEError, aconnect_sse

from daemon.base.addresses import Address
from daemon.base.clock import Clock, iso_utc
from daemon.base.reconnect import Outage

log = logging.getLogger("heliocube.dashboard")

# The service sends its state once a second.
_SILENT_S = 5.0
_RETRY_AFTER_S = 1.0
_BEAT_S = 2.0
_LONGEST_EVENT = 16 << 20


class Listener:
    """One browser: what it has not been sent yet, the newest of each service only."""

    def __init__(self) -> None:
        self._pending: dict[str, str] = {}
        self._news = asyncio.Event()

    def put(self, service: str, message: str) -> None:
        """Take a message; an older one of the same service that waits still is dropped."""
        self._pending[service] = message
        self._news.set()

    async def next(self) -> list[str]:
        """Return the messages to send; none if nothing is new for a while."""
        try:
            async with asyncio.timeout(_BEAT_S):
                await self._news.wait()
        except TimeoutError:
            return []
        self._news.clear()
        found, self._pending = list(self._pending.values()), {}
        return found


class Upstream:
    """One service, followed for as long as `run` runs.

    Parameters
    ----------
    address
        Of its local interface.
    client
        Makes the requests.
    clock
        For stamps.
    changed
        Called with this object when there is a new message.

    Attributes
    ----------
    message
        The newest for browsers.
    is_cube
        Whether it is the process of a cube, which has no tracker; False while that is not known.
    """

    def __init__(
        self, address: Address, client: httpx.AsyncClient, clock: Clock, changed: Callable[["Upstream"], None]
    ) -> None:
        self.name = str(address)
        self.url = f"http://{address.reachable_address}"
        self._client = client
        self._clock = clock
        self._changed = changed
        self._outage = Outage(log, f"the service at {self.name}")
        self.message = ""
        # Neither up nor down: nothing is wrong yet.
        self._publish_reachability(None, "has not answered yet")

    async def run(self) -> None:
        """Follow the service, and try again for ever when it is lost."""
        while True:
            try:
                async for state in self._states():
                    self._outage.up(self._clock.monotonic())
                    self._publish(f'{{"service": {json.dumps(self.name)}, "up": true, "state": {state}}}')
                reason = "has ended the connection"
            except (httpx.HTTPError, SSEError, ValueError, RecursionError) as error:
                reason = _reason(error)
            self._outage.down(self._clock.monotonic(), reason)
            self._publish_reachability(False, reason)
            await asyncio.sleep(_RETRY_AFTER_S)

    async def _states(self) -> AsyncIterator[str]:
        timeout = httpx.Timeout(_SILENT_S)
        async with aconnect_sse(self._client, "GET", f"{self.url}/api/events", timeout=timeout) as source:
            source.response.raise_for_status()
            bounded = _Bounded(cast("httpx.AsyncByteStream", source.response.stream))
            source.response.stream = bounded
            async for event in source.aiter_sse():
                bounded.taken = 0
                if event.event == "state":
                    # Data that are not JSON, such as NaN, would break every browser's page.
                    found = json.loads(event.data, parse_constant=_refuse)
                    self.is_cube = isinstance(found, dict) and found.get("role") == "cube"
                    yield event.data.replace("\n", " ")

    def _publish_reachability(self, up: bool | None, why: str) -> None:
        # The next service at this address may have a tracker.
        self.is_cube = False
        found = {"service": self.name, "up": up, "why": why, "time": iso_utc(self._clock.utc())}
        self._publish(json.dumps(found))

    def _publish(self, message: str) -> None:
        self.message = message
        self._changed(self)


class Fleet:
    """All services, and the browsers that listen.

    Parameters
    ----------
    addresses
        Of the services' local interfaces; the first is shown first.
    client, clock
        As for `Upstream`.
    orders
        Makes the requests of orders other than stop; `client` where it is None.
    """

    def __init__(
        self,
        addresses: Sequence[Address],
        client: httpx.AsyncClient,
        clock: Clock,
        orders: httpx.AsyncClient | None = None,
    ) -> None:
        self._listeners: list[Listener] = []
        self.client = client
        self.orders = client if orders is None else orders
        self.services = {
            str(address): Upstream(address, client, clock, self._pass_to_listeners) for address in addresses
        }

    @property
    def listeners(self) -> int:
        """How many browsers listen."""
        return len(self._listeners)

    async def run(self) -> None:
        """Follow all services until cancelled."""
        async with asyncio.TaskGroup() as group:
            for service in self.services.values():
                group.create_task(service.run())

    @contextmanager
    def listening(self) -> Iterator[Listener]:
        """Give a listener that has the newest message of each service already."""
        listener = Listener()
        for service in self.services.values():
            listener.put(service.name, service.message)
        self._listeners.append(listener)
        try:
            yield listener
        finally:
            self._listeners.remove(listener)

    def _pass_to_listeners(self, service: Upstream) -> None:
        for listener in self._listeners:
            listener.put(service.name, service.message)


class _Bounded(httpx.AsyncByteStream):
    """A stream of events that limits their length, because the reader keeps an event until it has ended."""

    def __init__(self, stream: httpx.AsyncByteStream) -> None:
        self._stream = stream
        self.taken = 0

    async def __aiter__(self) -> AsyncIterator[bytes]:
        async for part in self._stream:
            self.taken += len(part)
            if self.taken > _LONGEST_EVENT:
                raise ValueError("too long for an event")
            yield part

    async def aclose(self) -> None:
        await self._stream.aclose()


def _refuse(constant: str) -> None:
    raise ValueError(f"{constant} is no JSON")


def _reason(error: Exception) -> str:
    if isinstance(error, httpx.ConnectError):
        return "is not running, or listens elsewhere"
    if isinstance(error, httpx.TimeoutException):
        return f"has been silent for {_SILENT_S:g} s"
    if isinstance(error, httpx.HTTPStatusError):
        return f"refuses its events ({error.response.status_code})"
    if isinstance(error, httpx.TransportError):
        return "has broken off the connection"
    return "does not speak as heliocube does"
