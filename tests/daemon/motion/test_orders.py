"""The one door for moves: what is accepted, refused, replaced, interrupted and forgotten."""

import asyncio
import math

import pytest

from daemon.base.records import Event, Mode, MoveOutcome, Target
from drivers.errors import RefusedError
from tests.support.motion import (
    B_PACKET,
    STOP_PACKET,
    TRACKING_OFF_PACKET,
    commands_sent,
    motion_duration_s,
    override_telemetry,
    target_packets,
)
from tests.support.phases import now, wait_for_long_rest, wait_for_move, wait_for_rest, wait_for_tracking


@pytest.mark.parametrize("target", [(51, 60), (0, 14.9), (math.nan, 60), (0, math.inf)])
@pytest.mark.parametrize("stow", [False, True])
def test_motion_refuses_a_target_outside_the_limits(run_rig, monkeypatch, target, stow):
    async def scenario(rig):
        await wait_for_long_rest(rig)
        sent = commands_sent(rig, monkeypatch)
        with pytest.raises(ValueError, match="outside the limits"):
            rig.motion.order(Target(*target, "test"), stow=stow)
        await asyncio.sleep(5)
        assert not sent

    run_rig(scenario)


def test_a_stow_goes_ahead_with_the_reference_in_doubt_and_an_ordinary_move_does_not(run_rig):
    async def scenario(rig):
        await wait_for_long_rest(rig)
        rig.unit.power_cycle(now(rig))
        await asyncio.sleep(2)
        with pytest.raises(RefusedError, match="restarted"):
            rig.motion.order(Target(0, 60, "test"))
        rig.motion.order(Target(0, 90, "storm"), stow=True)
        await asyncio.sleep(90)
        assert rig.truth() == (pytest.approx(0, abs=1), pytest.approx(90, abs=1))

    run_rig(scenario)


def test_a_stow_goes_on_when_the_reference_is_lost_on_its_way_and_an_ordinary_move_ends(run_rig):
    async def scenario(rig):
        await wait_for_long_rest(rig)
        for stow, outcome in ((False, MoveOutcome.STALLED), (True, MoveOutcome.ARRIVED)):
            rig.motion.order(Target(0, 90 if stow else 20, "test"), stow=stow)
            await asyncio.sleep(2)
            override_telemetry(rig, reference_doubt="the count jumped")
            await rig.until(lambda: rig.motion.target is None, 120, "the end of the move")
            assert rig.motion.last_move.outcome is outcome
            assert rig.motion.doubt
            del rig.positioner.read_telemetry
            rig.motion.clear_faults()
            await rig.until(lambda: rig.motion.doubt is None, 20, "the clear")

    run_rig(scenario, motion={"deadband_deg": 30})


def test_no_ordinary_move_is_accepted_while_homing(run_rig):
    async def scenario(rig):
        await wait_for_long_rest(rig)
        rig.motion.home()
        await asyncio.sleep(5)
        with pytest.raises(RefusedError, match="while homing"):
            rig.motion.order(Target(0, 60, "test"))
        assert rig.motion.homing

    run_rig(scenario)


def test_an_order_replaces_a_reference_run_that_was_asked_for_and_has_not_begun(run_rig):
    async def scenario(rig):
        await wait_for_long_rest(rig)
        rig.motion.home()
        rig.motion.order(Target(0, 60, "test"))
        await asyncio.sleep(60)
        assert not [event for event in rig.records_of(Event) if event.text == "homing"]
        assert rig.motion.last_move.target_b_deg == 60

    run_rig(scenario)


def test_a_reference_run_replaces_a_move_that_was_ordered(run_rig):
    async def scenario(rig):
        await wait_for_long_rest(rig)
        before = rig.motion.last_move
        rig.motion.order(Target(0, 60, "test"))
        rig.motion.home()
        await rig.until(lambda: rig.motion.homing, 5, "homing")
        await rig.until(lambda: not rig.motion.homing, 300, "the end of homing")
        assert rig.motion.last_move is before

    run_rig(scenario, motion={"deadband_deg": 30})


@pytest.mark.parametrize("queued", ["home", "target"])
def test_a_queued_move_or_reference_run_does_not_outlive_a_stop(run_rig, monkeypatch, queued):
    async def scenario(rig):
        await wait_for_long_rest(rig)
        sent = commands_sent(rig, monkeypatch)
        if queued == "home":
            rig.motion.home()
        else:
            rig.motion.order(Target(0, 60, "test"))
        await rig.motion.stop()
        assert await motion_duration_s(rig, 60) == 0.0
        assert {data[:3] for _, data in sent} == {STOP_PACKET}

    run_rig(scenario)


def test_a_stop_ends_the_move_at_once_and_not_with_its_time_limit(run_rig):
    async def scenario(rig):
        await wait_for_move(rig)
        await rig.motion.stop()
        await rig.until(lambda: rig.motion.target is None, 2, "the end of the move")
        assert rig.motion.last_move.outcome is MoveOutcome.INTERRUPTED

    run_rig(scenario)


def test_a_stop_given_to_motion_drops_a_target_that_has_not_begun(run_rig):
    async def scenario(rig):
        await wait_for_tracking(rig)
        await wait_for_rest(rig)
        rig.control.hold("so that control orders nothing")
        await wait_for_rest(rig)
        rig.motion.order(Target(-20, 70, "test"))
        # The order is taken back before anything has begun to carry it out.
        await rig.motion.stop()
        assert await motion_duration_s(rig, 10) == 0
        assert rig.motion.target is None

    run_rig(scenario)


def test_moves_ordered_before_a_lost_link_are_forgotten(run_rig, monkeypatch):
    async def scenario(rig):
        await wait_for_long_rest(rig)
        rig.motion.order(Target(0, 60, "test"))
        rig.motion.request_stop()
        rig.motion.order(Target(0, 50, "test"))
        rig.cables.positioner.link_up = False
        await asyncio.sleep(3)
        sent = commands_sent(rig, monkeypatch)
        rig.cables.positioner.link_up = True
        await rig.until(lambda: rig.motion.connected, 20, "the connection")
        await asyncio.sleep(30)
        assert not target_packets(sent)

    run_rig(scenario, motion={"deadband_deg": 30})


@pytest.mark.parametrize("when", ["at the connection", "later"])
def test_the_own_tracking_of_the_unit_is_switched_off(run_rig, monkeypatch, when):
    async def scenario(rig):
        await wait_for_long_rest(rig)
        if when == "at the connection":
            rig.cables.positioner.link_up = False
            await asyncio.sleep(2)
        # Without a supply it cannot move, whatever it wants.
        rig.unit.inject("undervoltage", now(rig))
        rig.unit.inject("own_tracking", now(rig))
        sent = commands_sent(rig, monkeypatch)
        rig.cables.positioner.link_up = True
        await rig.until(lambda: TRACKING_OFF_PACKET in [data for _, data in sent], 20, "the command")
        await asyncio.sleep(3)
        assert not rig.motion.telemetry.autonomous
        rig.unit.repair("undervoltage", now(rig))
        assert await motion_duration_s(rig, 10) == 0.0
        assert rig.motion.unexplained_motion is None, "nothing has moved"
        await rig.until_mode(Mode.TRACKING, 20)

    run_rig(scenario)


def test_a_target_right_after_an_arrival_waits_until_both_axes_stand(run_rig, monkeypatch):
    async def scenario(rig):
        await wait_for_long_rest(rig)
        rig.motion.order(Target(10, 60, "test"))
        await rig.until(lambda: rig.motion.target is not None, 3, "the move")
        await rig.until(lambda: rig.motion.target is None, 90, "its end")
        sent = commands_sent(rig, monkeypatch)
        rig.motion.order(Target(0, 90, "storm"), stow=True)
        await rig.until(lambda: target_packets(sent), 5, "the next target")
        assert [data[:3] for _, data in sent][:2] == [STOP_PACKET] * 2
        assert target_packets(sent)[0].startswith(B_PACKET)
        await rig.until(lambda: rig.motion.target is None, 90, "its end")
        assert rig.motion.last_move.outcome is MoveOutcome.ARRIVED

    run_rig(scenario)


def test_an_order_that_cannot_be_carried_out_any_more_is_reported_and_dropped(run_rig, monkeypatch):
    async def scenario(rig):
        await wait_for_long_rest(rig)
        rig.motion.order(Target(0, 60, "test"))
        override_telemetry(rig, faults=("a_hall_fault",))
        sent = commands_sent(rig, monkeypatch)
        await asyncio.sleep(5)
        assert not target_packets(sent)
        assert any(event.text == "no move: the positioner reports a_hall_fault" for event in rig.records_of(Event))

    run_rig(scenario)


def test_after_many_short_outages_the_first_tries_to_reconnect_are_quick_again(run_rig):
    async def scenario(rig):
        await wait_for_long_rest(rig)
        for _ in range(8):
            rig.cables.positioner.link_up = False
            await asyncio.sleep(0.7)
            rig.cables.positioner.link_up = True
            await rig.until(lambda: rig.motion.connected, 2.5, "the connection")
            await asyncio.sleep(5)

    run_rig(scenario)
