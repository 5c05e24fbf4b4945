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
from tests.support.motion import A_PACKET, B_PACKET, lose_packets
from tests.support.phases import wait_for_move, wait_for_rest, wait_for_tracking


def test_the_state_reports_mode_scan_pose_limits_and_bridge_with_age_and_quality(serve):
    async def scenario(rig, call):
        await wait_for_tracking(rig)
        await wait_for_rest(rig)
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


def test_the_api_page_in_docs_names_every_key_of_the_state(serve):
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


def test_an_interrupted_move_appears_in_the_news_after_the_stow_that_interrupted_it(serve):
    async def scenario(rig, call):
        await wait_for_move(rig)
        rig.wind_m_s = 16.0
        await rig.until_mode(Mode.STOW, 6)
        await wait_for_rest(rig)
        news = (await call.get("/api/state")).json["news"]
        assert news == sorted(news, key=itemgetter("time"))
        stow, move = ([part in item["text"] for item in news].index(True) for part in ("-> stow", "(interrupted)"))
        assert stow < move

    serve(scenario)


def test_before_the_first_scan_the_scan_and_the_next_decision_are_null(serve):
    async def scenario(rig, call):
        found = (await call.get("/api/state")).json
        assert found["scan"] is None
        assert found["next_decision_s"] is None

    serve(scenario)


def test_scan_and_pose_are_marked_stale_while_their_devices_are_lost_and_recover(serve):
    async def scenario(rig, call):
        await wait_for_tracking(rig)
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


def test_an_old_pose_is_marked_stale_even_while_the_link_is_up(serve):
    async def scenario(rig, call):
        await wait_for_tracking(rig)
        await wait_for_rest(rig)
        rig.positioner.read_telemetry = lambda: asyncio.sleep(3600)
        await asyncio.sleep(20)
        assert (await call.get("/api/state")).json["tracker"]["pose"]["stale"] is False
        await asyncio.sleep(25)
        tracker = (await call.get("/api/state")).json["tracker"]
        assert (tracker["connected"], tracker["pose"]["stale"]) == (True, True)

    serve(scenario)


def test_motor_currents_are_shown_with_telemetry_and_no_values_of_a_lost_tracker_are(serve):
    async def scenario(rig, call):
        read = rig.positioner.read_telemetry

        async def with_currents():
            return replace(await read(), a_motor_current_a=0.75, b_motor_current_a=float("nan"))

        rig.positioner.read_telemetry = with_currents
        await wait_for_tracking(rig)
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


def test_extra_details_of_a_positioner_are_shown_as_given_and_an_unknown_supply_is_left_out(serve):
    async def scenario(rig, call):
        read = rig.positioner.read_telemetry
        await wait_for_tracking(rig)
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


def test_a_stow_that_failed_and_waits_for_a_retry_is_not_reported_as_at_the_stow_position(serve, monkeypatch):
    async def scenario(rig, call):
        async def seen():
            state = (await call.get("/api/state")).json
            return state["mode"]["name"], state["tracker"]["moving"], state["at_stow"]

        await wait_for_tracking(rig)
        await wait_for_rest(rig)
        lose_packets(rig, monkeypatch, A_PACKET, B_PACKET)
        rig.wind_m_s = 20.0
        await rig.until(lambda: rig.motion.last_move.outcome is MoveOutcome.REFUSED, 60, "the stow that fails")
        assert await seen() == ("stow", False, False)
        monkeypatch.undo()
        await rig.until(lambda: rig.truth().b_deg > 89, 700, "the stow")
        await wait_for_rest(rig)
        assert await seen() == ("stow", False, True)
        rig.positioner.read_telemetry = lambda: asyncio.sleep(3600)
        await asyncio.sleep(45)
        assert (await seen())[2] is False

    serve(scenario)


def test_a_reference_run_is_reported_as_moving_and_homing_without_a_target(serve):
    async def scenario(rig, call):
        await wait_for_tracking(rig)
        await wait_for_rest(rig)
        assert (await call.post("home", b"{}")).status == 200
        tracker = (await call.get("/api/state")).json["tracker"]
        assert (tracker["moving"], tracker["homing"], tracker["target"]) == (True, True, None)
        assert 'heliocube_moving{tracker="tracker"} 1.0' in (await call.get("/metrics")).body.decode()
        await wait_for_rest(rig)
        tracker = (await call.get("/api/state")).json["tracker"]
        assert (tracker["moving"], tracker["homing"]) == (False, False)

    serve(scenario)


@pytest.mark.parametrize("turn", [1, -1])
def test_the_stow_release_time_is_null_while_one_of_the_stow_sources_gives_none(run_rig, turn):
    async def scenario(rig):
        told, untold = StowStatus("roof", "wind", 1.0, release_in_s=5.0), StowStatus("hail", "it has failed", 1.0)
        calm = StowStatus("field", None, 1.0)

        def missing_s(*sources):
            seen = rig.take_snapshot()
            (tracker,) = seen.trackers
            return state_json(replace(seen, trackers=(replace(tracker, wind=sources[::turn]),)))["stow_release_in_s"]

        assert missing_s(calm) is None
        assert missing_s(calm, told, told._replace(release_in_s=7.0)) == 7.0
        assert missing_s(calm, told, untold) is None

    run_rig(scenario)


def test_the_api_page_in_docs_explains_the_count_of_refused_datagrams(serve):
    async def scenario(rig, call):
        await wait_for_move(rig)
        assert (await call.get("/api/state")).json["bridge"]["refused"] == 0

    serve(scenario)
    (row,) = (line for line in (DOCS / "api.md").read_text().splitlines() if line.startswith("| `bridge` |"))
    assert "`refused`, of all reasons together" in row
