"""A cube on the rig whose wiring fails: the faces that it spoils are found by day, reported, and not used."""

import asyncio

import pytest

from daemon.base.records import Mode, Quality
from tests.support.rig import ManualWeather


def qualities(rig):
    scan = rig.control.state.scan
    return [] if scan is None else [face.quality for face in scan.faces]


def alarm(rig):
    return next((alarm.text for alarm in rig.service.cube_alarms.active if alarm.name == "cube-face"), None)


def every_face(rig):
    return qualities(rig) == [Quality.IMPLAUSIBLE] * 4


def stick_all(rig):
    for bit in (0, 1, 2):
        rig.switch.stick(bit, True, rig.clock.monotonic())


@pytest.mark.parametrize("weather", [ManualWeather(), ManualWeather(dni=0, dhi=150), ManualWeather(dni=0, dhi=20)])
@pytest.mark.parametrize(("bit", "high"), [(0, False), (0, True), (1, False), (1, True), (2, True)])
def test_a_stuck_address_line_is_found_within_ten_minutes(run_rig, bit, high, weather):
    async def scenario(rig):
        await rig.until_mode(Mode.TRACKING, 60)
        await asyncio.sleep(100)
        rig.switch.stick(bit, high, rig.clock.monotonic())
        await rig.until(lambda: every_face(rig) or rig.mode is Mode.FALLBACK, 600, "the finding")
        await rig.until_mode(Mode.FALLBACK, 70)
        assert alarm(rig)

    # Line 2 stuck low is not tested: it is low in the address of all four faces anyway.
    run_rig(scenario, weather=weather, rest_look_s=5.0)


def test_a_port_without_supply_is_found_in_ten_minutes_and_its_faces_are_used_again_once_they_agree(run_rig):
    async def scenario(rig):
        await rig.until_mode(Mode.TRACKING, 60)
        stick_all(rig)
        await rig.until(lambda: every_face(rig), 600, "the finding")
        assert "the east, south, west and zenith faces read" in alarm(rig)
        await rig.until_mode(Mode.FALLBACK, 70)
        rig.switch.unstick(rig.clock.monotonic())
        await asyncio.sleep(300)
        assert every_face(rig), "one good look is no agreement"
        await rig.until(lambda: alarm(rig) is None, 1200, "the end of the alarm")
        await rig.until_mode(Mode.TRACKING, 60)

    run_rig(scenario, rest_look_s=5.0)


@pytest.mark.parametrize("face", range(4))
def test_a_face_at_exactly_0_v_is_named_and_not_used(run_rig, face):
    name = ("east", "south", "west", "zenith")[face]

    async def scenario(rig):
        await rig.until_mode(Mode.TRACKING, 60)
        rig.scene.break_sensor(face, 0.0)
        await rig.until(lambda: qualities(rig)[face] is Quality.IMPLAUSIBLE, 600, "the finding")
        assert f"the {name} face reads next to nothing" in alarm(rig)
        assert [quality for index, quality in enumerate(qualities(rig)) if index != face] == [Quality.OK] * 3
        await asyncio.sleep(100)
        assert rig.mode is Mode.TRACKING
        rig.scene.break_sensor(face, 2.0)
        await rig.until(lambda: qualities(rig)[face] is Quality.OVER_RANGE, 30, "what the meter says")
        rig.scene.repair_sensor(face)
        await rig.until(lambda: alarm(rig) is None, 1500, "the end of the alarm")

    run_rig(scenario, rest_look_s=5.0)


def test_interchanged_faces_are_found(run_rig):
    async def scenario(rig):
        sensor = rig.switch._inputs
        rig.switch._inputs = lambda channel, now: sensor({0: 2, 2: 0}.get(channel, channel), now)
        await rig.until(lambda: Quality.IMPLAUSIBLE in qualities(rig), 700, "the finding")
        assert "faces are interchanged" in alarm(rig)

    run_rig(scenario, start="2022-10-12T07:30", rest_look_s=5.0)


@pytest.mark.parametrize("face", [2, 3])
def test_an_open_input_that_repeats_the_face_read_before_it_is_found_in_the_sun(run_rig, face):
    async def scenario(rig):
        sensor = rig.switch._inputs
        rig.switch._inputs = lambda channel, now: None if channel == face else sensor(channel, now)
        await rig.until(lambda: Quality.IMPLAUSIBLE in qualities(rig), 3600, "the finding")
        assert f"the {('west', 'zenith')[face - 2]} face reads" in alarm(rig)

    seldom = {"cube": {"scan_every_s": 15}, "safety": {"scan_stale_s": 65, "fallback_after_s": 130}}
    run_rig(scenario, start="2022-10-12T07:30", rest_look_s=5.0, **seldom)


@pytest.mark.parametrize(
    ("weather", "start", "hours"),
    [(ManualWeather(), "2022-10-12T06:00", 4), (ManualWeather(dni=0, dhi=8), "2022-10-12T14:30", 3)],
)
def test_a_sound_cube_raises_no_alarm_through_dawn_and_dusk(run_rig, weather, start, hours):
    async def scenario(rig):
        for _ in range(hours * 6):
            await asyncio.sleep(600)
            assert alarm(rig) is None

    seldom = {"cube": {"scan_every_s": 30}, "safety": {"scan_stale_s": 130, "fallback_after_s": 260}}
    run_rig(scenario, weather=weather, start=start, rest_look_s=5.0, **seldom)


def test_a_clock_that_was_set_to_noon_at_night_raises_no_alarm_about_a_face(run_rig):
    async def scenario(rig):
        await asyncio.sleep(60)
        rig.clock.step_s = -12 * 3600.0
        for face in range(4):
            rig.scene.break_sensor(face, 0.0)
        await asyncio.sleep(850)
        assert alarm(rig) is None

    run_rig(scenario, start="2022-10-12T23:30", rest_look_s=5.0)
