"""What `Alm` of model 601 says while a tracker is not where it should be."""

import asyncio

import pytest

from daemon.base.records import Mode, Move, MoveOutcome
from drivers.modbus.pdu import decode_number
from tests.daemon.sunspec.desk import on_rig
from tests.support.phases import wait_for_rest


@pytest.mark.parametrize("stopped", [False, True])
def test_a_failed_stow_that_awaits_a_retry_sets_the_alarm_bit_for_off_target_also_under_a_stop(run_rig, stopped):
    async def scenario(rig, control):
        for axis in "ab":
            rig.unit.inject(f"{axis}_ignores_targets", rig.clock.monotonic())
        if stopped:
            # A person's stow would end with the stop.
            rig.wind_m_s = 20.0
        else:
            rig.control.stow("storm")
        failed = MoveOutcome.REFUSED, MoveOutcome.STALLED
        await rig.until(lambda: any(move.outcome in failed for move in rig.records_of(Move)), 120, "a stow that fails")
        if stopped:
            await rig.control.stop("somebody is at the axes", "ana")
        await asyncio.sleep(5)
        assert (rig.mode, rig.motion.target) == (Mode.HOLD if stopped else Mode.STOW, None)
        tracker = (await control.models())[601][1]
        assert (tracker[23], tracker[26 + 21]) == (1, 1)
        sent = tracker[26 + 8 : 26 + 12]
        assert decode_number(sent[:2], "int32") == 9000, "it has been sent flat"

    on_rig(run_rig, scenario)


@pytest.mark.parametrize("on_its_way", ["stow", "goto", None])
def test_a_fault_sets_the_obstructed_bits_and_off_target_too_if_a_move_or_stow_was_not_finished(run_rig, on_its_way):
    async def scenario(rig, control):
        async def alarm():
            tracker = (await control.models())[601][1]
            assert tracker[23] == tracker[26 + 21]
            return tracker[23]

        if on_its_way == "stow":
            rig.wind_m_s = 20.0
        elif on_its_way == "goto":
            rig.control.goto(30.0, 40.0, "to be seen")
        await asyncio.sleep(8)
        assert await alarm() == (1 if on_its_way else 0)
        rig.unit.inject("a_overcurrent", rig.clock.monotonic())
        await rig.until_mode(Mode.FAULT, 20)
        await asyncio.sleep(1)
        assert await alarm() == (0b111 if on_its_way else 0b110)
        rig.wind_m_s = 20.0
        await asyncio.sleep(8)
        assert (rig.mode, await alarm()) == (Mode.FAULT, 0b111)

    on_rig(run_rig, scenario)


def test_a_storm_sets_no_alarm_bit_once_the_tracker_is_at_the_stow_position(run_rig):
    async def scenario(rig, control):
        rig.wind_m_s = 20.0
        await rig.until_mode(Mode.STOW, 20)
        await wait_for_rest(rig)
        assert rig.truth() == pytest.approx((0.0, 90.0), abs=0.8)
        assert (await control.models())[601][1][23] == 0

    on_rig(run_rig, scenario)
