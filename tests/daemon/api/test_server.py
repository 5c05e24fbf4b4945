"""The port of the interface, and addresses that are not there."""

import asyncio
import socket

from daemon.base.records import Event
from tests.support.addresses import SocketWithoutIpv6
from tests.support.api import server_of


def test_an_api_port_in_use_by_another_program_raises_an_alarm_until_it_is_free(serve, run_rig):
    async def scenario(rig, call):
        port = call.server.url.rpartition(":")[2]
        settings = rig.service.settings.api.model_copy(update={"listen": f"127.0.0.1:{port}"})
        urls = []
        second = server_of(rig, settings, tell=urls.append)
        assert (second.url, urls) == (None, [])
        serving = asyncio.create_task(second.run())
        await asyncio.sleep(300)
        (alarm,) = (await call.get("/api/state")).json["alarms"]
        assert (alarm["name"], alarm["state"]) == ("api-down", "raised")
        text = (
            f"the local interface cannot listen on 127.0.0.1:{port}: Address already in use: 'heliocube stop' cannot"
            " reach the service"
        )
        assert alarm["text"] == text
        call.server.close()
        await asyncio.sleep(11)
        # The terminal shows the URL with the token, which no file may have.
        assert urls == [second.url] == [f"http://127.0.0.1:{port}"]
        told = [event.text for event in rig.records_of(Event) if event.subject == "alarm"]
        assert told == [f"raised api-down: {text}", f"cleared api-down: {text}"]
        serving.cancel()
        await asyncio.wait((serving,))

    serve(scenario)


def test_an_ipv6_address_on_a_system_without_ipv6_raises_an_alarm_and_no_error(serve, monkeypatch):
    async def scenario(rig, call):
        monkeypatch.setattr(socket, "socket", SocketWithoutIpv6)
        settings = rig.service.settings.api.model_copy(update={"listen": "[::1]:20572"})
        assert server_of(rig, settings).url is None
        (alarm,) = (await call.get("/api/state")).json["alarms"]
        assert alarm["name"] == "api-down"

    serve(scenario)


def test_unknown_paths_and_wrong_methods_are_refused_in_one_sentence(serve):
    async def scenario(rig, call):
        reply = await call.get("/api/nothing")
        assert (reply.status, reply.json) == (404, {"error": "there is no /api/nothing here; see docs/api.md"})
        reply = await call.post("stop/")
        assert (reply.status, reply.json) == (404, {"error": "there is no /api/stop/ here; see docs/api.md"})
        reply = await call.get("/api/stow")
        assert (reply.status, reply.json) == (405, {"error": "/api/stow does not take GET, but POST"})

    serve(scenario)
