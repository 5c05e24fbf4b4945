"""What explains motion that nobody ordered, and until when: a button, a restart, a reference run of the unit's own."""

import asyncio
import itertools

import pytest

from daemon.base.records import Event, Target
from tests.support.fake_positioner import run_motion, wait_out_standstill


@pytest.mark.parametrize(("after_s", "explained"), [(0.0, True), (2.0, True), (3.4, True), (4.6, False)])
def test_a_button_explains_motion_that_begins_up_to_four_seconds_after_it_was_last_seen(after_s, explained):
    async def scenario(rig):
        await wait_out_standstill(rig)
        rig.unit.telemetry_overrides["button_pressed"] = True
        await asyncio.sleep(1.0)
        pressed_s = rig.motion.telemetry.status_monotonic_s
        rig.unit.telemetry_overrides.clear()
        await rig.until(lambda: rig.clock.monotonic() >= pressed_s + after_s)
        rig.unit.drive(30.0, 60.0)
        await asyncio.sleep(10.0)
        assert (rig.motion.unexplained_motion is None) == explained
        assert rig.unit.place()[0] < 5.0, "it is stopped in any case"
        assert len([text for text in rig.positioner_events if "a button is pressed" in text]) == explained

    run_motion(scenario)


def test_a_button_that_the_status_shows_only_after_the_motion_explains_it():
    async def scenario(rig):
        await wait_out_standstill(rig)
        rig.unit.status_age_s = 3.0
        rig.unit.drive(30.0, 60.0)
        await rig.until(lambda: rig.motion.unexplained_motion, 2.0)
        await asyncio.sleep(1.0)
        rig.unit.telemetry_overrides["button_pressed"] = True
        await asyncio.sleep(6.0)
        assert rig.motion.unexplained_motion is None
        rig.unit.telemetry_overrides.clear()
        await asyncio.sleep(1.0)
        assert not rig.active_alarms
        assert rig.positioner_events[-1].startswith("A moved from +0.0 to +")
        assert rig.positioner_events[-1].endswith("a button is pressed at the unit")

    run_motion(scenario)


def test_motion_by_a_button_is_reported_every_ten_minutes_at_most():
    async def scenario(rig):
        await wait_out_standstill(rig)
        times_s = []
        for _ in range(14):
            rig.unit.telemetry_overrides["button_pressed"] = True
            rig.unit.drive(rig.unit.place()[0] + 1.0, 60.0)
            await asyncio.sleep(5.0)
            rig.unit.telemetry_overrides.clear()
            await asyncio.sleep(95.0)
        told = [event for event in rig.records_of(Event) if "a button is pressed" in event.text]
        times_s = [event.time_monotonic_s for event in told]
        assert len(told) in (2, 3)
        assert all(600.0 < after - before <= 710.0 for before, after in itertools.pairwise(times_s))

    run_motion(scenario)


@pytest.mark.parametrize("was_before", [False, True])
def test_motion_that_comes_with_a_restart_of_the_unit_is_a_doubt_and_no_incident(was_before):
    async def scenario(rig):
        rig.unit.telemetry_overrides["was_reset"] = was_before
        await wait_out_standstill(rig)
        rig.unit.put(0.5, 60.0)
        rig.unit.telemetry_overrides["was_reset"] = True
        await asyncio.sleep(10.0)
        assert (rig.motion.unexplained_motion is None) == (not was_before)
        assert "restarted" in rig.motion.doubt

    run_motion(scenario)


@pytest.mark.parametrize("fields", [{"autonomous": True}, {}])
def test_a_restart_explains_neither_own_tracking_nor_motion_that_goes_on(fields):
    async def scenario(rig):
        await wait_out_standstill(rig)
        # Between two looks, so that the same look sees restart and motion.
        await rig.until(lambda: rig.clock.monotonic() - rig.motion.telemetry.time_monotonic_s > 0.1)
        halt = rig.unit.halt

        async def late():
            await asyncio.sleep(1.0)
            await halt()

        rig.unit.halt = halt if fields else late
        rig.unit.telemetry_overrides |= {"was_reset": True, **fields}
        rig.unit.drive(40.0, 60.0)
        await asyncio.sleep(13.0)
        assert rig.motion.unexplained_motion

    run_motion(scenario)


@pytest.mark.parametrize("kind", ["homing", "aims_home"])
def test_a_reference_run_of_the_units_own_is_stopped_and_leaves_the_count_in_doubt(kind):
    async def scenario(rig):
        await wait_out_standstill(rig)
        rig.unit.telemetry_overrides[kind] = True
        if kind == "aims_home":
            await asyncio.sleep(2.0)
            assert rig.motion.doubt is None, "an aim alone is none"
            rig.unit.drive(-50.0, 60.0)
        await rig.until(lambda: rig.motion.unexplained_motion, 4.0)
        rig.unit.telemetry_overrides.clear()
        await asyncio.sleep(10.0)
        assert rig.motion.doubt == (
            "the positioner made a reference run of its own, its count may have changed: home it"
        )
        if kind == "homing":
            assert rig.motion.unexplained_motion.startswith(
                "the positioner made a reference run of its own without an order"
            )

    run_motion(scenario)


def test_a_reference_run_of_the_units_own_that_ends_before_the_next_look_is_reported_as_such():
    async def scenario(rig):
        await wait_out_standstill(rig)
        rig.unit.telemetry_overrides["aims_home"] = True
        await asyncio.sleep(2.0)
        rig.unit.telemetry_overrides.clear()
        rig.unit.put(-52.0, 60.0)
        await rig.until(lambda: rig.motion.unexplained_motion, 4.0)
        assert rig.motion.unexplained_motion.startswith(
            "the positioner made a reference run of its own without an order"
        )

    run_motion(scenario)


def test_a_status_from_before_the_stop_does_not_show_a_reference_run_of_the_units_own():
    async def scenario(rig):
        await wait_out_standstill(rig)
        rig.motion.freeze("ana")
        await rig.until(lambda: not rig.motion._guard.halt_wanted, 3.0)
        judged_s = rig.clock.monotonic()
        rig.unit.telemetry_overrides |= {"homing": True, "status_monotonic_s": judged_s + 0.5}
        await asyncio.sleep(3.0)
        assert rig.motion.doubt is None
        rig.unit.telemetry_overrides["status_monotonic_s"] = judged_s + 1.5
        await asyncio.sleep(2.0)
        assert "reference run of its own" in rig.motion.doubt

    run_motion(scenario)


def test_the_status_bit_of_a_reference_run_is_ignored_during_an_ordered_move():
    async def scenario(rig):
        rig.motion.order(Target(30.0, 60.0, "go"))
        await asyncio.sleep(4.0)
        rig.unit.telemetry_overrides["homing"] = True
        await asyncio.sleep(4.0)
        assert rig.motion.doubt is None
        assert rig.motion.unexplained_motion is None
        assert rig.motion.target is not None

    run_motion(scenario)


def test_motion_under_a_pressed_button_blocks_nothing_while_it_is_inquired_into():
    async def scenario(rig):
        await wait_out_standstill(rig)
        rig.unit.telemetry_overrides["button_pressed"] = True
        await asyncio.sleep(1.0)
        rig.unit.drive(30.0, 60.0)
        for _ in range(40):
            await asyncio.sleep(0.1)
            assert rig.motion.unexplained_motion is None
        assert rig.active_alarms == {}

    run_motion(scenario)


def test_a_reference_run_of_the_units_own_during_a_move_is_reported_as_a_wrong_destination():
    async def scenario(rig):
        rig.motion.order(Target(30.0, 60.0, "go"))
        await asyncio.sleep(3.0)
        rig.unit.telemetry_overrides["homing"] = True
        rig.unit.drive(-50.0, 60.0)
        await rig.until(lambda: rig.motion.unexplained_motion, 4.0)
        rig.unit.telemetry_overrides.clear()
        await asyncio.sleep(8.0)
        assert rig.motion.unexplained_motion.startswith("A heads for position -50, but was sent to 30")
        assert "reference run of its own" in rig.motion.doubt

    run_motion(scenario)


def test_an_axis_that_strays_during_an_ordered_reference_run_is_no_run_of_the_units_own():
    async def scenario(rig):
        rig.motion.home()
        await rig.until(lambda: rig.unit.sent[-1] == ("home", "a"), 5.0)
        await asyncio.sleep(3.0)
        rig.unit.drive(0.0, 20.0)
        await rig.until(lambda: not rig.motion.homing, 10.0)
        await asyncio.sleep(8.0)
        assert rig.motion.unexplained_motion.startswith("B moved from +60.0 to ")
        assert "reference run of its own" not in rig.motion.doubt
        assert rig.motion.doubt.startswith("homing failed (B moved from ")

    run_motion(scenario)
