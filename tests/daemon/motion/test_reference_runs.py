"""One reference run from its order to its end, and what a clear forgives, with a hand-driven positioner."""

import asyncio

import pytest

from daemon.base.records import Pose, Target
from daemon.base.state import StateFolder
from daemon.motion.doubts import NOT_FINISHED, Doubts
from drivers.errors import LinkLostError, RefusedError
from tests.support.fake_positioner import run_motion


def clear_slowly(unit):
    """Let the unit take two seconds to clear its marks."""
    clear = unit.clear_faults

    async def slow(*, forgive=True):
        before = await clear(forgive=forgive)
        await asyncio.sleep(2.0)
        return before

    unit.clear_faults = slow


def test_a_reference_run_clears_homes_both_axes_and_ends_the_doubts():
    async def scenario(rig):
        rig.unit.telemetry_overrides |= {"was_reset": True, "reference_doubt": "the count jumped"}
        await asyncio.sleep(2.0)

        async def homed(axis):
            await home(axis)
            if axis == "b":
                rig.unit.telemetry_overrides.pop("reference_doubt")

        home, rig.unit.home = rig.unit.home, homed
        sent, began = len(rig.unit.sent), rig.changes
        rig.motion.home()
        await rig.until(lambda: rig.motion.homing, 2.0)
        assert not rig.motion.is_idle
        assert rig.motion._guard.rest_pose is None
        assert rig.changes > began
        await rig.until(lambda: not rig.motion.homing, 90.0)
        assert rig.unit.sent[sent:] == [("clear", False), ("home", "a"), ("home", "b"), "halt"]
        assert rig.positioner_events[-2:] == ["homing", "homing finished"]
        assert rig.motion.doubt is None

    run_motion(scenario)


@pytest.mark.parametrize(
    ("says", "words"),
    [
        ({"reference_doubt": "axis A missed its switch"}, "axis A missed its switch"),
        ({"faults": ("a_hall",)}, "a_hall"),
        ({"was_reset": True}, "the positioner has restarted"),
    ],
)
def test_a_reference_run_that_leaves_a_doubt_has_failed(says, words):
    async def scenario(rig):
        rig.motion.home()
        await asyncio.sleep(5.0)
        rig.unit.telemetry_overrides |= says
        await rig.until(lambda: not rig.motion.homing, 60.0)
        assert f"homing failed: {words}" in rig.positioner_events
        assert f"homing failed ({words}), the reference is in doubt: home it" in rig.motion.doubt
        assert ("home", "b") not in rig.unit.sent
        assert rig.unit.sent[-1] == "halt"

    run_motion(scenario)


def test_a_reference_run_that_does_not_end_is_given_up_after_a_quarter_of_an_hour():
    async def scenario(rig):
        rig.unit.homes_s = 1e6
        rig.motion.home()
        for at in range(89):
            await asyncio.sleep(10.0)
            rig.unit.put(at % 2, 60.0)
        assert rig.motion.homing
        await asyncio.sleep(20.0)
        assert not rig.motion.homing
        assert rig.positioner_events[-1] == "homing failed: axis A has not ended its reference run in time"

    run_motion(scenario)


def test_a_reference_run_on_which_the_axis_stands_is_given_up_after_a_minute():
    async def scenario(rig):
        rig.unit.homes_s = 1e6
        rig.motion.home()
        for at in range(3):
            await asyncio.sleep(50.0)
            rig.unit.put(at + 1.0, 60.0)
        await asyncio.sleep(58.0)
        assert rig.motion.homing
        await asyncio.sleep(5.0)
        assert not rig.motion.homing
        assert rig.positioner_events[-1] == "homing failed: axis A has not moved for 60 s, nor ended its reference run"
        assert rig.unit.sent[-1] == "halt"
        assert "the reference is in doubt: home it" in rig.motion.doubt

    run_motion(scenario)


@pytest.mark.parametrize("call", ["clear", "home"])
def test_a_reference_run_that_is_refused_is_reported_and_counts_as_not_finished(call):
    async def scenario(rig):
        rig.unit.refuses[call] = RefusedError("hand", "not now")
        rig.motion.home()
        await rig.until(lambda: "homing refused: not now" in rig.positioner_events, 5.0)
        await asyncio.sleep(2.0)
        assert not rig.motion.homing
        assert rig.motion.doubt == "homing was not finished, the reference is in doubt: home it"
        assert rig.unit.sent[-1] == "halt"

    run_motion(scenario)


@pytest.mark.parametrize("doubted", [False, True])
@pytest.mark.parametrize("ended_by", ["rest", "button"])
def test_a_reference_run_that_is_stopped_leaves_the_doubt_that_was_there_and_no_other(doubted, ended_by):
    async def scenario(rig):
        if doubted:
            rig.unit.telemetry_overrides["faults"] = ("a_hall",)
            await asyncio.sleep(2.0)
        rig.motion.home()
        await asyncio.sleep(5.0)
        if ended_by == "rest":
            rig.motion.request_stop()
        else:
            rig.unit.telemetry_overrides["button_pressed"] = True
        await rig.until(lambda: not rig.motion.homing, 3.0)
        assert rig.positioner_events[-1] == "homing was stopped before its end"
        assert (rig.motion.doubt is not None) == doubted
        assert rig.unit.sent[-1] == "halt"

    run_motion(scenario)


def test_a_clear_that_is_refused_is_reported_and_forgives_nothing():
    async def scenario(rig):
        rig.unit.telemetry_overrides["was_reset"] = True
        rig.unit.refuses["clear"] = RefusedError("hand", "not now")
        await asyncio.sleep(2.0)
        rig.motion.clear_faults()
        await asyncio.sleep(2.0)
        assert rig.positioner_events[-1] == "nothing was cleared: not now"
        assert rig.motion.doubt is not None
        rig.unit.telemetry_overrides["faults"] = ("a_hall",)
        await asyncio.sleep(2.0)
        rig.unit.telemetry_overrides["faults"] = ()
        await asyncio.sleep(2.0)
        assert "a_hall cleared by itself" in rig.motion.doubt, "it is not being cleared any more"

    run_motion(scenario)


def test_a_waiting_clear_is_dropped_by_a_stop_and_reported_as_dropped():
    async def scenario(rig):
        rig.unit.telemetry_overrides["reference_doubt"] = "the count jumped"
        await asyncio.sleep(2.0)
        rig.motion.order(Target(0.0, 90.0, "storm"), stow=True)
        await rig.until(lambda: rig.motion.target is not None)
        rig.motion.clear_faults()
        rig.motion.freeze("ana")
        assert rig.positioner_events[-1] == "nothing was cleared: a stop came first"
        await asyncio.sleep(5.0)
        assert rig.motion.doubt == "the count jumped"
        assert not [sent for sent in rig.unit.sent if sent[0] == "clear"]

    run_motion(scenario)


@pytest.mark.parametrize("shown", [True, False])
def test_a_clear_forgives_a_failed_move_only_if_it_was_shown(shown):
    async def scenario(rig):
        rig.unit.refuses["move"] = RefusedError("hand", "not taken")
        rig.motion.order(Target(10.0, 60.0, "go"))
        await rig.until(lambda: rig.moves)
        assert rig.motion.concerns == ("the last move failed (refused): not taken",)
        before = rig.changes
        rig.motion.clear_faults(None if shown else ())
        await asyncio.sleep(2.0)
        assert (rig.motion.doubt is None) == shown
        assert rig.changes > before

    run_motion(scenario, attempts=1)


def test_after_reference_runs_of_both_axes_in_vain_the_failure_is_reported_and_the_doubt_stays():
    async def scenario(rig):
        rig.unit.telemetry_overrides["reference_doubt"] = "the count jumped"
        await asyncio.sleep(2.0)
        rig.motion.home()
        await asyncio.sleep(60.0)
        assert ("home", "b") in rig.unit.sent
        assert rig.positioner_events[-1] == "homing failed: the count jumped"
        assert "homing finished" not in rig.positioner_events
        rig.unit.telemetry_overrides.pop("reference_doubt")
        await asyncio.sleep(60.0)
        assert rig.motion.doubt == "homing failed (the count jumped), the reference is in doubt: home it"

    run_motion(scenario)


def test_the_axis_that_is_homed_may_turn():
    async def scenario(rig):
        home = rig.unit.home

        async def turning(axis):
            await home(axis)
            rig.unit.drive(*((30.0, 60.0) if axis == "a" else (30.0, 90.0)))

        rig.unit.home = turning
        rig.motion.home()
        await asyncio.sleep(60.0)
        assert rig.positioner_events == ["homing", "homing finished"]
        assert rig.motion.unexplained_motion is rig.motion.doubt is None

    run_motion(scenario)


def test_a_reference_run_after_an_interrupted_and_a_failed_move_succeeds_and_ends_the_alarm():
    async def scenario(rig):
        rig.motion.order(Target(40.0, 60.0, "go"))
        await asyncio.sleep(3.0)
        rig.motion.request_stop()
        await rig.until(lambda: rig.moves)
        rig.unit.refuses["move"] = RefusedError("hand", "not taken")
        rig.motion.order(Target(40.0, 60.0, "go"))
        await rig.until(lambda: len(rig.moves) == 2)
        assert "move-failed" in rig.active_alarms
        rig.motion.home()
        await asyncio.sleep(60.0)
        assert rig.positioner_events[-1] == "homing finished"
        assert rig.motion.doubt is None
        assert "move-failed" not in rig.active_alarms

    run_motion(scenario, attempts=1)


def test_a_reference_run_is_kept_as_not_finished_until_it_ends(tmp_path):
    async def scenario(rig):
        rig.motion.home()
        await rig.until(lambda: rig.motion.homing, 3.0)
        assert Doubts(StateFolder(tmp_path)).reference == NOT_FINISHED
        await rig.until(lambda: not rig.motion.homing, 90.0)
        assert Doubts(StateFolder(tmp_path)).reference is None

    run_motion(scenario, folder=tmp_path)


@pytest.mark.parametrize("ask", ["clear", "home"])
def test_faults_that_the_unit_clears_on_request_leave_no_doubt_however_long_it_takes(ask):
    async def scenario(rig):
        rig.unit.telemetry_overrides["faults"] = ("a_hall",)
        await asyncio.sleep(2.0)
        clear_slowly(rig.unit)
        if ask == "clear":
            rig.motion.clear_faults()
        else:
            rig.motion.home()
        await asyncio.sleep(4.0)
        assert not [text for text in rig.motion.concerns if "cleared by itself" in text]
        rig.unit.telemetry_overrides["faults"] = ("b_hall",)
        await asyncio.sleep(2.0)
        rig.unit.telemetry_overrides["faults"] = ()
        await asyncio.sleep(2.0)
        assert [text for text in rig.motion.concerns if text.startswith("b_hall cleared by itself")]

    run_motion(scenario)


@pytest.mark.parametrize("doubted", [False, True])
def test_a_stop_while_marks_are_cleared_for_a_reference_run_keeps_it_from_beginning(doubted):
    async def scenario(rig):
        if doubted:
            rig.unit.telemetry_overrides["faults"] = ("a_hall",)
            await asyncio.sleep(2.0)
        clear_slowly(rig.unit)
        rig.motion.home()
        await asyncio.sleep(1.0)
        rig.motion.request_stop()
        await rig.until(lambda: not rig.motion.homing, 3.0)
        assert rig.positioner_events[-2:] == ["homing", "homing was stopped before its end"]
        assert rig.motion.doubt == (NOT_FINISHED if doubted else None)
        after = rig.unit.sent[rig.unit.sent.index(("clear", False)) :]
        assert set(after[1:]) == {"stop", "halt"}, "the stop ends what the driver is at"
        assert after[-1] == "halt"

    run_motion(scenario)


def test_the_axis_that_waits_for_its_reference_run_may_not_move():
    async def scenario(rig):
        rig.motion.home()
        await rig.until(lambda: ("home", "a") in rig.unit.sent)
        await asyncio.sleep(2.0)
        rig.unit.drive(0.0, 20.0)
        await rig.until(lambda: not rig.motion.homing, 5.0)
        assert rig.positioner_events[-1].startswith("homing failed: B moved from +60.0")
        assert rig.unit.place()[1] > 57.0, "it has been stopped"
        assert "B moved from" in rig.motion.unexplained_motion
        assert ("home", "b") not in rig.unit.sent

    run_motion(scenario)


def test_stray_motion_in_a_reference_run_stays_known_even_if_the_link_is_lost_at_its_halt():
    async def scenario(rig):
        rig.motion.home()
        await rig.until(lambda: ("home", "a") in rig.unit.sent)
        await asyncio.sleep(2.0)
        rig.unit.refuses["halt"] = LinkLostError("hand", "is gone")
        rig.unit.drive(0.0, 20.0)
        await rig.until(lambda: not rig.motion.connected, 5.0)
        del rig.unit.refuses["halt"]
        await rig.wait_until_connected()
        assert "B moved from" in rig.motion.unexplained_motion

    run_motion(scenario)


def test_a_good_reference_run_ends_with_a_look_at_rest():
    async def scenario(rig):
        rig.motion.home()
        await rig.until(lambda: "homing finished" in rig.positioner_events, 90.0)
        end = next(at for at, record in enumerate(rig.records) if getattr(record, "text", "") == "homing finished")
        assert not [record for record in rig.records[:end] if isinstance(record, Pose)][-1].moving

    run_motion(scenario)


@pytest.mark.parametrize("shown", [True, False])
def test_a_clear_lets_the_unit_forgive_a_doubt_only_where_it_was_shown(shown):
    async def scenario(rig):
        rig.unit.telemetry_overrides["reference_doubt"] = "the count jumped"
        await asyncio.sleep(2.0)
        rig.motion.clear_faults(None if shown else ())
        await asyncio.sleep(2.0)
        assert rig.unit.sent[-1] == ("clear", shown)
        assert (rig.motion.doubt is None) == shown

    run_motion(scenario)


def test_control_looks_again_at_the_end_of_a_reference_run():
    async def scenario(rig):
        rig.motion.home()
        await asyncio.sleep(5.0)
        before = rig.changes
        await rig.until(lambda: not rig.motion.homing, 90.0)
        await asyncio.sleep(5.0)
        assert rig.changes == before + 1

    run_motion(scenario)
