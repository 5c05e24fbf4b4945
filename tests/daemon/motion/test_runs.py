"""One move from its order to its end, with a hand-driven positioner: attempts, pauses and outcomes."""

import asyncio
import itertools
import logging
import math

import pytest

from daemon.base.records import MoveOutcome, Target
from drivers.errors import LinkLostError, RefusedError
from tests.support.fake_positioner import START_UTC_S, run_motion


def times_of(rig, name):
    """Record the times of a call to the unit, from now on [s]."""
    at_s, call = [], getattr(rig.unit, name)

    async def timed(*what, **named):
        at_s.append(rig.clock.monotonic())
        return await call(*what, **named)

    setattr(rig.unit, name, timed)
    return at_s


def test_the_record_of_a_move_has_its_start_target_end_duration_outcome_and_reason():
    async def scenario(rig):
        before_s = rig.clock.monotonic()
        assert rig.motion.last_move is None
        assert rig.motion.last_move_started_s == -math.inf
        rig.motion.order(Target(10.0, 50.0, "by the law"))
        await rig.until(lambda: rig.moves)
        move = rig.motion.last_move
        assert rig.moves == [move]
        assert (move.from_a_deg, move.from_b_deg, move.target_a_deg, move.target_b_deg) == (0.0, 60.0, 10.0, 50.0)
        assert (move.end_a_deg, move.end_b_deg) == (rig.motion.pose.a_deg, rig.motion.pose.b_deg)
        assert abs(move.end_a_deg - 10.0) <= 0.8
        assert 4.5 <= move.duration_s <= 8.0
        assert before_s <= move.time_monotonic_s == rig.motion.last_move_started_s < before_s + 0.2
        assert move.time_utc_s == pytest.approx(START_UTC_S + move.time_monotonic_s)
        assert (move.outcome, move.why) == (MoveOutcome.ARRIVED, "by the law")
        assert rig.motion.target is None

    run_motion(scenario)


def test_control_looks_again_at_the_end_of_a_move():
    async def scenario(rig):
        rig.motion.order(Target(10.0, 60.0, "go"))
        before = rig.changes
        await rig.until(lambda: rig.moves)
        await asyncio.sleep(0.1)
        assert rig.changes == before + 1

    run_motion(scenario)


@pytest.mark.parametrize("attempts", [1, 3])
def test_a_refused_target_is_tried_again_after_a_second_each_time_from_rest(attempts):
    async def scenario(rig):
        rig.unit.refuses["move"] = RefusedError("hand", "not taken")
        at_s = times_of(rig, "move_to")
        sent = len(rig.unit.sent)
        rig.motion.order(Target(10.0, 60.0, "go"))
        await rig.until(lambda: rig.moves)
        assert len(at_s) == attempts
        assert all(1.3 <= later - earlier <= 1.9 for earlier, later in itertools.pairwise(at_s))
        asked = [what if isinstance(what, str) else what[0] for what in rig.unit.sent[sent:]]
        assert asked == ["move", "halt"] * attempts
        pauses = attempts - 1
        assert sum(pose.moving for pose in rig.poses) == 2 * pauses, "each second of them is watched like a move"
        assert (rig.moves[-1].outcome, rig.moves[-1].why) == (MoveOutcome.REFUSED, "not taken")
        assert rig.active_alarms["move-failed"] == (
            "a move failed and waits to be tried again: the last move failed (refused): not taken"
        )
        assert rig.motion.doubt == "the last move failed (refused): not taken"

    run_motion(scenario, attempts=attempts)


def test_a_failed_move_is_accepted_again_after_its_pause_and_forgotten_once_a_move_arrives():
    async def scenario(rig):
        rig.unit.refuses["move"] = RefusedError("hand", "not taken")
        rig.motion.order(Target(10.0, 60.0, "go"))
        await rig.until(lambda: rig.moves)
        with pytest.raises(RefusedError, match="the last move failed"):
            rig.motion.order(Target(10.0, 60.0, "go"))
        rig.unit.refuses.clear()
        await asyncio.sleep(95.0)
        assert rig.motion.doubt is not None
        await asyncio.sleep(10.0)
        assert rig.motion.doubt is None
        rig.motion.order(Target(10.0, 60.0, "go"))
        await rig.until(lambda: len(rig.moves) == 2)
        assert rig.moves[-1].outcome is MoveOutcome.ARRIVED
        assert "move-failed" not in rig.active_alarms
        assert rig.motion.concerns == ()

    run_motion(scenario, attempts=1, retry_after_s=100.0)


def test_a_stow_that_failed_waits_for_its_own_pause_and_goes_then_without_being_asked_again():
    async def scenario(rig):
        rig.unit.refuses["move"] = RefusedError("hand", "not taken")
        rig.motion.order(Target(0.0, 90.0, "storm"), stow=True)
        await rig.until(lambda: rig.moves)
        failed_s = rig.clock.monotonic()
        assert rig.active_alarms["move-failed"].startswith("the stow failed")
        rig.unit.refuses.clear()
        at_s = times_of(rig, "move_to")
        rig.motion.order(Target(0.0, 90.0, "storm"), stow=True)
        await rig.until(lambda: len(rig.moves) == 2, 120.0)
        assert 59.0 <= at_s[0] - failed_s <= 61.0

    run_motion(scenario, attempts=1)


def test_an_axis_that_stalls_is_stopped_and_tried_again():
    async def scenario(rig):
        at_s = times_of(rig, "move_to")
        drive = rig.unit.drive
        rig.unit.drive = lambda a_deg, b_deg: drive(a_deg / 2.0, b_deg) if len(at_s) == 1 else drive(a_deg, b_deg)
        rig.unit.telemetry_overrides["supply_v"] = 24.0
        rig.motion.order(Target(20.0, 60.0, "go"))
        await rig.until(lambda: rig.moves, 90.0)
        assert rig.moves[-1].outcome is MoveOutcome.ARRIVED
        assert len(at_s) == 2
        assert rig.unit.sent.count("halt") >= 2
        assert not rig.active_alarms

    run_motion(scenario)


@pytest.mark.parametrize(
    ("says", "outcome"),
    [({"faults": ("a_hall",)}, MoveOutcome.STALLED), ({"reference_doubt": "a jump"}, MoveOutcome.STALLED)],
)
def test_a_fault_or_doubt_reported_during_a_move_ends_it_without_another_attempt(says, outcome):
    async def scenario(rig):
        at_s = times_of(rig, "move_to")
        rig.motion.order(Target(40.0, 60.0, "go"))
        await asyncio.sleep(4.0)
        rig.unit.telemetry_overrides |= says
        await rig.until(lambda: rig.moves, 3.0)
        await asyncio.sleep(10.0)
        assert rig.moves[-1].outcome is outcome
        assert len(at_s) == 1
        assert rig.unit.place()[0] < 15.0

    run_motion(scenario)


def test_a_stow_goes_on_with_the_reference_in_doubt():
    async def scenario(rig):
        rig.motion.order(Target(0.0, 90.0, "storm"), stow=True)
        await asyncio.sleep(4.0)
        rig.unit.telemetry_overrides["reference_doubt"] = "a jump"
        await rig.until(lambda: rig.moves)
        assert rig.moves[-1].outcome is MoveOutcome.ARRIVED

    run_motion(scenario)


@pytest.mark.parametrize(("restarts", "stow", "clears"), [
    (True, True, True), (False, True, False), (True, False, False),
])  # fmt: skip
def test_only_a_stow_that_a_restarted_unit_refuses_clears_the_mark_of_the_restart_first(restarts, stow, clears):
    async def scenario(rig):
        move_to = rig.unit.move_to

        async def once_cleared(a_deg, b_deg, *, first):
            if ("clear", False) in rig.unit.sent:
                return await move_to(a_deg, b_deg, first=first)
            rig.unit.telemetry_overrides["was_reset"] = restarts
            raise RefusedError("hand", "not taken")

        rig.unit.move_to = once_cleared
        rig.motion.order(Target(0.0, 70.0, "go"), stow=stow)
        await rig.until(lambda: rig.moves)
        assert (("clear", False) in rig.unit.sent) == clears
        assert rig.moves[-1].outcome is (MoveOutcome.ARRIVED if clears else MoveOutcome.REFUSED)

    run_motion(scenario)


def test_own_tracking_that_comes_on_in_an_attempt_ends_the_tries():
    async def scenario(rig):
        at_s = times_of(rig, "move_to")
        rig.unit.refuses["move"] = RefusedError("hand", "not taken")
        rig.unit.refuses["disable_autonomy"] = RefusedError("hand", "stays on")
        rig.motion.order(Target(40.0, 60.0, "go"))
        await rig.until(lambda: at_s)
        rig.unit.telemetry_overrides["autonomous"] = True
        await asyncio.sleep(6.0)
        assert len(at_s) == 1

    run_motion(scenario)


@pytest.mark.parametrize("when", ["on the way", "between two attempts", "at a refusal"])
def test_a_stop_interrupts_a_move_wherever_it_is(when):
    async def scenario(rig):
        at_s = times_of(rig, "move_to")
        if when == "on the way":
            rig.motion.order(Target(40.0, 60.0, "go"))
            await asyncio.sleep(3.0)
        else:
            rig.unit.refuses["move"] = RefusedError("hand", "not taken")
            rig.motion.order(Target(40.0, 60.0, "go"))
            await rig.until(lambda: at_s)
            await asyncio.sleep(0.1 if when == "at a refusal" else 0.6)
        rig.motion.request_stop()
        asked_s = rig.clock.monotonic()
        await rig.until(lambda: rig.moves, 5.0)
        assert rig.clock.monotonic() - asked_s < 0.5
        assert (rig.moves[-1].outcome, rig.moves[-1].why) == (MoveOutcome.INTERRUPTED, "go")
        assert "move-failed" not in rig.active_alarms
        await asyncio.sleep(10.0)
        assert len(at_s) == 1
        assert rig.unit.place()[0] < 8.0, "it has been stopped"

    run_motion(scenario)


def test_a_button_on_the_way_interrupts_the_move_and_stops_it():
    async def scenario(rig):
        rig.motion.order(Target(40.0, 60.0, "go"))
        await asyncio.sleep(3.0)
        rig.unit.telemetry_overrides["button_pressed"] = True
        await rig.until(lambda: rig.moves, 2.0)
        await asyncio.sleep(10.0)
        assert (rig.moves[-1].outcome, rig.moves[-1].why) == (MoveOutcome.INTERRUPTED, "go")
        assert rig.unit.place()[0] < 9.0

    run_motion(scenario)


def test_an_axis_set_going_by_a_refused_order_is_halted_and_is_no_unexplained_motion():
    async def scenario(rig):
        async def half_taken(_a_deg, _b_deg, *, first="a"):
            rig.unit.drive(0.0, 20.0)
            await asyncio.sleep(0.6)
            raise RefusedError("hand", f"{first} was taken and the other was not")

        rig.unit.move_to = half_taken
        rig.motion.order(Target(10.0, 20.0, "go"))
        await rig.until(lambda: rig.moves)
        await asyncio.sleep(10.0)
        assert rig.moves[-1].outcome is MoveOutcome.REFUSED
        assert rig.motion.unexplained_motion is None
        assert rig.unit.place()[1] > 50.0

    run_motion(scenario)


def test_an_axis_that_strays_between_two_attempts_is_stopped_and_ends_the_move():
    async def scenario(rig):
        at_s = times_of(rig, "move_to")
        rig.unit.refuses["move"] = RefusedError("hand", "not taken")
        rig.motion.order(Target(40.0, 60.0, "go"))
        await rig.until(lambda: at_s)
        await asyncio.sleep(0.4)
        rig.unit.drive(0.0, 20.0)
        await rig.until(lambda: rig.moves, 15.0)
        assert rig.moves[-1].outcome is MoveOutcome.OVERSHOT
        assert rig.moves[-1].why.startswith("B moved from +60.0")
        assert rig.unit.place()[1] > 58.8, "stopped at the next look, not at the end of the pause"
        assert len(at_s) == 1
        assert rig.motion.unexplained_motion

    run_motion(scenario)


def test_an_axis_that_makes_up_the_rest_of_the_last_move_is_halted_before_the_next_one():
    async def scenario(rig):
        rig.motion.order(Target(10.0, 60.0, "go"))
        await rig.until(lambda: rig.moves)
        sent = len(rig.unit.sent)
        rig.motion.order(Target(20.0, 60.0, "on"))
        await rig.until(lambda: len(rig.moves) == 2)
        assert rig.unit.sent[sent:] == ["halt", ("move", 20.0, 60.0, "a")]
        await asyncio.sleep(15.0)
        sent = len(rig.unit.sent)
        rig.motion.order(Target(30.0, 60.0, "on"))
        await rig.until(lambda: len(rig.moves) == 3)
        assert rig.unit.sent[sent:] == [("move", 30.0, 60.0, "a")], "it has settled"

    run_motion(scenario)


def test_a_failed_move_is_logged_as_a_warning_the_first_second_and_fourth_time(caplog):
    async def scenario(rig):
        rig.unit.refuses["move"] = RefusedError("hand", "not taken")
        for count in range(1, 5):
            rig.motion.order(Target(0.0, 90.0, "storm"), stow=True)
            await rig.until(lambda count=count: len(rig.moves) == count, 700.0)

    with caplog.at_level(logging.DEBUG, "heliocube.motion"):
        run_motion(scenario, attempts=1)
    levels = [record.levelno for record in caplog.records if record.getMessage() == "move failed: not taken"]
    assert levels == [logging.WARNING, logging.WARNING, logging.DEBUG, logging.WARNING]


def test_an_axis_that_goes_on_after_the_link_is_lost_while_its_target_is_sent_leaves_no_doubt():
    async def scenario(rig):
        async def half_sent(a_deg, b_deg, *, first="a"):
            rig.unit.drive(a_deg, b_deg)
            rig.unit.is_lost = True
            raise LinkLostError("hand", f"{first} may have been taken")

        rig.unit.move_to = half_sent
        rig.motion.order(Target(10.0, 60.0, "go"))
        await rig.until(lambda: rig.moves)
        assert rig.moves[-1].outcome is MoveOutcome.LINK_LOST
        await asyncio.sleep(3.0)
        rig.unit.is_lost = False
        await asyncio.sleep(15.0)
        assert rig.unit.place()[0] > 5.0
        assert rig.motion.doubt is None

    run_motion(scenario)


def test_the_last_attempt_that_stalls_ends_with_a_halt_too():
    async def scenario(rig):
        drive = rig.unit.drive
        rig.unit.drive = lambda a_deg, b_deg: drive(a_deg / 2.0, b_deg)
        rig.motion.order(Target(20.0, 60.0, "go"))
        await rig.until(lambda: rig.moves)
        assert rig.moves[-1].outcome is MoveOutcome.STALLED
        assert rig.unit.sent[-2:] == [("move", 20.0, 60.0, "a"), "halt"]

    run_motion(scenario, attempts=1)


def test_a_link_that_drops_at_every_move_is_a_failed_move_from_the_third_on():
    async def scenario(rig):
        rig.unit.refuses["move"] = LinkLostError("hand", "does not answer")
        for count in (1, 2, 3):
            assert "move-failed" not in rig.active_alarms
            await rig.until(lambda: rig.motion.connected and rig.motion.stands_since_s is not None)
            rig.motion.order(Target(10.0, 60.0, "go"))
            await rig.until(lambda count=count: len(rig.moves) == count)
        assert [move.outcome for move in rig.moves] == [MoveOutcome.LINK_LOST] * 3
        text = "the last move failed (link-lost): does not answer"
        assert rig.active_alarms["move-failed"] == f"a move failed and waits to be tried again: {text}"
        await rig.until(lambda: rig.motion.connected)
        assert rig.motion.doubt is None, "the next one has no pause"

    run_motion(scenario)
