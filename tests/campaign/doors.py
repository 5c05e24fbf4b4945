"""The doors through which a person commands a tracker: calls in the process, HTTP, MQTT. Each has the same answers."""

import asyncio
import json
from dataclasses import dataclass
from types import SimpleNamespace

from daemon.api.app import Api
from daemon.mqtt.commands import Commands
from daemon.mqtt.connection import Incoming
from daemon.service.operator import CommandError, Operator
from daemon.service.operator_commands import NAMES, Operators
from daemon.service.recent import Recent
from daemon.service.snapshot import snapshot


@dataclass(frozen=True, slots=True)
class Reply:
    """What a door says came of a command."""

    done: bool
    text: str


_TOKEN = "t" * 43
_DONE_BY_MQTT_S = 30.0


def _said(name, value, why):
    said = {"why": why}
    if name == "goto":
        said |= dict(zip(("a_deg", "b_deg"), value, strict=True))
    return said


class Direct:
    """Calls in the process."""

    def has(self, name):
        return hasattr(Operator, name)

    async def give(self, service, name, value, why):
        answer = await getattr(Operator(service.trackers[0], 1.0), name)(*value, why)
        return Reply(answer.done, answer.text)


class Http:
    """Requests to the local interface, without the sockets."""

    def has(self, name):
        return hasattr(Operator, name)

    async def give(self, service, name, value, why):
        body = json.dumps(_said(name, value, why)).encode()
        status, found = await self._post(service, name, body)
        if status >= 500:
            raise AssertionError(f"{name} is answered with {status}: {found}")
        if status != 200:
            raise CommandError(found["error"], wrong=status == 422)
        return Reply(found["done"], found["text"])

    async def _post(self, service, name, body):
        recent = Recent()
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
        return name in NAMES

    async def give(self, service, name, value, why):
        replies = asyncio.Queue()
        commands = Commands(Operators(service.trackers, 1.0), replies.put_nowait)
        payload = json.dumps(_said(name, value, why)).encode()
        commands.take(name, Incoming(f"x/command/{name}", payload, retained=False))
        async with asyncio.timeout(_DONE_BY_MQTT_S):
            reply = SimpleNamespace(**await replies.get())
        if not reply.accepted:
            raise CommandError(reply.text)
        return Reply(reply.done, reply.text)


DOORS = {"direct": Direct(), "HTTP": Http(), "MQTT": Mqtt()}
