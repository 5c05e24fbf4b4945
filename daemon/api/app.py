"""The routes of the local interface."""

import asyncio
import json
import math
import secrets
from collections.abc import AsyncIterator, Awaitable, Callable, Iterator
from datetime import UTC, datetime
from typing import Any

from starlette.applications import Starlette
from starlette.exceptions import HTTPException
from starlette.requests import ClientDisconnect, Request
from starlette.responses import JSONResponse, Response, StreamingResponse
from starlette.routing import Route

from daemon.api.metrics import Metrics
from daemon.base.records import Record
from daemon.service.operator import CommandError
from daemon.service.operator_commands import LONGEST_BODY, NAMES, BodyError, Operators, parse
from daemon.service.recent import Recent
from daemon.service.snapshot import Snapshot, TrackerState
from daemon.service.state import kind_of, number, record_json, state_json

# A longer body is read to its end and thrown away, so that its sender gets to see the answer; there is an end to that.
_LONGEST_READ = 64 << 20
_MOST_SCANS = 2000
_MOST_LISTENERS = 16
_STATE_EVERY_S = 1.0
_STUCK_AFTER_S = 30.0


class Api:
    """What the routes do.

    Parameters
    ----------
    see
        Takes a snapshot of the service.
    recent
        What came over its bus lately.
    operators
        Carry out commands.
    token
        That commands must bear.
    speed
        How many times as fast as the machine's the service's clock runs.
    """

    def __init__(
        self, see: Callable[[], Snapshot], recent: Recent, operators: Operators, token: str, speed: float
    ) -> None:
        self._see = see
        self._recent = recent
        self._token = token.encode()
        self._speed = speed
        self._operators = operators
        self._metrics = Metrics(see)
        self._closing = asyncio.Event()
        self.app = Starlette(
            routes=[
                Route("/api/state", self._state),
                Route("/api/scans", self._scans),
                Route("/api/events", self._events),
                Route("/healthz", self._health),
                Route("/metrics", self._metrics_text),
                *[Route(f"/api/{name}", self._command(name), methods=["POST"]) for name in NAMES],
            ],
            exception_handlers={HTTPException: _refused, Exception: _broken},
        )

    def close(self) -> None:
        """End the streams of all listeners."""
        self._closing.set()

    async def _state(self, _: Request) -> Response:
        return JSONResponse(state_json(self._see()))

    async def _scans(self, request: Request) -> Response:
        scans = self._recent.scans_since(_since(request.query_params.get("since")), _MOST_SCANS)
        return JSONResponse({"scans": [record_json(scan) for scan in scans], "more": len(scans) == _MOST_SCANS})

    async def _events(self, _: Request) -> Response:
        if self._recent.listeners >= _MOST_LISTENERS:
            raise HTTPException(503, "too many programs listen to the events already; close one")
        return StreamingResponse(self._stream(), media_type="text/event-stream", headers={"Cache-Control": "no-store"})

    async def _stream(self) -> AsyncIterator[str]:
        """Yield the state once a second of wall time, and every record as it comes."""
        loop = asyncio.get_running_loop()
        with self._recent.listening() as records:
            closing = asyncio.create_task(self._closing.wait())
            try:
                due_s = -math.inf
                while not self._closing.is_set():
                    if loop.time() >= due_s:
                        due_s = loop.time() + _STATE_EVERY_S * self._speed
                        yield _event("state", state_json(self._see()))
                    following = asyncio.create_task(records.get())
                    try:
                        await asyncio.wait(
                            (following, closing),
                            timeout=max(due_s - loop.time(), 0.0),
                            return_when=asyncio.FIRST_COMPLETED,
                        )
                    finally:
                        following.cancel()
                    if following.done() and not following.cancelled():
                        yield _record_event(following.result())
            finally:
                closing.cancel()

    async def _health(self, _: Request) -> Response:
        """Answer whether the work goes on; a device that is down is named, and no reason for a restart."""
        seen = self._see()
        troubles, longest_s = [], _STUCK_AFTER_S * max(self._speed, 1.0)
        down = [f"cube: {seen.cube_down_why}"] if seen.cube_down_why else []
        for tracker in seen.trackers:
            of = _of(tracker.name, seen)
            if tracker.silent_s > longest_s:
                troubles.append(f"control{of} has not run for {tracker.silent_s:.0f} s")
            down += [f"{part}{of}: {why}" for part, why in _down(tracker)]
        if seen.store is not None and seen.store.down_why is not None:
            down.append(f"store: {seen.store.down_why}")
        down += [f"mqtt{_of(name, seen)}: {link.down_why}" for name, link in seen.links.items() if link.down_why]
        found = {"ok": not troubles, "troubles": troubles, "down": down, "simulated": seen.simulated}
        return JSONResponse(found, status_code=503 if troubles else 200)

    async def _metrics_text(self, _: Request) -> Response:
        return Response(self._metrics.text(), media_type="text/plain; version=0.0.4; charset=utf-8")

    def _command(self, name: str) -> Callable[[Request], Awaitable[Response]]:
        async def command(request: Request) -> Response:
            content = await _read(request)
            self._authorise(request)
            if content is None:
                raise HTTPException(413, f"the body is longer than {LONGEST_BODY} bytes")
            try:
                command = parse(name, content, "HTTP").meant_for(request.query_params.get("tracker"))
                return JSONResponse(await self._operators.carry_out(command))
            except BodyError as error:
                raise HTTPException(400, str(error)) from None
            except CommandError as error:
                raise HTTPException(422 if error.wrong else 409, str(error)) from None

        return command

    def _authorise(self, request: Request) -> None:
        scheme, _, given = request.headers.get("authorization", "").partition(" ")
        if scheme.lower() != "bearer" or not given:
            raise HTTPException(
                401, "a command needs the header 'Authorization: Bearer TOKEN'", {"WWW-Authenticate": "Bearer"}
            )
        if not secrets.compare_digest(given.strip().encode("latin-1", "replace"), self._token):
            raise HTTPException(
                401, "the token is not the service's: see api.token_file", {"WWW-Authenticate": "Bearer"}
            )


def _of(tracker: str, seen: Snapshot) -> str:
    return f" of {tracker}" if len(seen.trackers) > 1 else ""


def _down(tracker: TrackerState) -> Iterator[tuple[str, str]]:
    if tracker.positioner.down_why:
        yield "positioner", tracker.positioner.down_why
    if tracker.load is not None and tracker.load.down_why:
        yield "load", tracker.load.down_why


async def _read(request: Request) -> bytes | None:
    """Return the body, or None for one that is too long."""
    content, length = bytearray(), 0
    try:
        async for chunk in request.stream():
            length += len(chunk)
            if length <= LONGEST_BODY:
                content += chunk
            if length > _LONGEST_READ:
                break
    except ClientDisconnect:
        raise HTTPException(400, "the connection ended within the body") from None
    return bytes(content) if length <= LONGEST_BODY else None


def _since(text: str | None) -> float:
    if text is None:
        return -math.inf
    try:
        found = datetime.fromisoformat(text)
    except ValueError:
        raise HTTPException(400, f"since={ascii(text)[:40]} is no UTC time; write 2022-10-14T08:00:00Z") from None
    return (found.replace(tzinfo=UTC) if found.tzinfo is None else found).timestamp()


def _record_event(record: Record) -> str:
    return _event(kind_of(record), record_json(record))


def _event(kind: str, data: dict[str, Any]) -> str:
    return f"event: {kind}\ndata: {json.dumps(data, default=number)}\n\n"


async def _refused(request: Request, error: Exception) -> Response:
    assert isinstance(error, HTTPException)  # noqa: S101 - narrowing; Starlette calls this for no other
    sentence = error.detail
    if error.status_code == 404:
        sentence = f"there is no {ascii(request.url.path)[1:-1][:80]} here; see docs/api.md"
    elif error.status_code == 405:
        sentence = f"{request.url.path} does not take {request.method}, but {(error.headers or {}).get('Allow', 'GET')}"
    return JSONResponse({"error": sentence}, status_code=error.status_code, headers=error.headers)


async def _broken(_: Request, error: Exception) -> Response:
    return JSONResponse({"error": f"the service met an error of its own ({type(error).__name__})"}, status_code=500)
