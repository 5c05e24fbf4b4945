"""The stream of events: what it brings, when it ends, and how many may listen."""

import asyncio
import json
import re

from daemon.base.records import Event
from tests.support.api import Caller, server_of
from tests.support.phases import wait_for_tracking


def test_event_stream_sends_the_state_scans_poses_and_events(serve):
    async def scenario(rig, call):
        await wait_for_tracking(rig)
        reader, writer = await call.open("GET", "/api/events")
        await asyncio.sleep(20)
        rig.service.bus.publish(Event(rig.clock.utc(), rig.clock.monotonic(), "test", "hello"))
        await reader.readuntil(b"event: state\ndata: ")
        assert json.loads(await reader.readline())["mode"]["name"] == "tracking"
        seen = set()
        while "event" not in seen:
            line = (await reader.readline()).decode()
            seen.update(re.findall(r"^event: (.+)$", line))
        assert {"state", "scan", "pose", "event"} <= seen
        assert json.loads((await reader.readline()).decode().removeprefix("data: "))["text"] == "hello"
        writer.close()
        await writer.wait_closed()

    serve(scenario)


def test_the_event_stream_ends_whole_and_at_once_when_the_service_ends(run_rig):
    async def scenario(rig):
        server = server_of(rig, rig.service.settings.api.model_copy(update={"listen": "127.0.0.1:0"}))
        serving = asyncio.create_task(server.run())
        reader, writer = await Caller(server).open("GET", "/api/events")
        await reader.readuntil(b"event: state")
        begun_s = rig.clock.monotonic()
        serving.cancel()
        rest = await reader.read()
        assert rest.endswith(b"\n\n\r\n0\r\n\r\n"), "an event, and the last part of a chunked answer"
        assert rig.clock.monotonic() - begun_s < 0.5
        writer.close()
        await asyncio.wait((serving,))

    run_rig(scenario)


def test_the_seventeenth_event_listener_is_refused_with_503(serve):
    async def scenario(rig, call):
        connections = [await call.open("GET", "/api/events") for _ in range(16)]
        for reader, _ in connections:
            await reader.readuntil(b"event: state")
        reply = await call.get("/api/events")
        assert (reply.status, reply.json) == (
            503,
            {"error": "too many programs listen to the events already; close one"},
        )
        for _, writer in connections:
            writer.close()

    serve(scenario)


def test_only_sixteen_of_forty_simultaneous_event_listeners_are_admitted(serve):
    async def scenario(rig, call):
        connections = await asyncio.gather(*(call.open("GET", "/api/events") for _ in range(40)))
        statuses = [int((await reader.readline()).split()[1]) for reader, _ in connections]
        assert (statuses.count(200), statuses.count(503)) == (16, 24)
        for _, writer in connections:
            writer.close()

    serve(scenario)


def test_head_requests_for_the_event_stream_take_no_listener_place(serve):
    async def scenario(rig, call):
        asked = [await call.open("HEAD", "/api/events") for _ in range(16)]
        for reader, _ in asked:
            assert (await reader.readline()).split()[1] == b"200"
        reader, writer = await call.open("GET", "/api/events")
        await reader.readuntil(b"event: state")
        async with asyncio.timeout(5):
            rest = [await reader.read() for reader, _ in asked]
        assert all(b"text/event-stream" in head and head.endswith(b"\r\n\r\n") for head in rest)
        assert not any(b"content-length" in head.lower() for head in rest), "nobody knows how long a stream gets"
        for _, each in (*asked, (reader, writer)):
            each.close()

    serve(scenario)


def test_one_far_address_gets_at_most_half_of_the_event_listener_places(serve):
    async def scenario(rig, call):
        far = {"X-Forwarded-For": "192.0.2.7"}
        connections = [await call.open("GET", "/api/events", headers=far) for _ in range(8)]
        for reader, _ in connections:
            await reader.readuntil(b"event: state")
        assert (await call("GET", "/api/events", headers=far)).status == 503
        connections.append(await call.open("GET", "/api/events", headers={"X-Forwarded-For": "192.0.2.8"}))
        assert (await connections[-1][0].readline()).split()[1] == b"200"
        connections.pop(0)[1].close()
        await asyncio.sleep(2)
        connections.append(await call.open("GET", "/api/events", headers=far))
        assert (await connections[-1][0].readline()).split()[1] == b"200"
        for _, writer in connections:
            writer.close()

    serve(scenario)
