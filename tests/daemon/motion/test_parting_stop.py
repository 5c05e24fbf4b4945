"""A link that is given up while an axis may be moving: one stop goes out first, for the unit may still hear it."""

import asyncio

import pytest

from daemon.base.records import MoveOutcome, Target
from drivers.errors import LinkLostError
from tests.support.fake_positioner import FakePositioner, run_motion
from tests.support.motion import STOP_PACKET, commands_sent
from tests.support.phases import wait_for_long_rest, wait_for_move


def test_an_axis_stands_soon_after_its_unit_has_fallen_silent(run_rig):
    async def scenario(rig):
        await wait_for_move(rig)
        rig.cables.positioner.silent = True
        await rig.until(lambda: not rig.motion.connected, 3.0, "the loss")
        # The motor runs out for a fraction of a second: wait for that.
        await asyncio.sleep(1.0)
        stands = rig.truth()
        await asyncio.sleep(60.0)
        assert rig.truth() == stands
        move = rig.motion.last_move
        assert move.outcome is MoveOutcome.LINK_LOST
        assert abs(stands.a_deg - move.target_a_deg) + abs(stands.b_deg - move.target_b_deg) > 5.0, "on its way"

    run_rig(scenario)


def test_a_unit_that_rests_is_sent_nothing_when_it_falls_silent(run_rig, monkeypatch):
    async def scenario(rig):
        await wait_for_long_rest(rig)
        sent = commands_sent(rig, monkeypatch)
        rig.cables.positioner.silent = True
        await asyncio.sleep(60.0)
        assert not rig.motion.connected
        assert not sent
        rig.cables.positioner.silent = False
        await rig.until(lambda: rig.motion.connected, 20.0, "the link")
        assert sent[0][1].startswith(STOP_PACKET)

    run_rig(scenario)


@pytest.mark.parametrize("hangs", [True, False])
def test_the_stop_before_a_lost_link_is_closed_neither_delays_the_close_nor_raises_an_error(hangs):
    class Hanging(FakePositioner):
        lost_s = closed_s = None

        async def read_telemetry(self):
            if self.is_lost and self.lost_s is None:
                self.lost_s = self._clock.monotonic()
            return await super().read_telemetry()

        async def stop(self):
            self.sent.append("stop")
            if hangs:
                await asyncio.Event().wait()
            raise LinkLostError("hand", "takes no data")

        async def close(self):
            if self.lost_s is not None and self.closed_s is None:
                self.closed_s = self._clock.monotonic()
            await super().close()

    async def scenario(rig):
        rig.motion.order(Target(40.0, 60.0, "far"))
        await asyncio.sleep(5.0)
        rig.unit.is_lost = True
        await rig.until(lambda: not rig.motion.connected)
        await asyncio.sleep(1.0)
        assert rig.unit.sent[rig.unit.sent.index("stop") :][:2] == ["stop", "close"]
        assert rig.unit.closed_s - rig.unit.lost_s <= 0.35
        rig.unit.is_lost = False
        await rig.until(lambda: rig.motion.connected)

    run_motion(scenario, make=Hanging)
