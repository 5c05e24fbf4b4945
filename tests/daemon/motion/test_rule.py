"""Motion without an order, or against a stop, is stopped, told, and blocks the tracker until a person has looked."""

import asyncio
import logging

import pytest

from daemon.base.records import Event, Mode, Move, MoveOutcome, Target
from drivers.errors import RefusedError
from sim_drivers.pozsol.setup import AxisDrive, Setup
from tests.support.motion import (
    A_PACKET,
    B_PACKET,
    STOP_PACKET,
    alarms,
    clear_blocking_faults,
    commands_sent,
    lose_packets,
    motion_duration_s,
    override_telemetry,
    send_foreign_b_target,
)
from tests.support.phases import wait_for_long_rest, wait_for_move, wait_for_rest, wait_for_tracking


@pytest.mark.parametrize("what", ["target", "own_tracking", "re_reference"])
def test_a_unit_that_moves_by_itself_is_stopped_within_2_s_and_blocks_even_a_stow(run_rig, caplog, what):
    async def scenario(rig):
        await wait_for_long_rest(rig)
        if what == "target":
            send_foreign_b_target(rig, 85.0)
        else:
            rig.unit.inject(what, rig.clock.monotonic())
        assert 0 < await motion_duration_s(rig, 20) <= 2.0
        assert "without an order" in rig.motion.unexplained_motion
        assert "heliocube clear" in alarms(rig)["unexplained-motion"]
        assert rig.mode is Mode.FAULT
        rig.control.stow("storm")
        with pytest.raises(RefusedError, match="without an order"):
            rig.motion.order(Target(0, 90, "storm"), stow=True)
        with pytest.raises(RefusedError, match="without an order"):
            rig.motion.home()
        stands = rig.truth()
        await asyncio.sleep(700)
        assert rig.truth() == stands
        rig.control.auto()
        assert rig.motion.concerns
        await clear_blocking_faults(rig)
        assert not alarms(rig)
        await rig.until_mode(Mode.TRACKING, 30)

    rig = run_rig(scenario)
    told = [event for event in rig.records_of(Event) if event.subject == "alarm" and "without an order" in event.text]
    warned = [r for r in caplog.records if r.levelno == logging.WARNING and "without an order" in r.getMessage()]
    assert len(warned) == 1
    assert [event.text.startswith("cleared ") for event in told] == [False, True]


@pytest.mark.parametrize("lost", [A_PACKET, B_PACKET])
def test_an_axis_that_drives_on_after_a_refused_move_is_stopped(run_rig, monkeypatch, lost):
    async def scenario(rig):
        await wait_for_long_rest(rig)
        lose_packets(rig, monkeypatch, lost)
        rig.motion.order(Target(20, 80, "test"))
        await rig.until(lambda: rig.motion.last_move.target_b_deg == 80, 60, "the refusal")
        assert rig.motion.last_move.outcome is MoveOutcome.REFUSED
        assert await motion_duration_s(rig, 60) == 0.0
        assert rig.motion.unexplained_motion is None

    run_rig(scenario)


def test_each_attempt_of_a_refused_move_ends_with_both_axes_standing(run_rig, monkeypatch):
    async def scenario(rig):
        await wait_for_long_rest(rig)
        lose_packets(rig, monkeypatch, A_PACKET)
        sent = commands_sent(rig, monkeypatch)
        rig.motion.order(Target(20, 80, "test"))
        await rig.until(lambda: rig.motion.last_move.target_b_deg == 80, 60, "the refusal")
        order = [data[:3] if data.startswith(STOP_PACKET) else data[:2] for _, data in sent]
        for at in [at for at, start in enumerate(order) if start == A_PACKET][1:]:
            assert order[at - 1] == STOP_PACKET
        assert order[-1] == STOP_PACKET
        assert order.count(A_PACKET) == 3

    run_rig(scenario)


def test_a_move_that_goes_the_wrong_way_or_elsewhere_is_stopped_and_blocks(run_rig):
    async def scenario(rig):
        await wait_for_long_rest(rig)
        rig.motion.order(Target(rig.motion.pose.a_deg, 80, "test"))
        await asyncio.sleep(3)
        assert rig.motion.target is not None
        send_foreign_b_target(rig, 20.0)
        assert await motion_duration_s(rig, 20) <= 2.0
        assert rig.motion.last_move.outcome is MoveOutcome.OVERSHOT
        assert "heads for position" in rig.motion.unexplained_motion

    run_rig(scenario)


def test_a_unit_that_does_not_hear_stop_is_reported_and_stays_blocked_when_it_hears_again(run_rig, monkeypatch):
    async def scenario(rig):
        await wait_for_long_rest(rig)
        rig.motion.order(Target(40, 15, "far"))
        await asyncio.sleep(2)
        rig.unit.inject("deaf", rig.clock.monotonic())
        sent = commands_sent(rig, monkeypatch)
        await rig.control.stop("halt")
        await rig.until(lambda: "deaf-to-stop" in alarms(rig), 15, "the alarm")
        assert "supply" in alarms(rig)["deaf-to-stop"]
        stops = len(sent)
        await asyncio.sleep(10)
        assert len(sent) >= stops + 10, "it does not give up"
        assert rig.motion.stands_since_s is None
        rig.unit.repair("deaf", rig.clock.monotonic())
        assert await motion_duration_s(rig, 60) <= 6.0
        assert rig.truth().b_deg > 20, "it did not drive to its old target"
        assert rig.motion.stands_since_s is not None
        rig.control.auto()
        with pytest.raises(RefusedError, match="does not obey"):
            rig.motion.order(Target(0, 90, "storm"), stow=True)
        await clear_blocking_faults(rig)

    run_rig(scenario)


def test_an_axis_that_moves_at_the_connection_is_stopped_and_blocks_nothing(run_rig):
    async def scenario(rig):
        await wait_for_long_rest(rig)
        rig.motion.order(Target(40, 15, "far"))
        await asyncio.sleep(2)
        rig.cables.positioner.link_up = False
        await asyncio.sleep(5)
        rig.cables.positioner.link_up = True
        await rig.until(lambda: rig.motion.connected, 10, "the connection")
        assert await motion_duration_s(rig, 5) == 0.0
        assert rig.motion.blocked is None
        await rig.until_mode(Mode.TRACKING, 10)

    run_rig(scenario)


def test_motion_by_a_button_at_the_unit_is_stopped_and_is_no_unexplained_motion(run_rig):
    async def scenario(rig):
        await wait_for_long_rest(rig)
        send_foreign_b_target(rig, 85.0)
        await asyncio.sleep(0.1)
        override_telemetry(rig, button_pressed=True)
        assert await motion_duration_s(rig, 20) <= 2.0
        assert rig.motion.unexplained_motion is None
        assert rig.motion.is_button_pressed
        with pytest.raises(RefusedError, match="a button was pressed"):
            rig.motion.order(Target(0, 90, "test"))
        with pytest.raises(RefusedError, match="a button was pressed"):
            rig.motion.home()
        assert "unexplained-motion" not in alarms(rig)

    rig = run_rig(scenario)
    told = [event.text for event in rig.records_of(Event) if event.subject == "positioner"]
    assert sum("a button is pressed" in text for text in told) == 1


def test_a_button_held_for_long_blocks_nothing_and_does_not_count_as_deafness_to_stop(run_rig):
    async def scenario(rig):
        await wait_for_tracking(rig)
        await wait_for_rest(rig)
        rig.unit.inject("button", rig.clock.monotonic())
        for _ in range(80):
            await asyncio.sleep(0.5)
            assert rig.motion.unexplained_motion is None
        rig.unit.repair("button", rig.clock.monotonic())
        await asyncio.sleep(20)
        assert rig.motion.unexplained_motion is None
        assert not alarms(rig)

    run_rig(scenario)


def test_a_reference_run_of_the_unit_in_mid_move_leaves_the_count_in_doubt(run_rig):
    async def scenario(rig):
        await wait_for_move(rig)
        rig.unit.inject("re_reference", rig.clock.monotonic())
        await rig.until(lambda: rig.motion.unexplained_motion, 3, "the alarm")
        await asyncio.sleep(10)
        assert "reference run of its own" in rig.motion.doubt

    run_rig(scenario)


def test_a_button_pressed_in_mid_move_ends_the_move(run_rig):
    async def scenario(rig):
        await wait_for_move(rig)
        override_telemetry(rig, button_pressed=True)
        assert await motion_duration_s(rig, 10) <= 2.0
        assert rig.records_of(Move)[-1].outcome is MoveOutcome.INTERRUPTED

    run_rig(scenario)


@pytest.mark.parametrize("drive_of_unit", [AxisDrive(), AxisDrive(overshoot_mm=1.0), AxisDrive(speed_mm_s=1.0)])
def test_small_and_large_ordered_moves_are_never_taken_for_unexplained_motion(run_rig, drive_of_unit):
    async def scenario(rig):
        await wait_for_long_rest(rig)
        a, b = 0.0, 60.0
        for step in (0.3, 0.7, -0.7, 0.75, 3.0, -0.5, -12.0, 0.6, 20.0, -0.2):
            a, b = a + step, b - step
            rig.motion.order(Target(a, b, "test"))
            await asyncio.sleep(0.7 if step == 3.0 else 60)
            assert rig.motion.unexplained_motion is None

    run_rig(scenario, setup=Setup(drive=drive_of_unit), motion={"deadband_deg": 30})


def test_a_host_that_was_busy_for_seconds_does_not_call_a_standing_unit_deaf(run_rig):
    async def scenario(rig):
        halt = rig.positioner.halt

        async def busy_then_halt():
            asyncio.get_running_loop().skip(8.0)
            await halt()

        rig.positioner.halt = busy_then_halt
        await rig.until(lambda: rig.motion.connected, 30, "the connection")
        await asyncio.sleep(10)
        assert "deaf-to-stop" not in alarms(rig)
        assert rig.motion.unexplained_motion is None

    run_rig(scenario)


def test_an_arrived_tracker_that_is_moved_later_is_found(run_rig):
    async def scenario(rig):
        await wait_for_tracking(rig)
        await wait_for_rest(rig)
        for wait_s, there in ((1.0, 75.0), (15.0, 70.0)):
            await asyncio.sleep(wait_s)
            send_foreign_b_target(rig, there)
            assert 0 < await motion_duration_s(rig, 10) <= 2.0
            assert rig.motion.unexplained_motion
            rig.motion.clear_faults()
            await rig.until(lambda: rig.motion.unexplained_motion is None, 10, "the clear")

    run_rig(scenario, motion={"deadband_deg": 30})


@pytest.mark.parametrize("pressed", [False, True])
def test_motion_of_the_units_own_is_not_forgotten_with_the_link_unless_a_button_explains_it(run_rig, pressed):
    async def scenario(rig):
        await wait_for_long_rest(rig)
        rig.motion.order(Target(40, 60, "test"))
        await rig.until(lambda: rig.motion.target is not None, 3, "the move")
        await asyncio.sleep(5)
        # The unit does not hear the stop, goes on, and its own tracking turns it round.
        rig.unit.inject("deaf", rig.clock.monotonic())
        rig.motion.request_stop()
        await asyncio.sleep(1)
        rig.unit.inject("own_tracking", rig.clock.monotonic())
        if pressed:
            override_telemetry(rig, button_pressed=True)
        await asyncio.sleep(1.5)
        rig.cables.positioner.link_up = False
        for fault in ("own_tracking", "deaf"):
            rig.unit.repair(fault, rig.clock.monotonic())
        await asyncio.sleep(2)
        rig.cables.positioner.link_up = True
        await rig.until(lambda: rig.motion.connected, 20, "the connection")
        await asyncio.sleep(5)
        if pressed:
            assert rig.motion.unexplained_motion is None
        else:
            assert "but was sent to" in rig.motion.unexplained_motion
            assert rig.mode is Mode.FAULT

    run_rig(scenario)
