"""The store's records of a span of time, for charts: read in a thread, one reader at a time."""

import asyncio
from collections.abc import Callable
from datetime import UTC, datetime
from typing import Any, TypeVar

from starlette.exceptions import HTTPException
from starlette.requests import Request
from starlette.responses import JSONResponse, Response

from daemon.base.errors import UserError
from daemon.service.snapshot import Snapshot
from daemon.store.history import KINDS_OF_LINES, KINDS_OF_NUMBERS, is_span, lines_of, packed_numbers, stored_days

_Found = TypeVar("_Found")


class History:
    """The routes of stored days.

    Parameters
    ----------
    see
        Takes a snapshot of the service, which says where its store is.
    """

    def __init__(self, see: Callable[[], Snapshot]) -> None:
        self._see = see
        self._reader_lock = asyncio.Lock()

    async def days(self, _: Request) -> Response:
        """Answer which solar days of the site have records."""
        return JSONResponse({"days": await self._read(stored_days, self._see().site.longitude_deg)})

    async def kind(self, request: Request) -> Response:
        """Answer with one kind of records of a span."""
        kind, query = request.path_params["kind"], request.query_params
        start_s, end_s = parse_query_time("from", query.get("from", "")), parse_query_time("to", query.get("to", ""))
        if not is_span(start_s, end_s):
            raise HTTPException(422, "from must be before to, and at most 7 days before it")
        names = [tracker.name for tracker in self._see().trackers]
        tracker = query.get("tracker", names[0] if len(names) == 1 else "")
        # A process of the cube knows no trackers, but its store may have their records.
        if names and tracker and tracker not in names:
            raise HTTPException(422, f"there is no tracker {ascii(tracker)[:40]}; the trackers are {', '.join(names)}")
        if kind in KINDS_OF_NUMBERS:
            content = await self._read(packed_numbers, kind, start_s, end_s, tracker)
            return Response(content, media_type="application/octet-stream", headers={"Content-Encoding": "gzip"})
        if kind in KINDS_OF_LINES:
            return JSONResponse(await self._read(lines_of, kind, start_s, end_s, tracker))
        known = ", ".join((*KINDS_OF_NUMBERS, *KINDS_OF_LINES))
        raise HTTPException(400, f"there are no records of the kind {ascii(kind)[:40]}; there are {known}")

    async def _read(self, read: Callable[..., _Found], *arguments: Any) -> _Found:
        store = self._see().store
        if store is None:
            raise HTTPException(409, "no records are kept here: set store.directory")
        async with self._reader_lock:
            try:
                return await asyncio.to_thread(read, store.path, *arguments)
            except UserError as error:
                raise HTTPException(409, str(error)) from None


def parse_query_time(name: str, text: str) -> float:
    """Return the UTC [s] of a time in a query; refuses anything else."""
    try:
        found = datetime.fromisoformat(text)
        return (found.replace(tzinfo=UTC) if found.tzinfo is None else found).timestamp()
    except (ValueError, OverflowError):
        raise HTTPException(400, f"{name}={ascii(text)[:40]} is not a UTC time; write 2022-10-14T08:00:00Z") from None
