"""A part that dies or a driver that hangs ends the service, named in one sentence and with the axes at rest."""

import asyncio
import logging

import pytest

from daemon.base.errors import UserError
from daemon.base.records import Event, Move, MoveOutcome
from drivers.errors import DriverHungError
from tests.support.phases import wait_for_long_rest, wait_for_move


@pytest.mark.parametrize("part", ["control", "motion", "acquisition", "watchdog"])
def test_a_task_of_the_service_that_dies_is_named_and_stops_the_service_and_the_axes(run_rig, caplog, part):
    class BrokenError(Exception):
        pass

    def breaking(rig):
        async def die():
            await wait_for_move(rig)
            owner = {
                "control": (rig.control, "tick"),
                "motion": (rig.positioner, "read_telemetry"),
                "acquisition": (rig.service.acquisition, "_face"),
                "watchdog": (rig.service._watchdog, "_status"),
            }[part]

            def fail(*_args):
                raise BrokenError(part)

            setattr(*owner, fail)
            await asyncio.sleep(60)

        return die()

    rigs = []

    def remember(rig):
        rigs.append(rig)
        return breaking(rig)

    with pytest.raises(BaseExceptionGroup), caplog.at_level(logging.ERROR):
        run_rig(remember)
    assert f"the task '{part}' died" in caplog.text
    unit = rigs[0].unit
    now = rigs[0].clock.monotonic()
    assert unit.truth(now + 5) == unit.truth(now + 60), "the axes were stopped"


@pytest.mark.parametrize("instrument", ["multiplexer", "voltmeter", "positioner"])
def test_a_driver_with_too_many_hung_calls_ends_the_service_in_one_sentence_with_axes_at_rest(run_rig, instrument):
    async def scenario(rig):
        await rig.until(lambda: rig.motion.moving, 200, "a move")

        async def hung():
            raise DriverHungError(instrument, "8 calls of its driver never returned")

        getattr(rig, instrument).open = hung
        getattr(rig.cables, instrument).link_up = False
        ended = "the service ends and must be restarted"
        await rig.until(lambda: any(ended in event.text for event in rig.records_of(Event)), 30, "the end")
        if instrument != "positioner":
            await asyncio.sleep(2)
            before = rig.truth()
            await asyncio.sleep(60)
            assert rig.truth() == before
            assert rig.records_of(Move)[-1].outcome is MoveOutcome.INTERRUPTED

    with pytest.raises(UserError, match=rf"{instrument}: 8 calls .* never returned: the service ends and must be"):
        run_rig(scenario)


def test_a_process_that_was_suspended_for_minutes_takes_no_driver_for_a_hung_one(run_rig):
    async def scenario(rig):
        await wait_for_long_rest(rig)
        for _ in range(8):
            # At another moment between two checks each time.
            await asyncio.sleep(31.17)
            asyncio.get_running_loop().skip(200.0)
            await asyncio.sleep(1.0)
            await rig.until(lambda: rig.motion.connected, 60, "the connection")

    run_rig(scenario)
