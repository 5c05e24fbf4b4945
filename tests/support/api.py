"""Fixtures: the local interface on real sockets, beside the rig under virtual time, and a client of it."""

import asyncio
import json

import pytest

from daemon.api.app import Api
from daemon.api.configuration import OwnConfiguration
from daemon.api.server import ApiServer
from daemon.service.operator_commands import Operators
from daemon.service.recent import RecentRecords

TOKEN = "t" * 43
BEARER = {"Authorization": f"Bearer {TOKEN}"}


class Reply:
    def __init__(self, content):
        head, _, self.body = content.partition(b"\r\n\r\n")
        self.status = int(head.split()[1])
        self.head = head.decode()

    @property
    def json(self):
        return json.loads(self.body, parse_constant=lambda name: pytest.fail(f"{name} is not JSON"))


class Caller:
    """Speaks to the interface as any program would."""

    def __init__(self, server):
        self.server = server

    async def open(self, method, path, body=b"", headers=None, length=None):
        host, port = self.server.url.removeprefix("http://").split(":")
        reader, writer = await asyncio.open_connection(host, int(port))
        lines = {"Host": "localhost", "Connection": "close", "Content-Length": len(body) if length is None else length}
        head = "".join(f"{name}: {value}\r\n" for name, value in (lines | (headers or {})).items())
        writer.write(f"{method} {path} HTTP/1.1\r\n{head}\r\n".encode() + body)
        await writer.drain()
        return reader, writer

    async def __call__(self, method, path, body=b"", headers=None):
        reader, writer = await self.open(method, path, body, headers)
        try:
            return Reply(await reader.read())
        finally:
            writer.close()
            await writer.wait_closed()

    async def get(self, path):
        return await self("GET", path)

    async def post(self, name, body=b"", headers=BEARER):
        return await self("POST", f"/api/{name}", body, headers)


def server_of(rig, settings, recent=None, store=None, hosts=(), links=None, file=None, tell=print):
    """Return the local interface of a rig's service."""
    recent = RecentRecords() if recent is None else recent
    operators = Operators(rig.service.trackers, 1.0, rig.service.cube_alarms)
    own = OwnConfiguration(file, [tracker.name for tracker in rig.service.trackers])
    api = Api(lambda: rig.take_snapshot(recent, store, links), recent, operators, TOKEN, rig.clock, 1.0, hosts, own=own)
    return ApiServer(settings, api, rig.clock, rig.service.cube_alarms.set, tell, 1.0)


@pytest.fixture
def serve(run_rig):
    """Run a scenario with the rig and a caller of its local interface."""

    def run(scenario, hosts=(), file=None, **options):
        async def beside(rig):
            recent = RecentRecords()
            rig.bus.subscribe(recent.note)
            settings = rig.service.settings.api.model_copy(update={"listen": "127.0.0.1:0"})
            server = server_of(rig, settings, recent, hosts=hosts, file=file)
            serving = asyncio.create_task(server.run())
            try:
                await scenario(rig, Caller(server))
            finally:
                serving.cancel()
                await asyncio.wait((serving,))

        return run_rig(beside, **options)

    return run
