"""The law `optimal` in the running service."""

import asyncio
import json

import numpy as np
import pytest

from daemon.base.records import Decision, Mode, Move, MoveOutcome, Quality, Scan
from solar.ephemeris import sun_direction
from solar.frames import normal_from_angles, separation_deg
from tests.daemon.tracker.days import pass_quietly
from tests.support.api import serve
from tests.support.rig import SITE, ManualWeather

__all__ = ["serve"]

OPTIMAL = {"name": "optimal"}
# Scans enough for every decision, and a third of the work of an hour.
SELDOM = {"cube": {"scan_every_s": 20}, "safety": {"scan_stale_s": 65}, "rest_look_s": 5.0}


async def half_an_hour(_rig):
    await asyncio.sleep(1800)


def off_sun_deg(rig):
    return float(separation_deg(normal_from_angles(*rig.truth()), sun_direction(rig.clock.utc(), *SITE)))


def break_faces(rig, *broken):
    """Let some faces of the cube read far beyond anything that is plausible."""
    sensor = rig.scene.sensor_voltage

    def voltage(face, utc_s):
        return 0.4 if face in broken else sensor(face, utc_s)

    rig.scene.sensor_voltage = voltage


def without(*broken):
    async def scenario(rig):
        break_faces(rig, *broken)
        await asyncio.sleep(1200)

    return scenario


def test_the_law_optimal_follows_the_sun_in_a_clear_sky_with_few_moves(run_rig):
    rig = run_rig(half_an_hour, law=OPTIMAL, **SELDOM)
    assert off_sun_deg(rig) < 5.0
    assert rig.mode is Mode.TRACKING
    moves = rig.records_of(Move)
    assert 2 <= len(moves) <= 8
    assert all(move.outcome is MoveOutcome.ARRIVED for move in moves)
    decisions = rig.records_of(Decision)
    times = [decision.time_monotonic_s for decision in decisions]
    assert np.diff(times) == pytest.approx(60.0, abs=0.2)
    estimate = decisions[-1].estimate
    assert estimate.dni_w_m2 == pytest.approx(700.0, rel=0.02)
    assert estimate.dhi_w_m2 == pytest.approx(90.0, rel=0.1)
    assert estimate.albedo == 0.2


def test_the_law_optimal_lays_the_tracker_flat_under_an_overcast_sky(run_rig):
    rig = run_rig(half_an_hour, law=OPTIMAL, weather=ManualWeather(dni=0, dhi=150), **SELDOM)
    assert rig.truth().b_deg == pytest.approx(90, abs=2.0)
    assert rig.truth().a_deg == pytest.approx(0, abs=2.0)


@pytest.mark.parametrize("face", range(4))
def test_the_law_optimal_goes_on_tracking_with_one_face_broken(run_rig, face):
    rig = run_rig(without(face), law=OPTIMAL, **SELDOM)
    assert rig.records_of(Scan)[-1].faces[face].quality is not Quality.OK
    assert rig.mode is Mode.TRACKING
    assert rig.records_of(Decision)[-1].law == "optimal"
    assert off_sun_deg(rig) < 6.0


def test_the_law_optimal_does_not_take_a_dead_zenith_face_for_night(run_rig):
    async def scenario(rig):
        sensor = rig.scene.sensor_voltage
        rig.scene.sensor_voltage = lambda face, utc_s: 0.0 if face == 3 else sensor(face, utc_s)
        await asyncio.sleep(2400)

    rig = run_rig(scenario, law=OPTIMAL, **SELDOM)
    assert rig.mode is Mode.TRACKING
    assert off_sun_deg(rig) < 6.0


def test_with_two_faces_broken_the_tracker_follows_the_sun_by_the_clock_in_fallback(run_rig):
    rig = run_rig(without(0, 3), law=OPTIMAL, **SELDOM)
    assert rig.mode is Mode.FALLBACK
    assert rig.records_of(Decision)[-1].law == "chronometric"
    assert off_sun_deg(rig) < 2.0


@pytest.mark.parametrize("law", ["mu-prime", "sun-vector", "flat", "chronometric"])
def test_the_other_laws_go_on_tracking_with_one_face_broken_too(run_rig, law):
    rig = run_rig(without(0), law={"driver": law}, **SELDOM)
    assert rig.mode is Mode.TRACKING
    assert rig.records_of(Decision)[-1].law == law


class Blinking(ManualWeather):
    """Sun and cloud in turn, ten minutes each."""

    def at(self, utc_s):
        conditions = super().at(utc_s)
        conditions.dni_w_m2[:] = 800.0 * (utc_s // 600 % 2)
        conditions.dhi_w_m2[:] = 200.0
        return conditions


def ordered_deg(rig):
    return sum(
        abs(move.target_a_deg - move.from_a_deg) + abs(move.target_b_deg - move.from_b_deg)
        for move in rig.records_of(Move)
    )


@pytest.mark.parametrize(("key", "limit"), [("travel_per_day_deg", 90.0), ("moves_per_day", 2)])
def test_the_law_optimal_stays_within_its_budget_of_the_day_and_a_restart_opens_no_new_one(
    run_rig, tmp_path, key, limit
):
    law = OPTIMAL | {"thrift": 0.1, key: limit}
    store = {"directory": tmp_path}
    first = run_rig(half_an_hour, law=law, weather=Blinking(), store=store, **SELDOM)
    second = run_rig(half_an_hour, law=law, weather=Blinking(), store=store, start="2022-10-12T11:00", **SELDOM)
    used = {
        "travel_per_day_deg": ordered_deg(first) + ordered_deg(second),
        "moves_per_day": len(first.records_of(Move)) + len(second.records_of(Move)),
    }[key]
    # The positioner's telemetry tells tenths of a degree.
    assert 0 < used <= limit + (0.0 if key == "moves_per_day" else 1.0)


def test_the_moves_per_day_of_the_law_optimal_also_limit_the_moves_in_fallback(run_rig):
    rig = run_rig(without(0, 3), law=OPTIMAL | {"moves_per_day": 2}, **SELDOM)
    assert len(rig.records_of(Move)) == 2


async def until_tomorrow(rig):
    await asyncio.sleep(2 * 3600)
    pass_quietly(rig, "2022-10-13T00:30")
    await asyncio.sleep(600)


class ClearDays(ManualWeather):
    def at(self, utc_s):
        conditions = super().at(utc_s)
        up = sun_direction(utc_s, *SITE)[:, 2].clip(0)
        conditions.dni_w_m2[:] = 800.0 * (up > 0)
        conditions.dhi_w_m2[:] = 100.0 * up
        return conditions


def test_the_values_learned_on_a_day_survive_a_restart_and_relearn_forgets_them(run_rig, serve, tmp_path):
    store = {"directory": tmp_path}
    seldom = {"cube": {"scan_every_s": 60}, "safety": {"scan_stale_s": 130}, "rest_look_s": 5.0}
    taught = run_rig(until_tomorrow, law=OPTIMAL, weather=ClearDays(), store=store, start="2022-10-12T14:00", **seldom)
    learned = taught.control.pointing.law.learned
    assert learned.albedo != 0.2

    async def again(rig, call):
        await rig.until_mode(Mode.TRACKING, 120)
        found = (await call.get("/api/state")).json["law"]
        assert found["name"] == "optimal"
        assert found["learned"] == pytest.approx(learned.to_dict())
        assert found["today"] == {"travelled_deg": 0.0, "moves": 0} or found["today"]["moves"] <= 1
        assert (await call.post("relearn")).status == 200
        assert (await call.get("/api/state")).json["law"]["learned"]["albedo"] == 0.2
        assert json.loads((tmp_path / "learned.json").read_text())["albedo"] == 0.2

    serve(again, law=OPTIMAL, weather=ClearDays(), store=store, start="2022-10-14T10:00")


def test_the_law_optimal_learns_anew_if_the_file_of_learned_values_is_damaged(run_rig, tmp_path):
    (tmp_path / "learned.json").write_text('{"albedo": 7, "day": 1}')

    async def scenario(rig):
        assert rig.control.pointing.law.learned.albedo == 0.2

    run_rig(scenario, law=OPTIMAL, store={"directory": tmp_path})


def test_relearn_is_refused_with_409_for_a_law_that_learns_nothing(serve):
    async def scenario(rig, call):
        await rig.until_mode(Mode.TRACKING, 120)
        assert (await call.get("/api/state")).json["law"] == {"name": "mu-prime"}
        assert (await call.post("relearn")).status == 409

    serve(scenario)


def test_the_law_optimal_makes_no_move_after_a_clock_step(run_rig):
    async def scenario(rig):
        await asyncio.sleep(600)
        rig.clock.step_s = 7200.0
        before = len(rig.records_of(Move))
        await asyncio.sleep(600)
        assert len(rig.records_of(Move)) == before
        assert "clock was set" in rig.records_of(Decision)[-1].target.why

    run_rig(scenario, law=OPTIMAL, **SELDOM)
