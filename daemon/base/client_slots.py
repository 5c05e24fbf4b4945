"""A limited number of places for clients that stay long, such as those that listen to events."""

import ipaddress
from collections import Counter
from collections.abc import AsyncIterable, Iterator
from contextlib import AbstractContextManager, contextmanager

from starlette.responses import StreamingResponse
from starlette.types import Receive, Scope, Send

from daemon.base.addresses import unmap_ipv4


class ClientSlots:
    """Places that are taken for long, of which one remote address gets no more than half.

    Loopback may have all places: all clients may come from there, through a tunnel or a proxy on this machine.

    Parameters
    ----------
    most
        How many there are.
    """

    def __init__(self, most: int) -> None:
        self._place_count = most
        self._taken: Counter[str] = Counter()

    def are_free_for(self, host: str) -> bool:
        """Return whether a client from this host may take a place; a proxy may give any text as its host."""
        try:
            near = ipaddress.ip_address(unmap_ipv4(host)).is_loopback
        except ValueError:
            near = False
        return self._taken.total() < self._place_count and self._taken[host] < (
            self._place_count if near else self._place_count // 2
        )

    @contextmanager
    def taken_by(self, host: str) -> Iterator[None]:
        """Count a place as taken for as long as the context lasts."""
        self._taken[host] += 1
        try:
            yield
        finally:
            self._taken -= Counter((host,))


class EventStream(StreamingResponse):
    """Events for one client, which holds a place of its own meanwhile.

    Parameters
    ----------
    events
        As they are sent.
    place
        What `ClientSlots.taken_by` has given. It is taken when the answer begins and not with the first event, which
        may be late: of many clients that come at once, each would find the place free.
    """

    def __init__(self, events: AsyncIterable[str | bytes], place: AbstractContextManager[None]) -> None:
        super().__init__(events, media_type="text/event-stream", headers={"Cache-Control": "no-store"})
        self._place = place

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Send the events to their end, or until nobody listens."""
        with self._place:
            await super().__call__(scope, receive, send)
