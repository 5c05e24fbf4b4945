"""Acknowledging an alarm, by every way that people use."""

import asyncio
import json

import pytest

from daemon.base.records import Event, Mode
from tests.support import DOCS
from tests.support.api import serve
from tests.support.phases import wait_for_move

__all__ = ["serve"]


async def blown(rig, call_http):
    """Stop the tracker and let the wind rise: stow is wanted and not possible."""
    await wait_for_move(rig)
    await call_http.post("stop", b'{"by": "ana"}')
    rig.wind_m_s = 20.0
    await rig.until(lambda: rig.tracker.alarms.active, 6, "the alarm")


def test_an_acknowledged_alarm_shows_by_whom_and_acknowledging_moves_nothing(serve):
    async def scenario(rig, call_http):
        await blown(rig, call_http)
        before = rig.truth()
        reply = await call_http.post("acknowledge", b'{"alarm": "stow-wanted", "by": "bob@lab", "why": "I am here"}')
        assert reply.status == 200, reply.body
        assert reply.json["text"].startswith(
            "acknowledged: stow-wanted is still on: make sure that nobody is at the axes"
        )
        found = (await call_http.get("/api/state")).json
        (alarm,) = found["alarms"]
        assert (alarm["state"], alarm["acknowledged_by"], found["unacknowledged"]) == ("acknowledged", "bob@lab", 0)
        assert alarm["remedy"].endswith("then `heliocube auto`")
        lines = (await call_http.get("/metrics")).body.decode()
        assert 'heliocube_alarm{name="stow-wanted",severity="critical",tracker="tracker"} 1.0' in lines
        assert "heliocube_alarm_unacknowledged{" not in lines
        await asyncio.sleep(60)
        assert rig.truth() == before
        assert rig.mode is Mode.HOLD
        assert rig.control.wishes.stop.by == "ana"
        assert "acknowledged stow-wanted by bob@lab: I am here" in [event.text for event in rig.records_of(Event)]
        again = await call_http.post("acknowledge", b'{"alarm": "stow-wanted"}')
        assert again.json["text"] == "stow-wanted was acknowledged before, by bob@lab at 2022-10-12 10:00 UTC"

    serve(scenario)


def test_acknowledging_an_ended_alarm_again_answers_who_did_so_first_until_it_is_raised_anew(serve):
    async def scenario(rig, call_http):
        await wait_for_move(rig)
        alarms = rig.tracker.alarms
        alarms.set("driver-hung", "it hangs")
        alarms.set("motor-current", "2 A")
        alarms.set("motor-current", None)
        body = b'{"alarm": "motor-current", "by": "ana"}'
        first = await call_http.post("acknowledge", body)
        events = len(rig.records_of(Event))
        again = await call_http.post("acknowledge", body.replace(b"ana", b"bob"))
        assert (first.json["text"], again.status) == ("acknowledged: motor-current (over)", 200)
        assert again.json["text"] == "motor-current was acknowledged before, by ana at 2022-10-12 10:00 UTC"
        assert len(rig.records_of(Event)) == events
        assert [alarm.state for alarm in alarms.shown] == ["raised"]
        alarms.set("motor-current", "3 A")
        alarms.set("motor-current", None)
        assert (await call_http.post("acknowledge", body)).json == first.json

    serve(scenario)


def test_acknowledging_without_a_name_covers_all_alarms_including_those_of_the_cube(serve):
    async def scenario(rig, call_http):
        await blown(rig, call_http)
        rig.service.cube_alarms.set("store-down", "the disk is full")
        reply = await call_http.post("acknowledge")
        assert {alarm["state"] for alarm in (await call_http.get("/api/state")).json["alarms"]} == {"acknowledged"}
        assert "store-down" in reply.json["text"]
        assert (await call_http.post("acknowledge")).json["text"] == "there is nothing to acknowledge"

    serve(scenario)


@pytest.mark.parametrize(
    ("body", "status", "sentence"),
    [
        ({"alarm": "reference"}, 409, "the alarm reference is not on: shown are stow-wanted"),
        ({"alarm": "tea"}, 422, "there is no alarm 'tea': shown are stow-wanted"),
        ({"tracker": "east"}, 422, "there is no tracker 'east'; the trackers are tracker"),
        ({"alarm": 3}, 400, '"alarm" must be one line of text with at most 200 letters'),
    ],
)
def test_an_impossible_acknowledgement_is_refused_in_one_sentence_with_the_documented_status(
    serve, body, status, sentence
):
    (row,) = (line for line in (DOCS / "api.md").read_text().splitlines() if line.startswith(f"| {status} |"))
    on_the_page = {"reference": "an alarm that is not shown", "tea": "an alarm or a tracker that does not exist"}
    assert on_the_page.get(body.get("alarm"), "") in row

    async def scenario(rig, call_http):
        await blown(rig, call_http)
        reply = await call_http.post("acknowledge", json.dumps(body).encode())
        assert (reply.status, reply.json) == (status, {"error": sentence})

    serve(scenario)


@pytest.mark.parametrize(
    ("cable", "mode", "quiet_s", "name", "within_s"),
    [
        ("positioner", Mode.FAULT, 30, "positioner-down", 60),
        ("voltmeter", Mode.FALLBACK, 600, "no-readings", 400),
    ],
)
def test_a_positioner_or_voltmeter_that_is_lost_for_long_raises_an_alarm_until_it_is_back(
    run_rig, cable, mode, quiet_s, name, within_s
):
    async def scenario(rig):
        def alarmed():
            return name in {alarm.name for alarm in rig.tracker.alarms.active}

        await wait_for_move(rig)
        getattr(rig.cables, cable).link_up = False
        await rig.until_mode(mode, 600)
        await asyncio.sleep(quiet_s)
        assert not alarmed()
        await rig.until(alarmed, within_s, "the alarm")
        getattr(rig.cables, cable).link_up = True
        await rig.until(lambda: not alarmed(), 900, "its end")

    run_rig(scenario)


@pytest.mark.parametrize("name", ["positioner-down", "clock"])
def test_an_alarm_that_is_raised_only_after_minutes_stays_acknowledged_over_a_restart(run_rig, tmp_path, name):
    async def scenario(rig):
        rig.cables.positioner.link_up = name != "positioner-down"
        rig.synchronised = name != "clock"
        await rig.until(lambda: rig.tracker.alarms.active, 150, "the alarm")
        rig.tracker.alarms.acknowledge("ana")
        (alarm,) = rig.tracker.alarms.active
        assert (alarm.name, alarm.state) == (name, "acknowledged")
        acknowledged_s.append(alarm.acknowledged_utc_s)

    acknowledged_s = []
    for start in ("2022-10-12T10:00", "2022-10-12T12:00"):
        run_rig(scenario, start=start, store={"directory": tmp_path})
    assert acknowledged_s[0] == acknowledged_s[1]


def test_clear_acknowledges_the_ended_alarms_that_wait_for_a_person_and_no_others(serve):
    async def scenario(rig, call_http):
        await wait_for_move(rig)
        alarms = rig.tracker.alarms
        # Motion and control set their alarms at every look; here neither sets these two.
        alarms.set("driver-hung", "it hangs")
        alarms.set("move-failed", "stalled")
        alarms.set("move-failed", None)
        assert (await call_http.post("clear", b'{"by": "ana"}')).status == 200
        assert [(alarm.name, alarm.state) for alarm in alarms.shown] == [("driver-hung", "raised")]

    serve(scenario)
