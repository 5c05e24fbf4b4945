"""Doubts about the reference: what raises them, who may end them, and what they survive."""

import asyncio
import json
from dataclasses import replace

import pytest

from daemon.base.records import Mode, Target
from daemon.motion.doubts import RESET
from drivers.errors import RefusedError
from tests.support.motion import CLEAR_PACKET, alarms, commands_sent, send_foreign_b_target
from tests.support.phases import now, positioner_events, wait_for_long_rest, wait_for_tracking


def test_clear_forgives_the_fault_that_was_shown_and_not_the_reset_behind_it(run_rig):
    async def scenario(rig):
        await wait_for_long_rest(rig)
        rig.unit.inject("a_overcurrent", now(rig))
        await asyncio.sleep(1)
        shown = rig.motion.concerns
        assert shown == ("the positioner reports a_overcurrent",)
        rig.unit.power_cycle(now(rig))
        rig.motion.clear_faults(shown=shown)
        await asyncio.sleep(10)
        assert RESET in rig.motion.doubt
        assert RESET in alarms(rig)["reference"]
        rig.motion.clear_faults(shown=(*rig.motion.concerns,))
        await rig.until_mode(Mode.TRACKING, 30)
        assert not alarms(rig)

    run_rig(scenario)


def test_a_reset_that_comes_after_the_shown_fault_is_not_forgiven_by_a_clear(run_rig):
    async def scenario(rig):
        await wait_for_long_rest(rig)
        rig.unit.inject("a_overcurrent", now(rig))
        await asyncio.sleep(1)
        rig.motion.clear_faults()
        await asyncio.sleep(0.5)
        rig.unit.power_cycle(now(rig))
        await asyncio.sleep(20)
        assert RESET in rig.motion.doubt
        assert rig.mode is Mode.FAULT

    run_rig(scenario)


def test_a_fault_that_nobody_was_shown_leaves_a_doubt_when_the_unit_clears_it(run_rig):
    async def scenario(rig):
        await wait_for_long_rest(rig)
        rig.unit.inject("a_overcurrent", now(rig))
        await asyncio.sleep(1)
        rig.motion.clear_faults(shown=())
        await asyncio.sleep(5)
        assert not rig.motion.telemetry.faults
        assert "a_overcurrent was cleared before anybody had seen it" in rig.motion.doubt

    run_rig(scenario)


def test_a_clear_that_was_asked_for_before_the_link_was_lost_is_dropped_with_it(run_rig, monkeypatch):
    async def scenario(rig):
        await wait_for_long_rest(rig)
        rig.unit.power_cycle(now(rig))
        await asyncio.sleep(2)
        rig.motion.clear_faults()
        rig.cables.positioner.link_up = False
        await asyncio.sleep(5)
        sent = commands_sent(rig, monkeypatch)
        rig.cables.positioner.link_up = True
        await asyncio.sleep(60)
        assert not [data for _, data in sent if data.startswith(CLEAR_PACKET)]
        assert RESET in rig.motion.doubt
        assert "nothing was cleared: the positioner was lost first" in positioner_events(rig)

    run_rig(scenario)


def test_a_clear_without_telemetry_is_refused(run_rig):
    async def scenario(rig):
        await wait_for_long_rest(rig)
        rig.cables.positioner.link_up = False
        await asyncio.sleep(3)
        with pytest.raises(RefusedError, match="no telemetry"):
            rig.motion.clear_faults()
        with pytest.raises(RefusedError, match="no telemetry"):
            rig.motion.home()

    run_rig(scenario)


def test_a_fault_that_vanishes_while_unplugged_is_remembered(run_rig):
    async def scenario(rig):
        await wait_for_long_rest(rig)
        rig.unit.inject("a_overcurrent", now(rig))
        await asyncio.sleep(2)
        rig.cables.positioner.link_up = False
        await asyncio.sleep(1000 - now(rig))
        rig.cables.positioner.link_up = True
        await rig.until(lambda: rig.motion.connected, 20, "the connection")
        await asyncio.sleep(2)
        assert not rig.motion.telemetry.faults
        assert "a_overcurrent cleared by itself" in rig.motion.doubt
        assert "a_overcurrent cleared by itself" in alarms(rig)["positioner-fault"]

    run_rig(scenario)


def test_a_fault_that_clears_itself_leaves_a_doubt(run_rig):
    async def scenario(rig):
        await wait_for_long_rest(rig)
        rig.unit.inject("a_overcurrent", now(rig))
        await asyncio.sleep(1000 - now(rig))
        assert not rig.motion.telemetry.faults
        assert "a_overcurrent cleared by itself" in rig.motion.doubt
        told = [name for name, text in alarms(rig).items() if "a_overcurrent cleared by itself" in text]
        assert told == ["positioner-fault"], "one cause is one alarm"
        assert rig.mode is Mode.FAULT

    run_rig(scenario)


def states(rig):
    return {alarm.name: alarm.state for alarm in rig.tracker.alarms.active}


def test_a_second_fault_raises_an_acknowledged_alarm_again_and_the_end_of_a_fault_does_not(run_rig):
    async def scenario(rig):
        await wait_for_long_rest(rig)
        rig.unit.inject("a_overcurrent", now(rig))
        await rig.until(lambda: "positioner-fault" in states(rig), 10, "the fault")
        rig.tracker.alarms.acknowledge("ana")
        await asyncio.sleep(10)
        assert states(rig)["positioner-fault"] == "acknowledged"
        rig.unit.inject("b_overcurrent", now(rig))
        await rig.until(lambda: "b_overcurrent" in alarms(rig)["positioner-fault"], 10, "the second fault")
        assert states(rig)["positioner-fault"] == "raised"
        rig.tracker.alarms.acknowledge("ana")
        rig.unit.power_cycle(now(rig))
        await rig.until(lambda: "b_overcurrent cleared by itself" in alarms(rig)["positioner-fault"], 30, "its end")
        assert states(rig) == {"positioner-fault": "acknowledged", "reference": "raised"}

    run_rig(scenario)


def test_a_second_doubt_raises_an_acknowledged_alarm_again(run_rig):
    async def scenario(rig):
        await wait_for_long_rest(rig)
        rig.unit.power_cycle(now(rig))
        await rig.until(lambda: "reference" in states(rig), 30, "the restart")
        rig.tracker.alarms.acknowledge("ana")
        await asyncio.sleep(10)
        assert states(rig)["reference"] == "acknowledged"
        rig.motion.home()
        await asyncio.sleep(10)
        rig.motion.request_stop()
        await rig.until(lambda: "homing was not finished" in alarms(rig)["reference"], 30, "the second doubt")
        assert states(rig)["reference"] == "raised"

    run_rig(scenario)


def test_doubts_and_incidents_outlive_the_service(run_rig, tmp_path):
    async def scenario(rig):
        await wait_for_long_rest(rig)
        rig.unit.power_cycle(now(rig))
        for _ in range(2):
            # The unit loses the first packet after its restart: send it again.
            send_foreign_b_target(rig, 85.0)
        await rig.until(lambda: rig.motion.unexplained_motion and rig.motion.doubt, 30, "both")
        await asyncio.sleep(10)

    async def again(rig):
        await rig.until(lambda: rig.motion.connected, 30, "the connection")
        assert "without an order" in rig.motion.blocked
        assert RESET in rig.motion.doubt
        await asyncio.sleep(300)
        assert rig.mode is Mode.FAULT
        rig.motion.clear_faults()
        await rig.until_mode(Mode.TRACKING, 60)

    store = {"directory": tmp_path}
    run_rig(scenario, store=store)
    run_rig(again, store=store)
    kept = json.loads((tmp_path / "motion.json").read_text())
    assert kept == {"doubts": {}, "incidents": {}, "faults": [], "homing": False}
    run_rig(wait_for_tracking, store=store)


@pytest.mark.parametrize("text", ["", "{", '{"doubts": 3}', "\0"])
def test_a_file_of_doubts_that_cannot_be_read_is_a_doubt(run_rig, tmp_path, text):
    async def scenario(rig):
        await rig.until_mode(Mode.FAULT, 30)
        assert "motion.json cannot be read" in rig.control.why
        rig.motion.clear_faults()
        await rig.until_mode(Mode.TRACKING, 90)

    (tmp_path / "motion.json").write_text(text)
    run_rig(scenario, store={"directory": tmp_path})


def test_a_service_that_is_killed_while_homing_comes_back_in_doubt(run_rig, tmp_path):
    async def scenario(rig):
        await wait_for_long_rest(rig)
        rig.motion.home()
        await asyncio.sleep(20)
        (tmp_path / "kept.json").write_text((tmp_path / "motion.json").read_text())

    async def again(rig):
        await rig.until_mode(Mode.FAULT, 30)
        assert "homing was not finished" in rig.control.why

    run_rig(scenario, store={"directory": tmp_path})
    (tmp_path / "kept.json").replace(tmp_path / "motion.json")
    run_rig(again, store={"directory": tmp_path})


def test_a_reference_run_of_the_units_own_is_a_doubt(run_rig):
    async def scenario(rig):
        await wait_for_long_rest(rig)
        rig.unit.inject("re_reference", now(rig))
        await asyncio.sleep(10)
        assert "a reference run of its own" in rig.motion.doubt
        assert rig.motion.unexplained_motion

    run_rig(scenario)


def test_the_destination_of_a_reference_run_of_the_units_own_is_enough_for_a_doubt(run_rig):
    async def scenario(rig):
        await wait_for_long_rest(rig)
        read = rig.positioner.read_telemetry

        async def without_the_run_itself():
            return replace(await read(), homing=False)

        rig.positioner.read_telemetry = without_the_run_itself
        rig.unit.inject("re_reference", now(rig))
        await asyncio.sleep(10)
        assert "a reference run of its own" in rig.motion.doubt

    run_rig(scenario)


def test_a_tracker_that_stands_elsewhere_after_an_outage_is_in_doubt(run_rig):
    async def scenario(rig):
        await wait_for_long_rest(rig)
        rig.cables.positioner.link_up = False
        await asyncio.sleep(3)
        send_foreign_b_target(rig, 60.0)
        await asyncio.sleep(60)
        rig.cables.positioner.link_up = True
        await rig.until_mode(Mode.FAULT, 30)
        await rig.until(lambda: rig.motion.connected, 30, "the connection")
        assert "axis B has the count" in rig.motion.doubt
        assert any("before the loss it stood at" in text for text in positioner_events(rig))
        rig.motion.order(Target(0, 90, "storm"), stow=True)
        await asyncio.sleep(60)
        assert rig.truth().b_deg == pytest.approx(90, abs=1)

    run_rig(scenario)
