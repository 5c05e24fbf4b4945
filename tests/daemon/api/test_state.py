"""What /api/state and /api/scans tell: age and quality, what is stale, and what is not known."""

import asyncio
import math
import re
from dataclasses import replace
from operator import itemgetter

import pytest

from daemon.base.records import Mode, MoveOutcome
from daemon.service.state import state_json
from daemon.tracker.stow import StowStatus
from tests.support import DOCS
from tests.support.motion import A_PACKET, B_PACKET, lose
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


def test_the_page_about_the_interface_names_every_key_of_the_state(serve):
    page = (DOCS / "api.md").read_text(encoding="utf-8")
    whole, _, own = page.partition("## What the state has")[2].partition("Of a tracker.")
    firsts = [" ".join(re.findall(r"^\| (.+?) \|", part, re.MULTILINE)) for part in (whole, own)]
    of_all, of_one = (set(re.findall(r"`(\w+)`", words)) for words in firsts)

    async def scenario(rig, call):
        found = (await call.get("/api/state")).json
        (tracker,) = found["trackers"].values()
        assert of_all == set(found) - set(tracker)
        assert set(tracker) <= of_one

    serve(scenario)


def test_a_move_is_news_when_it_has_ended_after_the_stow_that_ended_it(serve):
    async def scenario(rig, call):
        await under_way(rig)
        rig.wind_m_s = 16.0
        await rig.until_mode(Mode.STOW, 6)
        await at_rest(rig)
        news = (await call.get("/api/state")).json["news"]
        assert news == sorted(news, key=itemgetter("time"))
        stow, move = ([part in item["text"] for item in news].index(True) for part in ("-> stow", "(interrupted)"))
        assert stow < move

    serve(scenario)


def test_before_the_first_scan_what_is_unknown_is_null(serve):
    async def scenario(rig, call):
        found = (await call.get("/api/state")).json
        assert found["scan"] is None
        assert found["next_decision_s"] is None

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
        assert 'heliocube_positioner_up{tracker="tracker"} 1.0' in metrics
        rig.cables.positioner.link_up = False
        await rig.until(lambda: not rig.motion.connected, 15, "the loss")
        await asyncio.sleep(0.2)
        metrics = (await call.get("/metrics")).body.decode()
        assert "heliocube_angle_degrees{" not in metrics
        assert 'heliocube_positioner_up{tracker="tracker"} 0.0' in metrics
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
            "since='yesterday' is not a UTC time; write 2022-10-14T08:00:00Z",
        )

    serve(scenario)


def test_a_stow_that_fails_between_two_tries_has_not_reached_the_stow_position(serve, monkeypatch):
    async def scenario(rig, call):
        async def seen():
            state = (await call.get("/api/state")).json
            return state["mode"]["name"], state["tracker"]["moving"], state["at_stow"]

        await tracking(rig)
        await at_rest(rig)
        lose(rig, monkeypatch, A_PACKET, B_PACKET)
        rig.wind_m_s = 20.0
        await rig.until(lambda: rig.motion.last_move.outcome is MoveOutcome.REFUSED, 60, "the stow that fails")
        assert await seen() == ("stow", False, False)
        monkeypatch.undo()
        await rig.until(lambda: rig.truth().b_deg > 89, 700, "the stow")
        await at_rest(rig)
        assert await seen() == ("stow", False, True)
        rig.positioner.read_telemetry = lambda: asyncio.sleep(3600)
        await asyncio.sleep(45)
        assert (await seen())[2] is False

    serve(scenario)


def test_a_reference_run_is_moving_too_and_has_no_target(serve):
    async def scenario(rig, call):
        await tracking(rig)
        await at_rest(rig)
        assert (await call.post("home", b"{}")).status == 200
        tracker = (await call.get("/api/state")).json["tracker"]
        assert (tracker["moving"], tracker["homing"], tracker["target"]) == (True, True, None)
        assert 'heliocube_moving{tracker="tracker"} 1.0' in (await call.get("/metrics")).body.decode()
        await at_rest(rig)
        tracker = (await call.get("/api/state")).json["tracker"]
        assert (tracker["moving"], tracker["homing"]) == (False, False)

    serve(scenario)


@pytest.mark.parametrize("turn", [1, -1])
def test_how_long_a_stow_lasts_is_not_known_where_one_of_its_sources_does_not_tell(run_rig, turn):
    async def scenario(rig):
        told, untold = StowStatus("roof", "wind", 1.0, release_in_s=5.0), StowStatus("hail", "it has failed", 1.0)
        calm = StowStatus("field", None, 1.0)

        def missing_s(*sources):
            seen = rig.see()
            (tracker,) = seen.trackers
            return state_json(replace(seen, trackers=(replace(tracker, wind=sources[::turn]),)))["stow_release_in_s"]

        assert missing_s(calm) is None
        assert missing_s(calm, told, told._replace(release_in_s=7.0)) == 7.0
        assert missing_s(calm, told, untold) is None

    run_rig(scenario)


def test_the_page_says_what_the_count_of_refused_datagrams_is(serve):
    async def scenario(rig, call):
        await under_way(rig)
        assert (await call.get("/api/state")).json["bridge"]["refused"] == 0

    serve(scenario)
    (row,) = (line for line in (DOCS / "api.md").read_text().splitlines() if line.startswith("| `bridge` |"))
    assert "`refused`, of all reasons together" in row
