"""Two stand-ins for services, as far as the dashboard knows them, that speak HTTP; the dashboard; and a browser."""

import asyncio
import gzip
import json

import httpx

from daemon.base.addresses import parse_address
from daemon.base.clock import SystemClock
from daemon.dashboard.app import Dashboard
from daemon.dashboard.upstream import Fleet

TOKEN = "t" * 43
OTHER = "o" * 43
NAMES = ("127.0.0.1:1001", "127.0.0.1:1002")
PAGE = "http://dash.lab:20574"


class Streamed(httpx.AsyncByteStream):
    def __init__(self, service):
        self.service = service

    async def __aiter__(self):
        for state in self.service.states:
            yield f"event: state\ndata: {state}\n\nevent: pose\ndata: {{}}\n\n".encode()
        await self.service.ends.wait()


class Service:
    """A service as far as the dashboard knows one."""

    def __init__(self, token):
        self.token = token
        self.states = ['{"version": "1", "trackers": {}}']
        self.ends = asyncio.Event()
        self.asked = []
        self.refusal = None
        self.gone = False

    def answer(self, request):
        if self.gone:
            raise httpx.ConnectError("refused")
        path = request.url.path
        if path == "/api/events":
            return httpx.Response(200, headers={"content-type": "text/event-stream"}, stream=Streamed(self))
        if path == "/api/sun":
            body = gzip.compress(json.dumps({"at": request.url.params.get("at")}).encode())
            headers = {"content-type": "application/json", "content-encoding": "gzip"}
            return httpx.Response(200, headers=headers, stream=httpx.ByteStream(body))
        if request.headers.get("authorization") != f"Bearer {self.token}":
            return httpx.Response(401, json={"error": "the token is not the service's"})
        if path == "/api/authorised":
            return httpx.Response(200, json={"ok": True})
        self.asked.append((path, json.loads(request.content)))
        if self.refusal:
            return httpx.Response(409, json={"error": self.refusal})
        return httpx.Response(200, json={"text": f"{path} done", "state": "done"})


class House:
    """Two services, the dashboard, and a browser on its page."""

    def __init__(self):
        self.services = dict(zip(NAMES, (Service(TOKEN), Service(OTHER)), strict=True))
        self.client = httpx.AsyncClient(transport=httpx.MockTransport(self._answer))
        self.fleet = Fleet([parse_address(name) for name in NAMES], self.client, SystemClock())
        self.dashboard = Dashboard(self.fleet, SystemClock(), ["dash.lab"])
        self.browser = httpx.AsyncClient(
            transport=httpx.ASGITransport(self.dashboard.app), base_url=PAGE, headers={"Origin": PAGE}
        )

    def _answer(self, request):
        reply = self.services[f"{request.url.host}:{request.url.port}"].answer(request)
        if not reply.is_stream_consumed:
            return reply
        # A reply from a network has not been read in advance.
        return httpx.Response(reply.status_code, headers=reply.headers, stream=httpx.ByteStream(reply.content))

    async def login(self, token=TOKEN, by="ana"):
        return await self.browser.post("/login", json={"token": token, "by": by})

    async def order(self, name="stow", service=NAMES[0], **more):
        return await self.browser.post("/command", json={"name": name, "service": service, **more})


def in_house(scenario):
    async def run():
        house = House()
        async with house.client, house.browser:
            await scenario(house)

    asyncio.run(run())
