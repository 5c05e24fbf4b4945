"""The one door for moves: what is accepted, refused, interrupted, tried again."""

import asyncio
import itertools
import math

import pytest

from daemon.base.records import Event, Mode, MoveOutcome, Target
from drivers.errors import RefusedError
from sim_drivers.pozsol.setup import AxisDrive, Setup
from tests.daemon.motion.test_rule import moves_for, quiet
from tests.daemon.service.test_faults import at_rest, commands_sent, tracking, under_way
from tests.support.motion import A_PACKET, B_PACKET, STOP_PACKET, TRACKING_OFF_PACKET, alarms, drive_b, lose, show


def now(bench):
    return bench.clock.monotonic()


def targets(sent):
    return [data for _, data in sent if data[:2] in (A_PACKET, B_PACKET)]


@pytest.mark.parametrize("target", [(51, 60), (0, 14.9), (math.nan, 60), (0, math.inf)])
@pytest.mark.parametrize("stow", [False, True])
def test_motion_itself_refuses_what_is_outside_the_limits(run_rig, monkeypatch, target, stow):
    async def scenario(bench):
        await quiet(bench)
        sent = commands_sent(bench, monkeypatch)
        with pytest.raises(ValueError, match="outside the limits"):
            bench.motion.order(Target(*target, "test"), stow=stow)
        await asyncio.sleep(5)
        assert not sent

    run_rig(scenario)


def test_a_stow_goes_ahead_with_the_reference_in_doubt_and_an_ordinary_move_does_not(run_rig):
    async def scenario(bench):
        await quiet(bench)
        bench.unit.power_cycle(now(bench))
        await asyncio.sleep(2)
        with pytest.raises(RefusedError, match="restarted"):
            bench.motion.order(Target(0, 60, "test"))
        bench.motion.order(Target(0, 90, "storm"), stow=True)
        await asyncio.sleep(90)
        assert bench.truth() == (pytest.approx(0, abs=1), pytest.approx(90, abs=1))

    run_rig(scenario)


def test_a_stow_goes_on_when_the_reference_is_lost_on_its_way_and_an_ordinary_move_ends(run_rig):
    async def scenario(bench):
        await quiet(bench)
        for stow, outcome in ((False, MoveOutcome.STALLED), (True, MoveOutcome.ARRIVED)):
            bench.motion.order(Target(0, 90 if stow else 20, "test"), stow=stow)
            await asyncio.sleep(2)
            show(bench, reference_doubt="the count jumped")
            await bench.until(lambda: bench.motion.target is None, 120, "the end of the move")
            assert bench.motion.last_move.outcome is outcome
            assert bench.motion.doubt
            del bench.positioner.read_telemetry
            bench.motion.clear_faults()
            await bench.until(lambda: bench.motion.doubt is None, 20, "the clear")

    run_rig(scenario, motion={"deadband_deg": 30})


def test_no_ordinary_move_is_taken_while_homing(run_rig):
    async def scenario(bench):
        await quiet(bench)
        bench.motion.home()
        await asyncio.sleep(5)
        with pytest.raises(RefusedError, match="while homing"):
            bench.motion.order(Target(0, 60, "test"))
        assert bench.motion.homing

    run_rig(scenario)


def test_an_order_replaces_a_reference_run_that_was_asked_for_and_has_not_begun(run_rig):
    async def scenario(bench):
        await quiet(bench)
        bench.motion.home()
        bench.motion.order(Target(0, 60, "test"))
        await asyncio.sleep(60)
        assert not [event for event in bench.of(Event) if event.text == "homing"]
        assert bench.motion.last_move.target_b_deg == 60

    run_rig(scenario)


def test_a_reference_run_replaces_a_move_that_was_ordered(run_rig):
    async def scenario(bench):
        await quiet(bench)
        before = bench.motion.last_move
        bench.motion.order(Target(0, 60, "test"))
        bench.motion.home()
        await bench.until(lambda: bench.motion.homing, 5, "homing")
        await bench.until(lambda: not bench.motion.homing, 300, "the end of homing")
        assert bench.motion.last_move is before

    run_rig(scenario, motion={"deadband_deg": 30})


@pytest.mark.parametrize("queued", ["home", "target"])
def test_what_was_queued_does_not_outlive_a_stop(run_rig, monkeypatch, queued):
    async def scenario(bench):
        await quiet(bench)
        sent = commands_sent(bench, monkeypatch)
        if queued == "home":
            bench.motion.home()
        else:
            bench.motion.order(Target(0, 60, "test"))
        await bench.motion.stop()
        assert await moves_for(bench, 60) == 0.0
        assert {data[:3] for _, data in sent} == {STOP_PACKET}

    run_rig(scenario)


def test_a_stop_ends_the_move_at_once_and_not_with_its_time_limit(run_rig):
    async def scenario(bench):
        await under_way(bench)
        await bench.motion.stop()
        await bench.until(lambda: bench.motion.target is None, 2, "the end of the move")
        assert bench.motion.last_move.outcome is MoveOutcome.INTERRUPTED

    run_rig(scenario)


def test_what_was_ordered_before_a_loss_is_forgotten(run_rig, monkeypatch):
    async def scenario(bench):
        await quiet(bench)
        bench.motion.order(Target(0, 60, "test"))
        bench.motion.rest()
        bench.motion.order(Target(0, 50, "test"))
        bench.cables.positioner.link_up = False
        await asyncio.sleep(3)
        sent = commands_sent(bench, monkeypatch)
        bench.cables.positioner.link_up = True
        await bench.until(lambda: bench.motion.connected, 20, "the connection")
        await asyncio.sleep(30)
        assert not targets(sent)

    run_rig(scenario, motion={"deadband_deg": 30})


@pytest.mark.parametrize("when", ["at the connection", "later"])
def test_own_tracking_is_switched_off(run_rig, monkeypatch, when):
    async def scenario(bench):
        await quiet(bench)
        if when == "at the connection":
            bench.cables.positioner.link_up = False
            await asyncio.sleep(2)
        # Without a supply it cannot move, whatever it wants.
        bench.unit.inject("undervoltage", now(bench))
        bench.unit.inject("own_tracking", now(bench))
        sent = commands_sent(bench, monkeypatch)
        bench.cables.positioner.link_up = True
        await bench.until(lambda: TRACKING_OFF_PACKET in [data for _, data in sent], 20, "the command")
        await asyncio.sleep(3)
        assert not bench.motion.telemetry.autonomous
        bench.unit.repair("undervoltage", now(bench))
        assert await moves_for(bench, 10) == 0.0
        assert bench.motion.unexplained is None, "nothing has moved"
        await bench.until_mode(Mode.TRACKING, 20)

    run_rig(scenario)


def test_a_move_is_tried_as_often_as_the_settings_say_and_no_more(run_rig, monkeypatch):
    async def scenario(bench):
        await quiet(bench)
        lose(bench, monkeypatch, A_PACKET, B_PACKET)
        sent = commands_sent(bench, monkeypatch)
        bench.motion.order(Target(0, 60, "test"))
        await asyncio.sleep(120)
        assert bench.motion.last_move.outcome is MoveOutcome.REFUSED
        assert len(targets(sent)) == 2 * 4
        assert bench.motion.doubt.startswith("the last move failed (refused): ")

    run_rig(scenario, motion={"attempts": 4})


def test_a_stop_between_two_attempts_ends_the_move(run_rig, monkeypatch):
    async def scenario(bench):
        await quiet(bench)
        lose(bench, monkeypatch, A_PACKET, B_PACKET)
        bench.motion.order(Target(0, 60, "test"))
        await asyncio.sleep(1.5)
        sent = commands_sent(bench, monkeypatch)
        bench.motion.rest()
        await bench.until(lambda: bench.motion.target is None, 3, "the end of the move")
        assert bench.motion.last_move.outcome is MoveOutcome.INTERRUPTED
        assert not targets(sent)
        assert bench.motion.doubt is None

    run_rig(scenario)


def test_an_order_that_cannot_be_carried_out_any_more_is_told_and_dropped(run_rig, monkeypatch):
    async def scenario(bench):
        await quiet(bench)
        bench.motion.order(Target(0, 60, "test"))
        show(bench, faults=("a_hall_fault",))
        sent = commands_sent(bench, monkeypatch)
        await asyncio.sleep(5)
        assert not targets(sent)
        assert any(event.text == "no move: the positioner reports a_hall_fault" for event in bench.of(Event))

    run_rig(scenario)


def test_a_move_that_overshoots_ends_with_stop(run_rig, monkeypatch):
    async def scenario(bench):
        sent = commands_sent(bench, monkeypatch)
        await bench.until(lambda: bench.motion.last_move, 200, "the end of the move")
        assert bench.motion.last_move.outcome is MoveOutcome.OVERSHOT
        assert sent[-1][1].startswith(STOP_PACKET)
        assert await moves_for(bench, 30) <= 1.0

    run_rig(scenario, motion={"attempts": 1}, setup=Setup(drive=AxisDrive(overshoot_mm=12.0)))


def test_a_move_that_stalls_ends_with_stop(run_rig, monkeypatch):
    async def scenario(bench):
        await quiet(bench)
        bench.motion.order(Target(bench.motion.pose.a_deg, 60, "test"))
        await asyncio.sleep(2)
        here = bench.motion.telemetry
        sent = commands_sent(bench, monkeypatch)
        show(bench, position_a=here.position_a, position_b=here.position_b, b_deg=here.b_deg)
        await bench.until(lambda: bench.motion.target is None, 30, "the end")
        assert bench.motion.last_move.outcome is MoveOutcome.STALLED
        assert sent[-1][1].startswith(STOP_PACKET)

    run_rig(scenario, motion={"attempts": 1, "deadband_deg": 30})


def test_after_many_short_outages_the_first_tries_to_reconnect_are_quick_again(run_rig):
    async def scenario(bench):
        await quiet(bench)
        for _ in range(8):
            bench.cables.positioner.link_up = False
            await asyncio.sleep(0.7)
            bench.cables.positioner.link_up = True
            await bench.until(lambda: bench.motion.connected, 2.5, "the connection")
            await asyncio.sleep(5)

    run_rig(scenario)


def test_the_port_is_released_at_the_end(run_rig):
    closed = []

    async def scenario(bench):
        await quiet(bench)
        close = bench.positioner.close

        async def noted():
            closed.append(now(bench))
            await close()

        bench.positioner.close = noted

    run_rig(scenario)
    assert len(closed) == 1


# What fails is tried again, ever more seldom


def test_a_stow_that_fails_is_an_alarm_and_is_tried_again_with_growing_pauses(run_rig, monkeypatch):
    async def scenario(bench):
        await quiet(bench)
        lose(bench, monkeypatch, A_PACKET, B_PACKET)
        sent = commands_sent(bench, monkeypatch)
        start_s = now(bench)
        bench.wind_m_s = 20.0
        await bench.until(lambda: "move-failed" in alarms(bench), 30, "the alarm")
        assert "the stow failed and is tried again: the last move failed (refused)" in alarms(bench)["move-failed"]
        await asyncio.sleep(3600)
        tries = [at - start_s for at, data in sent if data[:2] == B_PACKET][::3]
        pauses = [round((b - a) / 60) for a, b in itertools.pairwise(tries)]
        assert pauses[:4] == [1, 2, 5, 10]
        assert len(targets(sent)) <= 60
        monkeypatch.undo()
        await bench.until(lambda: bench.truth().b_deg > 89, 700, "the stow")
        await at_rest(bench)
        assert "move-failed" not in alarms(bench)

    run_rig(scenario)


def test_an_ordinary_move_that_fails_again_is_tried_after_twice_the_pause(run_rig, monkeypatch):
    async def scenario(bench):
        await quiet(bench)
        lose(bench, monkeypatch, A_PACKET, B_PACKET)
        for pause_s in (600, 1200, 2400):
            bench.motion.order(Target(0, 60, "test"))
            await bench.until(lambda: bench.motion.doubt, 30, "the failure")
            await asyncio.sleep(pause_s - 20)
            assert bench.motion.doubt
            await asyncio.sleep(30)
            assert bench.motion.doubt is None
        shown = bench.motion.concerns
        assert shown[0].startswith("the last move failed")
        bench.motion.clear_faults(shown=shown)
        await asyncio.sleep(3)
        assert bench.motion.concerns == ()
        assert not alarms(bench)

    run_rig(scenario, motion={"deadband_deg": 30})


def test_stands_since_tells_when_telemetry_saw_both_axes_come_to_rest(run_rig):
    async def scenario(bench):
        await quiet(bench)
        before_s = bench.motion.stands_since_s
        assert before_s < now(bench) - 15
        await bench.motion.stop()
        assert bench.motion.stands_since_s is None, "whether it stood is not known before the next look"
        await bench.until(lambda: bench.motion.stands_since_s, 3, "standstill")
        bench.motion.order(Target(0, 60, "test"))
        await asyncio.sleep(3)
        assert bench.motion.stands_since_s is None
        await bench.motion.stop()
        stopped_s = now(bench)
        assert bench.motion.stands_since_s is None, "a stop that was sent is not yet a standstill"
        await bench.until(lambda: bench.motion.stands_since_s, 3, "standstill")
        assert bench.motion.stands_since_s > stopped_s
        bench.cables.positioner.link_up = False
        await asyncio.sleep(2)
        assert bench.motion.stands_since_s is None

    run_rig(scenario, motion={"deadband_deg": 30})


def test_an_arrived_tracker_that_is_moved_later_is_found(run_rig):
    async def scenario(bench):
        await tracking(bench)
        await at_rest(bench)
        for wait_s, there in ((1.0, 75.0), (15.0, 70.0)):
            await asyncio.sleep(wait_s)
            drive_b(bench, there)
            assert 0 < await moves_for(bench, 10) <= 2.0
            assert bench.motion.unexplained
            bench.motion.clear_faults()
            await bench.until(lambda: bench.motion.unexplained is None, 10, "the clear")

    run_rig(scenario, motion={"deadband_deg": 30})
