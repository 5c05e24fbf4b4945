"""The local interface, over real sockets, on the rig under virtual time."""

import asyncio
import json
import math
import re
from dataclasses import replace
from pathlib import Path

import pytest

from daemon.base.records import Event, Mode
from daemon.store.store import StoreStatus
from tests.support.api import BEARER, TOKEN, Caller, server_of
from tests.support.motion import commands_sent
from tests.support.phases import at_rest, tracking, under_way


def test_the_state_tells_everything_with_age_and_quality(serve):
    async def scenario(rig, call):
        await tracking(rig)
        await at_rest(rig)
        found = (await call.get("/api/state")).json
        assert found["simulated"] is True
        assert found["mode"] == {
            "name": "tracking",
            "asked": None,
            "why": rig.control.why,
            "since": found["mode"]["since"],
        }
        assert found["scan"]["stale"] is False
        for face in found["scan"]["faces"].values():
            assert face["quality"] == "ok"
            assert 0 <= face["age_s"] <= found["scan"]["age_s"] + 5
        pose, truth = found["tracker"]["pose"], rig.truth()
        assert (pose["a_deg"], pose["b_deg"]) == (pytest.approx(truth[0], abs=0.2), pytest.approx(truth[1], abs=0.2))
        assert pose["stale"] is False
        assert 0 <= pose["age_s"] <= 30
        assert found["tracker"]["limits"] == {"a_min_deg": -50, "a_max_deg": 50, "b_min_deg": 15, "b_max_deg": 90}
        assert found["bridge"]["accepted"] > 5
        assert found["decision"]["law"] == "mu-prime"
        assert any("tracking" in item["text"] for item in found["news"])

    serve(scenario)


def test_what_is_too_old_is_marked_stale_and_recovers(serve):
    async def scenario(rig, call):
        await tracking(rig)
        rig.cables.voltmeter.link_up = rig.cables.positioner.link_up = False
        await asyncio.sleep(60)
        found = (await call.get("/api/state")).json
        assert found["scan"]["stale"] is True
        assert {face["quality"] for face in found["scan"]["faces"].values()} == {"stale"}
        assert found["tracker"]["connected"] is False
        assert found["tracker"]["pose"]["stale"] is True
        assert "voltmeter" in found["cube_down_why"]
        metrics = (await call.get("/metrics")).body.decode()
        assert "heliocube_irradiance_watts_per_square_meter{" not in metrics
        assert 'heliocube_face_ok{face="east"} 0.0' in metrics
        health = await call.get("/healthz")
        assert (health.status, health.json["ok"], len(health.json["down"])) == (200, True, 2)

        rig.cables.voltmeter.link_up = rig.cables.positioner.link_up = True
        await rig.until_mode(Mode.TRACKING, 200)
        await asyncio.sleep(10)
        found = (await call.get("/api/state")).json
        assert {face["quality"] for face in found["scan"]["faces"].values()} == {"ok"}
        assert found["tracker"]["pose"]["stale"] is False
        assert found["cube_down_why"] is None

    serve(scenario)


def test_before_the_first_scan_what_is_unknown_is_null(serve):
    async def scenario(rig, call):
        found = (await call.get("/api/state")).json
        assert found["scan"] is None
        assert found["next_decision_s"] is None

    serve(scenario)


def test_scans_since_an_instant_are_the_later_ones_in_order(serve):
    async def scenario(rig, call):
        await asyncio.sleep(60)
        scans = (await call.get("/api/scans")).json["scans"]
        assert [scan["sequence"] for scan in scans] == list(range(len(scans)))
        later = (await call.get(f"/api/scans?since={scans[4]['time']}")).json["scans"]
        assert later[0]["sequence"] == 5
        assert "time_monotonic_s" not in later[0]
        wrong = await call.get("/api/scans?since=yesterday")
        assert (wrong.status, wrong.json["error"]) == (
            400,
            "since='yesterday' is no UTC time; write 2022-10-14T08:00:00Z",
        )

    serve(scenario)


def test_events_bring_the_state_and_every_record_and_end_with_the_service(serve):
    async def scenario(rig, call):
        await tracking(rig)
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
        call.server.close()
        writer.close()
        await writer.wait_closed()

    serve(scenario)


def test_metrics_are_those_of_prometheus(serve):
    async def scenario(rig, call):
        await under_way(rig)
        reply = await call.get("/metrics")
        lines = reply.body.decode().splitlines()
        assert "text/plain" in reply.head
        assert 'heliocube_info{role="both",simulated="true",version="0.1.0"} 1.0' in lines
        assert 'heliocube_mode{mode="tracking",tracker="tracker"} 1.0' in lines
        assert 'heliocube_moving{tracker="tracker"} 1.0' in lines
        assert f'heliocube_angle_degrees{{axis="a",tracker="tracker"}} {rig.motion.pose.a_deg}' in lines
        names = [line.split("{")[0].split()[0] for line in lines if not line.startswith("#")]
        assert all(name.startswith("heliocube_") for name in names)
        assert "python_info" not in names

    serve(scenario)


def test_health_is_bad_when_control_no_longer_looks(serve):
    async def scenario(rig, call):
        await tracking(rig)
        rig.control.last_tick_s -= 31
        reply = await call.get("/healthz")
        assert (reply.status, reply.json["ok"]) == (503, False)
        assert "control has not run for 3" in reply.json["troubles"][0]

    serve(scenario)


def test_a_stop_over_the_interface_reaches_the_unit_before_anything_else(serve, monkeypatch):
    async def scenario(rig, call):
        await under_way(rig)
        sent, asked_s = commands_sent(rig, monkeypatch), rig.clock.monotonic()
        reply = await call.post("stop", b'{"why": "a hand"}')
        assert sent[0][1].startswith(b"$9s")
        assert sent[0][0] - asked_s < 0.2
        assert reply.status == 200
        assert reply.json["done"] is True
        a_deg, b_deg = rig.truth()
        assert f"standing at A {a_deg:+.1f}, B {b_deg:.1f} deg; mode hold: stopped by HTTP since " in reply.json["text"]

    serve(scenario)


def test_goto_goes_and_outside_the_limits_is_refused_with_the_limits(serve):
    async def scenario(rig, call):
        await tracking(rig)
        await at_rest(rig)
        reply = await call.post("goto", b'{"a_deg": -20, "b_deg": 70.5}')
        assert (reply.status, reply.json["text"][:28]) == (200, "moving to A -20.0, B 70.5 de")
        for body in (b'{"a_deg": 60, "b_deg": 70}', b'{"a_deg": NaN, "b_deg": 70}', b'{"a_deg": 0, "b_deg": 1e999}'):
            reply = await call.post("goto", body)
            assert reply.status == 422
            assert reply.json["error"].endswith("is outside the limits (A -50..50 deg, B 15..90 deg)")

    serve(scenario)


@pytest.mark.parametrize(
    ("headers", "sentence"),
    [
        ({}, "a command needs the header 'Authorization: Bearer TOKEN'"),
        ({"Authorization": f"Basic {TOKEN}"}, "a command needs the header 'Authorization: Bearer TOKEN'"),
        ({"Authorization": "Bearer "}, "a command needs the header 'Authorization: Bearer TOKEN'"),
        ({"Authorization": f"Bearer {TOKEN[:-1]}"}, "the token is not the service's: see api.token_file"),
        ({"Authorization": f"Bearer {TOKEN}x"}, "the token is not the service's: see api.token_file"),
        ({"Authorization": "Bearer \xe9"}, "the token is not the service's: see api.token_file"),
    ],
)
def test_without_the_right_token_nothing_is_commanded(serve, headers, sentence):
    async def scenario(rig, call):
        await tracking(rig)
        for command in ("stow", "hold", "auto", "stop", "goto", "home", "clear"):
            reply = await call.post(command, b'{"a_deg": 0, "b_deg": 60}' if command == "goto" else b"", headers)
            assert (reply.status, reply.json) == (401, {"error": sentence})
            assert "www-authenticate: Bearer" in reply.head
        assert rig.mode is Mode.TRACKING

    serve(scenario)


@pytest.mark.parametrize(
    ("body", "status", "sentence"),
    [
        (b"stow please", 400, "the body is not JSON"),
        (b"\xff\xfe", 400, "the body is not JSON"),
        (b"[" * 4000, 400, "the body is not JSON"),
        (b"[1]", 400, 'the body is not a JSON object, such as {"why": "maintenance"}'),
        (b'{"when": 1}', 400, "the body has 'when', but may have only why, by, id, tracker"),
        (b'{"why": "a", "by": "b", "why": "c"}', 400, "the body has 'why' twice"),
        (b"x" * 5000, 413, "the body is longer than 4096 bytes"),
        (b"x" * 10_000_000, 413, "the body is longer than 4096 bytes"),
    ],
    ids=lambda value: repr(value)[:30],
)
def test_a_body_that_cannot_be_meant_is_one_sentence_and_commands_nothing(serve, body, status, sentence):
    async def scenario(rig, call):
        await tracking(rig)
        reply = await call.post("stow", body)
        assert (reply.status, reply.json) == (status, {"error": sentence})
        assert rig.mode is Mode.TRACKING

    serve(scenario)


@pytest.mark.parametrize(
    "body", [b"", b'{"a_deg": 1}', b'{"a_deg": "1", "b_deg": 60}', b'{"a_deg": true, "b_deg": 60}']
)
def test_goto_needs_two_numbers(serve, body):
    async def scenario(rig, call):
        reply = await call.post("goto", body)
        assert reply.status == 400
        assert reply.json["error"] == 'goto needs two numbers of degrees, such as {"a_deg": -10, "b_deg": 60}'

    serve(scenario)


def test_unknown_places_and_wrong_methods_are_one_sentence(serve):
    async def scenario(rig, call):
        reply = await call.get("/api/nothing")
        assert (reply.status, reply.json) == (404, {"error": "there is no /api/nothing here; see docs/api.md"})
        reply = await call.get("/api/stow")
        assert (reply.status, reply.json) == (405, {"error": "/api/stow does not take GET, but POST"})

    serve(scenario)


def test_a_port_that_is_taken_is_told_once_and_taken_when_it_is_free(serve, run_rig):
    async def scenario(rig, call):
        port = call.server.url.rpartition(":")[2]
        settings = rig.service.settings.api.model_copy(update={"listen": f"127.0.0.1:{port}"})
        second = server_of(rig, settings)
        assert second.url is None
        serving = asyncio.create_task(second.run())
        await asyncio.sleep(300)
        told = [event.text for event in rig.of(Event) if event.subject == "api"]
        assert told == [
            f"127.0.0.1:{port} cannot be listened on: Address already in use; set api.listen to another port"
        ]
        call.server.close()
        await asyncio.sleep(11)
        assert second.url == f"http://127.0.0.1:{port}"
        serving.cancel()
        await asyncio.wait((serving,))

    serve(scenario)


def test_a_pose_that_grows_old_on_a_link_that_is_up_is_stale(serve):
    async def scenario(rig, call):
        await tracking(rig)
        await at_rest(rig)
        rig.positioner.read_telemetry = lambda: asyncio.sleep(3600)
        await asyncio.sleep(20)
        assert (await call.get("/api/state")).json["tracker"]["pose"]["stale"] is False
        await asyncio.sleep(25)
        tracker = (await call.get("/api/state")).json["tracker"]
        assert (tracker["connected"], tracker["pose"]["stale"]) == (True, True)

    serve(scenario)


def test_motor_currents_are_shown_while_there_is_telemetry_and_nothing_of_a_lost_tracker_is(serve):
    async def scenario(rig, call):
        read = rig.positioner.read_telemetry

        async def with_currents():
            return replace(await read(), a_motor_current_a=0.75, b_motor_current_a=float("nan"))

        rig.positioner.read_telemetry = with_currents
        await tracking(rig)
        assert (await call.get("/api/state")).json["tracker"]["motor_current_a"] == {"a": 0.75, "b": None}
        metrics = (await call.get("/metrics")).body.decode()
        assert 'heliocube_motor_amperes{axis="a",tracker="tracker"} 0.75' in metrics
        assert 'heliocube_motor_amperes{axis="b"' not in metrics
        assert "heliocube_angle_degrees{" in metrics
        rig.cables.positioner.link_up = False
        await rig.until(lambda: not rig.motion.connected, 15, "the loss")
        await asyncio.sleep(0.2)
        metrics = (await call.get("/metrics")).body.decode()
        assert "heliocube_angle_degrees{" not in metrics
        assert "heliocube_motor_amperes{" not in metrics
        assert (await call.get("/api/state")).json["tracker"]["motor_current_a"] == {"a": None, "b": None}

    serve(scenario)


def test_what_a_make_tells_beyond_the_interface_is_shown_as_it_is_and_a_supply_it_does_not_tell_is_left_out(serve):
    async def scenario(rig, call):
        read = rig.positioner.read_telemetry
        await tracking(rig)
        tracker = (await call.get("/api/state")).json["tracker"]
        assert (tracker["details"], tracker["supply_v"]) == ({"mode": "tracker ok"} | tracker["details"], 24.0)
        assert "heliocube_supply_volts{" in (await call.get("/metrics")).body.decode()

        async def of_another_make():
            return replace(
                await read(), supply_v=math.nan, details={"oil_degc": 41.5, "brake": "off", "tilt": math.inf}
            )

        rig.positioner.read_telemetry = of_another_make
        await asyncio.sleep(20)
        tracker = (await call.get("/api/state")).json["tracker"]
        assert tracker["details"] == {"oil_degc": 41.5, "brake": "off", "tilt": None}
        assert tracker["supply_v"] is None
        assert "heliocube_supply_volts{" not in (await call.get("/metrics")).body.decode()
        rig.cables.positioner.link_up = False
        await rig.until(lambda: not rig.motion.connected, 15, "the loss")
        assert (await call.get("/api/state")).json["tracker"]["details"] == {}

    serve(scenario)


def test_the_seventeenth_listener_is_sent_away(serve):
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


def test_the_tracker_of_a_command_stands_in_the_body_or_in_the_query(serve):
    async def scenario(rig, call):
        east, west = rig.service.trackers
        await rig.until(lambda: west.control.mode is east.control.mode is Mode.TRACKING, 120, "tracking of both")
        reply = await call.post("hold", b'{"tracker": "west"}')
        assert (reply.status, west.control.mode, east.control.mode) == (200, Mode.HOLD, Mode.TRACKING)
        assert (await call.post("hold?tracker=east")).status == 200
        assert east.control.mode is Mode.HOLD
        for name, body, sentence in [
            ("auto", b"", "'auto' needs the name of a tracker, one of east, west"),
            ("auto?tracker=north", b"", "there is no tracker 'north' here, but east, west"),
        ]:
            reply = await call.post(name, body)
            assert (reply.status, reply.json["error"]) == (422, sentence)
        reply = await call.post("auto?tracker=east", b'{"tracker": "west"}')
        assert (reply.status, reply.json["error"]) == (422, "the body names the tracker 'west', and the query 'east'")
        assert {"east", "west"} == set((await call.get("/api/state")).json["trackers"])
        metrics = (await call.get("/metrics")).body.decode().splitlines()
        assert 'heliocube_mode{mode="hold",tracker="west"} 1.0' in metrics
        assert 'heliocube_mode{mode="hold",tracker="east"} 1.0' in metrics

    serve(scenario, tracker=[{"name": "east"}, {"name": "west"}])


def test_health_names_a_store_that_is_down(run_rig):
    async def scenario(rig):
        down = StoreStatus(Path("records"), 0, 5, 0, "the disk is full")
        settings = rig.service.settings.api.model_copy(update={"listen": "127.0.0.1:0"})
        server = server_of(rig, settings, store=down)
        serving = asyncio.create_task(server.run())
        reply = await Caller(server).get("/healthz")
        assert (reply.status, reply.json["down"]) == (200, ["store: the disk is full"])
        serving.cancel()
        await asyncio.wait((serving,))

    run_rig(scenario)


def test_a_body_without_end_is_not_read_to_its_end(serve):
    async def scenario(rig, call):
        reader, writer = await call.open("POST", "/api/stow", headers=BEARER, length=1 << 40)
        sent = 0
        replying = asyncio.create_task(reader.read(200))
        while not replying.done() and sent < 200 << 20:
            writer.write(b"x" * (1 << 20))
            sent += 1 << 20
            try:
                await writer.drain()
            except ConnectionError:
                break
        assert b"413" in await replying
        assert sent < 200 << 20
        writer.close()

    serve(scenario)
