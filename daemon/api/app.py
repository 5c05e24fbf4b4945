"""The routes of the local interface."""

import asyncio
import math
from collections.abc import AsyncIterator, Awaitable, Callable, Iterable, Iterator

from starlette.applications import Starlette
from starlette.exceptions import HTTPException
from starlette.requests import Request
from starlette.responses import JSONResponse, Response, StreamingResponse
from starlette.routing import Route

from daemon.api.configuration import QUERY_KEY, OwnConfiguration, WrongServiceError
from daemon.api.gate import CLIENT_GONE_KEY, AllowedHosts, Bodies, Gate, Token
from daemon.api.history import History, parse_query_time
from daemon.api.metrics import Metrics
from daemon.api.openapi import description
from daemon.api.pages import CachedPage, Feed, ScanLog, event_of, to_json
from daemon.api.refusals import ApiRefusals
from daemon.api.sun import sun_json
from daemon.api.turns import ReadThrottle
from daemon.base.client_slots import ClientSlots, EventStream
from daemon.base.clock import END_UTC_S, FIRST_UTC_S, Clock
from daemon.service.operator import CommandError
from daemon.service.operator_commands import COMMAND_NAMES, LONGEST_BODY, BodyError, Operators, TooManyError, parse
from daemon.service.recent import RecentRecords
from daemon.service.snapshot import Snapshot, TrackerState
from daemon.service.state import state_json

_MOST_LISTENERS = 16
_STATE_EVERY_S = 1.0
_STUCK_AFTER_S = 30.0


class Api:
    """What the routes do.

    Parameters
    ----------
    see
        Takes a snapshot of the service.
    glance
        Takes a snapshot without the parts that take long to find out, for pages without them; `see` if it is None.
    own
        The service's configuration, for requests that name the one that they mean; None where it has no file.
    recent
        Passes on the records of its bus.
    operators
        Carry out commands.
    token
        That commands must bear.
    clock
        The service's time.
    speed
        The service's clock runs this many times as fast as the machine's.
    hosts
        Host names that requests may use, besides this machine's own.
    """

    def __init__(
        self,
        see: Callable[[], Snapshot],
        recent: RecentRecords,
        operators: Operators,
        token: str,
        clock: Clock,
        speed: float,
        hosts: Iterable[str] = (),
        glance: Callable[[], Snapshot] | None = None,
        own: OwnConfiguration | None = None,
    ) -> None:
        self._own = own or OwnConfiguration(None, ())
        self._glance = glance = glance or see
        self._speed = speed
        self._operators = operators
        self.refusals = ApiRefusals(clock.monotonic)
        self._scan_log, self._feed = ScanLog(), Feed()
        recent.follow(self._scan_log.note)
        recent.follow(self._feed.note)
        self._state_page = CachedPage(see, lambda seen: to_json(state_json(seen)), clock.monotonic, speed)
        self._metrics_page = CachedPage(
            lambda: Metrics(glance(), dict(self.refusals.counts)), Metrics.text, clock.monotonic, speed
        )
        self._places = ClientSlots(_MOST_LISTENERS)
        self._closing = asyncio.Event()
        self._turns = ReadThrottle(clock.monotonic, speed)
        self._bodies = Bodies(speed)
        history = History(glance)
        routes = Starlette(
            routes=[
                Route("/api/state", self._state),
                Route("/api/scans", self._scans),
                Route("/api/events", self._events),
                Route("/api/sun", self._sun),
                Route("/api/days", history.days),
                Route("/api/history/{kind}", history.kind),
                Route("/api/authorised", self._authorised, methods=["POST"]),
                Route("/api/openapi.json", self._description),
                Route("/healthz", self._health),
                Route("/metrics", self._metrics_text),
                *[Route(f"/api/{name}", self._command(name), methods=["POST"]) for name in COMMAND_NAMES],
            ],
            exception_handlers={
                HTTPException: _answer_http_error,
                WrongServiceError: _answer_wrong_service,
                Exception: _answer_own_error,
            },
        )
        # A redirection has no body: a person who sends a stop to /api/stop/ with curl would read nothing, and the
        # tracker would go on.
        routes.router.redirect_slashes = False
        self.routes = routes.routes
        self.token = Token(token)
        self.app = Gate(routes, self.token, AllowedHosts(hosts), self._turns, self._bodies, self.refusals)

    def close(self) -> None:
        """End the streams of all listeners, and refuse requests that still wait for their turn."""
        self._closing.set()
        self._turns.close()

    async def _state(self, request: Request) -> Response:
        self._own.require(request.query_params.getlist(QUERY_KEY))
        return Response(await self._state_page.get(), media_type="application/json")

    async def _scans(self, request: Request) -> Response:
        since_utc_s = _since(request.query_params.get("since"))
        return Response(self._scan_log.page(since_utc_s), media_type="application/json")

    async def _sun(self, request: Request) -> Response:
        seen = self._glance()
        given = request.query_params.get("at")
        at_s = seen.time_utc_s if given is None else parse_query_time("at", given)
        if given is not None and not FIRST_UTC_S <= at_s < END_UTC_S:
            raise HTTPException(422, f"at={ascii(given)[:40]} is not a time from 1970 to 2199")
        return JSONResponse(await asyncio.to_thread(sun_json, seen.site.place(), at_s))

    async def _authorised(self, _: Request) -> Response:
        """Answer a request whose token is the service's; the gate refuses any other."""
        return JSONResponse({"ok": True})

    async def _events(self, request: Request) -> Response:
        host = request.client.host if request.client else ""
        if not self._places.are_free_for(host):
            raise HTTPException(503, "too many programs listen to the events already; close one")
        if request.method == "HEAD":
            # A HEAD request does not listen, and a stream would hold its place until the client goes.
            headers = {"Cache-Control": "no-store"}
            return StreamingResponse(iter(()), media_type="text/event-stream", headers=headers)
        return EventStream(self._stream(), self._places.taken_by(host))

    async def _stream(self) -> AsyncIterator[bytes]:
        """Yield the state once a second of wall time, and every record as it comes."""
        loop = asyncio.get_running_loop()
        with self._feed.listening() as events:
            closing = asyncio.create_task(self._closing.wait())
            try:
                due_s = -math.inf
                while not self._closing.is_set():
                    if loop.time() >= due_s:
                        due_s = loop.time() + _STATE_EVERY_S * self._speed
                        yield event_of("state", await self._state_page.get())
                    following = asyncio.create_task(events.get())
                    try:
                        await asyncio.wait(
                            (following, closing),
                            timeout=max(due_s - loop.time(), 0.0),
                            return_when=asyncio.FIRST_COMPLETED,
                        )
                    finally:
                        following.cancel()
                    if following.done() and not following.cancelled():
                        yield following.result()
            finally:
                closing.cancel()

    async def _description(self, _: Request) -> Response:
        return JSONResponse(description())

    async def _health(self, request: Request) -> Response:
        """Answer whether the work goes on; a device that is down is named, but is no reason for a restart."""
        self._own.require(request.query_params.getlist(QUERY_KEY))
        seen = self._glance()
        troubles, longest_s = [], _STUCK_AFTER_S * max(self._speed, 1.0)
        parts = (("cube", seen.cube_trouble), ("bridge", seen.bridge_down_why))
        down = [f"{part}: {why}" for part, why in parts if why]
        for tracker in seen.trackers:
            of = _tracker_suffix(tracker.name, seen)
            if tracker.silent_s > longest_s:
                troubles.append(f"control{of} has not run for {tracker.silent_s:.0f} s")
            down += [f"{part}{of}: {why.removeprefix(f'{part}: ')}" for part, why in _devices_down(tracker)]
        if seen.store is not None and seen.store.down_why is not None:
            down.append(f"store: {seen.store.down_why}")
        for name, link in seen.links.items():
            down += [f"mqtt{_tracker_suffix(name, seen)}: {why}" for why in (link.down_why, *link.troubles) if why]
        found = {
            "ok": not troubles,
            "troubles": troubles,
            "down": down,
            "loop_late_worst_s": round(seen.loop.worst_s, 4),
            "simulated": seen.simulated,
        }
        return JSONResponse(found, status_code=503 if troubles else 200)

    async def _metrics_text(self, _: Request) -> Response:
        page = await self._metrics_page.get()
        return Response(page, media_type="text/plain; version=0.0.4; charset=utf-8")

    def _command(self, name: str) -> Callable[[Request], Awaitable[Response]]:
        async def command(request: Request) -> Response:
            content = await self._bodies.read(request.receive, LONGEST_BODY)
            if content is None and name != "stop":
                raise HTTPException(413, f"the body is longer than {LONGEST_BODY} bytes")
            if name != "stop" and await _is_given_up(request):
                raise HTTPException(400, "the connection was cut off before the order was read")
            meant = request.query_params.getlist(QUERY_KEY)
            if name != "stop":
                self._own.require(meant, "nothing is done: ")
            try:
                command = parse(name, content or b"", "HTTP").with_tracker(request.query_params.getlist("tracker"))
                answer = await self._operators.carry_out(command)
                # A stop is carried out by the wrong service too; its sender is told only after that.
                self._own.check_stop_was_meant(meant, answer["text"])
                return JSONResponse(answer)
            except BodyError as error:
                raise HTTPException(400, str(error)) from None
            except TooManyError as error:
                raise HTTPException(429, str(error), {"Retry-After": "1"}) from None
            except CommandError as error:
                self._own.check_stop_was_meant(meant, str(error))
                raise HTTPException(422 if error.wrong else 409, str(error)) from None
            finally:
                self._state_page.forget()
                self._metrics_page.forget()

        return command


async def _is_given_up(request: Request) -> bool:
    """Tell whether the client has gone; its request may have waited in the kernel while this process stood still."""
    for _ in range(2):
        # The next turn of the loop reads the end of the connection, and the turn after it reports that.
        await asyncio.sleep(0)
    return CLIENT_GONE_KEY in request.scope.get("extensions", {})


def _tracker_suffix(tracker: str, seen: Snapshot) -> str:
    return f" of {tracker}" if len(seen.trackers) > 1 else ""


def _devices_down(tracker: TrackerState) -> Iterator[tuple[str, str]]:
    if tracker.positioner.down_why:
        yield "positioner", tracker.positioner.down_why
    if tracker.load is not None and tracker.load.down_why:
        yield "load", tracker.load.down_why


def _since(text: str | None) -> float:
    return -math.inf if text is None else parse_query_time("since", text)


async def _answer_http_error(request: Request, error: Exception) -> Response:
    assert isinstance(error, HTTPException)  # noqa: S101 - narrowing; Starlette calls this for no other
    sentence = error.detail
    if error.status_code == 404:
        sentence = f"there is no {ascii(request.url.path)[1:-1][:80]} here; see docs/api.md"
    elif error.status_code == 405:
        sentence = f"{request.url.path} does not take {request.method}, but {(error.headers or {}).get('Allow', 'GET')}"
    return JSONResponse({"error": sentence}, status_code=error.status_code, headers=error.headers)


async def _answer_wrong_service(_: Request, error: Exception) -> Response:
    return JSONResponse({"error": str(error)}, status_code=421)


async def _answer_own_error(_: Request, error: Exception) -> Response:
    return JSONResponse({"error": f"the service met an error of its own ({type(error).__name__})"}, status_code=500)
