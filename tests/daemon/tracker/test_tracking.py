"""The main job: the tracker points where the law says."""

import asyncio
import itertools
import math

import pytest

from daemon.base.records import Decision, Mode, ModeChange, Move, MoveOutcome, Pose, Scan
from solar.ephemeris import sun_direction
from solar.frames import normal_from_angles, separation_deg
from tests.daemon.tracker.days import pass_quietly
from tests.support.phases import wait_for_tracking
from tests.support.rig import SITE, ManualWeather


async def half_an_hour(_rig):
    await asyncio.sleep(1800)


def plain_mean(scans):
    """Mean of the last 24 scans, as the paper's flowchart has it."""
    last = scans[-24:]
    return [sum(scan.faces[i].irradiance_w_m2 for scan in last) / len(last) for i in range(4)]


def test_mu_prime_sends_the_tracker_where_equations_12_to_14_put_it(run_rig):
    rig = run_rig(half_an_hour, law={"name": "mu-prime"})
    decisions = rig.records_of(Decision)
    assert len(decisions) >= 5
    for decision in decisions:
        scans = [record for record in rig.records[: rig.records.index(decision)] if isinstance(record, Scan)]
        east, south, west, zenith = plain_mean(scans)
        mu = (south - min(east, west), east - west, zenith)
        a_deg = math.degrees(math.asin(-mu[1] / math.hypot(*mu)))
        b_deg = math.degrees(math.atan2(mu[2], mu[0]))
        assert decision.target.a_deg == pytest.approx(max(min(a_deg, 50), -50), abs=0.1)
        assert decision.target.b_deg == pytest.approx(max(min(b_deg, 90), 15), abs=0.1)
    moves = rig.records_of(Move)
    assert all(move.outcome is MoveOutcome.ARRIVED for move in moves)
    truth = rig.truth()
    assert (truth.a_deg, truth.b_deg) == (
        pytest.approx(decisions[-1].target.a_deg, abs=1.2),
        pytest.approx(decisions[-1].target.b_deg, abs=1.2),
    )


def test_the_chronometric_law_keeps_the_module_perpendicular_to_the_sun(run_rig):
    rig = run_rig(half_an_hour, law={"name": "chronometric"})
    truth = rig.truth()
    sun = sun_direction(rig.clock.utc(), *SITE)
    assert separation_deg(normal_from_angles(*truth), sun) < 2.0
    assert len(rig.records_of(Move)) >= 4


def test_an_overcast_sky_lays_the_tracker_flat(run_rig):
    rig = run_rig(half_an_hour, weather=ManualWeather(dni=0, dhi=150))
    assert rig.truth().b_deg == pytest.approx(90, abs=1.5)
    assert rig.truth().a_deg == pytest.approx(0, abs=1.5)


def test_decisions_come_every_5_minutes_from_a_2_minute_window_and_scans_take_their_shortest_time(run_rig):
    rig = run_rig(half_an_hour)
    times = [decision.time_monotonic_s for decision in rig.records_of(Decision)]
    assert [later - earlier for earlier, later in itertools.pairwise(times)] == pytest.approx(
        [300] * (len(times) - 1), abs=0.1
    )
    first, *others = [decision.irradiances.coverage for decision in rig.records_of(Decision)]
    assert first >= 0.25
    assert others == pytest.approx([1.0] * len(others), abs=0.1)
    scans = rig.records_of(Scan)
    # Scans may take five percent longer than this.
    floor_s = 4 * (0.3 + 0.040)
    east_to_zenith = [scan.zenith.time_monotonic_s - scan.east.time_monotonic_s for scan in scans]
    assert max(east_to_zenith) <= floor_s * 3 / 4 * 1.05
    starts = [scan.time_monotonic_s for scan in scans]
    assert [b - a for a, b in itertools.pairwise(starts)] == pytest.approx([5.0] * (len(starts) - 1), abs=0.01)


def test_sensor_noise_alone_under_an_overcast_sky_causes_no_move(run_rig):
    rig = run_rig(half_an_hour, weather=ManualWeather(dni=0, dhi=200), law={"name": "mu-prime"}, rest_look_s=5.0)
    assert len(rig.records_of(Move)) == 0, "flat to begin with, flat by the law: nothing to do"


def test_the_tracker_lies_flat_in_mode_night_and_tracks_again_in_the_morning(run_rig):
    async def through_the_night(rig):
        await rig.until_mode(Mode.NIGHT, 2 * 3600)
        await asyncio.sleep(1800)
        pass_quietly(rig, "2022-10-13T05:30")
        await asyncio.sleep(1.5 * 3600)

    class Day(ManualWeather):
        def at(self, utc_s):
            conditions = super().at(utc_s)
            up = sun_direction(utc_s, *SITE)[:, 2].clip(0)
            conditions.dni_w_m2[:] = 600.0 * (up > 0)
            conditions.dhi_w_m2[:] = 300.0 * up
            return conditions

    seldom = {"cube": {"scan_every_s": 60}, "safety": {"scan_stale_s": 130}}
    rig = run_rig(through_the_night, start="2022-10-12T17:00", weather=Day(), rest_look_s=30.0, **seldom)
    modes = [change.after for change in rig.records_of(ModeChange)]
    assert modes == [Mode.TRACKING, Mode.NIGHT, Mode.TRACKING]
    dark = next(change.time_utc_s for change in rig.records_of(ModeChange) if change.after is Mode.NIGHT)
    at_night = [pose for pose in rig.records_of(Pose) if dark + 600 < pose.time_utc_s < dark + 11 * 3600]
    assert {(round(pose.a_deg), round(pose.b_deg)) for pose in at_night} == {(0, 90)}


def test_a_good_scan_ends_fallback_within_a_tenth_of_a_second(run_rig):
    async def scenario(rig):
        await wait_for_tracking(rig)
        await asyncio.sleep(130)
        for wait_s in (0.0, 1.3, 2.9):
            rig.cables.voltmeter.link_up = False
            await rig.until_mode(Mode.FALLBACK, 90)
            await asyncio.sleep(wait_s)
            rig.cables.voltmeter.link_up = True
            scans = len(rig.records_of(Scan))
            await rig.until(
                lambda scans=scans: any(scan.ok for scan in rig.records_of(Scan)[scans:]), 60, "a good scan"
            )
            await asyncio.sleep(0.1)
            assert rig.mode is Mode.TRACKING
            assert rig.control.state.since_utc_s == rig.records_of(ModeChange)[-1].time_utc_s
            await asyncio.sleep(130)

    run_rig(scenario)
