"""Wind on the whole service: gusts, several sources, restarts."""

import asyncio

import pytest

from daemon.base.records import Decision, Event, Mode, Move
from daemon.service.state import state_json
from tests.daemon.tracker.days import operator
from tests.support.motion import override_telemetry, send_foreign_b_target
from tests.support.phases import wait_for_homing, wait_for_long_rest, wait_for_rest
from tests.support.rig import ManualWeather


def wind_of(rig):
    return state_json(rig.take_snapshot())["wind"]


def test_a_gust_of_two_seconds_between_two_ticks_of_the_control_stows_the_tracker(run_rig):
    async def scenario(rig):
        await rig.until_mode(Mode.TRACKING, 60)
        for _ in range(3):
            # Just after a look; the gust is over before the next.
            looked_s = rig.control.last_tick_s
            await rig.until(lambda before=looked_s: rig.control.last_tick_s > before, 10, "a look")
            rig.wind_m_s = 14.0
            await asyncio.sleep(0.1)
        rig.wind_m_s = 25.0
        await asyncio.sleep(2.0)
        rig.wind_m_s = 3.0
        await rig.until_mode(Mode.STOW, 0.5)
        assert "25.0 m/s" in rig.control.why
        await asyncio.sleep(2.0)
        (seen,) = wind_of(rig)
        assert seen["name"] == "wind"
        assert (seen["speed_m_s"], seen["stow_from_m_s"], seen["release_below_m_s"]) == (3.0, 15.0, 10.0)
        assert 880 < seen["release_in_s"] <= 900

    run_rig(scenario)


def test_a_service_that_was_killed_in_a_storm_comes_back_stowing(run_rig, tmp_path):
    async def storm(rig):
        await rig.until_mode(Mode.TRACKING, 60)
        rig.wind_m_s = 25.0
        await rig.until_mode(Mode.STOW, 6)

    async def after(rig):
        rig.wind_m_s = None
        await rig.until_mode(Mode.STOW, 10)
        assert "before the restart" in rig.control.why
        await asyncio.sleep(200)
        rig.wind_m_s = 3.0
        await asyncio.sleep(890)
        assert rig.mode is Mode.STOW
        assert not rig.records_of(Decision)
        await rig.until_mode(Mode.TRACKING, 60)

    run_rig(storm, store={"directory": tmp_path})
    run_rig(after, store={"directory": tmp_path})


def test_tracking_does_not_begin_before_the_first_wind_message(run_rig):
    async def scenario(rig):
        rig.wind_m_s = None
        await asyncio.sleep(120)
        assert rig.mode is Mode.STARTING
        assert rig.control.why == "waiting for the first message of wind"
        rig.wind_m_s = 3.0
        await rig.until_mode(Mode.TRACKING, 10)

    run_rig(scenario)


def test_the_tracker_does_not_go_to_the_night_position_before_the_first_wind_message(run_rig):
    async def scenario(rig):
        rig.wind_m_s = None
        await asyncio.sleep(120)
        assert rig.mode is Mode.STARTING
        assert rig.control.why == "waiting for the first message of wind"
        assert not rig.records_of(Move)
        rig.wind_m_s = 3.0
        await rig.until_mode(Mode.NIGHT, 10)
        await asyncio.sleep(240)
        assert [(move.target_a_deg, move.target_b_deg) for move in rig.records_of(Move)] == [(0.0, 40.0)]

    run_rig(scenario, start="2022-10-12T01:00", weather=ManualWeather(dni=0, dhi=0), safety={"night_b_deg": 40.0})


def test_no_automatic_reference_run_is_made_before_the_first_wind_message(run_rig):
    async def scenario(rig):
        rig.wind_m_s = None
        await rig.until(lambda: rig.motion.connected, 10, "the connection")
        rig.unit.power_cycle(rig.clock.monotonic(), keep_position=True)
        await asyncio.sleep(120)
        assert rig.mode is Mode.FAULT
        assert not rig.motion.homing
        rig.wind_m_s = 3.0
        await wait_for_homing(rig)

    run_rig(scenario, motion={"rehome": "automatic"})


def test_a_wind_sensor_that_is_silent_from_the_start_stows_the_tracker_after_the_allowed_silence(run_rig):
    async def scenario(rig):
        rig.wind_m_s = None
        await asyncio.sleep(290)
        assert rig.mode is Mode.STARTING
        await rig.until_mode(Mode.STOW, 30)

    run_rig(scenario)


def test_a_stow_begins_after_auto_as_soon_as_telemetry_shows_that_the_button_was_let_go(run_rig):
    async def scenario(rig):
        await wait_for_long_rest(rig)
        override_telemetry(rig, button_pressed=True, status_monotonic_s=rig.clock.monotonic())
        await rig.until(lambda: rig.control.wishes.buttons is not None, 5, "the hold")
        rig.wind_m_s = 20.0
        await asyncio.sleep(1.5)
        # The unit reports its status every few seconds: by the latest report the button is still pressed.
        rig.control.auto()
        await rig.until_mode(Mode.STOW, 1)
        assert rig.motion.target is None
        override_telemetry(rig, button_pressed=False)
        await rig.until(lambda: rig.motion.target is not None, 3, "the stow")

    run_rig(scenario)


def test_maintenance_in_a_storm_and_the_auto_that_ends_it_raise_and_clear_no_alarm(run_rig):
    async def scenario(rig):
        await wait_for_long_rest(rig)
        rig.wind_m_s = 20.0
        await rig.until_mode(Mode.STOW, 10)
        await operator(rig).maintenance("bearings", "ana")
        await asyncio.sleep(30)
        await operator(rig).auto("done")
        assert rig.mode is Mode.STOW
        assert not [event.text for event in rig.records_of(Event) if event.subject == "alarm"]

    run_rig(scenario)


def stow_missed(rig):
    return [alarm.text for alarm in rig.tracker.alarms.active if alarm.name == "stow-wanted"]


@pytest.mark.parametrize("later", ["an axis is turned", "the pose is in doubt"])
def test_a_stop_at_the_stow_position_in_a_storm_raises_no_alarm_until_it_is_turned_or_in_doubt(run_rig, later):
    async def scenario(rig):
        await wait_for_long_rest(rig)
        rig.wind_m_s = 20.0
        await rig.until_mode(Mode.STOW, 6)
        await rig.until(lambda: rig.motion.moving, 5, "the stow")
        await wait_for_rest(rig)
        await operator(rig).stop("a look at the module", "ana")
        await asyncio.sleep(60)
        assert not stow_missed(rig)
        assert "; stow is wanted and the tracker stands there (wind 20.0 m/s" in rig.control.why
        if later == "an axis is turned":
            # As another program would.
            send_foreign_b_target(rig, 60)
        else:
            rig.unit.power_cycle(rig.clock.monotonic(), keep_position=True)
        await rig.until(lambda: stow_missed(rig), 15, "the alarm")
        assert "stow is wanted and not done" in rig.control.why

    run_rig(scenario)


def test_a_stop_on_the_way_to_stow_raises_an_alarm_even_within_5_degrees_of_the_position(run_rig):
    async def scenario(rig):
        await wait_for_long_rest(rig)
        rig.wind_m_s = 20.0
        safety = rig.control._settings.safety
        await rig.until(lambda: rig.motion.target is not None and rig.mode is Mode.STOW, 10, "the stow")

        def off_deg():
            pose = rig.motion.pose
            return max(abs(pose.a_deg - safety.stow_a_deg), abs(pose.b_deg - safety.stow_b_deg))

        await rig.until(lambda: off_deg() < 5.0, 200, "nearly there")
        await operator(rig).stop("a hand", "ana")
        await rig.until(lambda: rig.motion.stands_since_s is not None, 10, "rest")
        assert off_deg() > rig.control._settings.motion.tolerance_deg
        await asyncio.sleep(6)
        (text,) = stow_missed(rig)
        assert "but the tracker is stopped by ana" in text

    run_rig(scenario)


def test_a_stop_at_the_stow_position_raises_an_alarm_once_the_positioner_is_unplugged(run_rig):
    async def scenario(rig):
        await wait_for_long_rest(rig)
        rig.wind_m_s = 20.0
        await rig.until(lambda: rig.motion.target is not None and rig.mode is Mode.STOW, 10, "the stow")
        await wait_for_rest(rig)
        await operator(rig).stop("a look at the module", "ana")
        await asyncio.sleep(6)
        assert not stow_missed(rig)
        rig.cables.positioner.link_up = False
        await rig.until(lambda: stow_missed(rig), 15, "the alarm")

    run_rig(scenario)


def test_a_stop_that_auto_releases_while_it_is_being_sent_does_not_prevent_the_wind_stow(run_rig):
    async def scenario(rig):
        await wait_for_long_rest(rig)
        rig.wind_m_s = 25.0
        await rig.until_mode(Mode.STOW, 6)
        await rig.until(lambda: rig.motion.moving, 5, "the stow")
        stop = rig.positioner.stop

        async def stop_as_on_a_port():
            await asyncio.sleep(0.005)
            await stop()

        rig.positioner.stop = stop_as_on_a_port
        stopping = asyncio.create_task(operator(rig).stop("enough", "ana"))
        await asyncio.sleep(0.002)
        await operator(rig).auto("a mistake", "ben")
        await stopping
        assert rig.mode is Mode.STOW
        await asyncio.sleep(10)
        assert rig.motion.target is not None

    run_rig(scenario)


SLEPT_S = 3600.0


@pytest.mark.parametrize("cube", ["hears", "lost"])
def test_after_the_machine_has_slept_no_decision_is_made_before_a_new_wind_message(run_rig, cube):
    async def scenario(rig):
        await rig.until_mode(Mode.TRACKING, 60)
        if cube == "lost":
            for face in range(4):
                rig.scene.break_sensor(face, 0.5)
            await rig.until_mode(Mode.FALLBACK, 120)
        await asyncio.sleep(30)
        mode = rig.mode
        # The steady clock stands still while a machine sleeps, and the network may come back later than the machine.
        rig.wind_m_s, rig.clock.slept_s, rig.synchronised = None, SLEPT_S, True
        await asyncio.sleep(10)
        decided = len(rig.records_of(Decision))
        await asyncio.sleep(700)
        assert rig.mode is mode
        assert rig.control.why == "waiting for wind to be heard: the machine has slept"
        assert len(rig.records_of(Decision)) == decided
        rig.wind_m_s = 3.0
        await rig.until(lambda: len(rig.records_of(Decision)) > decided, 10, "the decision")

    run_rig(scenario, safety={"wind_stale_s": 1200})


def test_a_stow_in_which_the_machine_has_slept_ends_only_after_the_whole_time_of_calm_anew(run_rig):
    async def scenario(rig):
        await rig.until_mode(Mode.TRACKING, 60)
        rig.wind_m_s = 25.0
        await rig.until_mode(Mode.STOW, 6)
        await asyncio.sleep(5)
        rig.wind_m_s = 3.0
        await asyncio.sleep(800)
        rig.clock.slept_s = SLEPT_S
        await asyncio.sleep(890)
        assert rig.mode is Mode.STOW
        await rig.until_mode(Mode.TRACKING, 30)

    run_rig(scenario)


def test_after_a_sleep_of_the_machine_at_night_tracking_by_day_awaits_a_new_wind_message(run_rig):
    async def scenario(rig):
        await rig.until_mode(Mode.NIGHT, 60)
        await asyncio.sleep(60)
        rig.wind_m_s, rig.clock.slept_s = None, 8 * 3600.0
        rig.weather.dhi = 200.0  # from 2:00 on
        await asyncio.sleep(280)
        assert rig.mode is Mode.STARTING
        rig.wind_m_s = 3.0
        await rig.until_mode(Mode.TRACKING, 10)
        await rig.until(lambda: rig.records_of(Decision), 10, "the decision")

    run_rig(scenario, start="2022-10-12T01:58", weather=ManualWeather(dni=0, dhi=0))
