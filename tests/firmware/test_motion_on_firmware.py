"""The service's motion on the maker's firmware: an order that it refuses at first is taken at the next attempt."""

import asyncio
import logging
from random import Random

import pytest

from daemon.base.alarms.alarms import Alarms
from daemon.base.clock import LoopClock
from daemon.base.records import Event, Move, MoveOutcome, Target
from daemon.base.state import StateFolder
from daemon.config.settings import Settings
from daemon.motion.motion import Motion
from tests.firmware.live import driver_on, until

MOVES = (Target(-3.0, 88.0, "first"), Target(1.0, 86.0, "at once"), Target(-2.0, 88.5, "at once again"))


def test_a_target_ordered_while_the_previous_move_brakes_is_reached_without_a_warning(start_firmware, caplog):
    caplog.set_level(logging.INFO)
    firmware = start_firmware(0.0, 90.0)
    records, left = [], list(MOVES)

    async def scene():
        settings = Settings()
        clock = LoopClock(asyncio.get_running_loop().time, 1.7e9)
        alarms = Alarms(clock, records.append)
        positioner = driver_on(firmware)
        motion = Motion(
            positioner,
            settings.limits.limits(),
            settings.motion,
            settings.instruments.positioner,
            clock,
            Random(1),
            records.append,
            lambda: None,
            alarms,
            StateFolder(None),
        )
        running = asyncio.create_task(motion.run())
        try:

            async def connected():
                return motion.connected

            await until(connected)
            # On a busy machine the emulator prints its first screens too slowly, and the service looks for it again.
            caplog.clear()
            records.clear()
            while len([one for one in records if isinstance(one, Move)]) < len(MOVES):
                if motion.connected and motion.blocked is None and motion.is_idle and left:
                    motion.order(left.pop(0))
                # When a move counts as arrived, the unit may still be braking.
                await asyncio.sleep(0.005)
            assert alarms.active == ()
        finally:
            running.cancel()
            await asyncio.gather(running, return_exceptions=True)

    asyncio.run(asyncio.wait_for(scene(), 180.0))
    moves = [record for record in records if isinstance(record, Move)]
    assert [move.outcome for move in moves] == [MoveOutcome.ARRIVED] * len(MOVES)
    assert firmware.pose_deg() == pytest.approx((MOVES[-1].a_deg, MOVES[-1].b_deg), abs=1.0)
    assert [record.getMessage() for record in caplog.records if record.levelno >= logging.WARNING] == []
    assert [record.text for record in records if isinstance(record, Event)] == []
