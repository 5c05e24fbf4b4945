"""The checks that every request passes before it reaches a route: its host, its token, and its turn."""

import asyncio
import ipaddress
import secrets
from collections.abc import Iterable
from contextlib import suppress

from starlette.datastructures import Headers
from starlette.responses import JSONResponse
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from daemon.api.refusals import ApiRefusals
from daemon.api.turns import CrowdedError, ReadThrottle

# A body that is too long is read and thrown away, so that its sender gets to see the answer, but only up to this.
_LONGEST_READ = 16 << 20
_PAUSE_S = 0.002
CLIENT_GONE_KEY = "heliocube.given-up"
"""This key is among the extensions of a request if its sender has cut the connection off."""
_BEARER = {"WWW-Authenticate": "Bearer"}


class Token:
    """The token that commands must bear.

    Parameters
    ----------
    token
        Its text.
    """

    def __init__(self, token: str) -> None:
        self._token = token.encode()

    def refusal(self, headers: Headers) -> str | None:
        """Return why the headers of a request do not allow a command, or None if they do."""
        scheme, _, given = headers.get("authorization", "").partition(" ")
        if scheme.lower() != "bearer" or not given:
            return "a command needs the header 'Authorization: Bearer TOKEN'"
        if not self.matches(given.encode("latin-1", "replace")):
            return "the token is not the service's: restart the service after a change of api.token_file"
        return None

    def matches(self, given: bytes) -> bool:
        """Return whether these bytes are the token, with blanks around it or not."""
        return secrets.compare_digest(given.strip(), self._token)


class AllowedHosts:
    """The names under which the interface may be asked for.

    A web page whose host name was made to point at this machine sends that name; without this check a browser would let
    the page read everything. Nobody can do that with an address: those of loopback and the one that was connected to
    are always allowed, and so is ``localhost``.

    Parameters
    ----------
    names
        Others, such as the name of a proxy.
    """

    def __init__(self, names: Iterable[str]) -> None:
        self._names = {"localhost", *(_without_port(name).lower() for name in names)}

    def refusal(self, scope: Scope, headers: Headers) -> str | None:
        """Return why a request is not answered under its host, or None if it is."""
        given = headers.get("host")
        if given is None:
            # The request is in HTTP/1.0, which no browser speaks; HTTP/1.1 without a host is refused before.
            return None
        name = _without_port(given).lower().rstrip(".")
        if name in self._names:
            return None
        with suppress(ValueError):
            address = ipaddress.ip_address(name)
            own = (scope.get("server") or ("",))[0]
            if address.is_loopback or str(address) == own:
                return None
        return f"the host {ascii(given)[:60]} is not served here: add it to api.hosts if it is this machine's"


def _without_port(host: str) -> str:
    if host.startswith("["):
        return host[1:].partition("]")[0]
    return host.rpartition(":")[0] if host.count(":") == 1 else host


class Bodies:
    """Reads bodies. A body that is too long is read piece by piece, one such body at a time, so that it costs little.

    Parameters
    ----------
    speed
        The event loop's clock runs this many times as fast as the machine's.
    """

    def __init__(self, speed: float) -> None:
        self._pause_s = _PAUSE_S * speed
        self._long_body_lock = asyncio.Lock()

    async def read(self, receive: Receive, longest: int) -> bytes | None:
        """Return a body, or None for one that is longer or not whole; a longer one is read up to 16 MiB."""
        content, length, more = bytearray(), 0, True
        while more and length <= _LONGEST_READ:
            message = await receive()
            if message["type"] != "http.request":
                return None
            part, more = message.get("body", b""), message.get("more_body", False)
            length += len(part)
            if length <= longest:
                content += part
            elif more:
                async with self._long_body_lock:
                    await asyncio.sleep(self._pause_s)
        return bytes(content) if length <= longest else None


class Gate:
    """Stands before the routes.

    Parameters
    ----------
    routes
        What it stands before.
    token, hosts
        What is checked.
    turns
        For all but commands with the token.
    bodies
        Reads the bodies of refused requests.
    refusals
        Takes note of refused requests.
    """

    def __init__(
        self,
        routes: ASGIApp,
        token: Token,
        hosts: AllowedHosts,
        turns: ReadThrottle,
        bodies: Bodies,
        refusals: ApiRefusals,
    ) -> None:
        self._routes = routes
        self._token = token
        self._hosts = hosts
        self._turns = turns
        self._bodies = bodies
        self._refusals = refusals

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer one request."""
        headers = Headers(scope=scope)
        refusal = None
        commands = scope["method"] == "POST"
        if commands:
            refusal = self._token.refusal(headers)
        if not commands or refusal is not None:
            try:
                await self._turns.take()
            except CrowdedError:
                self._refusals.note("crowded", "too many programs ask for pages at once")
                sentence = "too many programs ask at once; ask again in a second"
                await self._refuse(503, sentence, {"Retry-After": "1", "Connection": "close"}, scope, receive, send)
                return
        wrong_host = self._hosts.refusal(scope, headers)
        if wrong_host is not None:
            self._refusals.note("host", f"{_client_host(scope)}: {wrong_host}")
            await self._refuse(421, wrong_host, {}, scope, receive, send)
        elif refusal is not None:
            self._refusals.note("token", f"a command from {_client_host(scope)} is refused: {refusal}")
            await self._refuse(401, refusal, _BEARER, scope, receive, send)
        else:
            await self._serve(scope, receive, send, counted=not commands)

    async def _serve(self, scope: Scope, receive: Receive, send: Send, *, counted: bool) -> None:
        begun_s: float | None = self._turns.now_s() if counted else None

        async def counting(message: Message) -> None:
            nonlocal begun_s
            if begun_s is not None:
                self._turns.charge(self._turns.now_s() - begun_s)
                begun_s = None
            await send(message)

        try:
            await self._routes(scope, receive, counting)
        except Exception as error:  # noqa: BLE001 - the client has got its error page; the service goes on
            self._refusals.note("error", f"{scope['method']} {ascii(scope['path'])[:80]} failed", error)

    async def _refuse(
        self, status: int, sentence: str, headers: dict[str, str], scope: Scope, receive: Receive, send: Send
    ) -> None:
        await self._bodies.read(receive, 0)
        await JSONResponse({"error": sentence}, status_code=status, headers=headers)(scope, receive, send)


def _client_host(scope: Scope) -> str:
    client = scope.get("client")
    return f"{client[0]}" if client else "somewhere"
