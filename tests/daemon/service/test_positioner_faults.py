"""The positioner is lost, refuses, stalls or restarts: what the tracker does, and what it leaves to a person."""

import asyncio
import logging
from dataclasses import replace

import pytest

from daemon.base.records import Decision, Event, Mode, Move, MoveOutcome, Pose
from daemon.service.operator import CommandError, Operator
from tests.support.motion import TRACKING_OFF_PACKET, commands_sent, override_telemetry, target_packets
from tests.support.phases import wait_for_long_rest, wait_for_move, wait_for_rest, wait_for_tracking


def test_positioner_settings_that_may_move_it_by_itself_are_reported_once(run_rig, caplog):
    async def scenario(rig):
        read = rig.positioner.read_telemetry

        async def with_setting():
            return replace(await read(), own_moves=("a night position (108=-50.0, 109=off)",))

        rig.positioner.read_telemetry = with_setting
        await wait_for_tracking(rig)
        await asyncio.sleep(600)

    rig = run_rig(scenario)
    told = "the positioner may move by itself: a night position (108=-50.0, 109=off)"
    assert [event.text for event in rig.records_of(Event)].count(told) == 1
    assert [record.getMessage() for record in caplog.records].count(told) == 1


def test_after_a_reconnection_the_first_command_is_stop_and_the_first_move_a_new_decision(run_rig, monkeypatch):
    async def scenario(rig):
        await wait_for_move(rig)
        rig.cables.positioner.link_up = False
        await rig.until_mode(Mode.FAULT, 15)
        assert "unplugged" in rig.control.why
        await asyncio.sleep(70)
        sent = commands_sent(rig, monkeypatch)
        back = rig.clock.monotonic()
        rig.cables.positioner.link_up = True
        await rig.until_mode(Mode.TRACKING, 15)
        await rig.until(lambda: any(data.startswith(b"$.") for _, data in sent), 400, "a move")
        assert sent[0][1].startswith(b"$9s"), f"the first command was {sent[0]}"
        decision = rig.records_of(Decision)[-1]
        assert decision.time_monotonic_s > back
        assert decision.moved

    rig = run_rig(scenario)
    assert MoveOutcome.LINK_LOST in [move.outcome for move in rig.records_of(Move)]
    told = [event.text for event in rig.records_of(Event) if event.subject == "positioner"]
    assert [text.split(":")[0] for text in told][:2] == ["the positioner is down", "the positioner is back"]


def test_a_lost_reference_waits_for_the_operator_and_homing_restores_it(run_rig):
    async def scenario(rig):
        await wait_for_tracking(rig)
        await wait_for_rest(rig)
        rig.unit.power_cycle(rig.clock.monotonic(), keep_position=False)
        await rig.until_mode(Mode.FAULT, 15)
        before = len(rig.records_of(Move))
        await asyncio.sleep(1200)
        assert len(rig.records_of(Move)) == before, "nothing moves without a reference"
        assert "home it" in rig.control.why
        rig.control.home()
        await rig.until_mode(Mode.STARTING, 15)
        await rig.until_mode(Mode.TRACKING, 900)
        await asyncio.sleep(400)
        truth, target = rig.truth(), rig.records_of(Decision)[-1].target
        assert truth.a_deg == pytest.approx(target.a_deg, abs=1.2)
        assert truth.b_deg == pytest.approx(target.b_deg, abs=1.2)

    run_rig(scenario)


def test_with_rehome_automatic_the_tracker_homes_by_itself(run_rig):
    async def scenario(rig):
        await wait_for_tracking(rig)
        rig.unit.power_cycle(rig.clock.monotonic(), keep_position=True)
        await rig.until(lambda: rig.motion.homing, 30, "homing")
        await rig.until_mode(Mode.TRACKING, 900)

    run_rig(scenario, motion={"rehome": "automatic"})


@pytest.mark.parametrize("wish", ["hold", "snow"])
def test_the_tracker_does_not_home_by_itself_while_a_person_holds_it(run_rig, wish):
    async def scenario(rig):
        await wait_for_long_rest(rig)
        getattr(rig.control, wish)("somebody on the roof")
        await asyncio.sleep(1)
        await wait_for_rest(rig)
        before = rig.truth()
        rig.unit.power_cycle(rig.clock.monotonic(), keep_position=True)
        await rig.until_mode(Mode.FAULT, 15)
        await asyncio.sleep(1200)
        assert not rig.motion.homing
        assert rig.truth() == before
        rig.control.auto()
        await rig.until(lambda: rig.motion.homing, 30, "homing")

    run_rig(scenario, motion={"rehome": "automatic"})


def test_overcurrent_in_mid_move_ends_in_a_fault_that_names_it_and_waits_to_be_cleared(run_rig):
    async def scenario(rig):
        await wait_for_move(rig)
        rig.unit.inject("a_overcurrent", rig.clock.monotonic())
        await rig.until_mode(Mode.FAULT, 15)
        assert "a_overcurrent" in rig.control.why
        await asyncio.sleep(60)
        rig.control.clear_faults()
        await rig.until_mode(Mode.TRACKING, 30)

    rig = run_rig(scenario)
    assert rig.records_of(Move)[0].outcome is MoveOutcome.STALLED


def test_a_move_that_the_positioner_silently_refuses_is_noticed_explained_and_tried_again_later(run_rig):
    async def scenario(rig):
        rig.unit.inject("undervoltage", rig.clock.monotonic())
        await rig.until_mode(Mode.FAULT, 120)
        assert "supply" in rig.control.why
        rig.unit.repair("undervoltage", rig.clock.monotonic())
        await rig.until_mode(Mode.TRACKING, 650)
        await rig.until(lambda: rig.records_of(Move)[-1].outcome == "arrived", 300, "a move that arrives")

    rig = run_rig(scenario)
    assert rig.records_of(Move)[0].outcome is MoveOutcome.REFUSED


def test_an_axis_whose_hall_sensor_fails_ends_in_fault_with_a_stalled_move_that_names_it(run_rig):
    async def scenario(rig):
        await wait_for_tracking(rig)
        await wait_for_rest(rig)
        rig.unit.inject("a_hall_loss", rig.clock.monotonic())
        rig.control.goto(20, 60, "test")
        await rig.until_mode(Mode.FAULT, 60)
        await wait_for_rest(rig)

    rig = run_rig(scenario)
    move = rig.records_of(Move)[-1]
    assert (move.outcome, move.why) == (MoveOutcome.STALLED, "the positioner reports a_hall_fault")


def test_the_positioners_own_tracking_is_switched_off_first_and_a_goto_given_then_is_not_sent(run_rig, monkeypatch):
    async def scenario(rig):
        await wait_for_tracking(rig)
        await wait_for_rest(rig)
        sent = commands_sent(rig, monkeypatch)
        rig.unit.inject("own_tracking", rig.clock.monotonic())
        rig.control.goto(20, 60, "test")
        await rig.until(lambda: sent and not rig.motion.telemetry.autonomous, 30, "own tracking off")
        assert sent[0][1] == TRACKING_OFF_PACKET
        assert not target_packets(sent)
        rig.control.auto()
        await rig.until_mode(Mode.TRACKING, 60)

    run_rig(scenario)


def test_hours_without_the_positioner_write_few_lines(run_rig, caplog):
    async def scenario(rig):
        await wait_for_tracking(rig)
        rig.cables.positioner.link_up = False
        await asyncio.sleep(2 * 3600)
        rig.cables.positioner.link_up = True
        await asyncio.sleep(60)

    with caplog.at_level(logging.INFO):
        run_rig(scenario, cube={"scan_every_s": 60}, safety={"scan_stale_s": 130, "fallback_after_s": 600})
    lines = [r for r in caplog.records if "positioner" in r.getMessage() and r.levelno >= logging.INFO]
    assert 2 <= len(lines) <= 10


def test_pose_records_agree_with_the_true_position_of_the_tracker(run_rig):
    async def scenario(rig):
        await wait_for_move(rig)
        await wait_for_rest(rig)

    rig = run_rig(scenario)
    pose = rig.records_of(Pose)[-1]
    assert (pose.a_deg, pose.b_deg) == (
        pytest.approx(rig.truth().a_deg, abs=0.06),
        pytest.approx(rig.truth().b_deg, abs=0.06),
    )


@pytest.mark.parametrize("more", ["", "; and 1 more, which 'heliocube status' shows"])
def test_a_refusal_names_two_doubts_about_the_reference_and_counts_the_others(run_rig, more):
    async def scenario(rig):
        await wait_for_tracking(rig)
        override_telemetry(rig, reference_doubt=f"it slipped; it jumped{'; it restarted' if more else ''}")
        await rig.until(lambda: rig.motion.doubt, 10, "the doubts")
        with pytest.raises(CommandError, match=rf"^the tracker cannot go anywhere: it slipped; it jumped{more}$"):
            await Operator(rig.tracker, 1.0).goto(0, 60, "x")

    run_rig(scenario)
