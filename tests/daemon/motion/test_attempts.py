"""A move that is refused or fails: how often it is tried, what ends the tries, and when they begin anew."""

import asyncio
import itertools

import pytest

from daemon.base.records import Event, Mode, MoveOutcome, Target
from sim_drivers.pozsol.setup import AxisDrive, Setup
from tests.daemon.tracker.days import operator
from tests.support.motion import (
    A_PACKET,
    B_PACKET,
    STOP_PACKET,
    alarms,
    commands_sent,
    lose_packets,
    motion_duration_s,
    override_telemetry,
    send_foreign_b_target,
    target_packets,
)
from tests.support.phases import now, wait_for_long_rest, wait_for_rest

# Attempts do not depend on scans: over hours, few will do.
FEW_SCANS = {"cube": {"scan_every_s": 60}, "safety": {"scan_stale_s": 130, "fallback_after_s": 600}}


def test_a_move_is_tried_as_often_as_the_settings_say_and_no_more(run_rig, monkeypatch):
    async def scenario(rig):
        await wait_for_long_rest(rig)
        lose_packets(rig, monkeypatch, A_PACKET, B_PACKET)
        sent = commands_sent(rig, monkeypatch)
        rig.motion.order(Target(0, 60, "test"))
        await asyncio.sleep(120)
        assert rig.motion.last_move.outcome is MoveOutcome.REFUSED
        assert len(target_packets(sent)) == 2 * 4
        assert rig.motion.doubt.startswith("the last move failed (refused): ")

    run_rig(scenario, motion={"attempts": 4})


def test_a_stop_between_two_attempts_ends_the_move(run_rig, monkeypatch):
    async def scenario(rig):
        await wait_for_long_rest(rig)
        lose_packets(rig, monkeypatch, A_PACKET, B_PACKET)
        rig.motion.order(Target(0, 60, "test"))
        await asyncio.sleep(1.5)
        sent = commands_sent(rig, monkeypatch)
        rig.motion.request_stop()
        await rig.until(lambda: rig.motion.target is None, 3, "the end of the move")
        assert rig.motion.last_move.outcome is MoveOutcome.INTERRUPTED
        assert not target_packets(sent)
        assert rig.motion.doubt is None

    run_rig(scenario)


def test_an_axis_that_moves_by_itself_between_two_attempts_is_stopped_and_gets_no_target(run_rig, monkeypatch):
    async def scenario(rig):
        await wait_for_long_rest(rig)
        lose_packets(rig, monkeypatch, A_PACKET, B_PACKET)
        sent = commands_sent(rig, monkeypatch)
        rig.motion.order(Target(0, 60, "test"))
        await rig.until(lambda: len(target_packets(sent)) == 2, 3, "the first attempt")
        await rig.until(lambda: rig.motion.stands_since_s is None, 3, "the stop after it")
        await rig.until(lambda: rig.motion.stands_since_s is not None, 3, "standstill")
        send_foreign_b_target(rig, 20)
        begun_s = now(rig)
        await rig.until(lambda: rig.motion.target is None, 12, "the end of the move")
        assert len(target_packets(sent)) == 2
        assert rig.motion.last_move.outcome is MoveOutcome.OVERSHOT
        assert "B moved" in rig.motion.unexplained_motion
        stopped_s = next(at_s for at_s, data in sent if at_s > begun_s and data[:3] == STOP_PACKET)
        assert stopped_s - begun_s < 1.6

    run_rig(scenario)


def test_a_move_that_overshoots_ends_with_stop(run_rig, monkeypatch):
    async def scenario(rig):
        sent = commands_sent(rig, monkeypatch)
        await rig.until(lambda: rig.motion.last_move, 200, "the end of the move")
        assert rig.motion.last_move.outcome is MoveOutcome.OVERSHOT
        assert sent[-1][1].startswith(STOP_PACKET)
        assert await motion_duration_s(rig, 30) <= 1.0

    run_rig(scenario, motion={"attempts": 1}, setup=Setup(drive=AxisDrive(overshoot_mm=12.0)))


def test_an_axis_that_went_past_its_target_is_reported_although_the_next_attempt_may_arrive(run_rig):
    async def scenario(rig):
        await rig.until(lambda: rig.motion.last_move, 300, "the end of the move")
        told = [
            event.text for event in rig.records_of(Event) if event.subject == "positioner" and "beyond" in event.text
        ]
        assert len(told) == 1
        assert told[0].startswith(("A stands at", "B stands at"))

    run_rig(scenario, motion={"attempts": 2}, setup=Setup(drive=AxisDrive(overshoot_mm=12.0)))


def test_a_move_that_stalls_ends_with_stop(run_rig, monkeypatch):
    async def scenario(rig):
        await wait_for_long_rest(rig)
        rig.motion.order(Target(rig.motion.pose.a_deg, 60, "test"))
        await asyncio.sleep(2)
        here = rig.motion.telemetry
        sent = commands_sent(rig, monkeypatch)
        override_telemetry(rig, position_a=here.position_a, position_b=here.position_b, b_deg=here.b_deg)
        await rig.until(lambda: rig.motion.target is None, 30, "the end")
        assert rig.motion.last_move.outcome is MoveOutcome.STALLED
        assert sent[-1][1].startswith(STOP_PACKET)

    run_rig(scenario, motion={"attempts": 1, "deadband_deg": 30})


def test_a_stow_that_fails_is_an_alarm_and_is_tried_again_with_growing_pauses(run_rig, monkeypatch):
    async def scenario(rig):
        await wait_for_long_rest(rig)
        lose_packets(rig, monkeypatch, A_PACKET, B_PACKET)
        sent = commands_sent(rig, monkeypatch)
        start_s = now(rig)
        rig.wind_m_s = 20.0
        await rig.until(lambda: "move-failed" in alarms(rig), 30, "the alarm")
        assert (
            "the stow failed and waits to be tried again: the last move failed (refused)" in alarms(rig)["move-failed"]
        )
        await asyncio.sleep(1300)
        tries = [at - start_s for at, data in sent if data[:2] == B_PACKET][::3]
        pauses = [round((b - a) / 60) for a, b in itertools.pairwise(tries)]
        assert pauses[:4] == [1, 2, 5, 10]
        assert len(target_packets(sent)) <= 30
        monkeypatch.undo()
        await rig.until(lambda: rig.truth().b_deg > 89, 700, "the stow")
        await wait_for_rest(rig)
        assert "move-failed" not in alarms(rig)

    run_rig(scenario, **FEW_SCANS)


def test_a_stow_that_waits_to_be_tried_again_is_forgotten_with_its_reason(run_rig, monkeypatch):
    async def scenario(rig):
        await wait_for_long_rest(rig)
        lose_packets(rig, monkeypatch, A_PACKET, B_PACKET)
        await operator(rig).stow("storm")
        await rig.until(lambda: "move-failed" in alarms(rig), 30, "the alarm")
        # By then the third try waits for the end of two minutes.
        await asyncio.sleep(140)
        await operator(rig).auto("it is over")
        assert rig.control.mode is Mode.TRACKING
        monkeypatch.undo()
        before = rig.truth()
        await asyncio.sleep(120)
        assert rig.truth() == before

    run_rig(scenario, motion={"deadband_deg": 30})


def test_an_ordinary_move_that_fails_again_is_tried_after_twice_the_pause(run_rig, monkeypatch):
    async def scenario(rig):
        await wait_for_long_rest(rig)
        lose_packets(rig, monkeypatch, A_PACKET, B_PACKET)
        for pause_s in (600, 1200):
            rig.motion.order(Target(0, 60, "test"))
            await rig.until(lambda: rig.motion.doubt, 30, "the failure")
            await asyncio.sleep(pause_s - 20)
            assert rig.motion.doubt
            await asyncio.sleep(30)
            assert rig.motion.doubt is None
        shown = rig.motion.concerns
        assert shown[0].startswith("the last move failed")
        rig.motion.clear_faults(shown=shown)
        await asyncio.sleep(3)
        assert rig.motion.concerns == ()
        assert not alarms(rig)

    run_rig(scenario, motion={"deadband_deg": 30}, **FEW_SCANS)


@pytest.mark.parametrize("keep_position", [True, False])
def test_a_stow_goes_on_within_ten_seconds_of_a_restart_of_the_unit_on_its_way(run_rig, keep_position):
    async def scenario(rig):
        await wait_for_long_rest(rig)
        rig.control.goto(40.0, 40.0, "a place")
        await rig.until(lambda: rig.motion.target is not None, 10, "the move")
        await wait_for_rest(rig)
        rig.control.auto()
        rig.wind_m_s = 20.0
        await rig.until(lambda: rig.mode is Mode.STOW and rig.motion.moving, 10, "the stow")
        await asyncio.sleep(5.0)
        rig.unit.power_cycle(rig.clock.monotonic(), keep_position=keep_position)
        await asyncio.sleep(1.0)
        stands = rig.truth()
        # A stow lays the module flat first.
        await rig.until(lambda: rig.truth().b_deg > stands.b_deg + 1.0, 10, "the rest of the way")
        await rig.until(lambda: rig.truth().b_deg > 85.0, 60, "a flat module")

    run_rig(scenario)
