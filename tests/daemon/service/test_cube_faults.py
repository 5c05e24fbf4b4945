"""The cube is lost, dark, late or lies: what the tracker follows then, and when it follows the cube again."""

import asyncio
import io
import re

import pytest
from rich.console import Console

from daemon.base.records import Decision, Event, Mode, ModeChange, Move
from daemon.commands.status.check import verdict
from daemon.commands.status.screen import live_screen, render
from daemon.notify.notices import ServiceWatch
from daemon.service.operator import Operator
from daemon.service.state import state_json
from solar.ephemeris import sun_direction
from solar.frames import normal_from_angles, separation_deg
from tests.support.phases import modes, wait_for_rest, wait_for_tracking
from tests.support.rig import SITE, ManualWeather


@pytest.mark.parametrize("instrument", ["multiplexer", "voltmeter"])
def test_without_the_cube_the_tracker_follows_the_sun_and_tracks_again_when_the_cube_is_back(run_rig, instrument):
    async def scenario(rig):
        await wait_for_tracking(rig)
        await wait_for_rest(rig)
        getattr(rig.cables, instrument).link_up = False
        await rig.until_mode(Mode.FALLBACK, 90)
        assert "no good scan" in rig.control.why
        await asyncio.sleep(700)
        sun = sun_direction(rig.clock.utc(), *SITE)
        assert separation_deg(normal_from_angles(*rig.truth()), sun) < 2.5
        getattr(rig.cables, instrument).link_up = True
        await rig.until_mode(Mode.TRACKING, 90)

    rig = run_rig(scenario)
    assert modes(rig) == [Mode.TRACKING, Mode.FALLBACK, Mode.TRACKING]
    told = [event.text for event in rig.records_of(Event) if event.subject == "cube"]
    assert len(told) == 2
    assert told[0].startswith("the cube is down")
    assert told[1] == "the cube is back"


@pytest.mark.parametrize("asked", ["stop", "hold", "stow", "snow"])
def test_a_silent_cube_raises_an_alarm_even_while_a_person_keeps_the_tracker_stopped_or_stowed(run_rig, asked):
    async def scenario(rig):
        def alarmed():
            return {alarm.name: alarm.text for alarm in rig.tracker.alarms.active}.get("no-readings")

        await wait_for_tracking(rig)
        await getattr(Operator(rig.tracker, 1.0), asked)("a visit", by="ana")
        rig.cables.voltmeter.link_up = False
        await asyncio.sleep(890)
        assert not alarmed()
        await rig.until(alarmed, 100, "the alarm")
        assert alarmed().startswith("no good readings for a quarter of an hour: no good scan for ")
        assert rig.mode.value == {"stop": "hold"}.get(asked, asked)
        rig.cables.voltmeter.link_up = True
        await rig.until(lambda: not alarmed(), 120, "its end")

    run_rig(scenario)


@pytest.mark.parametrize(("instrument", "method"), [("multiplexer", "select"), ("voltmeter", "open"), ("cube", "read")])
def test_an_unexpected_failure_of_a_cube_driver_is_an_outage_and_is_logged_once(
    run_rig, caplog, monkeypatch, instrument, method
):
    def fails(*_):
        raise KeyError("gauge")

    async def none():
        return None

    async def scenario(rig):
        await wait_for_tracking(rig)
        driver = rig.service.rig.cube if instrument == "cube" else getattr(rig, instrument)
        with monkeypatch.context() as broken:
            broken.setattr(driver, method, none if method == "read" else fails)
            if method == "open":
                rig.cables.voltmeter.link_up = False
                await asyncio.sleep(10)
                rig.cables.voltmeter.link_up = True
            await rig.until_mode(Mode.FALLBACK, 90)
            await asyncio.sleep(300)
        await rig.until_mode(Mode.TRACKING, 90)

    rig = run_rig(scenario)
    assert [record.message for record in caplog.records if record.exc_info] == ["the driver of the cube has failed"]
    told = [event.text for event in rig.records_of(Event) if event.subject == "cube"]
    assert told[0].startswith("the cube is down: ")
    assert told[-1] == "the cube is back"
    if method == "select":
        assert re.search(
            r"cube: its driver has failed with KeyError: 'gauge' \(test_cube_faults\.py, line \d+\)", told[0]
        )


@pytest.mark.parametrize(("silence_s", "moves"), [(150, 0), (285, 0), (420, 1)])
def test_a_gap_of_285_s_in_the_scans_causes_no_swing_to_the_sun_and_one_of_420_s_does(run_rig, silence_s, moves):
    async def scenario(rig):
        await wait_for_tracking(rig)
        await asyncio.sleep(900)
        await wait_for_rest(rig)
        before = len(rig.records_of(Move))
        rig.cables.voltmeter.link_up = False
        await asyncio.sleep(silence_s)
        assert rig.mode is Mode.FALLBACK
        rig.cables.voltmeter.link_up = True
        await rig.until_mode(Mode.TRACKING, 60)
        swung = [move for move in rig.records_of(Move)[before:] if move.target_b_deg < 75]
        assert len(swung) == moves

    run_rig(scenario, law={"driver": "optimal"}, weather=ManualWeather(dni=0, dhi=150), start="2022-12-21T11:00")


def test_the_reason_for_fallback_names_scans_that_the_bridge_refuses_only_while_they_are_the_cause(run_rig):
    async def scenario(rig):
        await wait_for_tracking(rig)
        sender = rig.service.sender
        key, sender._key = sender._key, bytes(32)
        await rig.until_mode(Mode.FALLBACK, 90)
        change = rig.records_of(ModeChange)[-1]
        assert re.search(r"no good scan for \d+ s; the bridge refused \d+ forged since; the latest is", change.why)
        assert change.why.endswith("was not signed with this receiver's key: give both sides the same key file")
        assert rig.control.state.why.startswith("no good scan")
        sender._key = key
        await rig.until_mode(Mode.TRACKING, 90)
        rig.cables.voltmeter.link_up = False
        await rig.until_mode(Mode.FALLBACK, 90)
        assert "refused" not in rig.control.why

    run_rig(scenario)


@pytest.mark.parametrize("out_s", [1, 70])
@pytest.mark.parametrize("instrument", ["multiplexer", "voltmeter", "positioner"])
def test_with_the_default_rhythm_tracking_resumes_within_15_s_of_an_instruments_return(run_rig, instrument, out_s):
    async def scenario(rig):
        await wait_for_tracking(rig)
        await asyncio.sleep(130)
        device = getattr(rig.cables, instrument)
        # At another instant of the scan each time, and of the pauses between tries.
        for turn in range(5):
            device.link_up = False
            await asyncio.sleep(out_s + 0.9 * turn)
            device.link_up = True
            await asyncio.sleep(15)
            assert rig.mode is Mode.TRACKING
            assert not (rig.motion if instrument == "positioner" else rig.service.acquisition).outage.is_down
            await asyncio.sleep(130)

    run_rig(scenario)


@pytest.mark.parametrize(("stuck_at_v", "quality"), [(9.9, "over-range"), (0.4, "implausible")])
def test_one_bad_face_is_named_and_never_used_for_pointing(run_rig, stuck_at_v, quality):
    async def scenario(rig):
        await wait_for_tracking(rig)
        rig.scene.break_sensor(2, stuck_at_v)
        await rig.until(lambda: rig.control.state.scan.faces[2].quality == quality, 60, "the face's quality")
        await asyncio.sleep(400)
        (told,) = rig.service.cube_alarms.active
        assert (told.name, "west" in told.text) == ("face-unread" if quality == "over-range" else "cube-face", True)
        assert rig.mode is Mode.TRACKING
        assert rig.control.why == f"the cube's readings are good, but not all of them (west {quality})"
        rig.scene.break_sensor(0, stuck_at_v)
        await rig.until_mode(Mode.FALLBACK, 90)
        assert f"east {quality}, west {quality}" in rig.control.why

    rig = run_rig(scenario)
    assert modes(rig) == [Mode.TRACKING, Mode.FALLBACK]
    assert all(
        not decision.irradiances.west_w_m2 > 200 for decision in rig.records_of(Decision) if decision.mode == "tracking"
    )


def test_a_voltmeter_that_repeats_its_reading_to_the_last_digit_counts_as_stale(run_rig):
    async def scenario(rig):
        await wait_for_tracking(rig)
        frozen = rig.switch.output_voltage(rig.clock.monotonic())
        rig.voltmeter.read_voltage = lambda: asyncio.sleep(0.04, frozen)
        await rig.until_mode(Mode.FALLBACK, 200)
        assert "stale" in rig.control.why

    run_rig(scenario)


def test_darkness_at_noon_is_a_fault_of_the_cube_and_not_night(run_rig):
    async def scenario(rig):
        await rig.until_mode(Mode.FALLBACK, 300)
        assert "daylight" in rig.control.why

    rig = run_rig(scenario, weather=ManualWeather(dni=0, dhi=1))
    assert Mode.NIGHT not in modes(rig)


def test_a_late_voltmeter_reply_is_never_credited_to_another_face(run_rig):
    async def scenario(rig):
        await wait_for_tracking(rig)
        for _ in range(5):
            await asyncio.sleep(0.9)
            rig.meter.reply_delay_s = 2.5
            await asyncio.sleep(3.0)
            rig.meter.reply_delay_s = 0.0
            await asyncio.sleep(20)

    rig = run_rig(scenario)
    scans = [record for record in rig.records if type(record).__name__ == "Scan"]
    truth = rig.scene.irradiances(rig.clock.utc())
    assert any(not scan.ok for scan in scans), "the delays were felt"
    for scan in scans:
        for reading, true in zip(scan.faces, truth, strict=True):
            if reading.quality == "ok":
                assert reading.irradiance_w_m2 == pytest.approx(true, abs=25)


def test_two_bad_faces_are_named_with_fault_and_time_in_alarm_status_screens_and_notice(run_rig):
    async def scenario(rig):
        await wait_for_tracking(rig)
        await asyncio.sleep(600)
        rig.scene.break_sensor(1, 0.0)
        await asyncio.sleep(1200)
        rig.scene.break_sensor(2, 0.0)
        await rig.until_mode(Mode.FALLBACK, 1800)
        state = state_json(rig.take_snapshot())
        lines, code = verdict(state, {"troubles": [], "down": []})
        screens = []
        for shown in (render(state), live_screen(state)):
            console = Console(file=io.StringIO(), width=2000, height=100)
            console.print(shown)
            screens.append(console.file.getvalue())
        (notice,) = ServiceWatch("roof", 60.0, "notice", None, 0.0).note_answer(state, 1.0)
        assert code == 4
        for door in (state["alarms"][0]["text"][:255], "\n".join(lines), *screens, notice.body):
            assert re.search(
                r"the south and west faces read next to nothing while other faces are lit; not used since"
                # In a terminal, times are local, with a date if that is another one.
                r" [\d :(-]*10:1\d UTC\)? \(south\) and [\d :(-]*10:[34]\d UTC\)? \(west\)",
                door,
            )
            assert "its sensor" not in door
        assert "south implausible, west implausible" in rig.control.why

    run_rig(scenario)
