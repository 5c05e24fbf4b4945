"""The doors through which a person commands a tracker: calls in the process, HTTP, MQTT. Each has the same answers."""

import asyncio
import json
from types import SimpleNamespace

from daemon.api.app import Api
from daemon.config.links import MqttSettings
from daemon.mqtt.commands import Commands
from daemon.mqtt.connection import Incoming
from daemon.service.operator import CommandError, Operator
from daemon.service.operator_commands import COMMAND_NAMES, Operators
from daemon.service.recent import RecentRecords
from daemon.service.snapshot import snapshot
from daemon.studies.campaign.command_channel import CommandReply, DirectCommandChannel

_TOKEN = "t" * 43
_DONE_BY_MQTT_S = 30.0


def _said(service, name, value, why, place):
    said = {"why": why}
    if place is not None:
        said["tracker"] = service.trackers[place].name
    if name == "goto":
        said |= dict(zip(("a_deg", "b_deg"), value, strict=True))
    return said


class Http:
    """Requests to the local interface, without the sockets."""

    def has(self, name):
        return hasattr(Operator, name)

    async def give(self, service, name, value, why, place=0):
        body = json.dumps(_said(service, name, value, why, place)).encode()
        status, found = await self._post(service, name, body)
        if status >= 500:
            raise AssertionError(f"{name} is answered with {status}: {found}")
        if status != 200:
            raise CommandError(found["error"], wrong=status == 422)
        return CommandReply(found["done"], found["text"])

    async def _post(self, service, name, body):
        recent = RecentRecords()
        operators = Operators(service.trackers, 1.0)
        app = Api(lambda: snapshot(service, recent, 1.0, None, {}), recent, operators, _TOKEN, service.clock, 1.0).app
        sent = []

        async def receive():
            return {"type": "http.request", "body": body, "more_body": False}

        async def send(message):
            sent.append(message)

        headers = [(b"authorization", f"Bearer {_TOKEN}".encode()), (b"host", b"localhost")]
        scope = {"type": "http", "method": "POST", "path": f"/api/{name}", "query_string": b"", "headers": headers}
        await app({**scope, "asgi": {"version": "3.0"}, "http_version": "1.1", "scheme": "http"}, receive, send)
        content = b"".join(message.get("body", b"") for message in sent[1:])
        return sent[0]["status"], json.loads(content)


class Mqtt:
    """Messages as they come from a broker."""

    def has(self, name):
        return name in COMMAND_NAMES

    async def give(self, service, name, value, why, place=0):
        replies = asyncio.Queue()
        commands = Commands(Operators(service.trackers, 1.0), replies.put_nowait, MqttSettings(), service.clock)
        payload = json.dumps(_said(service, name, value, why, place)).encode()
        commands.take(name, Incoming(f"x/command/{name}", payload, retained=False))
        async with asyncio.timeout(_DONE_BY_MQTT_S):
            reply = SimpleNamespace(**await replies.get())
        if not reply.accepted:
            raise CommandError(reply.text)
        return CommandReply(reply.done, reply.text)


DOORS = {"direct": DirectCommandChannel(), "HTTP": Http(), "MQTT": Mqtt()}
