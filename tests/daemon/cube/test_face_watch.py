"""Without a self-test: a face that cannot be true is found by day, told, not used, and used again once it agrees."""

import asyncio

import pytest

from daemon.base.records import Mode, Quality
from tests.support.rig import HandWeather


def qualities(bench):
    scan = bench.control.state.scan
    return [] if scan is None else [face.quality for face in scan.faces]


def alarm(bench):
    return next((alarm.text for alarm in bench.service.cube_alarms.active if alarm.name == "cube-face"), None)


def every_face(bench):
    return qualities(bench) == [Quality.IMPLAUSIBLE] * 4


def stick_all(bench):
    for bit in (0, 1, 2):
        bench.switch.stick(bit, True, bench.clock.monotonic())


@pytest.mark.parametrize("weather", [HandWeather(), HandWeather(dni=0, dhi=150), HandWeather(dni=0, dhi=20)])
@pytest.mark.parametrize(("bit", "high"), [(0, False), (0, True), (1, False), (1, True), (2, True)])
def test_a_stuck_line_is_found_within_ten_minutes(run_rig, bit, high, weather):
    async def scenario(bench):
        await bench.until_mode(Mode.TRACKING, 60)
        await asyncio.sleep(100)
        bench.switch.stick(bit, high, bench.clock.monotonic())
        await bench.until(lambda: every_face(bench) or bench.mode is Mode.FALLBACK, 600, "the finding")
        await bench.until_mode(Mode.FALLBACK, 70)
        assert alarm(bench)

    # Line 2 low is the address of all four faces anyway.
    run_rig(scenario, weather=weather)


def test_a_port_without_supply_is_found_within_ten_minutes_and_forgiven_after_agreement(run_rig):
    async def scenario(bench):
        await bench.until_mode(Mode.TRACKING, 60)
        stick_all(bench)
        await bench.until(lambda: every_face(bench), 600, "the finding")
        assert "the east, south, west, zenith faces read" in alarm(bench)
        await bench.until_mode(Mode.FALLBACK, 70)
        bench.switch.unstick(bench.clock.monotonic())
        await asyncio.sleep(300)
        assert every_face(bench), "one good look is no agreement"
        await bench.until(lambda: alarm(bench) is None, 1200, "the end of the alarm")
        await bench.until_mode(Mode.TRACKING, 60)

    run_rig(scenario)


@pytest.mark.parametrize("face", range(4))
def test_a_face_at_exactly_0_v_is_named_and_not_used(run_rig, face):
    name = ("east", "south", "west", "zenith")[face]

    async def scenario(bench):
        await bench.until_mode(Mode.TRACKING, 60)
        bench.scene.break_sensor(face, 0.0)
        await bench.until(lambda: qualities(bench)[face] is Quality.IMPLAUSIBLE, 600, "the finding")
        assert f"the {name} face reads next to nothing" in alarm(bench)
        assert [quality for index, quality in enumerate(qualities(bench)) if index != face] == [Quality.OK] * 3
        await bench.until_mode(Mode.FALLBACK, 70)
        bench.scene.repair_sensor(face)
        await bench.until_mode(Mode.TRACKING, 1500)
        assert alarm(bench) is None

    run_rig(scenario)


def test_interchanged_faces_are_found(run_rig):
    async def scenario(bench):
        sensor = bench.switch._inputs
        bench.switch._inputs = lambda channel, now: sensor({0: 2, 2: 0}.get(channel, channel), now)
        await bench.until(lambda: Quality.IMPLAUSIBLE in qualities(bench), 700, "the finding")
        assert "faces are interchanged" in alarm(bench)

    run_rig(scenario, start="2022-10-12T07:30")


@pytest.mark.parametrize(
    ("weather", "start", "hours"),
    [(HandWeather(), "2022-10-12T06:00", 4), (HandWeather(dni=0, dhi=8), "2022-10-12T14:30", 3)],
)
def test_a_sound_cube_is_believed_through_dawn_and_dusk(run_rig, weather, start, hours):
    async def scenario(bench):
        for _ in range(hours * 6):
            await asyncio.sleep(600)
            assert alarm(bench) is None

    run_rig(scenario, weather=weather, start=start, rest_look_s=5.0)


def test_a_clock_that_was_set_to_noon_at_night_accuses_nobody(run_rig):
    async def scenario(bench):
        await asyncio.sleep(60)
        bench.clock.step_s = -12 * 3600.0
        for face in range(4):
            bench.scene.break_sensor(face, 0.0)
        await asyncio.sleep(850)
        assert alarm(bench) is None

    run_rig(scenario, start="2022-10-12T23:30")
