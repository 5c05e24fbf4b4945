"""Doubts about the reference: who may end them, and what they outlive."""

import asyncio
import json

import pytest

from daemon.base.records import Event, Mode, Target
from daemon.motion.motion import Polling
from daemon.motion.reference import RESET
from drivers.errors import RefusedError
from tests.daemon.motion.test_rule import moves_for, quiet
from tests.daemon.service.test_faults import at_rest, commands_sent, tracking
from tests.support.motion import STOP_PACKET, alarms, drive_b, lose, show

CLEAR_PACKET, HOME_A_PACKET = b"$\x88", b"$95"


def now(bench):
    return bench.clock.monotonic()


async def homed(bench):
    await bench.until(lambda: bench.motion.homing, 10, "homing")
    await bench.until(lambda: not bench.motion.homing, 900, "the end of homing")


def told(bench):
    return [event.text for event in bench.of(Event) if event.subject == "positioner"]


def test_clear_forgives_the_fault_that_was_shown_and_not_the_reset_behind_it(run_rig):
    async def scenario(bench):
        await quiet(bench)
        bench.unit.inject("a_overcurrent", now(bench))
        await asyncio.sleep(1)
        shown = bench.motion.concerns
        assert shown == ("the positioner reports a_overcurrent",)
        bench.unit.power_cycle(now(bench))
        bench.motion.clear_faults(shown=shown)
        await asyncio.sleep(10)
        assert RESET in bench.motion.doubt
        assert RESET in alarms(bench)["reference"]
        bench.motion.clear_faults(shown=(*bench.motion.concerns,))
        await bench.until_mode(Mode.TRACKING, 30)
        assert not alarms(bench)

    run_rig(scenario)


def test_a_reset_that_comes_after_what_was_shown_is_not_forgiven(run_rig):
    async def scenario(bench):
        await quiet(bench)
        bench.unit.inject("a_overcurrent", now(bench))
        await asyncio.sleep(1)
        bench.motion.clear_faults()
        await asyncio.sleep(0.5)
        bench.unit.power_cycle(now(bench))
        await asyncio.sleep(20)
        assert RESET in bench.motion.doubt
        assert bench.mode is Mode.FAULT

    run_rig(scenario)


def test_a_fault_that_nobody_was_shown_leaves_a_doubt_when_the_unit_clears_it(run_rig):
    async def scenario(bench):
        await quiet(bench)
        bench.unit.inject("a_overcurrent", now(bench))
        await asyncio.sleep(1)
        bench.motion.clear_faults(shown=())
        await asyncio.sleep(5)
        assert not bench.motion.telemetry.faults
        assert "a_overcurrent was cleared before anybody had seen it" in bench.motion.doubt

    run_rig(scenario)


def test_a_clear_that_was_asked_for_before_the_link_was_lost_dies_with_it(run_rig, monkeypatch):
    async def scenario(bench):
        await quiet(bench)
        bench.unit.power_cycle(now(bench))
        await asyncio.sleep(2)
        bench.motion.clear_faults()
        bench.cables.positioner.link_up = False
        await asyncio.sleep(5)
        sent = commands_sent(bench, monkeypatch)
        bench.cables.positioner.link_up = True
        await asyncio.sleep(60)
        assert not [data for _, data in sent if data.startswith(CLEAR_PACKET)]
        assert RESET in bench.motion.doubt
        assert "nothing was cleared: the positioner was lost first" in told(bench)

    run_rig(scenario)


def test_a_clear_without_telemetry_is_refused(run_rig):
    async def scenario(bench):
        await quiet(bench)
        bench.cables.positioner.link_up = False
        await asyncio.sleep(3)
        with pytest.raises(RefusedError, match="no telemetry"):
            bench.motion.clear_faults()
        with pytest.raises(RefusedError, match="no telemetry"):
            bench.motion.home()

    run_rig(scenario)


def test_a_fault_that_vanishes_while_unplugged_is_remembered(run_rig):
    async def scenario(bench):
        await quiet(bench)
        bench.unit.inject("a_overcurrent", now(bench))
        await asyncio.sleep(2)
        bench.cables.positioner.link_up = False
        await asyncio.sleep(1000 - now(bench))
        bench.cables.positioner.link_up = True
        await bench.until(lambda: bench.motion.connected, 20, "the connection")
        await asyncio.sleep(2)
        assert not bench.motion.telemetry.faults
        assert "a_overcurrent cleared by itself" in bench.motion.doubt
        assert "a_overcurrent cleared by itself" in alarms(bench)["positioner-fault"]

    run_rig(scenario)


def test_a_fault_that_clears_itself_leaves_a_doubt(run_rig):
    async def scenario(bench):
        await quiet(bench)
        bench.unit.inject("a_overcurrent", now(bench))
        await asyncio.sleep(1000 - now(bench))
        assert not bench.motion.telemetry.faults
        assert "a_overcurrent cleared by itself" in bench.motion.doubt
        assert bench.mode is Mode.FAULT

    run_rig(scenario)


def test_doubts_and_incidents_outlive_the_service(run_rig, tmp_path):
    async def scenario(bench):
        await quiet(bench)
        bench.unit.power_cycle(now(bench))
        for _ in range(2):
            # The unit mislays the first packet after its restart.
            drive_b(bench, 85.0)
        await bench.until(lambda: bench.motion.unexplained and bench.motion.doubt, 30, "both")
        await asyncio.sleep(10)

    async def again(bench):
        await bench.until(lambda: bench.motion.connected, 30, "the connection")
        assert "without an order" in bench.motion.blocked
        assert RESET in bench.motion.doubt
        await asyncio.sleep(300)
        assert bench.mode is Mode.FAULT
        bench.motion.clear_faults()
        await bench.until_mode(Mode.TRACKING, 60)

    store = {"directory": tmp_path}
    run_rig(scenario, store=store)
    run_rig(again, store=store)
    kept = json.loads((tmp_path / "motion.json").read_text())
    assert kept == {"doubts": {}, "incidents": {}, "faults": [], "homing": False}
    run_rig(tracking, store=store)


@pytest.mark.parametrize("text", ["", "{", '{"doubts": 3}', "\0"])
def test_a_file_of_doubts_that_cannot_be_read_is_a_doubt(run_rig, tmp_path, text):
    async def scenario(bench):
        await bench.until_mode(Mode.FAULT, 30)
        assert "motion.json cannot be read" in bench.control.why
        bench.motion.clear_faults()
        await bench.until_mode(Mode.TRACKING, 90)

    (tmp_path / "motion.json").write_text(text)
    run_rig(scenario, store={"directory": tmp_path})


def test_a_service_that_is_killed_while_homing_comes_back_in_doubt(run_rig, tmp_path):
    async def scenario(bench):
        await quiet(bench)
        bench.motion.home()
        await asyncio.sleep(20)
        (tmp_path / "kept.json").write_text((tmp_path / "motion.json").read_text())

    async def again(bench):
        await bench.until_mode(Mode.FAULT, 30)
        assert "homing was not finished" in bench.control.why

    run_rig(scenario, store={"directory": tmp_path})
    (tmp_path / "kept.json").replace(tmp_path / "motion.json")
    run_rig(again, store={"directory": tmp_path})


def test_homing_ends_every_doubt_about_the_reference(run_rig):
    async def scenario(bench):
        await quiet(bench)
        bench.unit.inject("a_overcurrent", now(bench))
        await asyncio.sleep(1)
        bench.unit.power_cycle(now(bench), keep_position=False)
        await asyncio.sleep(10)
        assert len(bench.motion.concerns) >= 2
        bench.motion.home()
        await homed(bench)
        assert bench.motion.concerns == ()
        await bench.until_mode(Mode.TRACKING, 30)

    run_rig(scenario)


def test_a_homing_run_that_fails_leaves_a_doubt_though_there_was_none(run_rig):
    async def scenario(bench):
        await quiet(bench)
        bench.motion.home()
        await asyncio.sleep(5)
        bench.unit.inject("a_hall_loss", now(bench))
        await bench.until(lambda: not bench.motion.homing, 60, "the end of homing")
        assert "homing failed (" in bench.motion.doubt
        await asyncio.sleep(60)
        assert bench.mode is Mode.FAULT

    run_rig(scenario)


def test_a_run_that_the_driver_judges_bad_leaves_the_doubt(run_rig):
    async def scenario(bench):
        await quiet(bench)
        bench.unit.power_cycle(now(bench))
        await asyncio.sleep(2)
        bench.motion.home()
        await asyncio.sleep(3)
        show(bench, reference_doubt="axis A met its end switch 34 mm early")
        await bench.until(lambda: not bench.motion.homing, 200, "the end of homing")
        for words in (RESET, "axis A met its end switch 34 mm early", "homing failed"):
            assert words in bench.motion.doubt
        await asyncio.sleep(60)
        assert bench.mode is Mode.FAULT

    run_rig(scenario)


@pytest.mark.parametrize("end", ["stop", "stow", "unplug", "deaf"])
def test_a_homing_run_that_is_broken_off_leaves_the_doubt_that_was_there(run_rig, end):
    async def scenario(bench):
        await quiet(bench)
        bench.unit.power_cycle(now(bench))
        await bench.until_mode(Mode.FAULT, 15)
        bench.motion.home()
        await asyncio.sleep(8)
        assert bench.motion.homing
        if end == "stop":
            await bench.control.stop("a person")
            assert await moves_for(bench, 10) <= 2
            bench.control.auto()
        elif end == "stow":
            bench.control.stow("storm")
            await asyncio.sleep(120)
            assert bench.truth().b_deg == pytest.approx(90, abs=1)
            bench.control.auto()
        elif end == "unplug":
            bench.cables.positioner.link_up = False
            await asyncio.sleep(2)
            bench.cables.positioner.link_up = True
        else:
            bench.unit.power_cycle(now(bench))
        await bench.until_mode(Mode.FAULT, 60)
        await asyncio.sleep(60)
        assert "homing" in bench.motion.doubt
        assert RESET in bench.motion.doubt
        before = len([1 for text in told(bench) if text == "homing"])
        assert before == 1

    run_rig(scenario)


def test_a_homing_run_that_has_cleared_a_fault_and_is_broken_off_leaves_a_doubt(run_rig):
    async def scenario(bench):
        await tracking(bench)
        await at_rest(bench)
        bench.unit.inject("a_hall_loss", now(bench))
        bench.control.goto(20, 60, "test")
        await bench.until(lambda: bench.motion.telemetry.faults, 60, "the fault")
        bench.unit.repair("a_hall_loss", now(bench))
        await at_rest(bench)
        bench.control.home()
        await bench.until(lambda: bench.motion.homing and not bench.motion.telemetry.faults, 20, "the clearing")
        await asyncio.sleep(3)
        bench.control.stow("storm")
        await bench.until(lambda: not bench.motion.homing, 10, "the end of homing")
        await at_rest(bench)
        assert "homing was not finished" in bench.motion.doubt

    run_rig(scenario)


def test_the_other_axis_may_not_move_during_a_reference_run(run_rig):
    async def scenario(bench):
        await quiet(bench)
        bench.motion.home()
        await asyncio.sleep(8)
        assert bench.motion.homing
        bench.unit.inject("re_reference", now(bench))
        assert await moves_for(bench, 20) <= 2.0
        assert "B moved" in bench.motion.unexplained
        assert "homing failed" in bench.motion.doubt

    run_rig(scenario)


def test_a_reference_run_of_the_units_own_is_a_doubt(run_rig):
    async def scenario(bench):
        await quiet(bench)
        bench.unit.inject("re_reference", now(bench))
        await asyncio.sleep(10)
        assert "a reference run of its own" in bench.motion.doubt
        assert bench.motion.unexplained

    run_rig(scenario)


# Homing without being asked


def test_rehoming_by_itself_never_runs_under_a_stop_or_after_unexplained_motion(run_rig):
    async def scenario(bench):
        await quiet(bench)
        await bench.control.stop("a person works there")
        bench.motion.freeze("a person works there")
        bench.unit.power_cycle(now(bench))
        assert await moves_for(bench, 300) == 0.0
        bench.motion.freeze(None)
        bench.control.auto()
        await homed(bench)
        await bench.until_mode(Mode.TRACKING, 30)
        await at_rest(bench)
        drive_b(bench, 85.0)
        await asyncio.sleep(10)
        assert bench.motion.unexplained
        bench.unit.power_cycle(now(bench))
        assert await moves_for(bench, 300) == 0.0

    run_rig(scenario, motion={"rehome": "automatic"})


@pytest.mark.parametrize("mode", [Mode.STOW, Mode.HOLD])
def test_rehoming_by_itself_waits_while_the_tracker_is_stowed_or_stopped(run_rig, mode):
    async def scenario(bench):
        await quiet(bench)
        if mode is Mode.STOW:
            bench.control.stow("storm")
            await asyncio.sleep(120)
        else:
            await bench.control.stop("wait")
        bench.unit.power_cycle(now(bench))
        await asyncio.sleep(3)
        assert await moves_for(bench, 300) == 0.0
        assert bench.mode is mode
        bench.control.auto()
        await homed(bench)

    run_rig(scenario, motion={"rehome": "automatic"})


def test_rehoming_that_fails_is_tried_again_after_ever_longer_pauses(run_rig, monkeypatch):
    async def scenario(bench):
        await quiet(bench)
        lose(bench, monkeypatch, HOME_A_PACKET)
        bench.motion._polling = Polling(idle_s=5.0)
        bench.unit.power_cycle(now(bench))
        await asyncio.sleep(24 * 3600)
        assert 2 <= told(bench).count("homing") <= 7

    run_rig(scenario, motion={"rehome": "automatic"}, cube={"scan_every_s": 60}, safety={"scan_stale_s": 130})


def test_nothing_is_homed_while_a_fault_is_latched(run_rig):
    async def scenario(bench):
        await quiet(bench)
        bench.unit.power_cycle(now(bench))
        bench.unit.inject("a_overcurrent", now(bench))
        await asyncio.sleep(120)
        assert bench.motion.doubt
        assert not [text for text in told(bench) if text == "homing"]

    run_rig(scenario, motion={"rehome": "automatic"})


def test_a_tracker_that_stands_elsewhere_after_an_outage_is_in_doubt(run_rig):
    async def scenario(bench):
        await quiet(bench)
        bench.cables.positioner.link_up = False
        await asyncio.sleep(3)
        drive_b(bench, 60.0)
        await asyncio.sleep(60)
        bench.cables.positioner.link_up = True
        await bench.until_mode(Mode.FAULT, 30)
        await bench.until(lambda: bench.motion.connected, 30, "the connection")
        assert "before the loss it stood at" in bench.motion.doubt
        bench.motion.order(Target(0, 90, "storm"), stow=True)
        await asyncio.sleep(60)
        assert bench.truth().b_deg == pytest.approx(90, abs=1)

    run_rig(scenario)


@pytest.mark.parametrize("how", ["rest", "a stow"])
def test_a_homing_run_that_is_broken_off_ends_with_stop(run_rig, monkeypatch, how):
    async def scenario(bench):
        await quiet(bench)
        bench.motion.home()
        await asyncio.sleep(8)
        sent = commands_sent(bench, monkeypatch)
        if how == "rest":
            bench.motion.rest()
        else:
            bench.motion.order(Target(0, 90, "storm"), stow=True)
        await asyncio.sleep(3)
        assert sent[0][1].startswith(STOP_PACKET)

    run_rig(scenario)
