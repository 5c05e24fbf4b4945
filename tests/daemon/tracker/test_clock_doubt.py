"""A clock that was set: nothing follows the ephemeris until the clock is right again, however long that takes."""

import asyncio

import pytest

from daemon.base.records import Decision, Mode
from solar.ephemeris import sun_direction
from solar.frames import normal_from_angles, separation_deg
from tests.support.rig import SITE, ManualWeather

# Scans enough for every decision, at a quarter of the work.
SELDOM = {"cube": {"scan_every_s": 20}, "safety": {"scan_stale_s": 65}}


async def no_cube(rig):
    """Wait for tracking, then take the cube away and wait for fallback at rest."""
    await rig.until_mode(Mode.TRACKING, 60)
    for face in range(4):
        rig.scene.break_sensor(face, 0.5)
    await rig.until_mode(Mode.FALLBACK, 120)
    await rig.until(lambda: not rig.motion.moving, 200, "rest")
    await asyncio.sleep(5)


def stays(rig, before):
    return rig.truth() == (pytest.approx(before.a_deg, abs=0.05), pytest.approx(before.b_deg, abs=0.05))


@pytest.mark.parametrize("hours", [12, -12, 3])
def test_in_fallback_after_a_clock_step_the_tracker_stays_put_until_the_clock_is_set_right(run_rig, hours):
    async def scenario(rig):
        await no_cube(rig)
        before = rig.truth()
        rig.clock.step_s = hours * 3600.0
        for _ in range(30):
            await asyncio.sleep(60)
            assert rig.mode is Mode.FALLBACK
            assert stays(rig, before)
        (alarm,) = [alarm for alarm in rig.tracker.alarms.active if alarm.name == "clock"]
        assert f"set {'forward' if hours > 0 else 'back'} by {abs(hours)} h," in alarm.text
        (alarm,) = [alarm for alarm in rig.tracker.alarms.active if alarm.name == "no-readings"]
        assert alarm.text.startswith("standing")
        rig.clock.step_s = 0.0
        await asyncio.sleep(360)
        assert rig.mode is Mode.FALLBACK
        assert not stays(rig, before), "set right it follows the sun"
        assert "clock" not in [alarm.name for alarm in rig.tracker.alarms.active]

    run_rig(scenario, rest_look_s=5.0, **SELDOM)


@pytest.mark.parametrize(("hours", "start"), [(9, "07:00"), (-3, "13:00")])
def test_a_clock_that_is_hours_wrong_neither_turns_the_tracker_from_the_sun_nor_marks_a_face_bad(run_rig, hours, start):
    async def scenario(rig):
        await rig.until_mode(Mode.TRACKING, 60)
        await asyncio.sleep(600)
        rig.clock.step_s = hours * 3600.0
        for _ in range(45):
            await asyncio.sleep(60)
            assert rig.mode is Mode.TRACKING
            assert rig.control.state.scan.ok
        assert "clock" in [alarm.name for alarm in rig.tracker.alarms.active]
        sun = sun_direction(rig.clock.true_utc(), *SITE)
        assert separation_deg(normal_from_angles(*rig.truth()), sun) < 10.0

    run_rig(scenario, start=f"2022-10-12T{start}", rest_look_s=5.0, **SELDOM)


def test_after_a_step_the_chronometric_law_follows_the_new_time_once_the_clock_is_synchronised(run_rig):
    async def scenario(rig):
        await rig.until_mode(Mode.TRACKING, 60)
        rig.synchronised = False
        rig.clock.step_s = 7200.0
        await asyncio.sleep(1800)
        before = rig.truth()
        rig.synchronised = True
        await asyncio.sleep(400)
        assert not stays(rig, before)
        assert "clock" not in [alarm.name for alarm in rig.tracker.alarms.active]

    run_rig(scenario, law={"name": "chronometric"}, rest_look_s=5.0)


def test_mu_prime_goes_on_turning_the_tracker_by_good_faces_while_the_clock_is_in_doubt(run_rig):
    async def scenario(rig):
        await rig.until_mode(Mode.TRACKING, 60)
        await asyncio.sleep(400)
        assert rig.truth().b_deg == pytest.approx(90.0, abs=1.0), "the sky is even"
        decided = len(rig.records_of(Decision))
        rig.clock.step_s = 12 * 3600.0 - 1800.0
        # The scene computes an hour ahead, so this is the light from eleven o'clock on.
        rig.weather.dni, rig.weather.dhi = 700.0, 90.0
        await asyncio.sleep(1200)
        assert "clock" in [alarm.name for alarm in rig.tracker.alarms.active]
        assert rig.mode is Mode.TRACKING
        assert {decision.law for decision in rig.records_of(Decision)[decided:]} == {"mu-prime"}
        sun = sun_direction(rig.clock.true_utc(), *SITE)
        assert separation_deg(normal_from_angles(*rig.truth()), sun) < 10.0

    run_rig(scenario, start="2022-10-12T10:50", weather=ManualWeather(dni=0, dhi=150))


def test_dark_faces_are_not_night_while_the_clock_is_in_doubt_and_the_tracker_stays_where_it_is(run_rig):
    async def scenario(rig):
        await rig.until_mode(Mode.TRACKING, 60)
        await asyncio.sleep(100)
        before = rig.truth()
        rig.clock.step_s = 12 * 3600.0
        for face in range(4):
            rig.scene.break_sensor(face, 1e-6)
        await asyncio.sleep(600)
        assert "clock" in [alarm.name for alarm in rig.tracker.alarms.active]
        assert rig.mode is Mode.FALLBACK
        assert rig.control.why == "the zenith face reads 0.0 W/m2 while the clock is in doubt"
        assert stays(rig, before)

    run_rig(scenario, law={"name": "chronometric"})


def test_the_law_learns_nothing_while_the_time_of_day_is_in_doubt(run_rig):
    async def scenario(rig):
        await rig.until_mode(Mode.TRACKING, 120)
        received = []
        law = rig.control.pointing.law
        observe = law.observe
        law.observe = lambda reading: (received.append(reading.utc_s), observe(reading))
        rig.clock.step_s = 7200.0
        await asyncio.sleep(10)
        received.clear()
        await asyncio.sleep(1200)
        assert not received
        rig.clock.step_s = 0.0
        await asyncio.sleep(60)
        assert received

    run_rig(scenario, law={"name": "optimal"}, weather=ManualWeather())
