"""An operator's commands, and whether the answers say what the tracker truly did."""

import asyncio
import math
from datetime import UTC, datetime
from types import SimpleNamespace

import pytest

from daemon.base.records import Event, Mode, Target
from daemon.config.settings import Settings
from daemon.service.operator import CommandError, Operator, _Approach
from daemon.service.operator_commands import Operators, parse
from daemon.service.rig import Role
from sim_drivers.pozsol.setup import AxisDrive, Setup
from tests.support.motion import commands_sent, override_telemetry
from tests.support.phases import wait_for_move, wait_for_rest, wait_for_tracking
from tests.support.rig import ManualWeather, ServiceRig


def operator(rig):
    return Operator(rig.tracker, 1.0)


def angles(rig):
    """Where the unit truly stands, as an answer writes it."""
    a_deg, b_deg = rig.truth()
    return f"standing at A {a_deg:+.1f}, B {b_deg:.1f} deg"


def test_a_stop_in_mid_move_is_sent_first_and_the_answer_says_where_the_tracker_stands(run_rig, monkeypatch):
    async def scenario(rig):
        await wait_for_move(rig)
        sent, asked_s = commands_sent(rig, monkeypatch), rig.clock.monotonic()
        answer = await operator(rig).stop("a hand near the actuator", "ana@lab")
        assert sent[0][1].startswith(b"$9s")
        assert sent[0][0] - asked_s < 0.2
        assert answer.done
        assert answer.text.startswith("stopped on the way to A ")
        assert f"; {angles(rig)}; mode hold: stopped by ana@lab since 2022-10-12 10:0" in answer.text
        assert answer.text.endswith(" UTC: a hand near the actuator")
        await asyncio.sleep(900)
        assert angles(rig) in answer.text, "it stays where it was stopped"

    run_rig(scenario)


def test_a_stow_in_mid_move_stops_the_axes_first_and_the_answer_says_where_the_tracker_goes(run_rig, monkeypatch):
    async def scenario(rig):
        await wait_for_move(rig)
        sent, asked_s = commands_sent(rig, monkeypatch), rig.clock.monotonic()
        answer = await operator(rig).stow("storm")
        assert sent[0][1].startswith(b"$9s")
        assert sent[0][0] - asked_s < 0.2
        assert (answer.done, answer.seen) == (False, "under-way")
        assert answer.text.startswith("moving to A +0.0, B 90.0 deg, now at A ")
        assert answer.text.endswith("; mode stow: storm")
        await wait_for_rest(rig)
        assert rig.truth() == (pytest.approx(0, abs=0.9), pytest.approx(90, abs=0.9))
        again = await operator(rig).stow("storm")
        assert again.done
        assert again.text.startswith(f"{angles(rig)}; mode stow: storm; this replaces: stowed since ")

    run_rig(scenario)


@pytest.mark.parametrize(
    ("begin", "first"),
    [
        (lambda rig: rig.control.goto(30, 50, "test"), b"$."),
        # The unit reports a reference run up to three seconds after the order.
        (lambda rig: rig.control.home(), b"$95"),
    ],
)
def test_a_stow_while_another_order_is_being_sent_does_not_wait_for_that_order_to_take_effect(
    run_rig, monkeypatch, begin, first
):
    async def scenario(rig):
        await wait_for_tracking(rig)
        await wait_for_rest(rig)
        sent = commands_sent(rig, monkeypatch)
        begin(rig)
        await rig.until(lambda: any(data.startswith(first) for _, data in sent), 10, "the order", 0.01)
        before, asked_s = len(sent), rig.clock.monotonic()
        await operator(rig).stow("storm")
        assert sent[before][1].startswith(b"$9s")
        assert sent[before][0] - asked_s < 0.05
        await wait_for_rest(rig)
        assert rig.truth() == (pytest.approx(0, abs=0.9), pytest.approx(90, abs=0.9))

    run_rig(scenario)


def test_a_second_stow_does_not_stop_the_first(run_rig, monkeypatch):
    async def scenario(rig):
        await wait_for_tracking(rig)
        await wait_for_rest(rig)
        await operator(rig).stow("storm")
        await asyncio.sleep(3)
        sent = commands_sent(rig, monkeypatch)
        assert (await operator(rig).stow("storm")).seen == "under-way"
        assert not sent

    run_rig(scenario)


@pytest.mark.parametrize("target", [(51, 60), (0, 14.9), (math.nan, 60), (0, math.inf)])
def test_goto_outside_the_limits_is_refused_with_the_limits(run_rig, target):
    async def scenario(rig):
        await wait_for_tracking(rig)
        with pytest.raises(CommandError, match=r"outside the limits \(A -50\.\.50 deg, B 15\.\.90 deg\)") as refused:
            await operator(rig).goto(*target, "test")
        assert refused.value.wrong
        assert rig.mode is Mode.TRACKING

    run_rig(scenario)


def test_goto_moves_to_its_target_and_auto_resumes_tracking(run_rig):
    async def scenario(rig):
        await wait_for_tracking(rig)
        await wait_for_rest(rig)
        answer = await operator(rig).goto(-20, 70, "look at the other side")
        assert (answer.done, answer.seen) == (False, "under-way")
        assert answer.text.startswith("moving to A -20.0, B 70.0 deg, now at A ")
        await wait_for_rest(rig)
        await asyncio.sleep(11)
        again = await operator(rig).goto(-20, 70, "again")
        assert again.done
        assert again.text.startswith(f"{angles(rig)}; mode hold: again; this replaces: held since ")
        assert "mode tracking: " in (await operator(rig).auto("done")).text

    run_rig(scenario)


def test_hold_stops_a_move(run_rig):
    async def scenario(rig):
        await wait_for_move(rig)
        answer = await operator(rig).hold("measurement")
        assert answer.done
        assert answer.text == f"{angles(rig)}; mode hold: measurement"

    run_rig(scenario)


def test_hold_home_and_goto_are_refused_while_stowed_and_the_refusal_says_what_ends_that(run_rig):
    async def scenario(rig):
        await wait_for_tracking(rig)
        await operator(rig).stow("storm")
        for call in (operator(rig).hold, operator(rig).home, lambda why: operator(rig).goto(0, 60, why)):
            with pytest.raises(CommandError, match=r"while the tracker is stowed \(storm\): 'heliocube auto' ends"):
                await call("x")
        assert rig.mode is Mode.STOW

    run_rig(scenario)


def test_stop_outranks_every_stow_until_auto_and_the_answer_says_so(run_rig):
    async def scenario(rig):
        await wait_for_tracking(rig)
        await wait_for_rest(rig)
        await operator(rig).stow("storm")
        stopped = await operator(rig).stop("wait")
        assert stopped.text.endswith(" UTC: wait; stow is wanted and not done (storm)")
        rig.wind_m_s = 20.0
        await asyncio.sleep(120)
        assert rig.mode is Mode.HOLD
        await operator(rig).auto("clear of the axes")
        await rig.until_mode(Mode.STOW, 10)
        await asyncio.sleep(2)
        stopped = await operator(rig).stop("wait")
        assert "mode hold: stopped since " in stopped.text
        assert "; stow is wanted and not done (wind 20.0 m/s" in stopped.text

    run_rig(scenario)


@pytest.mark.parametrize("in_doubt", [False, True])
def test_answers_to_home_and_clear_say_what_the_positioner_does(run_rig, in_doubt):
    async def scenario(rig):
        await wait_for_tracking(rig)
        await wait_for_rest(rig)
        if in_doubt:
            rig.unit.power_cycle(rig.clock.monotonic())
            await rig.until_mode(Mode.FAULT, 10)
        answer = await operator(rig).home("reference")
        assert (answer.done, answer.seen) == (False, "under-way")
        assert answer.text.startswith("homing, now at A ")
        with pytest.raises(CommandError, match="on a reference run and takes no target until it has ended"):
            await operator(rig).goto(0, 60, "x")
        await wait_for_rest(rig)
        assert (await operator(rig).clear("marks")).done

    run_rig(scenario)


def test_a_reference_run_is_under_way_once_the_positioner_reports_it_before_any_axis_has_turned(run_rig):
    async def scenario(rig):
        await wait_for_tracking(rig)
        await wait_for_rest(rig)
        for axis in "ab":
            rig.unit.inject(f"{axis}_hall_loss", rig.clock.monotonic())
        assert (await operator(rig).home("reference")).seen == "under-way"

    run_rig(scenario)


def test_a_reference_run_that_ends_between_two_checks_counts_as_done(run_rig):
    async def scenario(rig):
        await wait_for_tracking(rig)
        await wait_for_rest(rig)
        await operator(rig).home("reference")
        await wait_for_rest(rig)
        # At this speed four seconds of the clock pass between two looks.
        answer = await Operator(rig.tracker, 200.0).home("once more")
        assert (answer.done, answer.seen) == (True, "done")
        assert answer.text.startswith("standing at A ")

    run_rig(scenario, setup=Setup(drive=AxisDrive(100.0, acceleration_mm_s2=200.0)))


def test_clear_waits_for_a_positioner_that_reports_its_status_every_three_seconds(run_rig):
    async def scenario(rig):
        await wait_for_tracking(rig)
        await wait_for_rest(rig)
        clear = rig.positioner.clear_faults

        async def with_two_statuses(*, forgive):
            await asyncio.sleep(7.2)
            return await clear(forgive=forgive)

        rig.positioner.clear_faults = with_two_statuses
        rig.unit.inject("a_overcurrent", rig.clock.monotonic())
        await rig.until_mode(Mode.FAULT, 15)
        assert (await operator(rig).clear("looked")).done

    run_rig(scenario)


def test_a_reference_run_that_the_positioner_never_begins_is_not_reported_as_under_way(run_rig, monkeypatch):
    async def scenario(rig):
        await wait_for_tracking(rig)
        await wait_for_rest(rig)
        feed = rig.unit.feed
        monkeypatch.setattr(rig.unit, "feed", lambda data, now: data.startswith((b"$95", b"$96")) or feed(data, now))
        answer = await operator(rig).home("the count slipped")
        assert answer.seen == "not-seen"
        assert "homing was not finished" in answer.text

    run_rig(scenario)


def test_a_fault_blocks_goto_until_a_person_clears_it_and_the_answer_names_the_fault(run_rig):
    async def scenario(rig):
        await wait_for_move(rig)
        rig.unit.inject("a_overcurrent", rig.clock.monotonic())
        await rig.until_mode(Mode.FAULT, 15)
        await wait_for_rest(rig)
        with pytest.raises(CommandError, match=r"the tracker cannot go anywhere: .*a_overcurrent"):
            await operator(rig).goto(0, 60, "x")
        answer = await operator(rig).clear("it turns freely", "ana")
        assert answer.done
        assert answer.text.startswith("forgiven: ")
        assert "a_overcurrent" in answer.text
        assert "; mode fault: " not in answer.text, "what is cleared keeps it no longer"
        again = await operator(rig).clear("once more")
        assert again.text.startswith("nothing was shown that could be cleared; ")
        assert "acknowledged positioner-fault by ana: clear" in [event.text for event in rig.records_of(Event)]

    run_rig(scenario)


def test_a_stop_that_cannot_be_sent_says_so_and_is_sent_first_when_the_link_is_back(run_rig, monkeypatch):
    async def scenario(rig):
        await wait_for_move(rig)
        rig.cables.positioner.link_up = False
        with pytest.raises(CommandError, match="stop could not be sent, and is sent as soon as") as told:
            await operator(rig).stop("halt")
        assert not told.value.wrong
        await rig.until(lambda: not rig.motion.connected, 5, "the loss")
        sent = commands_sent(rig, monkeypatch)
        rig.cables.positioner.link_up = True
        await rig.until_mode(Mode.HOLD, 60)
        assert sent[0][1].startswith(b"$9s")
        await asyncio.sleep(3)
        stands = rig.truth()
        await asyncio.sleep(900)
        assert rig.truth() == stands

    run_rig(scenario)


def test_without_telemetry_each_command_is_refused_with_a_sentence_that_says_why(run_rig):
    async def scenario(rig):
        await wait_for_tracking(rig)
        rig.cables.positioner.link_up = False
        await rig.until(lambda: not rig.motion.connected, 15, "the loss")
        for call in (operator(rig).home, operator(rig).clear, lambda why: operator(rig).goto(0, 60, why)):
            with pytest.raises(CommandError, match=r"the tracker cannot .*: positioner: is unplugged"):
                await call("x")
        with pytest.raises(CommandError, match="outside the limits"):
            await operator(rig).goto(51, 60, "x")
        with pytest.raises(CommandError, match="stop could not be sent"):
            await operator(rig).stop("x")
        with pytest.raises(CommandError, match="no clear: the tracker is stopped"):
            await operator(rig).clear("x")

    run_rig(scenario)


def test_every_accepted_command_is_recorded_as_an_event_with_its_reason(run_rig):
    async def scenario(rig):
        with pytest.raises(CommandError, match="the tracker cannot be homed: the positioner has not answered yet"):
            await operator(rig).home("too early")
        await wait_for_tracking(rig)
        desk = operator(rig)
        with pytest.raises(CommandError, match="there is nothing to forget: the law flat learns nothing"):
            await desk.relearn("nothing came of it")
        await desk.goto(-20, 70, "shading test")
        for command in (desk.auto, desk.snow, desk.hold, desk.stow, desk.auto, desk.home, desk.clear, desk.maintenance):
            await command("because", "ana")
        told = [event.text for event in rig.records_of(Event) if event.subject == "operator"]
        names = ("auto", "snow", "hold", "stow", "auto", "home", "clear faults", "maintenance")
        assert told == ["goto A -20, B 70 deg: shading test", *(f"{name}: because (ana)" for name in names)]

    run_rig(scenario, law={"name": "flat"})


def test_the_cubes_process_has_no_tracker_to_command():
    async def scenario():
        start = datetime(2022, 10, 12, 10, tzinfo=UTC)
        rig = ServiceRig(asyncio.get_running_loop(), Settings(), start, ManualWeather(), Role.CUBE)
        operators = Operators(rig.service.trackers, 1.0)
        for name, body in (("stow", b""), ("home", b""), ("goto", b'{"a_deg": 0, "b_deg": 60}')):
            with pytest.raises(CommandError, match="has no tracker: ask the tracker's process"):
                await operators.carry_out(parse(name, body, "test"))

    asyncio.run(scenario())


@pytest.mark.parametrize(
    ("a_deg", "b_deg", "heads_for", "seen"),
    [
        (0.0, 40.0, (20.0, 40.0), None),
        (0.14, 40.0, (20.0, 40.0), None),
        (0.16, 40.0, (20.0, 40.0), "under-way"),
        (0.1, 39.9, (20.0, 40.0), None),
        (5.0, 40.0, (-20.0, 40.0), None),
        (-5.0, 40.0, (20.0, 40.0), None),
    ],
)
def test_a_move_is_under_way_once_the_tracker_was_seen_to_come_nearer_to_the_requested_target(
    a_deg, b_deg, heads_for, seen
):
    motion = SimpleNamespace(
        pose=SimpleNamespace(a_deg=0.0, b_deg=40.0), connected=True, target=Target(*heads_for, ""), homing=False
    )
    approach = _Approach(motion, Target(20.0, 40.0, ""), 0.5)
    assert approach.seen() is None
    motion.pose = SimpleNamespace(a_deg=a_deg, b_deg=b_deg)
    assert approach.seen() == seen


@pytest.mark.parametrize(
    ("a_deg", "b_deg", "homing", "stands_s", "seen"),
    [
        (20.5, 40.5, False, 7.0, "done"),
        (20.0, 41.0, False, 7.0, None),
        (21.0, 40.0, False, 7.0, None),
        (20.0, 40.0, True, 7.0, None),
        (20.0, 40.0, False, None, None),
    ],
)
def test_a_move_is_done_only_when_the_tracker_stands_with_both_axes_at_the_target(a_deg, b_deg, homing, stands_s, seen):
    pose = SimpleNamespace(a_deg=a_deg, b_deg=b_deg)
    motion = SimpleNamespace(pose=pose, connected=True, target=None, homing=homing, stands_since_s=stands_s)
    assert _Approach(motion, Target(20.0, 40.0, ""), 0.5).seen() == seen


def test_coming_nearer_to_the_target_is_measured_from_the_farthest_position_seen():
    heading = Target(20.0, 40.0, "")
    motion = SimpleNamespace(pose=None, connected=True, target=heading, homing=False)
    approach = _Approach(motion, heading, 0.5)
    assert approach.seen() is None, "nobody knows where it is"
    for a_deg, seen in ((0.0, None), (-5.0, None), (-4.9, None), (-4.8, "under-way")):
        motion.pose = SimpleNamespace(a_deg=a_deg, b_deg=40.0)
        assert approach.seen() == seen


def test_hold_is_not_reported_as_done_while_the_positioner_is_about_to_make_a_reference_run(run_rig):
    async def scenario(rig):
        await wait_for_tracking(rig)
        await wait_for_rest(rig)
        override_telemetry(rig, aims_home=True)
        assert (await operator(rig).hold("x")).seen == "not-seen"
        del rig.positioner.read_telemetry
        assert (await operator(rig).hold("x")).done

    run_rig(scenario)
