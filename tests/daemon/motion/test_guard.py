"""The one rule of motion, look by look: each time and each bound at which a stop, a stray or a pose is judged."""

import asyncio
import itertools
import logging

import pytest

from daemon.base.records import Event, MoveOutcome, Target
from drivers.errors import RefusedError
from tests.support.hand_positioner import DEAF_S, RepeatingPositioner, run_motion


async def asleep(rig):
    """Let everything that a standstill has to last for be over."""
    await asyncio.sleep(30.0)


def test_it_rests_where_it_was_seen_and_no_longer_once_something_is_ordered():
    async def scenario(rig):
        guard = rig.motion._guard
        assert (guard.rested.a_deg, guard.rested.b_deg) == (0.0, 60.0)
        rig.motion.order(Target(10.0, 60.0, "go"))
        await rig.until(lambda: rig.motion.target is not None, 2.0)
        assert guard.rested is None
        await rig.until(lambda: rig.motion.target is None)
        assert guard.rested is None, "what is left of the way may still be made up"
        await asyncio.sleep(12.0)
        assert guard.rested.a_deg == 10.0

    run_motion(scenario)


def test_poses_at_rest_come_every_five_seconds_and_at_once_for_a_twentieth_of_a_degree():
    async def scenario(rig):
        await asleep(rig)
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
        assert not rig.motion.unexplained
        assert rig.poses[-1].time_utc_s - rig.poses[-1].time_monotonic_s == pytest.approx(1_665_568_800.0)

    run_motion(scenario)


def test_poses_under_a_button_and_on_a_move_come_with_every_look():
    async def scenario(rig):
        await asleep(rig)
        rig.unit.says["button_pressed"] = True
        count = len(rig.poses)
        await asyncio.sleep(3.05)
        assert len(rig.poses) - count >= 5
        rig.unit.says.clear()
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


@pytest.mark.parametrize(("a_deg", "b_deg"), [(30.0, 60.0), (0.0, 20.0)])
def test_what_moves_without_an_order_is_stopped_told_once_and_blocks(a_deg, b_deg, caplog):
    async def scenario(rig):
        await asleep(rig)
        rig.unit.drive(a_deg, b_deg)
        await rig.until(lambda: rig.motion.unexplained, 2.0)
        await asyncio.sleep(20.0)
        stands = rig.unit.place()
        assert max(abs(stands[0]), abs(stands[1] - 60.0)) < 4.0
        axis = "A" if a_deg else "B"
        assert rig.motion.unexplained.startswith(f"{axis} moved from ")
        assert "without an order: nothing moves" in rig.motion.unexplained
        assert rig.raised["unexplained-motion"] == rig.motion.unexplained
        assert rig.motion.stands_since_s is not None
        assert rig.unit.sent.count("halt") == 2, "one at the connection, one for this"

    run_motion(scenario)


def test_against_a_stop_is_said_with_the_stop_that_it_is_against():
    async def scenario(rig):
        await asleep(rig)
        rig.motion.freeze("ana has stopped it")
        await asyncio.sleep(5.0)
        rig.unit.drive(30.0, 60.0)
        await rig.until(lambda: rig.motion.unexplained, 2.0)
        assert "against a stop (ana has stopped it): " in rig.motion.unexplained

    run_motion(scenario)


def test_while_it_is_found_out_what_moved_nothing_may_move_either():
    async def scenario(rig):
        await asleep(rig)
        rig.unit.status_age_s = 1.5
        rig.unit.drive(30.0, 60.0)
        await rig.until(lambda: rig.motion.unexplained, 2.0)
        assert rig.motion._guard.doubts.incident is None
        with pytest.raises(RefusedError, match="without an order"):
            rig.motion.order(Target(0.0, 60.0, "go"), stow=True)
        await rig.until(lambda: rig.motion._guard.doubts.incident, 8.0)

    run_motion(scenario)


@pytest.mark.parametrize(("after_s", "explained"), [(0.0, True), (2.0, True), (3.4, True), (4.6, False)])
def test_a_button_explains_motion_for_four_seconds_before_it_is_seen(after_s, explained):
    async def scenario(rig):
        await asleep(rig)
        rig.unit.says["button_pressed"] = True
        await asyncio.sleep(1.0)
        pressed_s = rig.motion.telemetry.status_monotonic_s
        rig.unit.says.clear()
        await rig.until(lambda: rig.clock.monotonic() >= pressed_s + after_s)
        rig.unit.drive(30.0, 60.0)
        await asyncio.sleep(10.0)
        assert (rig.motion.unexplained is None) == explained
        assert rig.unit.place()[0] < 5.0, "it is stopped in any case"
        assert len([text for text in rig.told if "a button is pressed" in text]) == explained

    run_motion(scenario)


def test_a_button_that_the_status_shows_only_after_the_motion_explains_it():
    async def scenario(rig):
        await asleep(rig)
        rig.unit.status_age_s = 3.0
        rig.unit.drive(30.0, 60.0)
        await rig.until(lambda: rig.motion.unexplained, 2.0)
        await asyncio.sleep(1.0)
        rig.unit.says["button_pressed"] = True
        await asyncio.sleep(6.0)
        assert rig.motion.unexplained is None
        rig.unit.says.clear()
        await asyncio.sleep(1.0)
        assert not rig.raised
        assert rig.told[-1].startswith("A moved from +0.0 to +")
        assert rig.told[-1].endswith("a button is pressed at the unit")

    run_motion(scenario)


def test_buttons_are_told_of_every_ten_minutes_at_the_most():
    async def scenario(rig):
        await asleep(rig)
        times_s = []
        for _ in range(14):
            rig.unit.says["button_pressed"] = True
            rig.unit.drive(rig.unit.place()[0] + 1.0, 60.0)
            await asyncio.sleep(5.0)
            rig.unit.says.clear()
            await asyncio.sleep(95.0)
        told = [event for event in rig.of(Event) if "a button is pressed" in event.text]
        times_s = [event.time_monotonic_s for event in told]
        assert len(told) in (2, 3)
        assert all(600.0 < after - before <= 710.0 for before, after in itertools.pairwise(times_s))

    run_motion(scenario)


@pytest.mark.parametrize("was_before", [False, True])
def test_a_restart_that_comes_with_the_motion_is_a_doubt_and_no_incident(was_before):
    async def scenario(rig):
        rig.unit.says["was_reset"] = was_before
        await asleep(rig)
        rig.unit.put(0.5, 60.0)
        rig.unit.says["was_reset"] = True
        await asyncio.sleep(10.0)
        assert (rig.motion.unexplained is None) == (not was_before)
        assert "restarted" in rig.motion.doubt

    run_motion(scenario)


@pytest.mark.parametrize("fields", [{"autonomous": True}, {}])
def test_a_restart_explains_neither_own_tracking_nor_what_goes_on_moving(fields):
    async def scenario(rig):
        await asleep(rig)
        # Not in the instant of a look: restart and motion are to be seen by the same one.
        await rig.until(lambda: rig.clock.monotonic() - rig.motion.telemetry.time_monotonic_s > 0.1)
        halt = rig.unit.halt

        async def late():
            await asyncio.sleep(1.0)
            await halt()

        rig.unit.halt = halt if fields else late
        rig.unit.says |= {"was_reset": True, **fields}
        rig.unit.drive(40.0, 60.0)
        await asyncio.sleep(13.0)
        assert rig.motion.unexplained

    run_motion(scenario)


def test_a_jump_of_the_count_is_a_doubt_and_stops_nothing():
    async def scenario(rig):
        await asleep(rig)
        halts = rig.unit.sent.count("halt")
        rig.unit.put(30.0, 60.0)
        await asyncio.sleep(10.0)
        assert rig.motion.unexplained is None
        assert rig.motion.doubt.startswith("the count jumped from A +0.0, B 60.0 to A +30.0")
        assert rig.unit.sent.count("halt") == halts

    run_motion(scenario)


@pytest.mark.parametrize("kind", ["homing", "aims_home"])
def test_a_reference_run_of_the_units_own_is_stopped_and_leaves_the_count_in_doubt(kind):
    async def scenario(rig):
        await asleep(rig)
        rig.unit.says[kind] = True
        if kind == "aims_home":
            await asyncio.sleep(2.0)
            assert rig.motion.doubt is None, "an aim alone is none"
            rig.unit.drive(-50.0, 60.0)
        await rig.until(lambda: rig.motion.unexplained, 4.0)
        rig.unit.says.clear()
        await asyncio.sleep(10.0)
        assert rig.motion.doubt == (
            "the positioner made a reference run of its own, its count may have changed: home it"
        )
        if kind == "homing":
            assert rig.motion.unexplained.startswith("the positioner made a reference run of its own without an order")

    run_motion(scenario)


def test_what_the_status_said_before_the_stop_is_no_run_of_its_own():
    async def scenario(rig):
        await asleep(rig)
        rig.motion.freeze("ana")
        await rig.until(lambda: not rig.motion._guard.halt_wanted, 3.0)
        judged_s = rig.clock.monotonic()
        rig.unit.says |= {"homing": True, "status_monotonic_s": judged_s + 0.5}
        await asyncio.sleep(3.0)
        assert rig.motion.doubt is None
        rig.unit.says["status_monotonic_s"] = judged_s + 1.5
        await asyncio.sleep(2.0)
        assert "reference run of its own" in rig.motion.doubt

    run_motion(scenario)


def test_the_bit_of_a_reference_run_says_nothing_on_the_way_of_a_move_of_ours():
    async def scenario(rig):
        rig.motion.order(Target(30.0, 60.0, "go"))
        await asyncio.sleep(4.0)
        rig.unit.says["homing"] = True
        await asyncio.sleep(4.0)
        assert rig.motion.doubt is None
        assert rig.motion.unexplained is None
        assert rig.motion.target is not None

    run_motion(scenario)


def test_a_positioner_that_does_not_obey_is_told_after_five_seconds_and_stopped_again_and_again():
    async def scenario(rig):
        rig.motion.order(Target(50.0, 60.0, "go"))
        await asyncio.sleep(3.0)
        rig.unit.is_deaf = True
        asked_s = rig.clock.monotonic()
        await rig.motion.stop()
        await rig.until(lambda: "deaf-to-stop" in rig.raised, 12.0)
        assert 5.0 < rig.clock.monotonic() - asked_s < 9.0
        assert rig.raised["deaf-to-stop"].startswith(
            "the positioner does not obey stop: switch off the supply of its motors; nothing moves before"
        )
        halts = [rig.unit.sent.count("halt")]
        for _ in range(3):
            await asyncio.sleep(6.05)
            halts.append(rig.unit.sent.count("halt"))
        assert [after - before for before, after in itertools.pairwise(halts)] == [1, 1, 1]
        rig.unit.is_deaf = False
        await asyncio.sleep(8.0)
        assert rig.motion.stands_since_s is not None
        assert "deaf-to-stop" in rig.raised, "until a person has looked"

    run_motion(scenario)


def test_tries_to_stop_come_at_once_and_then_ever_more_slowly():
    async def scenario(rig):
        at_s, halt = [], rig.unit.halt

        async def timed():
            at_s.append(rig.clock.monotonic())
            await halt()

        rig.unit.halt = timed
        rig.unit.is_deaf = True
        rig.motion.freeze("ana")
        await asyncio.sleep(30.0)
        pauses_s = [after - before - DEAF_S for before, after in itertools.pairwise(at_s)]
        assert pauses_s[:6] == pytest.approx([0.5, 1.0, 2.0, 4.0, 4.0, 4.0])
        assert "deaf-to-stop" not in rig.raised, "nothing moves"
        assert rig.motion.stands_since_s is None, "a stop is on its way"

    run_motion(scenario)


def test_what_moves_under_a_button_is_no_deafness():
    async def scenario(rig):
        rig.unit.is_deaf = True
        rig.unit.says["button_pressed"] = True
        rig.unit.drive(40.0, 60.0)
        rig.motion.freeze("ana")
        await asyncio.sleep(12.0)
        assert "deaf-to-stop" not in rig.raised
        rig.unit.says.clear()
        await asyncio.sleep(4.0)
        assert "deaf-to-stop" not in rig.raised
        await rig.until(lambda: "deaf-to-stop" in rig.raised, 6.0)

    run_motion(scenario)


def test_a_fault_that_comes_up_halts_both_axes_once():
    async def scenario(rig):
        await asleep(rig)
        for faults, halts in (
            (("a_overcurrent",), 1),
            (("a_overcurrent", "b_overcurrent"), 1),
            (("b_overcurrent",), 0),
        ):
            before = rig.unit.sent.count("halt")
            rig.unit.says["faults"] = faults
            await asyncio.sleep(5.0)
            assert rig.unit.sent.count("halt") - before == halts, faults
        rig.unit.says["faults"] = ("a_overcurrent", "b_overcurrent")
        before = rig.unit.sent.count("halt")
        await asyncio.sleep(5.0)
        assert rig.unit.sent.count("halt") - before == 1, "what went away and comes back is new"
        rig.unit.is_lost = True
        await asyncio.sleep(5.0)
        assert not rig.motion._guard.must_halt
        rig.unit.is_lost = False
        before = rig.unit.sent.count("halt")
        await asyncio.sleep(15.0)
        assert rig.unit.sent.count("halt") - before == 1

    run_motion(scenario)


def test_settings_that_may_move_it_are_told_once_each():
    async def scenario(rig):
        await asleep(rig)
        for own in (("night return",), (), ("night return",), ("night return", "wind"), ("night return", "wind")):
            rig.unit.says["own_moves"] = own
            await asyncio.sleep(2.0)
        told = [text for text in rig.told if "may move by itself" in text]
        assert told == [
            "the positioner may move by itself: night return",
            "the positioner may move by itself: night return, wind",
        ]

    run_motion(scenario)


def test_a_motor_current_is_judged_with_every_look_and_forgotten_with_the_clear():
    async def scenario(rig):
        await asleep(rig)
        rig.unit.says["b_motor_current_a"] = 0.5
        await asyncio.sleep(3.5)
        assert "although it stands" in rig.raised["motor-current"]
        rig.unit.says.clear()
        await asyncio.sleep(3.0)
        assert "motor-current" in rig.raised
        rig.motion.clear_faults()
        await asyncio.sleep(2.0)
        assert "motor-current" not in rig.raised
        rig.unit.says["b_motor_current_a"] = 0.5
        rig.motion.order(Target(20.0, 60.0, "go"))
        await rig.until(lambda: rig.motion.target is None)
        assert "motor-current" not in rig.raised, "a motor at work draws current"

    run_motion(scenario)


def test_a_pressed_button_makes_control_look_again_at_once():
    async def scenario(rig):
        await asleep(rig)
        for pressed in (True, False):
            before = rig.changes
            rig.unit.says["button_pressed"] = pressed
            await asyncio.sleep(1.2)
            assert rig.changes == before + 1
        await asyncio.sleep(5.0)
        assert rig.changes == before + 1

    run_motion(scenario)


def test_what_is_seen_to_repeat_itself_is_not_read_again_and_is_as_new_as_the_last_glance():
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

    run_motion(scenario, make=RepeatingPositioner)


def test_what_has_just_come_to_rest_or_draws_current_is_read_although_it_repeats_itself():
    async def scenario(rig):
        await asyncio.sleep(10.0)
        rig.unit.says["button_pressed"] = True
        rig.unit.shows_the_same = False
        rig.unit.drive(0.5, 60.0)
        await asyncio.sleep(2.0)
        rig.unit.says.clear()
        await asyncio.sleep(1.0)
        rig.unit.shows_the_same = True
        looks = rig.unit.looks
        await asyncio.sleep(2.0)
        assert rig.unit.looks - looks >= 3, "it has come to rest less than five seconds ago"
        await asyncio.sleep(8.0)
        rig.unit.says["a_motor_current_a"] = 0.5
        rig.unit.shows_the_same = False
        await asyncio.sleep(0.7)
        rig.unit.shows_the_same = True
        await asyncio.sleep(2.5)
        assert "motor-current" in rig.raised, "a current that has to last is looked at"

    run_motion(scenario, make=RepeatingPositioner)


def test_what_may_yet_make_up_the_rest_of_a_move_is_read_although_it_repeats_itself():
    async def scenario(rig):
        rig.motion.order(Target(10.0, 60.0, "go"))
        await rig.until(lambda: rig.moves)
        await asyncio.sleep(6.0)
        looks = rig.unit.looks
        await asyncio.sleep(2.0)
        assert rig.unit.looks - looks >= 3

    run_motion(scenario, make=RepeatingPositioner)


def test_what_is_read_after_a_glance_is_not_given_the_time_of_the_glance():
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

    run_motion(scenario, make=RepeatingPositioner)


def test_a_stray_that_was_glanced_past_is_judged_from_the_last_glance_and_not_as_a_jump():
    async def scenario(rig):
        await asyncio.sleep(20.0)
        rig.unit.shows_the_same = False
        rig.unit.put(12.0, 60.0)
        await asyncio.sleep(1.0)
        assert rig.motion.doubt is not None, "twelve degrees in a second are a jump of the count"

    run_motion(scenario, make=RepeatingPositioner)


def test_while_the_driver_takes_its_time_it_is_looked_at_and_what_strays_is_stopped():
    async def scenario(rig):
        await asleep(rig)
        clear = rig.unit.clear_faults

        async def slow(*, forgive=True):
            await asyncio.sleep(15.0)
            return await clear(forgive=forgive)

        rig.unit.clear_faults = slow
        rig.motion.clear_faults()
        await asyncio.sleep(1.0)
        looks = rig.unit.looks
        await asyncio.sleep(3.0)
        assert 5 <= rig.unit.looks - looks <= 8
        rig.unit.drive(30.0, 60.0)
        await rig.until(lambda: rig.motion.unexplained, 3.0)
        assert rig.unit.place()[0] < 5.0

    run_motion(scenario)


def test_a_move_that_strays_ends_with_what_was_seen_and_one_that_a_button_explains_is_interrupted():
    async def scenario(rig):
        for pressed, outcome in ((True, MoveOutcome.INTERRUPTED), (False, MoveOutcome.OVERSHOT)):
            await asleep(rig)
            rig.motion.order(Target(40.0, 60.0, "go"))
            await asyncio.sleep(2.0)
            rig.unit.status_age_s = 2.0
            rig.unit.drive(-40.0, 60.0)
            await asyncio.sleep(1.0)
            if pressed:
                rig.unit.says["button_pressed"] = True
            await rig.until(lambda: rig.motion.target is None, 15.0)
            assert rig.moves[-1].outcome is outcome
            assert "heads for position -40" in rig.moves[-1].why
            rig.unit.says.clear()
            rig.unit.status_age_s = 0.0
            rig.unit.put(*rig.unit.place())

    run_motion(scenario)


def test_the_link_that_is_lost_takes_all_that_was_known_with_it(caplog):
    async def scenario(rig):
        await asleep(rig)
        rig.unit.is_lost = True
        await rig.until(lambda: not rig.motion.connected, 3.0)
        assert rig.motion.telemetry is None
        assert rig.motion.stands_since_s is None
        assert rig.motion.pose is not None
        assert not rig.motion.homing
        rig.unit.is_lost = False
        await rig.until(lambda: rig.motion.connected, 10.0)
        assert rig.motion.unexplained is None

    with caplog.at_level(logging.DEBUG):
        run_motion(scenario)


def test_a_standstill_is_not_said_while_a_stop_is_on_its_way():
    async def scenario(rig):
        await asleep(rig)
        rig.motion.freeze("ana")
        assert rig.motion.stands_since_s is None
        await asyncio.sleep(3.0)
        assert rig.motion.stands_since_s is not None

    run_motion(scenario)


def test_alarms_are_shown_again_only_when_something_has_changed():
    async def scenario(rig):
        await asleep(rig)
        rig.unit.says["faults"] = ("a_overcurrent",)
        await asyncio.sleep(3.0)
        assert rig.raised["positioner-fault"] == "the positioner reports a_overcurrent"
        rig.alarms.set("positioner-fault", None)
        await asyncio.sleep(3.0)
        assert "positioner-fault" not in rig.raised, "nobody raises what has not changed, thousands of times a day"

    run_motion(scenario)


def test_motion_that_goes_on_while_it_is_inquired_into_is_stopped_again():
    async def scenario(rig):
        await asleep(rig)
        rig.unit.status_age_s = 3.0
        rig.unit.drive(30.0, 60.0)
        await rig.until(lambda: rig.motion.unexplained, 2.0)
        await asyncio.sleep(0.6)
        halts = rig.unit.sent.count("halt")
        rig.unit.drive(30.0, 60.0)
        await asyncio.sleep(1.3)
        assert rig.unit.sent.count("halt") == halts + 1
        await asyncio.sleep(8.0)
        assert rig.unit.sent.count("halt") == halts + 1
        assert rig.unit.place()[0] < 8.0

    run_motion(scenario)


@pytest.mark.parametrize(("age_s", "told_within_s"), [(0.0, 2.6), (1.6, 4.0), (60.0, 5.5)])
def test_the_inquiry_ends_with_a_younger_status_or_after_four_seconds(age_s, told_within_s):
    async def scenario(rig):
        await asleep(rig)
        rig.unit.status_age_s = age_s
        rig.unit.drive(30.0, 60.0)
        await rig.until(lambda: rig.motion.unexplained, 2.0)
        began_s = rig.clock.monotonic()
        await rig.until(lambda: rig.motion._guard.doubts.incident, 10.0)
        took_s = rig.clock.monotonic() - began_s
        assert told_within_s - 1.8 <= took_s <= told_within_s

    run_motion(scenario)


def test_an_inquiry_under_a_button_blocks_nothing():
    async def scenario(rig):
        await asleep(rig)
        rig.unit.says["button_pressed"] = True
        await asyncio.sleep(1.0)
        rig.unit.drive(30.0, 60.0)
        for _ in range(40):
            await asyncio.sleep(0.1)
            assert rig.motion.unexplained is None
        assert rig.raised == {}

    run_motion(scenario)


def test_a_call_of_the_driver_that_is_given_up_is_ended():
    async def scenario(rig):
        await asleep(rig)
        ended = []

        async def endless(*, forgive=True):
            try:
                await asyncio.sleep(1e6)
            finally:
                ended.append(forgive)

        rig.unit.clear_faults = endless
        rig.motion.clear_faults()
        await asyncio.sleep(2.0)
        rig.unit.is_lost = True
        await asyncio.sleep(2.0)
        assert ended == [True]

    run_motion(scenario)


def test_before_and_at_the_connection_nothing_is_said_to_stand():
    async def scenario(rig):
        assert not rig.motion.resting
        assert rig.motion.stands_since_s is None
        rig.unit.is_deaf = True
        rig.unit.says["homing"] = True
        for _ in range(30):
            await asyncio.sleep(0.1)
            assert rig.motion.stands_since_s is None
        assert "reference run of its own" in rig.motion.doubt

    run_motion(scenario, connects=False)


def test_a_fault_of_before_the_connection_that_goes_away_by_itself_is_a_doubt():
    async def scenario(rig):
        rig.unit.says["faults"] = ("a_overcurrent",)
        await rig.connected()
        rig.unit.says.clear()
        await asyncio.sleep(1.0)
        assert rig.motion.doubt == "a_overcurrent cleared by itself, the reference may be lost: home it"

    run_motion(scenario, connects=False)


def test_poses_say_whether_something_was_ordered_to_move_or_is_being_stopped():
    async def scenario(rig):
        await asleep(rig)
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


def test_one_look_that_shows_motion_late_is_no_deafness():
    async def scenario(rig):
        rig.motion.order(Target(50.0, 60.0, "go"))
        await asyncio.sleep(3.0)
        rig.unit.is_deaf = True
        looks, read = [], rig.unit.read_telemetry

        async def counted():
            seen = await read()
            looks.append(rig.clock.monotonic())
            return seen

        rig.unit.read_telemetry = counted
        await rig.motion.stop()
        asked_s = rig.clock.monotonic()
        await rig.until(lambda: len(looks) > 1 and looks[-2] > asked_s + 5.6, 12.0)
        rig.unit.put(*rig.unit.place())
        await asyncio.sleep(12.0)
        assert "deaf-to-stop" not in rig.raised

    run_motion(scenario)


def test_what_strays_while_the_link_is_lost_is_told_and_not_stopped_a_second_time():
    async def scenario(rig):
        await asleep(rig)
        rig.unit.drive(30.0, 60.0)
        rig.unit.status_age_s = 3.0
        await rig.until(lambda: rig.motion.unexplained, 2.0)
        rig.unit.is_lost = True
        await rig.until(lambda: not rig.motion.connected, 3.0)
        assert "without an order" in rig.motion.unexplained
        rig.unit.put(*rig.unit.place())
        rig.unit.is_lost = False
        halts = rig.unit.sent.count("halt")
        await asyncio.sleep(20.0)
        assert rig.unit.sent.count("halt") == halts + 1

    run_motion(scenario)


def test_a_reference_run_of_its_own_in_the_middle_of_a_move_is_told_as_what_was_seen():
    async def scenario(rig):
        rig.motion.order(Target(30.0, 60.0, "go"))
        await asyncio.sleep(3.0)
        rig.unit.says["homing"] = True
        rig.unit.drive(-50.0, 60.0)
        await rig.until(lambda: rig.motion.unexplained, 4.0)
        rig.unit.says.clear()
        await asyncio.sleep(8.0)
        assert rig.motion.unexplained.startswith("A heads for position -50 and was sent to 30")
        assert "reference run of its own" in rig.motion.doubt

    run_motion(scenario)


def test_what_strays_in_a_reference_run_of_ours_is_no_run_of_its_own():
    async def scenario(rig):
        rig.motion.home()
        await rig.until(lambda: rig.unit.sent[-1] == ("home", "a"), 5.0)
        await asyncio.sleep(3.0)
        rig.unit.drive(0.0, 20.0)
        await rig.until(lambda: not rig.motion.homing, 10.0)
        await asyncio.sleep(8.0)
        assert rig.motion.unexplained.startswith("B moved from +60.0 to ")
        assert "reference run of its own" not in rig.motion.doubt
        assert rig.motion.doubt.startswith("homing failed (B moved from ")

    run_motion(scenario)


@pytest.mark.parametrize("axis", [0, 1])
def test_a_pose_is_told_for_a_change_in_either_direction(axis):
    async def scenario(rig):
        await asleep(rig)
        for step in (0.07, -0.07):
            place, count = list(rig.unit.place()), len(rig.poses)
            place[axis] += step
            rig.unit.put(*place)
            await asyncio.sleep(0.6)
            told = rig.poses[-1]
            assert (told.a_deg, told.b_deg) == pytest.approx(place)
            assert len(rig.poses) > count

    run_motion(scenario)
