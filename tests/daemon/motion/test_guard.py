"""What every look checks: motion that nobody ordered, jumps and faults; when it is stopped, inquired into and told."""

import asyncio

import pytest

from daemon.base.records import Event, MoveOutcome, Target
from drivers.errors import RefusedError
from tests.support.fake_positioner import RepeatingFakePositioner, run_motion, wait_out_standstill


@pytest.mark.parametrize(("a_deg", "b_deg"), [(30.0, 60.0), (0.0, 20.0)])
def test_motion_without_an_order_is_stopped_and_reported_once_and_blocks_even_a_stow(a_deg, b_deg, caplog):
    async def scenario(rig):
        await wait_out_standstill(rig)
        rig.unit.drive(a_deg, b_deg)
        await rig.until(lambda: rig.motion.unexplained_motion, 2.0)
        await asyncio.sleep(20.0)
        stands = rig.unit.place()
        assert max(abs(stands[0]), abs(stands[1] - 60.0)) < 4.0
        axis = "A" if a_deg else "B"
        assert rig.motion.unexplained_motion.startswith(f"{axis} moved from ")
        assert "without an order: nothing moves" in rig.motion.unexplained_motion
        assert rig.active_alarms["unexplained-motion"] == rig.motion.unexplained_motion
        assert rig.motion.stands_since_s is not None
        assert rig.unit.sent.count("halt") == 2, "one at the connection, one for this"
        for stow in (False, True):
            with pytest.raises(RefusedError, match="without an order"):
                rig.motion.order(Target(0.0, 60.0, "go"), stow=stow)
        assert [event.text for event in rig.records_of(Event)] == [
            f"raised unexplained-motion: {rig.motion.unexplained_motion}"
        ]
        assert caplog.messages == [rig.motion.unexplained_motion]

    run_motion(scenario)


def test_motion_against_a_stop_is_reported_with_the_reason_of_that_stop():
    async def scenario(rig):
        await wait_out_standstill(rig)
        rig.motion.freeze("ana has stopped it")
        await asyncio.sleep(5.0)
        rig.unit.drive(30.0, 60.0)
        await rig.until(lambda: rig.motion.unexplained_motion, 2.0)
        assert "against a stop (ana has stopped it): " in rig.motion.unexplained_motion

    run_motion(scenario)


def test_no_move_is_accepted_while_unordered_motion_is_inquired_into():
    async def scenario(rig):
        await wait_out_standstill(rig)
        rig.unit.status_age_s = 1.5
        rig.unit.drive(30.0, 60.0)
        await rig.until(lambda: rig.motion.unexplained_motion, 2.0)
        assert rig.motion._guard.doubts.incident is None
        with pytest.raises(RefusedError, match="without an order"):
            rig.motion.order(Target(0.0, 60.0, "go"), stow=True)
        await rig.until(lambda: rig.motion._guard.doubts.incident, 8.0)

    run_motion(scenario)


def test_a_jump_of_the_count_is_a_doubt_and_stops_nothing():
    async def scenario(rig):
        await wait_out_standstill(rig)
        halts = rig.unit.sent.count("halt")
        rig.unit.put(30.0, 60.0)
        await asyncio.sleep(10.0)
        assert rig.motion.unexplained_motion is None
        assert rig.motion.doubt.startswith("the count jumped from A +0.0, B 60.0 to A +30.0")
        assert rig.unit.sent.count("halt") == halts

    run_motion(scenario)


def test_a_jump_of_the_count_right_after_a_move_stops_the_axes():
    async def scenario(rig):
        rig.motion.order(Target(-20.0, 60.0, "test"))
        await rig.until(lambda: rig.moves, 60.0)
        halts = rig.unit.sent.count("halt")
        rig.unit.put(30.0, 60.0)
        await rig.until(lambda: rig.motion.doubt, 1.0)
        await rig.until(lambda: rig.unit.sent.count("halt") > halts, 1.0)
        assert rig.motion.unexplained_motion is None

    run_motion(scenario)


def test_a_fault_that_comes_up_halts_both_axes_once():
    async def scenario(rig):
        await wait_out_standstill(rig)
        for faults, halts in (
            (("a_overcurrent",), 1),
            (("a_overcurrent", "b_overcurrent"), 1),
            (("b_overcurrent",), 0),
        ):
            before = rig.unit.sent.count("halt")
            rig.unit.telemetry_overrides["faults"] = faults
            await asyncio.sleep(5.0)
            assert rig.unit.sent.count("halt") - before == halts, faults
        rig.unit.telemetry_overrides["faults"] = ("a_overcurrent", "b_overcurrent")
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


def test_settings_by_which_the_unit_may_move_itself_are_reported_once_each():
    async def scenario(rig):
        await wait_out_standstill(rig)
        for own in (("night return",), (), ("night return",), ("night return", "wind"), ("night return", "wind")):
            rig.unit.telemetry_overrides["own_moves"] = own
            await asyncio.sleep(2.0)
        told = [text for text in rig.positioner_events if "may move by itself" in text]
        assert told == [
            "the positioner may move by itself: night return",
            "the positioner may move by itself: night return, wind",
        ]

    run_motion(scenario)


def test_a_jump_of_the_count_by_12_deg_right_after_a_glance_is_a_doubt():
    async def scenario(rig):
        await asyncio.sleep(20.0)
        rig.unit.shows_the_same = False
        rig.unit.put(12.0, 60.0)
        await asyncio.sleep(1.0)
        assert rig.motion.doubt is not None, "twelve degrees in a second are a jump of the count"

    run_motion(scenario, make=RepeatingFakePositioner)


def test_during_a_slow_clear_the_unit_is_still_looked_at_and_a_stray_axis_is_stopped():
    async def scenario(rig):
        await wait_out_standstill(rig)
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
        await rig.until(lambda: rig.motion.unexplained_motion, 3.0)
        assert rig.unit.place()[0] < 5.0

    run_motion(scenario)


def test_a_move_that_strays_ends_as_overshot_and_one_that_a_button_explains_as_interrupted():
    async def scenario(rig):
        for pressed, outcome in ((True, MoveOutcome.INTERRUPTED), (False, MoveOutcome.OVERSHOT)):
            await wait_out_standstill(rig)
            rig.motion.order(Target(40.0, 60.0, "go"))
            await asyncio.sleep(2.0)
            rig.unit.status_age_s = 2.0
            rig.unit.drive(-40.0, 60.0)
            await asyncio.sleep(1.0)
            if pressed:
                rig.unit.telemetry_overrides["button_pressed"] = True
            await rig.until(lambda: rig.motion.target is None, 15.0)
            assert rig.moves[-1].outcome is outcome
            assert "heads for position -40" in rig.moves[-1].why
            rig.unit.telemetry_overrides.clear()
            rig.unit.status_age_s = 0.0
            rig.unit.put(*rig.unit.place())

    run_motion(scenario)


def test_motion_that_goes_on_while_it_is_inquired_into_is_stopped_again():
    async def scenario(rig):
        await wait_out_standstill(rig)
        rig.unit.status_age_s = 3.0
        rig.unit.drive(30.0, 60.0)
        await rig.until(lambda: rig.motion.unexplained_motion, 2.0)
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
def test_the_inquiry_into_unordered_motion_ends_with_a_newer_status_or_after_four_seconds(age_s, told_within_s):
    async def scenario(rig):
        await wait_out_standstill(rig)
        rig.unit.status_age_s = age_s
        rig.unit.drive(30.0, 60.0)
        await rig.until(lambda: rig.motion.unexplained_motion, 2.0)
        began_s = rig.clock.monotonic()
        await rig.until(lambda: rig.motion._guard.doubts.incident, 10.0)
        took_s = rig.clock.monotonic() - began_s
        assert told_within_s - 1.8 <= took_s <= told_within_s

    run_motion(scenario)


def test_a_driver_call_under_way_is_cancelled_when_the_link_is_lost():
    async def scenario(rig):
        await wait_out_standstill(rig)
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


def test_a_fault_from_before_the_connection_that_vanishes_by_itself_is_a_doubt():
    async def scenario(rig):
        rig.unit.telemetry_overrides["faults"] = ("a_overcurrent",)
        await rig.wait_until_connected()
        rig.unit.telemetry_overrides.clear()
        await asyncio.sleep(1.0)
        assert rig.motion.doubt == "a_overcurrent cleared by itself, the reference may be lost: home it"

    run_motion(scenario, connects=False)


def test_unordered_motion_stays_reported_through_a_lost_link_and_is_not_stopped_a_second_time():
    async def scenario(rig):
        await wait_out_standstill(rig)
        rig.unit.drive(30.0, 60.0)
        rig.unit.status_age_s = 3.0
        await rig.until(lambda: rig.motion.unexplained_motion, 2.0)
        rig.unit.is_lost = True
        await rig.until(lambda: not rig.motion.connected, 3.0)
        assert "without an order" in rig.motion.unexplained_motion
        rig.unit.put(*rig.unit.place())
        rig.unit.is_lost = False
        halts = rig.unit.sent.count("halt")
        await asyncio.sleep(20.0)
        assert rig.unit.sent.count("halt") == halts + 1

    run_motion(scenario)
