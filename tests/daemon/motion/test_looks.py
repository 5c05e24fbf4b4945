"""Each look at the unit: when it is read or only glanced at, which poses are told, and when it is said to stand."""

import asyncio
import logging

import pytest

from daemon.base.records import Target
from daemon.motion.polling import Polling
from drivers.errors import RefusedError
from tests.support.fake_positioner import RepeatingFakePositioner, run_motion, wait_out_standstill


def test_the_place_of_rest_is_unknown_from_an_order_until_the_move_has_settled():
    async def scenario(rig):
        guard = rig.motion._guard
        assert (guard.rest_pose.a_deg, guard.rest_pose.b_deg) == (0.0, 60.0)
        rig.motion.order(Target(10.0, 60.0, "go"))
        await rig.until(lambda: rig.motion.target is not None, 2.0)
        assert guard.rest_pose is None
        await rig.until(lambda: rig.motion.target is None)
        assert guard.rest_pose is None, "what is left of the way may still be made up"
        await asyncio.sleep(12.0)
        assert guard.rest_pose.a_deg == 10.0

    run_motion(scenario)


def test_poses_at_rest_come_every_five_seconds_and_at_once_for_a_twentieth_of_a_degree():
    async def scenario(rig):
        await wait_out_standstill(rig)
        count = len(rig.poses)
        await asyncio.sleep(20.0)
        assert len(rig.poses) - count == 4
        for place in ((0.0, 60.0), (0.06, 60.0), (0.06, 60.06)):
            count = len(rig.poses)
            rig.unit.put(*place)
            await asyncio.sleep(1.0)
            assert len(rig.poses) - count <= 1
            assert (rig.poses[-1].a_deg, rig.poses[-1].b_deg) == place
        count = len(rig.poses)
        rig.unit.put(0.1, 60.06)
        await rig.until(lambda: len(rig.poses) > count, 6.0)
        assert rig.poses[-1].time_monotonic_s - rig.poses[-2].time_monotonic_s >= 4.9
        assert not rig.motion.unexplained_motion
        assert rig.poses[-1].time_utc_s - rig.poses[-1].time_monotonic_s == pytest.approx(1_665_568_800.0)

    run_motion(scenario)


def test_poses_under_a_button_and_on_a_move_come_with_every_look():
    async def scenario(rig):
        await wait_out_standstill(rig)
        rig.unit.telemetry_overrides["button_pressed"] = True
        count = len(rig.poses)
        await asyncio.sleep(3.05)
        assert len(rig.poses) - count >= 5
        rig.unit.telemetry_overrides.clear()
        await asyncio.sleep(1.0)
        count = len(rig.poses)
        rig.motion.order(Target(10.0, 60.0, "go"))
        await asyncio.sleep(3.05)
        assert len(rig.poses) - count >= 5
        assert rig.poses[-1].moving
        await rig.until(lambda: rig.motion.target is None)
        await asyncio.sleep(0.6)
        assert not rig.poses[-1].moving, "the end of a move is told at once"

    run_motion(scenario)


def test_a_motor_current_is_judged_with_every_look_and_forgotten_with_the_clear():
    async def scenario(rig):
        await wait_out_standstill(rig)
        stops = rig.unit.sent.count("halt")
        rig.unit.telemetry_overrides["b_motor_current_a"] = 0.5
        await asyncio.sleep(2.5)
        assert rig.unit.sent.count("halt") == stops + 1, "the stop before may not have been heard"
        await asyncio.sleep(2.0)
        assert rig.unit.sent.count("halt") == stops + 2
        assert "although it stands" in rig.active_alarms["motor-current"]
        rig.unit.telemetry_overrides.clear()
        await asyncio.sleep(3.0)
        assert "motor-current" in rig.active_alarms
        rig.motion.clear_faults()
        await asyncio.sleep(2.0)
        assert "motor-current" not in rig.active_alarms
        rig.unit.telemetry_overrides["b_motor_current_a"] = 0.5
        rig.motion.order(Target(20.0, 60.0, "go"))
        await rig.until(lambda: rig.motion.target is None)
        assert "motor-current" not in rig.active_alarms, "a motor at work draws current"

    run_motion(scenario)


def test_a_pressed_button_makes_control_look_again_at_once():
    async def scenario(rig):
        await wait_out_standstill(rig)
        for pressed in (True, False):
            before = rig.changes
            rig.unit.telemetry_overrides["button_pressed"] = pressed
            await asyncio.sleep(1.2)
            assert rig.changes == before + 1
        await asyncio.sleep(5.0)
        assert rig.changes == before + 1

    run_motion(scenario)


def test_a_unit_that_repeats_itself_is_not_read_again_and_its_data_are_as_new_as_the_last_glance():
    async def scenario(rig):
        assert rig.unit.looks > 3, "what has just come to rest is read"
        await asyncio.sleep(6.0)
        looks, ages_s, poses_s, lags_s = rig.unit.looks, [], [], []
        for _ in range(100):
            await asyncio.sleep(0.3)
            now_s, pose = rig.clock.monotonic(), rig.motion.pose
            ages_s.append(now_s - rig.motion.telemetry.time_monotonic_s)
            poses_s.append(now_s - pose.time_monotonic_s)
            lags_s.append(pose.time_utc_s - pose.time_monotonic_s - 1_665_568_800.0)
            assert rig.motion.telemetry.status_monotonic_s == rig.motion.telemetry.time_monotonic_s
        assert 5 <= rig.unit.looks - looks <= 8, "each pose that is told is read"
        assert max(ages_s) <= 0.61
        assert max(poses_s) <= 0.61
        assert min(lags_s) >= 0.0
        assert max(lags_s) <= 0.11
        rig.unit.shows_the_same = False
        looks = rig.unit.looks
        await asyncio.sleep(2.0)
        assert rig.unit.looks - looks >= 3

    run_motion(scenario, make=RepeatingFakePositioner)


def test_a_unit_that_has_just_come_to_rest_or_draws_current_is_read_although_it_repeats_itself():
    async def scenario(rig):
        await asyncio.sleep(10.0)
        rig.unit.telemetry_overrides["button_pressed"] = True
        rig.unit.shows_the_same = False
        rig.unit.drive(0.5, 60.0)
        await asyncio.sleep(2.0)
        rig.unit.telemetry_overrides.clear()
        await asyncio.sleep(1.0)
        rig.unit.shows_the_same = True
        looks = rig.unit.looks
        await asyncio.sleep(2.0)
        assert rig.unit.looks - looks >= 3, "it has come to rest less than five seconds ago"
        await asyncio.sleep(8.0)
        rig.unit.telemetry_overrides["a_motor_current_a"] = 0.5
        rig.unit.shows_the_same = False
        await asyncio.sleep(0.7)
        rig.unit.shows_the_same = True
        await asyncio.sleep(2.5)
        assert "motor-current" in rig.active_alarms, "a current that has to last is looked at"

    run_motion(scenario, make=RepeatingFakePositioner)


def test_a_unit_that_may_yet_make_up_the_rest_of_a_move_is_read_although_it_repeats_itself():
    async def scenario(rig):
        rig.motion.order(Target(10.0, 60.0, "go"))
        await rig.until(lambda: rig.moves)
        await asyncio.sleep(6.0)
        looks = rig.unit.looks
        await asyncio.sleep(2.0)
        assert rig.unit.looks - looks >= 3

    run_motion(scenario, make=RepeatingFakePositioner)


def test_telemetry_read_after_a_glance_is_not_given_the_time_of_the_glance():
    async def scenario(rig):
        await asyncio.sleep(20.0)
        rig.unit.shows_the_same = False
        for _ in range(20):
            await asyncio.sleep(0.13)
            assert rig.clock.monotonic() - rig.motion.telemetry.time_monotonic_s <= 0.51
        rig.unit.put(0.05, 60.0)
        await asyncio.sleep(0.6)
        assert rig.motion.telemetry.a_deg == rig.motion.pose.a_deg == 0.05
        rig.unit.is_lost = True
        await asyncio.sleep(1.0)
        assert rig.motion.telemetry is None
        assert rig.clock.monotonic() - rig.motion.pose.time_monotonic_s < 1.6

    run_motion(scenario, make=RepeatingFakePositioner)


def test_after_a_lost_link_neither_telemetry_nor_a_standstill_is_known(caplog):
    async def scenario(rig):
        await wait_out_standstill(rig)
        rig.unit.is_lost = True
        await rig.until(lambda: not rig.motion.connected, 3.0)
        assert rig.motion.telemetry is None
        assert rig.motion.stands_since_s is None
        assert rig.motion.pose is not None
        assert not rig.motion.homing
        rig.unit.is_lost = False
        await rig.until(lambda: rig.motion.connected, 10.0)
        assert rig.motion.unexplained_motion is None

    with caplog.at_level(logging.DEBUG):
        run_motion(scenario)


def test_no_standstill_is_reported_while_a_stop_is_on_its_way():
    async def scenario(rig):
        await wait_out_standstill(rig)
        rig.motion.freeze("ana")
        assert rig.motion.stands_since_s is None
        await asyncio.sleep(3.0)
        assert rig.motion.stands_since_s is not None

    run_motion(scenario)


def test_alarms_are_shown_again_only_when_something_has_changed():
    async def scenario(rig):
        await wait_out_standstill(rig)
        rig.unit.telemetry_overrides["faults"] = ("a_overcurrent",)
        await asyncio.sleep(3.0)
        assert rig.active_alarms["positioner-fault"] == "the positioner reports a_overcurrent"
        rig.alarms.set("positioner-fault", None)
        await asyncio.sleep(3.0)
        assert "positioner-fault" not in rig.active_alarms, (
            "nobody raises what has not changed, thousands of times a day"
        )

    run_motion(scenario)


def test_before_and_at_the_connection_no_standstill_is_reported():
    async def scenario(rig):
        assert not rig.motion.is_idle
        assert rig.motion.stands_since_s is None
        rig.unit.is_deaf = True
        rig.unit.telemetry_overrides["homing"] = True
        for _ in range(30):
            await asyncio.sleep(0.1)
            assert rig.motion.stands_since_s is None
        assert "reference run of its own" in rig.motion.doubt

    run_motion(scenario, connects=False)


def test_poses_say_whether_something_was_ordered_to_move_or_is_being_stopped():
    async def scenario(rig):
        await wait_out_standstill(rig)
        count = len(rig.poses)
        rig.motion.freeze("ana")
        await asyncio.sleep(3.0)
        assert not any(pose.moving for pose in rig.poses[count:])
        rig.motion.freeze(None)
        rig.unit.is_deaf = True
        rig.motion.freeze("ana")
        await asyncio.sleep(1.2)
        assert rig.poses[-1].moving

    run_motion(scenario)


@pytest.mark.parametrize("axis", [0, 1])
def test_a_pose_is_recorded_for_a_change_of_either_axis_in_either_direction(axis):
    async def scenario(rig):
        await wait_out_standstill(rig)
        for step in (0.07, -0.07):
            place, count = list(rig.unit.place()), len(rig.poses)
            place[axis] += step
            rig.unit.put(*place)
            await asyncio.sleep(0.6)
            told = rig.poses[-1]
            assert (told.a_deg, told.b_deg) == pytest.approx(place)
            assert len(rig.poses) > count

    run_motion(scenario)


def test_motion_looks_at_the_unit_as_often_as_the_polling_says():
    async def scenario(rig):
        assert rig.motion.poll_interval_s == 7.0
        await asyncio.sleep(10.0)
        looks = rig.unit.looks
        await asyncio.sleep(70.0)
        assert rig.unit.looks - looks == 10
        rig.motion.order(Target(40.0, 60.0, "far"))
        looks = rig.unit.looks
        await asyncio.sleep(10.0)
        assert 5 <= rig.unit.looks - looks <= 8, "one ends the rest"

    run_motion(scenario, polling=Polling(idle_s=7.0, moving_s=2.0))


async def looks_in_5_s(rig):
    looks = rig.unit.looks
    await asyncio.sleep(5.0)
    return rig.unit.looks - looks


@pytest.mark.parametrize("stow", [False, True])
def test_a_unit_that_repeats_itself_is_only_glanced_at_until_the_pause_after_a_failure_is_over(stow):
    async def scenario(rig):
        await asyncio.sleep(20.0)
        assert await looks_in_5_s(rig) <= 2
        rig.unit.refuses["move"] = RefusedError("hand", "not taken")
        rig.motion.order(Target(10.0, 60.0, "go"), stow=stow)
        await rig.until(lambda: "move-failed" in rig.active_alarms)
        failed_s = rig.clock.monotonic()
        if stow:
            rig.motion.order(Target(10.0, 60.0, "go"), stow=True)
        await asyncio.sleep(20.0)
        assert await looks_in_5_s(rig) <= 2
        sent, changes = len(rig.unit.sent), rig.changes
        await rig.until(lambda: len(rig.unit.sent) > sent if stow else rig.changes > changes, 70.0)
        assert rig.clock.monotonic() - failed_s == pytest.approx(60.0, abs=0.7)
        assert rig.motion.doubt is None or stow

    run_motion(scenario, make=RepeatingFakePositioner, attempts=1, retry_after_s=60.0)


def test_a_unit_that_repeats_itself_is_only_glanced_at_until_it_may_be_homed():
    async def scenario(rig):
        rig.unit.telemetry_overrides["reference_doubt"] = "the count jumped"
        await asyncio.sleep(20.0)
        assert rig.motion.doubt == "the count jumped"
        assert await looks_in_5_s(rig) <= 2
        rig.motion.may_rehome = True
        await rig.until(lambda: rig.motion.homing, 0.7)

    run_motion(scenario, make=RepeatingFakePositioner, rehome="automatic")
