"""What readers get, made ready once for all of them: pages that are kept for an instant, scans, and the events."""

import asyncio
import json
from collections import deque
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from itertools import islice
from typing import Any, Generic, TypeVar

from daemon.api.history import parse_query_time
from daemon.base.clock import iso_utc
from daemon.base.records import Record, Scan
from daemon.service.state import finite_or_none, kind_of, record_json

_KEPT_S = 0.1
# A day of scans at the usual pace.
_SCANS = 17_280
_MOST_SCANS = 500
_PER_LISTENER = 500

Taken = TypeVar("Taken")


class CachedPage(Generic[Taken]):
    """A page that is made at most ten times a second, however many ask for it.

    Parameters
    ----------
    take
        Collects what the page shows, in the event loop, which waits for that.
    make
        Makes the page from it, in a thread, so that a page about hundreds of trackers does not hold up their work.
    now_s
        Returns the event loop's time [s].
    speed
        The event loop's clock runs this many times as fast as the machine's.
    """

    def __init__(
        self, take: Callable[[], Taken], make: Callable[[Taken], bytes], now_s: Callable[[], float], speed: float
    ) -> None:
        self._take = take
        self._make = make
        self._now_s = now_s
        self._kept_s = _KEPT_S * speed
        self._page: asyncio.Future[bytes] | None = None
        self._taken_s = 0.0

    async def get(self) -> bytes:
        """Return the page, taken not longer than a tenth of a second ago, or the one that is being made."""
        now_s = self._now_s()
        if self._page is None or (self._page.done() and not now_s - self._taken_s < self._kept_s):
            self._taken_s = now_s
            self._page = asyncio.ensure_future(asyncio.to_thread(self._make, self._take()))
        # The client that asked first may go before the others have the page.
        return await asyncio.shield(self._page)

    def forget(self) -> None:
        """Make the page anew the next time: a person who has changed something wants to see it."""
        self._page = None


class ScanLog:
    """The scans of the latest day, each encoded as JSON when it comes, so that a page only has to be put together."""

    def __init__(self) -> None:
        self._scans: deque[tuple[float, bytes]] = deque(maxlen=_SCANS)

    def note(self, record: Record) -> None:
        """Take in one record."""
        if isinstance(record, Scan):
            # Cut to the millisecond, as a client has it that asks for the scans after this one.
            shown_utc_s = parse_query_time("time", iso_utc(record.time_utc_s))
            self._scans.append((shown_utc_s, to_json(record_json(record))))

    def page(self, since_utc_s: float) -> bytes:
        """Return the oldest scans that ended later, at most 500, and whether there are others.

        If it is the time of a scan, these are all that came after that scan, even if the clock was set back in between.
        """
        behind = self._count_scans_up_to(since_utc_s)
        if behind is None:
            later = (content for utc_s, content in self._scans if utc_s > since_utc_s)
        else:
            later = (content for _, content in islice(self._scans, behind, None))
        found = list(islice(later, _MOST_SCANS + 1))
        more = b"true" if len(found) > _MOST_SCANS else b"false"
        return b'{"scans":[' + b",".join(found[:_MOST_SCANS]) + b'],"more":' + more + b"}"

    def _count_scans_up_to(self, since_utc_s: float) -> int | None:
        """Return how many scans there are up to the newest of that time, or None if no scan has it."""
        for place, (utc_s, _) in enumerate(reversed(self._scans)):
            if utc_s == since_utc_s:
                return len(self._scans) - place
        return None


class Feed:
    """Passes every record to all listeners, encoded once for all; a listener that is too slow loses the oldest."""

    def __init__(self) -> None:
        self._listeners: list[asyncio.Queue[bytes]] = []

    def note(self, record: Record) -> None:
        """Take in one record."""
        if not self._listeners:
            return
        event = event_of(kind_of(record), to_json(record_json(record)))
        for queue in self._listeners:
            if queue.full():
                queue.get_nowait()
            queue.put_nowait(event)

    @contextmanager
    def listening(self) -> Iterator[asyncio.Queue[bytes]]:
        """Give a queue of all events from now on."""
        queue: asyncio.Queue[bytes] = asyncio.Queue(_PER_LISTENER)
        self._listeners.append(queue)
        try:
            yield queue
        finally:
            self._listeners.remove(queue)


def event_of(kind: str, content: bytes) -> bytes:
    """Return one server-sent event."""
    return b"event: " + kind.encode() + b"\ndata: " + content + b"\n\n"


def to_json(found: dict[str, Any]) -> bytes:
    """Return a page as JSON; what is not a number is null."""
    return json.dumps(found, default=finite_or_none, separators=(",", ":")).encode()
