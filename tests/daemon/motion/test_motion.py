"""The owner of the positioner, door by door, with a positioner in hand: what is taken, refused, forgotten and told."""

import asyncio
import logging
import math

import pytest

from daemon.base.records import MoveOutcome, Target
from daemon.motion.motion import Polling
from drivers.errors import DriverHungError, LinkLostError, RefusedError
from drivers.interfaces import PositionerIdentity
from tests.support.hand_positioner import HandPositioner, RepeatingPositioner, run_motion


@pytest.mark.parametrize("target", [(-50.1, 60), (50.1, 60), (0, 14.9), (0, 90.1), (math.nan, 60), (0, math.nan)])
def test_no_target_outside_the_limits_is_taken(target):
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


def test_before_the_first_contact_nothing_is_taken():
    async def scenario(rig):
        with pytest.raises(RefusedError, match="cannot move: no telemetry yet"):
            rig.motion.order(Target(0.0, 80.0, "storm"), stow=True)
        with pytest.raises(RefusedError, match="cannot be homed: no telemetry"):
            rig.motion.home()
        with pytest.raises(RefusedError, match="cannot be cleared: no telemetry"):
            rig.motion.clear_faults()
        assert rig.motion.blocked is None
        assert rig.motion.pose is None
        assert not rig.motion.connected
        assert not rig.motion.moving

    run_motion(scenario, connects=False)


@pytest.mark.parametrize(
    ("says", "stow_goes", "words"),
    [
        ({"faults": ("a_overcurrent", "b_hall")}, False, "the positioner reports a_overcurrent, b_hall"),
        ({"was_reset": True}, True, "has restarted and may have lost its reference"),
        ({"reference_doubt": "the count jumped"}, True, "the count jumped"),
        ({"button_pressed": True}, False, "a button is pressed at the unit: somebody is there"),
    ],
)
def test_what_the_unit_says_stands_in_the_way_of_a_move_and_of_a_stow(says, stow_goes, words):
    async def scenario(rig):
        rig.unit.says |= says
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


def test_a_setup_that_contradicts_stands_in_the_way_of_everything():
    async def scenario(rig):
        assert rig.motion.blocked == "A is long; B is short"
        assert rig.motion.concerns == ("A is long", "B is short")
        assert rig.raised["positioner-setup"] == "A is long; B is short"
        with pytest.raises(RefusedError, match="cannot be homed: A is long; B is short"):
            rig.motion.home()
        with pytest.raises(RefusedError, match="cannot move: A is long"):
            rig.motion.order(Target(0.0, 80.0, "storm"), stow=True)

    def contradicting(clock):
        unit = HandPositioner(clock)
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


def test_an_order_replaces_the_move_that_is_on_and_only_a_stow_a_reference_run():
    async def scenario(rig):
        rig.motion.order(Target(40.0, 60.0, "far"))
        await asyncio.sleep(3.0)
        assert rig.motion.moving
        assert not rig.motion.resting
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
def test_an_order_that_has_not_begun_is_taken_back(takes_back):
    async def scenario(rig):
        rig.motion.order(Target(40.0, 60.0, "far"))
        assert not rig.motion.resting
        if takes_back == "rest":
            rig.motion.rest()
        elif takes_back == "stop":
            await rig.motion.stop()
        elif takes_back == "home":
            rig.motion.home()
        else:
            rig.motion.freeze("ana")
            rig.motion.freeze(None)
        await asyncio.sleep(100.0)
        assert not rig.moves
        assert rig.motion.resting

    run_motion(scenario)


@pytest.mark.parametrize("ends", ["rest", "stop", "freeze"])
def test_a_reference_run_that_has_not_begun_is_taken_back_and_one_that_is_on_ends(ends):
    async def scenario(rig):
        for after_s in (0.0, 5.0):
            rig.motion.home()
            assert not rig.motion.resting
            if after_s:
                await asyncio.sleep(after_s)
            if ends == "rest":
                rig.motion.rest()
            elif ends == "stop":
                await rig.motion.stop()
            else:
                rig.motion.freeze("ana")
            await asyncio.sleep(3.0)
            assert not rig.motion.homing
            assert ("homing" in rig.told) == (after_s > 0)
            assert ("home", "b") not in rig.unit.sent
            rig.motion.freeze(None)
        assert rig.told[-1] == "homing was stopped before its end"
        assert rig.motion.doubt is None, "what was not in doubt before is not now"

    run_motion(scenario)


def test_while_it_is_frozen_nothing_is_taken_and_what_moves_is_stopped():
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


def test_what_comes_up_after_the_order_was_taken_keeps_it_from_beginning():
    async def scenario(rig):
        await asyncio.sleep(20.0)
        await rig.until(lambda: rig.clock.monotonic() - rig.motion.telemetry.time_monotonic_s > 0.2)
        rig.unit.says["reference_doubt"] = "the count jumped"
        rig.motion.order(Target(40.0, 60.0, "far"))
        await asyncio.sleep(3.0)
        assert not rig.moves
        assert rig.told[-1] == "no move: the count jumped"
        assert rig.motion.resting

    run_motion(scenario)


def test_a_stop_that_cannot_be_sent_is_told_and_sent_when_the_link_is_back():
    async def scenario(rig):
        rig.unit.is_lost = True
        with pytest.raises(LinkLostError):
            await rig.motion.stop()
        assert not rig.motion.resting
        rig.unit.is_lost = False
        await asyncio.sleep(10.0)
        assert "halt" in rig.unit.sent[-2:]
        assert rig.motion.resting

    run_motion(scenario)


def test_what_was_asked_before_the_link_was_lost_is_forgotten_and_a_clear_is_told():
    async def scenario(rig):
        rig.unit.is_lost = True
        rig.motion.order(Target(40.0, 60.0, "far"))
        rig.motion.clear_faults()
        await rig.until(lambda: not rig.motion.connected, 3.0)
        assert "nothing was cleared: the positioner was lost first" in rig.told
        rig.unit.is_lost = False
        await asyncio.sleep(20.0)
        rig.unit.is_lost = True
        rig.motion.home()
        await rig.until(lambda: not rig.motion.connected, 3.0)
        rig.unit.is_lost = False
        await asyncio.sleep(20.0)
        assert not rig.moves
        assert not [sent for sent in rig.unit.sent if sent[0] in ("clear", "home")]
        assert rig.told.count("nothing was cleared: the positioner was lost first") == 1

    run_motion(scenario)


@pytest.mark.parametrize(
    ("place", "jumps"),
    [((10.7, 60.7), False), ((10.9, 60.0), True), ((9.1, 60.0), True), ((10.0, 59.1), True), ((10.0, 60.9), True)],
)
def test_where_it_stands_after_a_loss_is_compared_with_where_it_stood(place, jumps):
    async def scenario(rig):
        await asyncio.sleep(10.0)
        rig.unit.is_lost = True
        await asyncio.sleep(3.0)
        assert not rig.motion.resting, "nobody knows"
        rig.unit.put(*place)
        rig.unit.is_lost = False
        await asyncio.sleep(15.0)
        doubt = rig.motion.doubt
        assert (doubt is not None) == jumps
        if jumps:
            stands = f"positioner stands at A {place[0]:.1f}, B {place[1]:.1f} deg"
            text = f"{stands}; before the loss it stood at A 10.0, B 60.0"
            assert doubt.startswith(text)
            assert doubt.endswith(": compare with the arms, then clear or home it")
            assert sum(told.startswith(text) for told in rig.told) == 1

    def at_ten(clock):
        unit = HandPositioner(clock)
        unit.put(10.0, 60.0)
        return unit

    run_motion(scenario, make=at_ten)


def test_what_was_on_its_way_when_the_link_was_lost_may_stand_elsewhere():
    async def scenario(rig):
        rig.motion.order(Target(40.0, 60.0, "far"))
        await asyncio.sleep(3.0)
        rig.unit.is_lost = True
        await asyncio.sleep(4.0)
        assert rig.moves[-1].outcome is MoveOutcome.LINK_LOST
        rig.unit.is_lost = False
        await asyncio.sleep(15.0)
        assert rig.motion.doubt is None
        assert 0.0 < rig.unit.place()[0] < 35.0

    run_motion(scenario)


def test_the_first_connection_is_logged_and_a_later_one_is_told(caplog):
    async def scenario(rig):
        assert not rig.told
        rig.unit.is_lost = True
        await asyncio.sleep(3.0)
        rig.unit.is_lost = False
        await asyncio.sleep(10.0)
        assert rig.told == [
            "the positioner is down: hand: does not answer",
            "the positioner is back: board, firmware 1, serial 7",
        ]

    with caplog.at_level(logging.INFO):
        run_motion(scenario)
    said = [record.getMessage() for record in caplog.records]
    assert said.count("the positioner is connected: board, firmware 1, serial 7") == 1


def test_control_is_told_when_readiness_changes_and_only_then():
    async def scenario(rig):
        assert rig.changes == 1
        await asyncio.sleep(20.0)
        assert rig.changes == 1
        for says, more in (({"faults": ("a",)}, 1), ({}, 0), ({"reference_doubt": "x"}, 0)):
            before = rig.changes
            rig.unit.says = dict(says)
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
        rig.unit.says["autonomous"] = True
        await rig.connected()
        assert rig.unit.sent[-2:] == ["disable_autonomy", "halt"]
        assert rig.motion.blocked is None
        rig.unit.refuses["disable_autonomy"] = RefusedError("hand", "stays on")
        rig.unit.says["autonomous"] = True
        await asyncio.sleep(1.0)
        assert rig.motion.blocked == "the positioner's own sun tracking is on"
        with pytest.raises(RefusedError, match="own sun tracking is on"):
            rig.motion.order(Target(0.0, 90.0, "storm"), stow=True)

    run_motion(scenario, connects=False)


def test_a_clear_forgives_what_was_shown_and_a_failed_move_with_it():
    async def scenario(rig):
        rig.unit.says |= {"faults": ("a_hall",), "was_reset": True}
        await asyncio.sleep(3.0)
        concerns = rig.motion.concerns
        assert concerns[0] == "the positioner reports a_hall"
        rig.motion.clear_faults(())
        assert not rig.motion.resting
        await asyncio.sleep(3.0)
        assert "a_hall was cleared before anybody had seen it: home the positioner" in rig.motion.concerns
        rig.motion.clear_faults()
        await asyncio.sleep(3.0)
        assert rig.motion.concerns == ()
        assert rig.unit.sent.count(("clear", True)) == 2

    run_motion(scenario)


def test_a_driver_that_only_a_new_process_can_mend_ends_it_and_what_is_known_is_given_up():
    async def scenario(rig):
        rig.unit.is_lost = True
        rig.unit.refuses["open"] = DriverHungError("hand", "hangs")

        async def hung():
            raise DriverHungError("hand", "hangs")

        rig.unit.open = hung
        await asyncio.sleep(30.0)

    with pytest.raises(DriverHungError):
        run_motion(scenario)

    async def given_up(rig):
        before = rig.changes
        rig.motion.give_up("the driver hangs")
        assert not rig.motion.connected
        assert rig.motion.blocked == "the driver hangs"
        assert rig.changes == before + 1

    run_motion(given_up)


def test_at_the_end_what_moves_is_halted_and_the_unit_is_closed():
    async def scenario(rig):
        rig.motion.order(Target(40.0, 60.0, "far"))
        await asyncio.sleep(3.0)

    rig = run_motion(scenario)
    assert rig.unit.sent[-2:] == ["halt", "close"]

    async def at_rest(rig):
        await asyncio.sleep(30.0)
        rig.halts = rig.unit.sent.count("halt")

    rig = run_motion(at_rest)
    assert rig.unit.sent.count("halt") == rig.halts
    assert rig.unit.sent[-1] == "close"


def test_at_the_end_a_halt_that_hangs_is_waited_for_three_seconds():
    async def scenario(rig):
        rig.motion.order(Target(40.0, 60.0, "far"))
        await asyncio.sleep(3.0)
        rig.unit.halt = lambda: asyncio.sleep(1e6)
        rig.end_s = rig.clock.monotonic()

    rig = run_motion(scenario)
    assert rig.unit.sent[-1] == "close"
    assert 2.9 <= rig.clock.monotonic() - rig.end_s <= 3.5


@pytest.mark.parametrize(("rehome", "homes"), [("automatic", True), ("operator", False)])
def test_a_doubt_is_homed_away_by_itself_only_where_that_is_wanted_and_allowed(rehome, homes):
    async def scenario(rig):
        rig.unit.says["was_reset"] = True
        await asyncio.sleep(20.0)
        assert "homing" not in rig.told, "control has not allowed it"
        rig.motion.may_rehome = True
        rig.motion.freeze("ana")
        await asyncio.sleep(20.0)
        assert "homing" not in rig.told
        rig.motion.freeze(None)
        await asyncio.sleep(120.0)
        assert ("homing" in rig.told) == homes
        assert (rig.motion.doubt is None) == homes

    run_motion(scenario, rehome=rehome)


def test_it_looks_as_often_as_it_is_told():
    async def scenario(rig):
        assert rig.motion.looks_every_s == 7.0
        await asyncio.sleep(10.0)
        looks = rig.unit.looks
        await asyncio.sleep(70.0)
        assert rig.unit.looks - looks == 10
        rig.motion.order(Target(40.0, 60.0, "far"))
        looks = rig.unit.looks
        await asyncio.sleep(10.0)
        assert 5 <= rig.unit.looks - looks <= 8, "one ends the rest"

    run_motion(scenario, polling=Polling(idle_s=7.0, moving_s=2.0))


def test_a_reference_run_ends_the_move_that_is_on_and_is_made():
    async def scenario(rig):
        rig.motion.order(Target(40.0, 60.0, "far"))
        await asyncio.sleep(3.0)
        rig.motion.home()
        await rig.until(lambda: rig.motion.homing, 2.0)
        assert rig.moves[-1].outcome is MoveOutcome.INTERRUPTED
        await rig.until(lambda: not rig.motion.homing, 90.0)
        assert rig.told == ["homing", "homing finished"]

    run_motion(scenario)


@pytest.mark.parametrize("asks", ["order", "home", "clear"])
def test_what_is_asked_at_rest_begins_without_waiting_for_the_next_look(asks):
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
        await rig.until(lambda: rig.motion.unexplained, 5.0)
        await asyncio.sleep(10.0)
        with pytest.raises(RefusedError, match="cannot be homed: A moved from"):
            rig.motion.home()

    run_motion(scenario)


def test_a_unit_that_repeats_itself_is_read_each_time_while_something_may_be_due():
    async def scenario(rig):
        async def looks_in_5_s():
            looks = rig.unit.looks
            await asyncio.sleep(5.0)
            return rig.unit.looks - looks

        await asyncio.sleep(20.0)
        assert await looks_in_5_s() <= 2
        rig.unit.refuses["move"] = RefusedError("hand", "not taken")
        rig.motion.order(Target(10.0, 60.0, "go"))
        await asyncio.sleep(20.0)
        assert await looks_in_5_s() >= 9, "a pause may end"
        rig.motion.clear_faults()
        await asyncio.sleep(20.0)
        assert await looks_in_5_s() <= 2
        rig.unit.says["reference_doubt"] = "the count jumped"
        await asyncio.sleep(20.0)
        assert await looks_in_5_s() >= 9, "control may let it home"

    run_motion(scenario, make=RepeatingPositioner, attempts=1)


def test_a_second_restart_after_a_good_run_is_homed_at_once_and_a_run_that_was_no_good_waits():
    async def scenario(rig):
        rig.motion.may_rehome = True
        for runs in (1, 2):
            rig.unit.says["was_reset"] = True
            await rig.until(lambda runs=runs: rig.told.count("homing finished") == runs, 120.0)

    run_motion(scenario, rehome="automatic")

    async def in_vain(rig):
        rig.motion.may_rehome = True
        rig.unit.says["reference_doubt"] = "the count jumped"
        await asyncio.sleep(590.0)
        assert rig.told.count("homing") == 1
        await asyncio.sleep(60.0)
        assert rig.told.count("homing") == 2

    run_motion(in_vain, rehome="automatic")


def test_at_the_end_a_target_that_was_only_just_sent_is_halted_too():
    async def scenario(rig):
        rig.motion.order(Target(40.0, 60.0, "far"))
        await rig.until(lambda: rig.unit.sent[-1] == ("move", 40.0, 60.0, "a"), 1.0)
        assert rig.motion.stands_since_s is not None

    rig = run_motion(scenario)
    assert rig.unit.sent[-2:] == ["halt", "close"]


def test_at_the_end_a_stop_that_is_broken_off_is_sent_again():
    async def scenario(rig):
        await asyncio.sleep(30.0)
        rig.halts = rig.unit.sent.count("halt")
        rig.motion.freeze("ana")
        await rig.until(lambda: rig.unit.sent.count("halt") > rig.halts)

    rig = run_motion(scenario)
    assert rig.unit.sent.count("halt") == rig.halts + 2


def test_at_the_end_a_unit_that_does_not_answer_is_not_waited_for():
    async def scenario(rig):
        rig.unit.is_lost = True
        await asyncio.sleep(3.0)
        rig.halts = rig.unit.sent.count("halt")

    rig = run_motion(scenario)
    assert rig.unit.sent.count("halt") == rig.halts
