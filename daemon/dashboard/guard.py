"""The rules for every request: the page is asked for under its own name, and runs no code but its own."""

import ipaddress
from collections.abc import Collection
from urllib.parse import urlsplit

from starlette.datastructures import Headers, MutableHeaders
from starlette.responses import JSONResponse
from starlette.types import ASGIApp, Message, Receive, Scope, Send

_POLICY = (
    "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' data:; connect-src 'self';"
    " worker-src 'self'; manifest-src 'self'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
)
_HEADERS = {
    "Content-Security-Policy": _POLICY,
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "no-referrer",
    "Cross-Origin-Opener-Policy": "same-origin",
    "Cross-Origin-Resource-Policy": "same-origin",
}
_READING = ("GET", "HEAD")


class PageGuard:
    """Refuses requests under a foreign name, and changes that another page asks for.

    A name that resolves to this machine but is not its own may be an attack on the browser (DNS rebinding); a numeric
    address cannot be. A request that changes something must bear the page's own Origin.

    Parameters
    ----------
    app
        What is guarded.
    hosts
        Names besides localhost and numeric addresses.
    """

    def __init__(self, app: ASGIApp, hosts: Collection[str]) -> None:
        self._app = app
        self._hosts = {"localhost", *(host.lower() for host in hosts)}

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer one request."""
        if scope["type"] != "http":
            await self._app(scope, receive, send)
            return

        async def send_with_headers(message: Message) -> None:
            if message["type"] == "http.response.start":
                headers = MutableHeaders(scope=message)
                for name, value in _HEADERS.items():
                    headers.setdefault(name, value)
                headers.setdefault("Cache-Control", "no-cache")
            await send(message)

        refusal = self._refusal(scope["method"], Headers(scope=scope))
        app = self._app if refusal is None else JSONResponse({"error": refusal}, status_code=403)
        await app(scope, receive, send_with_headers)

    def _refusal(self, method: str, headers: Headers) -> str | None:
        host = headers.get("host")
        if host is None and method in _READING:
            # The request is in HTTP/1.0, which no browser speaks; HTTP/1.1 without a host is refused before.
            return None
        host = host or ""
        if not self._is_ours(host):
            return f"{ascii(host)[:60]} is not a name of this dashboard: add it to dashboard.hosts"
        origin = headers.get("origin")
        if method not in _READING and (origin is None or _host_of(origin) != host):
            return "an order must come from the dashboard's own page"
        return None

    def _is_ours(self, host: str) -> bool:
        try:
            name = urlsplit(f"//{host}").hostname or ""
        except ValueError:
            return False
        try:
            ipaddress.ip_address(name)
        except ValueError:
            return name in self._hosts
        return True


def _host_of(origin: str) -> str | None:
    """Return the name and the port in an origin, or None if it is not one."""
    try:
        return urlsplit(origin).netloc
    except ValueError:
        return None
