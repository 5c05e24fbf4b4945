"""The routes of the dashboard: the page, one stream of all services, and the operator's commands."""

import asyncio
import hashlib
import json
import math
import re
from collections.abc import AsyncIterator, Collection, Mapping
from contextlib import asynccontextmanager
from functools import partial
from importlib.metadata import version
from pathlib import Path
from typing import Any

import httpx
from starlette.applications import Starlette
from starlette.exceptions import HTTPException
from starlette.middleware import Middleware
from starlette.requests import ClientDisconnect, Request
from starlette.responses import HTMLResponse, JSONResponse, Response
from starlette.routing import Mount, Route
from starlette.staticfiles import StaticFiles

from daemon.base.client_slots import ClientSlots, EventStream
from daemon.base.clock import Clock
from daemon.dashboard.guard import PageGuard
from daemon.dashboard.sessions import LONGEST_IDLE_S, Session, Sessions
from daemon.dashboard.upstream import Fleet, Upstream

STATIC = Path(__file__).with_name("static")
KEEP_OPEN_KEY = "is_kept"
"""This name is True in the state of a request whose connection must not be closed in favour of a new one."""

_NO_SERVICE = "the program that answers is not a service of heliocube: see dashboard.services"
_NO_OBJECT = "the body is not a JSON object"
_COMMANDS = ("stow", "stop", "hold", "auto", "goto", "snow", "maintenance", "home", "clear", "relearn", "acknowledge")
# A service takes 4096 bytes, and the dashboard adds to the page's body who gives the order.
_LONGEST_BODY = 3584
_LONGEST_READ = 1 << 20
# Most bytes of a service's answer to an order, and of its records of a week, which are 40,000 at most.
_LONGEST_ANSWER, _LONGEST_RECORDS = 1 << 20, 64 << 20
_LONGEST_NAME = 60
_TOKEN = re.compile(r"[A-Za-z0-9._~+/=-]{32,512}")
_MOST_LISTENERS = 64
# A service that hangs keeps each reader for half a minute, even if nobody waits for the answer any more.
_MOST_READERS = 128
# The service waits up to 6 s for a command's effect before it answers.
_COMMAND_S = 15.0
# By then the page that gave an order no longer waits for it, and says so.
_OLDEST_S = 40.0
_KINDS = ("scans", "poses", "decisions", "curves", "modes", "moves", "events")
_READABLE = ("sun", "days", *(f"history/{kind}" for kind in _KINDS))
_READ_S = 30.0
_ANSWER_S = 5.0
# Less than the server's grace, after which it would cut requests off with a traceback each.
_END_WITHIN_S = 0.5
_ENDING_TEXT = "the dashboard was told to end before the service answered: look at the tracker"


class Dashboard:
    """What the routes do.

    Parameters
    ----------
    fleet
        The services.
    clock
        For sessions, and the age of orders.
    hosts
        Names under which browsers reach the dashboard.
    """

    def __init__(self, fleet: Fleet, clock: Clock, hosts: Collection[str]) -> None:
        self._fleet = fleet
        self._monotonic = clock.monotonic
        self._sessions = Sessions(clock.monotonic)
        self._places = ClientSlots(_MOST_LISTENERS)
        self._readers = ClientSlots(_MOST_READERS)
        self._closing = asyncio.Event()
        self._waits: set[asyncio.Timeout] = set()
        digest = _digest(STATIC)
        index = (STATIC / "index.html").read_text(encoding="utf-8")
        self._index = index.replace('data-page=""', f'data-page="{digest}"')
        hello = {"version": version("heliocube"), "page": digest, "services": list(fleet.services)}
        self._hello = f"event: hello\ndata: {json.dumps(hello)}\n\n"
        self.app = Starlette(
            routes=[
                Route("/", self._page),
                Route("/events", self._events),
                Route("/read/{what:path}", self._read),
                Route("/session", self._session),
                Route("/login", self._login, methods=["POST"]),
                Route("/logout", self._logout, methods=["POST"]),
                Route("/command", self._command, methods=["POST"]),
                Route("/stow-all", partial(self._order_all, "stow"), methods=["POST"]),
                Route("/stop-all", partial(self._order_all, "stop"), methods=["POST"]),
                Route("/healthz", self._health),
                Mount("/static", StaticFiles(directory=STATIC)),
            ],
            middleware=[Middleware(PageGuard, hosts=hosts)],
            exception_handlers={HTTPException: _refused, httpx.HTTPError: _unreachable},
        )

    def close(self) -> None:
        """End the streams of all browsers, and soon after the waits for services that do not answer."""
        self._closing.set()
        for wait in self._waits:
            self._end_soon(wait)

    async def _page(self, _: Request) -> Response:
        return HTMLResponse(self._index)

    async def _health(self, _: Request) -> Response:
        return JSONResponse({"ok": True, "version": version("heliocube"), "listeners": self._fleet.listeners})

    async def _events(self, request: Request) -> Response:
        host = _host(request)
        if not self._places.are_free_for(host):
            raise HTTPException(503, "too many pages are open already; close some")
        setattr(request.state, KEEP_OPEN_KEY, True)
        if request.method == "HEAD":
            return Response(media_type="text/event-stream", headers={"Cache-Control": "no-store"})
        return EventStream(self._stream(), self._places.taken_by(host))

    async def _stream(self) -> AsyncIterator[str]:
        yield self._hello
        with self._fleet.listening() as listener:
            while not self._closing.is_set():
                messages = await listener.next()
                # A beat shows that the dashboard is there although all services are gone; orders carry its time.
                beat = f"event: beat\ndata: {self._monotonic():.3f}\n\n"
                yield beat + "".join(f"data: {message}\n\n" for message in messages)

    async def _read(self, request: Request) -> Response:
        """Pass on a service's records of one kind, unchanged."""
        what, query = request.path_params["what"], dict(request.query_params)
        service = self._fleet.services.get(query.pop("service", ""))
        if what not in _READABLE or service is None:
            raise HTTPException(404, "the dashboard has no such service, or the service has no such records")
        host = _host(request)
        if not self._readers.are_free_for(host):
            raise HTTPException(503, "too many pages read stored days already; try again in half a minute")
        url = f"{service.url}/api/{what}"
        client = self._fleet.client
        with self._readers.taken_by(host):
            async with self._wait(None), client.stream("GET", url, params=query, timeout=_READ_S) as reply:
                content = await _raw(reply, _LONGEST_RECORDS)
        # Unchanged: the browser unpacks compressed content.
        kept = {name: reply.headers[name] for name in ("content-type", "content-encoding") if name in reply.headers}
        return Response(content, reply.status_code, headers=kept)

    async def _session(self, request: Request) -> Response:
        name = _session_name(request)
        session = self._sessions.find(name)
        response = JSONResponse(_session_json(session))
        if session is not None and name is not None:
            # The days until the cookie expires begin anew, as those of the session do.
            _set_session_cookie(request, response, name)
        return response

    async def _login(self, request: Request) -> Response:
        given = await _body(request)
        token, by = str(given.get("token", "")).strip(), str(given.get("by", "")).strip()
        if self._sessions.lockout_s > 0:
            raise HTTPException(429, f"too many wrong tokens: try again in {self._sessions.lockout_s:.0f} s")
        if not (0 < len(by) <= _LONGEST_NAME and by.isprintable()):
            raise HTTPException(400, f"say who you are, in 1 to {_LONGEST_NAME} letters: it goes into the records")
        if _TOKEN.fullmatch(token) is None:
            raise HTTPException(400, "that is not a token: copy the whole line of the service's api.token")
        services = list(self._fleet.services.values())
        accepted = await asyncio.gather(*(self._accepts(service, token) for service in services))
        tokens = {service.name: token for service, yes in zip(services, accepted, strict=True) if yes}
        if not tokens:
            if all(yes is None for yes in accepted):
                raise HTTPException(502, "no service answers now, so the token cannot be tried")
            self._sessions.note_wrong_token()
            raise HTTPException(401, "no service takes this token: see api.token_file of the service's configuration")
        before = _session_name(request)
        known = self._sessions.find(before)
        # A service that does not answer now gets the token later, and refuses it itself if it has another.
        silent = {service.name: token for service, yes in zip(services, accepted, strict=True) if yes is None}
        name = self._sessions.open(by, silent | (known.tokens if known else {}) | tokens)
        self._sessions.close(before)
        response = JSONResponse(_session_json(self._sessions.find(name)))
        _set_session_cookie(request, response, name)
        return response

    async def _accepts(self, service: Upstream, token: str) -> bool | None:
        """Return whether a service takes a token; None where it does not answer."""
        try:
            client = self._fleet.client
            status, _ = await self._post(client, f"{service.url}/api/authorised", token, b"", _ANSWER_S)
        except (httpx.HTTPError, HTTPException):
            return None
        return status == httpx.codes.OK

    async def _logout(self, request: Request) -> Response:
        self._sessions.close(_session_name(request))
        response = JSONResponse(_session_json(None))
        response.delete_cookie(_cookie(request))
        return response

    async def _command(self, request: Request) -> Response:
        given = await _body(request)
        session = self._require(request)
        name, service = given.pop("name", None), self._fleet.services.get(str(given.pop("service", "")))
        if name not in _COMMANDS:
            raise HTTPException(400, f"there is no command {ascii(name)[:40]}")
        if service is None:
            raise HTTPException(404, "the dashboard has no such service")
        self._refuse_old(str(name), given)
        status, content = await self._order(session, service, str(name), given)
        _sentence_of_answer(content)
        return Response(content, status_code=status, media_type="application/json")

    async def _order_all(self, name: str, request: Request) -> Response:
        given = await _body(request)
        session = self._require(request)
        self._refuse_old(name, given)
        # The refusal of a cube's process would look like that of a tracker that does not stow or stop.
        services = [service for service in self._fleet.services.values() if not service.is_cube]
        found = await asyncio.gather(*(self._order_one_service(session, service, name, given) for service in services))
        return JSONResponse({"results": found})

    async def _order_one_service(
        self, session: Session, service: Upstream, name: str, given: Mapping[str, Any]
    ) -> dict[str, Any]:
        try:
            status, content = await self._order(session, service, name, given)
            text = _sentence_of_answer(content)
        except HTTPException as error:
            status, text = error.status_code, error.detail
        except httpx.HTTPError:
            status, text = 502, "the service does not answer"
        return {"service": service.name, "accepted": status == httpx.codes.OK, "status": status, "text": text}

    async def _order(
        self, session: Session, service: Upstream, name: str, given: Mapping[str, Any]
    ) -> tuple[int, bytes]:
        token = session.tokens.get(service.name)
        if token is None:
            raise HTTPException(401, f"the service at {service.name} has another token: log in with that token too")
        client = self._fleet.client if name == "stop" else self._fleet.orders
        content = _encoded({**given, "by": session.by})
        status, answer = await self._post(client, f"{service.url}/api/{name}", token, content, _COMMAND_S)
        if status == httpx.codes.UNAUTHORIZED:
            # The service's own sentence is for the command line, whose token file the service has not read again.
            session.tokens.pop(service.name, None)
            taken = f"the service at {service.name} takes another token now: log in with that token"
            raise HTTPException(status, taken)
        return status, answer

    async def _post(
        self, client: httpx.AsyncClient, url: str, token: str, content: bytes, within_s: float
    ) -> tuple[int, bytes]:
        """Return the status and the body of an answer, which may be slow or endless if no service gives it."""
        headers = {"Authorization": f"Bearer {token}", "Content-Type": "application/json"}
        # Not compressed: a few compressed bytes may become gigabytes.
        headers["Accept-Encoding"] = "identity"
        async with (
            self._wait(within_s),
            client.stream("POST", url, content=content, headers=headers, timeout=within_s) as reply,
        ):
            return reply.status_code, await _raw(reply, _LONGEST_ANSWER)

    @asynccontextmanager
    async def _wait(self, within_s: float | None) -> AsyncIterator[None]:
        """Limit the time in which a service answers as a whole; it ends early if the dashboard is told to end."""
        try:
            async with asyncio.timeout(within_s) as wait:
                self._waits.add(wait)
                if self._closing.is_set():
                    self._end_soon(wait)
                try:
                    yield
                finally:
                    self._waits.discard(wait)
        except TimeoutError:
            if self._closing.is_set():
                raise HTTPException(503, _ENDING_TEXT) from None
            raise httpx.ReadTimeout(f"no whole answer in {within_s:g} s") from None

    def _end_soon(self, wait: asyncio.Timeout) -> None:
        ends_s = asyncio.get_running_loop().time() + _END_WITHIN_S
        if not wait.expired():
            wait.reschedule(min(ends_s, wait.when() or math.inf))

    def _refuse_old(self, name: str, given: dict[str, Any]) -> None:
        """Refuse an order that was under way for too long, if it says when it was given; never refuse a stop."""
        given_s = given.pop("given_s", None)
        if name != "stop" and isinstance(given_s, int | float) and not given_s >= self._monotonic() - _OLDEST_S:
            late = f"the order came more than {_OLDEST_S:g} s after it was given, and is not carried out: give it again"
            raise HTTPException(409, late)

    def _require(self, request: Request) -> Session:
        session = self._sessions.find(_session_name(request))
        if session is None:
            raise HTTPException(401, "log in first")
        setattr(request.state, KEEP_OPEN_KEY, True)
        return session


def _digest(folder: Path) -> str:
    """Return a digest of a folder's files: a release may keep its name when they change."""
    files = sorted(path for path in folder.rglob("*") if path.is_file())
    return hashlib.sha256(b"".join(path.read_bytes() for path in files)).hexdigest()[:16]


def _cookie(request: Request) -> str:
    """Return a name that no dashboard at another port has: a browser sends a host's cookies to all of its ports."""
    port = request.headers.get("host", "").rpartition(":")[2]
    return f"heliocube-{port}" if port.isdecimal() else "heliocube"


def _set_session_cookie(request: Request, response: Response, name: str) -> None:
    """Have the browser keep the name of a session for as long as the session is kept without use."""
    secure = request.url.scheme == "https"
    age_s = int(LONGEST_IDLE_S)
    response.set_cookie(_cookie(request), name, max_age=age_s, httponly=True, samesite="strict", secure=secure)


def _host(request: Request) -> str:
    return request.client.host if request.client else ""


def _session_name(request: Request) -> str | None:
    return request.cookies.get(_cookie(request))


async def _raw(reply: httpx.Response, longest: int) -> bytes:
    content = bytearray()
    async for part in reply.aiter_raw():
        content += part
        if len(content) > longest:
            raise HTTPException(502, _NO_SERVICE)
    return bytes(content)


def _sentence_of_answer(content: bytes) -> str:
    """Return the sentence of a service's answer."""
    try:
        found = json.loads(content)
        return str(found.get("text") or found["error"])
    except (ValueError, LookupError, AttributeError, RecursionError):
        raise HTTPException(502, _NO_SERVICE) from None


def _session_json(session: Session | None) -> dict[str, Any]:
    return {"by": None, "services": []} if session is None else {"by": session.by, "services": list(session.tokens)}


def _encoded(body: Mapping[str, Any]) -> bytes:
    """Return a command's body with all its odd values; the service may refuse them, but not those of a stop."""
    try:
        return json.dumps(body, ensure_ascii=False, separators=(",", ":")).encode(errors="replace")
    except RecursionError:
        raise HTTPException(400, _NO_OBJECT) from None


async def _body(request: Request) -> dict[str, Any]:
    content = bytearray()
    try:
        async for chunk in request.stream():
            # A body that is too long is read on, so that its sender gets to see the answer, but not for ever.
            content += chunk
            if len(content) > _LONGEST_READ:
                break
    except ClientDisconnect:
        raise HTTPException(400, "the body is not whole") from None
    if len(content) > _LONGEST_BODY:
        raise HTTPException(413, f"the body is longer than {_LONGEST_BODY} bytes")
    try:
        found = json.loads(content or b"{}")
    except (ValueError, RecursionError):
        found = None
    if not isinstance(found, dict):
        raise HTTPException(400, _NO_OBJECT)
    return found


async def _refused(_: Request, error: Exception) -> Response:
    assert isinstance(error, HTTPException)  # noqa: S101 - narrowing; Starlette calls this for no other
    return JSONResponse({"error": error.detail}, status_code=error.status_code, headers=error.headers)


async def _unreachable(_: Request, error: Exception) -> Response:
    late = isinstance(error, httpx.TimeoutException)
    sentence = "the service does not answer: look at the tracker" if late else "the service cannot be reached"
    return JSONResponse({"error": sentence}, status_code=502)
