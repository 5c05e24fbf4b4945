"""Reference runs on the whole rig, requested or not: what they end, what they leave, and when none begins."""

import asyncio

import pytest

from daemon.base.records import Mode, Target
from daemon.motion.doubts import RESET
from daemon.motion.polling import Polling
from drivers.errors import RefusedError
from tests.support.motion import (
    HOME_A_PACKET,
    STOP_PACKET,
    TRACKING_OFF_PACKET,
    alarms,
    commands_sent,
    lose_packets,
    motion_duration_s,
    override_telemetry,
    send_foreign_b_target,
)
from tests.support.phases import (
    now,
    positioner_events,
    wait_for_homing,
    wait_for_long_rest,
    wait_for_rest,
    wait_for_tracking,
)


def test_homing_ends_every_doubt_about_the_reference(run_rig):
    async def scenario(rig):
        await wait_for_long_rest(rig)
        rig.unit.inject("a_overcurrent", now(rig))
        await asyncio.sleep(1)
        rig.unit.power_cycle(now(rig), keep_position=False)
        await asyncio.sleep(10)
        assert len(rig.motion.concerns) >= 2
        rig.motion.home()
        await wait_for_homing(rig)
        assert rig.motion.concerns == ()
        await rig.until_mode(Mode.TRACKING, 30)

    run_rig(scenario)


def test_a_homing_run_that_fails_leaves_a_doubt_though_there_was_none(run_rig):
    async def scenario(rig):
        await wait_for_long_rest(rig)
        rig.motion.home()
        await asyncio.sleep(5)
        rig.unit.inject("a_hall_loss", now(rig))
        await rig.until(lambda: not rig.motion.homing, 60, "the end of homing")
        assert "homing failed (" in rig.motion.doubt
        await asyncio.sleep(60)
        assert rig.mode is Mode.FAULT

    run_rig(scenario)


def test_a_reference_run_that_the_driver_judges_bad_leaves_the_doubt(run_rig):
    async def scenario(rig):
        await wait_for_long_rest(rig)
        rig.unit.power_cycle(now(rig))
        await asyncio.sleep(2)
        rig.motion.home()
        await asyncio.sleep(3)
        override_telemetry(rig, reference_doubt="axis A met its end switch 34 mm early")
        await rig.until(lambda: not rig.motion.homing, 200, "the end of homing")
        for words in (RESET, "axis A met its end switch 34 mm early", "homing failed"):
            assert words in rig.motion.doubt
        await asyncio.sleep(60)
        assert rig.mode is Mode.FAULT

    run_rig(scenario)


@pytest.mark.parametrize("end", ["stop", "stow", "unplug", "deaf"])
def test_a_homing_run_that_is_broken_off_leaves_the_doubt_that_was_there(run_rig, end):
    async def scenario(rig):
        await wait_for_long_rest(rig)
        rig.unit.power_cycle(now(rig))
        await rig.until_mode(Mode.FAULT, 15)
        rig.motion.home()
        await asyncio.sleep(8)
        assert rig.motion.homing
        if end == "stop":
            await rig.control.stop("a person")
            assert await motion_duration_s(rig, 10) <= 2
            rig.control.auto()
        elif end == "stow":
            rig.control.stow("storm")
            await asyncio.sleep(120)
            assert rig.truth().b_deg == pytest.approx(90, abs=1)
            rig.control.auto()
        elif end == "unplug":
            rig.cables.positioner.link_up = False
            await asyncio.sleep(2)
            rig.cables.positioner.link_up = True
        else:
            rig.unit.power_cycle(now(rig))
        await rig.until_mode(Mode.FAULT, 60)
        await asyncio.sleep(60)
        assert "homing" in rig.motion.doubt
        assert RESET in rig.motion.doubt
        before = len([1 for text in positioner_events(rig) if text == "homing"])
        assert before == 1

    run_rig(scenario)


def test_a_homing_run_that_has_cleared_a_fault_and_is_broken_off_leaves_a_doubt(run_rig):
    async def scenario(rig):
        await wait_for_tracking(rig)
        await wait_for_rest(rig)
        rig.unit.inject("a_hall_loss", now(rig))
        rig.control.goto(20, 60, "test")
        await rig.until(lambda: rig.motion.telemetry.faults, 60, "the fault")
        rig.unit.repair("a_hall_loss", now(rig))
        await wait_for_rest(rig)
        rig.control.home()
        await rig.until(lambda: rig.motion.homing and not rig.motion.telemetry.faults, 20, "the clearing")
        await asyncio.sleep(3)
        rig.control.stow("storm")
        await rig.until(lambda: not rig.motion.homing, 10, "the end of homing")
        await wait_for_rest(rig)
        assert "homing was not finished" in rig.motion.doubt

    run_rig(scenario)


def test_the_other_axis_may_not_move_during_a_reference_run(run_rig):
    async def scenario(rig):
        await wait_for_long_rest(rig)
        rig.motion.home()
        await asyncio.sleep(8)
        assert rig.motion.homing
        rig.unit.inject("re_reference", now(rig))
        assert await motion_duration_s(rig, 20) <= 2.0
        assert "B moved" in rig.motion.unexplained_motion
        assert "homing failed" in rig.motion.doubt

    run_rig(scenario)


@pytest.mark.parametrize("clearing", [False, True])
def test_no_reference_run_begins_after_motion_that_nobody_ordered(run_rig, monkeypatch, clearing):
    async def scenario(rig):
        await wait_for_long_rest(rig)
        clear = rig.positioner.clear_faults

        async def slowly(**how):
            found = await clear(**how)
            await asyncio.sleep(3)
            return found

        rig.positioner.clear_faults = slowly
        sent = commands_sent(rig, monkeypatch)
        if clearing:
            rig.motion.home()
            await asyncio.sleep(1)
            send_foreign_b_target(rig, 85.0)
        else:
            send_foreign_b_target(rig, 85.0)
            # The run is requested before the next look.
            await asyncio.sleep(0.4)
            rig.motion.home()
        await asyncio.sleep(20)
        assert "B moved" in rig.motion.unexplained_motion
        assert not [data for _, data in sent if data.startswith(HOME_A_PACKET)]
        assert not rig.motion.homing

    run_rig(scenario)


def test_rehoming_by_itself_never_runs_under_a_stop_or_after_unexplained_motion(run_rig):
    async def scenario(rig):
        await wait_for_long_rest(rig)
        await rig.control.stop("a person works there")
        rig.motion.freeze("a person works there")
        rig.unit.power_cycle(now(rig))
        assert await motion_duration_s(rig, 300) == 0.0
        rig.motion.freeze(None)
        rig.control.auto()
        await wait_for_homing(rig)
        await rig.until_mode(Mode.TRACKING, 30)
        await wait_for_rest(rig)
        send_foreign_b_target(rig, 85.0)
        await asyncio.sleep(10)
        assert rig.motion.unexplained_motion
        rig.unit.power_cycle(now(rig))
        assert await motion_duration_s(rig, 300) == 0.0

    run_rig(scenario, motion={"rehome": "automatic"})


@pytest.mark.parametrize("mode", [Mode.STOW, Mode.HOLD])
def test_rehoming_by_itself_waits_while_the_tracker_is_stowed_or_stopped(run_rig, mode):
    async def scenario(rig):
        await wait_for_long_rest(rig)
        if mode is Mode.STOW:
            rig.control.stow("storm")
            await asyncio.sleep(120)
        else:
            await rig.control.stop("wait")
        rig.unit.power_cycle(now(rig))
        await asyncio.sleep(3)
        assert await motion_duration_s(rig, 300) == 0.0
        assert rig.mode is mode
        rig.control.auto()
        await wait_for_homing(rig)

    run_rig(scenario, motion={"rehome": "automatic"})


def test_rehoming_that_fails_is_tried_again_after_ever_longer_pauses(run_rig, monkeypatch):
    async def scenario(rig):
        await wait_for_long_rest(rig)
        lose_packets(rig, monkeypatch, HOME_A_PACKET)
        rig.motion._polling = Polling(idle_s=5.0)
        rig.unit.power_cycle(now(rig))
        await asyncio.sleep(3 * 3600)
        assert 2 <= positioner_events(rig).count("homing") <= 3

    run_rig(scenario, motion={"rehome": "automatic"}, cube={"scan_every_s": 60}, safety={"scan_stale_s": 130})


def test_no_automatic_reference_run_begins_while_a_fault_is_latched(run_rig):
    async def scenario(rig):
        await wait_for_long_rest(rig)
        rig.unit.power_cycle(now(rig))
        rig.unit.inject("a_overcurrent", now(rig))
        await asyncio.sleep(120)
        assert rig.motion.doubt
        assert not [text for text in positioner_events(rig) if text == "homing"]

    run_rig(scenario, motion={"rehome": "automatic"})


def test_a_reference_run_is_refused_for_good_if_a_mode_of_the_unit_cannot_be_switched_off(run_rig, monkeypatch):
    async def scenario(rig):
        await wait_for_long_rest(rig)
        lose_packets(rig, monkeypatch, TRACKING_OFF_PACKET)
        # Without a supply it cannot move, whatever it wants.
        rig.unit.inject("undervoltage", now(rig))
        rig.unit.inject("own_tracking", now(rig))
        await rig.until(lambda: rig.motion.blocked, 10, "the mode")
        rig.motion.home()
        await rig.until(lambda: "do it at the unit" in alarms(rig).get("positioner-fault", ""), 60, "the alarm")
        await asyncio.sleep(30)
        assert not rig.motion.is_homing_or_queued
        assert [
            text
            for text in positioner_events(rig)
            if text.startswith("homing refused: a mode of the positioner's own is on")
        ]
        with pytest.raises(RefusedError, match="cannot be homed: a mode of the positioner's own is on"):
            rig.motion.home()
        rig.unit.repair("undervoltage", now(rig))
        await asyncio.sleep(6)
        rig.unit.repair("own_tracking", now(rig))
        assert await motion_duration_s(rig, 30) == 0.0, "whoever has switched it off stands there"

    run_rig(scenario, motion={"rehome": "operator", "deadband_deg": 30})


@pytest.mark.parametrize("how", ["rest", "a stow"])
def test_a_homing_run_that_is_broken_off_ends_with_stop(run_rig, monkeypatch, how):
    async def scenario(rig):
        await wait_for_long_rest(rig)
        rig.motion.home()
        await asyncio.sleep(8)
        sent = commands_sent(rig, monkeypatch)
        if how == "rest":
            rig.motion.request_stop()
        else:
            rig.motion.order(Target(0, 90, "storm"), stow=True)
        await asyncio.sleep(3)
        assert sent[0][1].startswith(STOP_PACKET)

    run_rig(scenario)


def test_a_homing_run_that_is_given_up_is_stopped_and_does_not_count_as_unexplained_motion(run_rig):
    async def scenario(rig):
        await wait_for_long_rest(rig)
        rig.motion.home()
        await rig.until(lambda: rig.motion.homing, 5, "homing")
        await asyncio.sleep(10)
        rig.motion.request_stop()
        await rig.until(lambda: not rig.motion.homing, 5, "the end of homing")
        assert rig.motion.stands_since_s is not None
        await asyncio.sleep(5)
        assert rig.motion.unexplained_motion is None

    run_rig(scenario)
