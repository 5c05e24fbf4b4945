"""Commands over the interface: what they do, to which tracker, and which token and body they need."""

import asyncio
import json
import socket

import pytest

from daemon.base.addresses import DROP_UNSENT_ON_CLOSE
from daemon.base.records import Mode
from tests.support.api import BEARER, TOKEN
from tests.support.motion import commands_sent
from tests.support.phases import wait_for_move, wait_for_rest, wait_for_tracking

OTHER_TOKEN = "the token is not the service's: restart the service after a change of api.token_file"


def test_a_stop_over_http_reaches_the_positioner_before_anything_else(serve, monkeypatch):
    async def scenario(rig, call):
        await wait_for_move(rig)
        sent, asked_s = commands_sent(rig, monkeypatch), rig.clock.monotonic()
        reply = await call.post("stop", b'{"why": "a hand"}')
        assert sent[0][1].startswith(b"$9s")
        assert sent[0][0] - asked_s < 0.2
        assert reply.status == 200
        assert reply.json["done"] is True
        a_deg, b_deg = rig.truth()
        assert f"standing at A {a_deg:+.1f}, B {b_deg:.1f} deg; mode hold: stopped by HTTP since " in reply.json["text"]

    serve(scenario)


def test_goto_moves_the_tracker_and_outside_the_limits_is_refused_naming_the_limits(serve):
    async def scenario(rig, call):
        await wait_for_tracking(rig)
        await wait_for_rest(rig)
        reply = await call.post("goto", b'{"a_deg": -20, "b_deg": 70.5}')
        assert (reply.status, reply.json["text"][:28]) == (200, "moving to A -20.0, B 70.5 de")
        for body in (b'{"a_deg": 60, "b_deg": 70}', b'{"a_deg": NaN, "b_deg": 70}', b'{"a_deg": 0, "b_deg": 1e999}'):
            reply = await call.post("goto", body)
            assert reply.status == 422
            assert reply.json["error"].endswith("is outside the limits (A -50..50 deg, B 15..90 deg)")

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


def test_a_command_takes_its_tracker_from_the_body_or_the_query(serve):
    async def scenario(rig, call):
        east, west = rig.service.trackers
        await rig.until(lambda: west.control.mode is east.control.mode is Mode.TRACKING, 120, "tracking of both")
        reply = await call.post("hold", b'{"tracker": "west"}')
        assert (reply.status, west.control.mode, east.control.mode) == (200, Mode.HOLD, Mode.TRACKING)
        assert (await call.post("hold?tracker=east")).status == 200
        assert east.control.mode is Mode.HOLD
        for name, body, sentence in [
            (
                "auto",
                b"",
                "'auto' needs the name of a tracker: 'heliocube auto --tracker NAME', where NAME is one of east, west",
            ),
            ("auto?tracker=north", b"", "there is no tracker 'north'; the trackers are east, west"),
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


@pytest.mark.parametrize(
    ("query", "body"),
    [("?tracker=east&tracker=west", b""), ("?tracker=", b""), ("?tracker=east", b'{"tracker": "west"}')],
)
def test_with_an_ambiguous_tracker_a_stop_stops_all_trackers_and_a_hold_is_refused(serve, query, body):
    async def scenario(rig, call):
        east, west = rig.service.trackers
        await rig.until(lambda: west.control.mode is east.control.mode is Mode.TRACKING, 120, "tracking of both")
        reply = await call.post(f"hold{query}", body)
        assert reply.status == 422
        assert east.control.wishes.hold is west.control.wishes.hold is None
        reply = await call.post(f"stop{query}", body)
        assert (reply.status, reply.json["text"][:15]) == (200, "all 2 trackers:")
        assert None not in (east.control.wishes.stop, west.control.wishes.stop)

    serve(scenario, tracker=[{"name": "east"}, {"name": "west"}])


@pytest.mark.parametrize(("query", "body"), [("?tracker=east", b""), ("", b'{"tracker": "east"}')])
def test_a_stop_of_one_tracker_lets_the_others_go_on(serve, query, body):
    async def scenario(rig, call):
        east, west = rig.service.trackers
        await rig.until(lambda: west.control.mode is east.control.mode is Mode.TRACKING, 120, "tracking of both")
        assert (await call.post(f"stop{query}", body)).status == 200
        assert east.control.wishes.stop is not None
        assert (west.control.wishes.stop, west.control.mode) == (None, Mode.TRACKING)

    serve(scenario, tracker=[{"name": "east"}, {"name": "west"}])


@pytest.mark.parametrize(
    ("headers", "sentence"),
    [
        ({}, "a command needs the header 'Authorization: Bearer TOKEN'"),
        ({"Authorization": f"Basic {TOKEN}"}, "a command needs the header 'Authorization: Bearer TOKEN'"),
        ({"Authorization": "Bearer "}, "a command needs the header 'Authorization: Bearer TOKEN'"),
        ({"Authorization": f"Bearer {TOKEN[:-1]}"}, OTHER_TOKEN),
        ({"Authorization": f"Bearer {TOKEN}x"}, OTHER_TOKEN),
        ({"Authorization": "Bearer \xe9"}, OTHER_TOKEN),
    ],
)
def test_every_command_without_the_right_token_is_refused_and_has_no_effect(serve, headers, sentence):
    async def scenario(rig, call):
        await wait_for_tracking(rig)
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
def test_a_malformed_or_too_long_body_is_refused_in_one_sentence_and_has_no_effect(serve, body, status, sentence):
    async def scenario(rig, call):
        await wait_for_tracking(rig)
        reply = await call.post("stow", body)
        assert (reply.status, reply.json) == (status, {"error": sentence})
        assert rig.mode is Mode.TRACKING

    serve(scenario)


@pytest.mark.parametrize(("name", "cut_off", "obeyed"), [
    ("hold", True, False),
    ("hold", False, True),
    ("stop", True, True),
])  # fmt: skip
def test_after_a_stall_of_the_service_a_cut_off_hold_is_dropped_and_a_cut_off_stop_is_obeyed(
    serve, name, cut_off, obeyed
):
    async def scenario(rig, call):
        await wait_for_tracking(rig)
        host, port = call.server.url.removeprefix("http://").split(":")
        # Meanwhile the service does nothing: this call blocks its thread.
        with socket.create_connection((host, int(port))) as peer:
            if cut_off:
                peer.setsockopt(*DROP_UNSENT_ON_CLOSE)
            head = f"POST /api/{name} HTTP/1.1\r\nHost: localhost\r\nAuthorization: Bearer {TOKEN}\r\n"
            peer.sendall(f"{head}Content-Length: 0\r\n\r\n".encode())
        await asyncio.sleep(5)
        assert (getattr(rig.control.wishes, name) is not None) is obeyed
        assert rig.mode is (Mode.HOLD if obeyed else Mode.TRACKING)

    serve(scenario)


def test_an_endless_body_is_refused_without_being_read_to_the_end(serve):
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


def test_auto_is_refused_when_it_would_end_a_wish_that_its_sender_was_not_shown(serve):
    async def scenario(rig, call):
        await wait_for_tracking(rig)
        await call.post("stow", b'{"by": "ana"}')
        shown = {name: wish["latest"] for name, wish in (await call.get("/api/state")).json["wishes"].items() if wish}
        auto = json.dumps({"by": "ana", "shown": shown}).encode()
        await asyncio.sleep(0.01)
        await call.post("stop", b'{"by": "ben", "why": "a hand"}')
        refused = await call.post("auto", auto)
        assert refused.status == 409
        assert refused.json["error"].startswith("auto was given before the wish that it would end, so give it again; ")
        assert "stopped by ben since" in refused.json["error"]
        assert rig.control.wishes.stop is not None
        # That works whatever has happened to the clock since.
        stop = (await call.get("/api/state")).json["wishes"]["stop"]["latest"]
        both = await call.post("auto", json.dumps({"shown": shown | {"stop": stop}}).encode())
        assert both.status == 200
        assert rig.mode is Mode.TRACKING
        wrong = await call.post("auto", b'{"shown": {"stop": 1}}')
        assert wrong.status == 400
        assert wrong.json["error"].startswith('"shown" must have the time of each wish')
        await call.post("stop", b"")
        assert (await call.post("auto", b"")).status == 200, "whoever does not say what was shown"

    serve(scenario)
