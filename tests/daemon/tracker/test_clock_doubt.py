"""A clock that was set: nothing follows the ephemeris before it is trusted again."""

import asyncio

import pytest

from daemon.base.records import Decision, Mode, Quality
from tests.support.rig import HandWeather


async def no_cube(bench):
    """Wait for tracking, then take the cube away and wait for fallback at rest."""
    await bench.until_mode(Mode.TRACKING, 60)
    for face in range(4):
        bench.scene.break_sensor(face, 0.5)
    await bench.until_mode(Mode.FALLBACK, 120)
    await bench.until(lambda: not bench.motion.moving, 200, "rest")
    await asyncio.sleep(5)


def stays(bench, before):
    return bench.truth() == (pytest.approx(before.a_deg, abs=0.05), pytest.approx(before.b_deg, abs=0.05))


@pytest.mark.parametrize("hours", [12, -12, 3])
def test_in_fallback_the_tracker_stays_where_it_is_after_a_step(run_rig, hours):
    async def scenario(bench):
        await no_cube(bench)
        before = bench.truth()
        bench.clock.step_s = hours * 3600.0
        for _ in range(88):
            await asyncio.sleep(10)
            assert bench.mode is Mode.FALLBACK
            assert stays(bench, before)
        (alarm,) = [alarm for alarm in bench.tracker.alarms.active if alarm.name == "clock"]
        assert f"{hours * 3600:+d} s" in alarm.text
        bench.clock.step_s = 0.0
        await asyncio.sleep(910)
        assert bench.mode is Mode.FALLBACK
        await asyncio.sleep(300)
        assert not stays(bench, before), "trusted again it follows the sun"

    run_rig(scenario)


def test_with_good_faces_mu_prime_goes_on(run_rig):
    async def scenario(bench):
        await bench.until_mode(Mode.TRACKING, 60)
        await asyncio.sleep(400)
        decided = len(bench.of(Decision))
        bench.clock.step_s = 12 * 3600.0 - 1800.0
        await asyncio.sleep(800)
        assert bench.mode is Mode.TRACKING
        assert len(bench.of(Decision)) > decided

    # The simulated sky follows the clock too, so let it be one that does not depend on the sun.
    run_rig(scenario, weather=HandWeather(dni=0, dhi=150))


def test_a_dark_face_in_doubt_is_no_night(run_rig):
    async def scenario(bench):
        await bench.until_mode(Mode.TRACKING, 60)
        await asyncio.sleep(100)
        before = bench.truth()
        bench.clock.step_s = 12 * 3600.0
        for face in range(4):
            bench.scene.break_sensor(face, 1e-6)
        await asyncio.sleep(600)
        assert bench.mode is not Mode.NIGHT
        assert bench.control.state.scan.zenith.quality in Quality
        assert stays(bench, before)

    run_rig(scenario, law={"name": "chronometric"})
