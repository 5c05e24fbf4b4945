"""Motion, call by call, with a hand-driven positioner: what is taken, refused, forgiven and told."""

import asyncio
import math

import pytest

from daemon.base.records import MoveOutcome, Target
from daemon.motion.polling import Polling
from drivers.errors import RefusedError
from drivers.interfaces import PositionerIdentity
from tests.support.fake_positioner import FakePositioner, run_motion


@pytest.mark.parametrize("target", [(-50.1, 60), (50.1, 60), (0, 14.9), (0, 90.1), (math.nan, 60), (0, math.nan)])
def test_a_target_outside_the_limits_is_refused_even_for_a_stow(target):
    async def scenario(rig):
        sent = len(rig.unit.sent)
        with pytest.raises(ValueError, match=r"outside the limits \("):
            rig.motion.order(Target(*target, "test"), stow=True)
        await asyncio.sleep(2.0)
        assert len(rig.unit.sent) == sent

    run_motion(scenario)


@pytest.mark.parametrize("place", [(-50.0, 15.0), (50.0, 90.0)])
def test_the_limits_themselves_can_be_reached(place):
    async def scenario(rig):
        rig.motion.order(Target(*place, "test"))
        await asyncio.sleep(60.0)
        assert rig.unit.place() == place
        assert rig.moves[-1].outcome is MoveOutcome.ARRIVED

    run_motion(scenario)


@pytest.mark.parametrize(
    ("says", "stow_goes", "words"),
    [
        ({"faults": ("a_overcurrent", "b_hall")}, False, "the positioner reports a_overcurrent, b_hall"),
        ({"was_reset": True}, True, "has restarted and may have lost its reference"),
        ({"reference_doubt": "the count jumped"}, True, "the count jumped"),
        ({"button_pressed": True}, False, "a button is pressed at the unit: somebody is there"),
    ],
)
def test_faults_and_a_pressed_button_block_moves_and_stows_and_a_doubted_reference_only_moves(says, stow_goes, words):
    async def scenario(rig):
        rig.unit.telemetry_overrides |= says
        await asyncio.sleep(3.0)
        with pytest.raises(RefusedError, match=words):
            rig.motion.order(Target(0.0, 80.0, "go"))
        if stow_goes:
            rig.motion.order(Target(0.0, 80.0, "storm"), stow=True)
            await rig.until(lambda: rig.moves)
            assert rig.moves[-1].outcome is MoveOutcome.ARRIVED
            assert rig.motion.doubt
        else:
            with pytest.raises(RefusedError, match=words):
                rig.motion.order(Target(0.0, 80.0, "storm"), stow=True)

    run_motion(scenario)


def test_a_setup_that_contradicts_the_configuration_blocks_moves_stows_and_reference_runs():
    async def scenario(rig):
        assert rig.motion.blocked == "A is long; B is short"
        assert rig.motion.concerns == ("A is long", "B is short")
        assert rig.active_alarms["positioner-setup"] == "A is long; B is short"
        with pytest.raises(RefusedError, match="cannot be homed: A is long; B is short"):
            rig.motion.home()
        with pytest.raises(RefusedError, match="cannot move: A is long"):
            rig.motion.order(Target(0.0, 80.0, "storm"), stow=True)

    def contradicting(clock):
        unit = FakePositioner(clock)
        unit.identity = PositionerIdentity("board", "1", "", setup_conflicts=("A is long", "B is short"))
        return unit

    run_motion(scenario, make=contradicting)


def test_a_stow_lays_the_module_flat_first_and_another_move_turns_it_first():
    async def scenario(rig):
        for stow, first in ((False, "a"), (True, "b")):
            rig.motion.order(Target(5.0 if stow else 10.0, 70.0, "go"), stow=stow)
            await rig.until(lambda: rig.motion.target is not None, 3.0)
            await rig.until(lambda: rig.motion.target is None)
            assert rig.unit.sent[-1][3] == first
            await asyncio.sleep(12.0)

    run_motion(scenario)


def test_an_order_replaces_a_move_under_way_but_only_a_stow_replaces_a_reference_run():
    async def scenario(rig):
        rig.motion.order(Target(40.0, 60.0, "far"))
        await asyncio.sleep(3.0)
        assert rig.motion.moving
        assert not rig.motion.is_idle
        rig.motion.order(Target(0.0, 60.0, "back"))
        await rig.until(lambda: len(rig.moves) == 2)
        assert [move.outcome for move in rig.moves] == [MoveOutcome.INTERRUPTED, MoveOutcome.ARRIVED]
        assert rig.moves[0].why == "far"
        rig.motion.home()
        await asyncio.sleep(3.0)
        assert rig.motion.homing
        assert rig.motion.moving
        with pytest.raises(RefusedError, match="cannot move while homing"):
            rig.motion.order(Target(20.0, 60.0, "go"))
        rig.motion.order(Target(0.0, 90.0, "storm"), stow=True)
        await rig.until(lambda: len(rig.moves) == 3)
        assert rig.moves[-1].outcome is MoveOutcome.ARRIVED
        assert ("home", "b") not in rig.unit.sent

    run_motion(scenario)


@pytest.mark.parametrize("takes_back", ["rest", "stop", "freeze", "home"])
def test_an_order_that_has_not_begun_is_dropped_by_a_rest_a_stop_a_freeze_or_a_reference_run(takes_back):
    async def scenario(rig):
        rig.motion.order(Target(40.0, 60.0, "far"))
        assert not rig.motion.is_idle
        if takes_back == "rest":
            rig.motion.request_stop()
        elif takes_back == "stop":
            await rig.motion.stop()
        elif takes_back == "home":
            rig.motion.home()
        else:
            rig.motion.freeze("ana")
            rig.motion.freeze(None)
        await asyncio.sleep(100.0)
        assert not rig.moves
        assert rig.motion.is_idle

    run_motion(scenario)


@pytest.mark.parametrize("ends", ["rest", "stop", "freeze"])
def test_a_rest_a_stop_or_a_freeze_drops_a_waiting_reference_run_and_ends_one_under_way(ends):
    async def scenario(rig):
        for after_s in (0.0, 5.0):
            rig.motion.home()
            assert not rig.motion.is_idle
            if after_s:
                await asyncio.sleep(after_s)
            if ends == "rest":
                rig.motion.request_stop()
            elif ends == "stop":
                await rig.motion.stop()
            else:
                rig.motion.freeze("ana")
            await asyncio.sleep(3.0)
            assert not rig.motion.homing
            assert ("homing" in rig.positioner_events) == (after_s > 0)
            assert ("home", "b") not in rig.unit.sent
            rig.motion.freeze(None)
        assert rig.positioner_events[-1] == "homing was stopped before its end"
        assert rig.motion.doubt is None, "what was not in doubt before is not now"

    run_motion(scenario)


def test_while_motion_is_frozen_orders_are_refused_and_a_move_under_way_is_stopped():
    async def scenario(rig):
        rig.motion.order(Target(40.0, 60.0, "far"))
        await asyncio.sleep(3.0)
        rig.motion.freeze("ana has stopped it")
        await asyncio.sleep(2.0)
        assert rig.moves[-1].outcome is MoveOutcome.INTERRUPTED
        halts = rig.unit.sent.count("halt")
        rig.motion.freeze("ben has stopped it")
        await asyncio.sleep(2.0)
        assert rig.unit.sent.count("halt") == halts, "it stands already"
        for ask in (lambda: rig.motion.order(Target(0.0, 90.0, "x"), stow=True), rig.motion.home):
            with pytest.raises(RefusedError, match="ben has stopped it"):
                ask()
        rig.motion.freeze(None)
        rig.motion.order(Target(0.0, 60.0, "go"))
        await rig.until(lambda: len(rig.moves) == 2)

    run_motion(scenario)


def test_a_doubt_that_comes_up_after_an_order_keeps_the_move_from_beginning():
    async def scenario(rig):
        await asyncio.sleep(20.0)
        await rig.until(lambda: rig.clock.monotonic() - rig.motion.telemetry.time_monotonic_s > 0.2)
        rig.unit.telemetry_overrides["reference_doubt"] = "the count jumped"
        rig.motion.order(Target(40.0, 60.0, "far"))
        await asyncio.sleep(3.0)
        assert not rig.moves
        assert rig.positioner_events[-1] == "no move: the count jumped"
        assert rig.motion.is_idle

    run_motion(scenario)


def test_control_is_told_when_readiness_changes_and_only_then():
    async def scenario(rig):
        assert rig.changes == 1
        await asyncio.sleep(20.0)
        assert rig.changes == 1
        for says, more in (({"faults": ("a",)}, 1), ({}, 0), ({"reference_doubt": "x"}, 0)):
            before = rig.changes
            rig.unit.telemetry_overrides = dict(says)
            await asyncio.sleep(2.0)
            assert rig.changes == before + more, says
        before = rig.changes
        rig.motion.clear_faults()
        await asyncio.sleep(3.0)
        assert rig.changes > before
        before = rig.changes
        rig.unit.is_lost = True
        await asyncio.sleep(3.0)
        assert rig.changes == before + 1

    run_motion(scenario)


def test_own_tracking_is_switched_off_and_the_axes_are_halted():
    async def scenario(rig):
        rig.unit.telemetry_overrides["autonomous"] = True
        await rig.wait_until_connected()
        assert rig.unit.sent[-2:] == ["disable_autonomy", "halt"]
        assert rig.motion.blocked is None
        rig.unit.refuses["disable_autonomy"] = RefusedError("hand", "stays on")
        rig.unit.telemetry_overrides["autonomous"] = True
        await asyncio.sleep(1.0)
        assert rig.motion.blocked == "a mode of the positioner's own is on: sun tracking, wind or snow"
        with pytest.raises(RefusedError, match="a mode of the positioner's own is on"):
            rig.motion.order(Target(0.0, 90.0, "storm"), stow=True)
        await asyncio.sleep(10.0)
        assert "positioner-fault" not in rig.active_alarms, "it may only just have been switched on"
        await rig.until(lambda: "positioner-fault" in rig.active_alarms, 8.0)
        assert rig.active_alarms["positioner-fault"].endswith("and nothing is moved: do it at the unit")
        rig.unit.refuses.clear()
        await rig.until(lambda: rig.motion.blocked is None, 3.0)
        assert rig.alarms.acknowledge("ana")
        assert "positioner-fault" not in rig.active_alarms

    run_motion(scenario, connects=False)


def test_a_clear_forgives_only_the_faults_and_doubts_that_were_shown():
    async def scenario(rig):
        rig.unit.telemetry_overrides |= {"faults": ("a_hall",), "was_reset": True}
        await asyncio.sleep(3.0)
        concerns = rig.motion.concerns
        assert concerns[0] == "the positioner reports a_hall"
        rig.motion.clear_faults(())
        assert not rig.motion.is_idle
        await asyncio.sleep(3.0)
        assert "a_hall was cleared before anybody had seen it: home it" in rig.motion.concerns
        rig.motion.clear_faults()
        await asyncio.sleep(3.0)
        assert rig.motion.concerns == ()
        assert rig.unit.sent.count(("clear", True)) == 2

    run_motion(scenario)


@pytest.mark.parametrize(("rehome", "homes"), [("automatic", True), ("operator", False)])
def test_an_automatic_reference_run_is_made_only_where_it_is_configured_and_allowed(rehome, homes):
    async def scenario(rig):
        rig.unit.telemetry_overrides["was_reset"] = True
        await asyncio.sleep(20.0)
        assert "homing" not in rig.positioner_events, "control has not allowed it"
        rig.motion.may_rehome = True
        rig.motion.freeze("ana")
        await asyncio.sleep(20.0)
        assert "homing" not in rig.positioner_events
        rig.motion.freeze(None)
        await asyncio.sleep(120.0)
        assert ("homing" in rig.positioner_events) == homes
        assert (rig.motion.doubt is None) == homes

    run_motion(scenario, rehome=rehome)


def test_a_reference_run_interrupts_the_move_under_way_and_is_made():
    async def scenario(rig):
        rig.motion.order(Target(40.0, 60.0, "far"))
        await asyncio.sleep(3.0)
        rig.motion.home()
        await rig.until(lambda: rig.motion.homing, 2.0)
        assert rig.moves[-1].outcome is MoveOutcome.INTERRUPTED
        await rig.until(lambda: not rig.motion.homing, 90.0)
        assert rig.positioner_events == ["homing", "homing finished"]

    run_motion(scenario)


@pytest.mark.parametrize("asks", ["order", "home", "clear"])
def test_a_move_reference_run_or_clear_asked_for_at_rest_begins_before_the_next_look(asks):
    async def scenario(rig):
        await asyncio.sleep(10.0)
        await rig.until(lambda: rig.clock.monotonic() - rig.motion.telemetry.time_monotonic_s < 0.1)
        if asks == "order":
            rig.motion.order(Target(10.0, 60.0, "go"))
        elif asks == "home":
            rig.motion.home()
        else:
            rig.motion.clear_faults()
        sent = len(rig.unit.sent)
        await rig.until(lambda: len(rig.unit.sent) > sent, 0.5)

    run_motion(scenario, polling=Polling(idle_s=7.0))


def test_after_unexplained_motion_no_reference_run_is_made():
    async def scenario(rig):
        rig.unit.drive(10.0, 60.0)
        await rig.until(lambda: rig.motion.unexplained_motion, 5.0)
        await asyncio.sleep(10.0)
        with pytest.raises(RefusedError, match="cannot be homed: A moved from"):
            rig.motion.home()

    run_motion(scenario)


def test_a_restart_after_a_good_reference_run_is_homed_at_once_and_a_failed_run_is_repeated_later():
    async def scenario(rig):
        rig.motion.may_rehome = True
        for runs in (1, 2):
            rig.unit.telemetry_overrides["was_reset"] = True
            await rig.until(lambda runs=runs: rig.positioner_events.count("homing finished") == runs, 120.0)

    run_motion(scenario, rehome="automatic")

    async def in_vain(rig):
        rig.motion.may_rehome = True
        rig.unit.telemetry_overrides["reference_doubt"] = "the count jumped"
        await asyncio.sleep(590.0)
        assert rig.positioner_events.count("homing") == 1
        await asyncio.sleep(60.0)
        assert rig.positioner_events.count("homing") == 2

    run_motion(in_vain, rehome="automatic")
