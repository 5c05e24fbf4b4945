"""A clear that takes its time: if only the wait for it hinders a stow, the stow goes first."""

import asyncio

import pytest

from daemon.base.records import Target
from drivers.errors import RefusedError
from tests.support.fake_positioner import FakePositioner, run_motion, wait_out_standstill


class SlowToClear(FakePositioner):
    """A unit that shows its status every few seconds, and only then that it has cleared it; a stop ends the wait."""

    async def clear_faults(self, *, forgive=True):
        self.stops = 0
        for _ in range(65):
            await asyncio.sleep(0.1)
            if self.stops:
                raise RefusedError("hand", "a stop came in between")
        return await super().clear_faults(forgive=forgive)

    async def stop(self):
        self.stops = 1
        await super().stop()


@pytest.mark.parametrize("ahead", [False, True])
def test_a_stow_does_not_wait_for_a_clear_that_takes_its_time(ahead):
    async def scenario(rig):
        await wait_out_standstill(rig)
        rig.unit.put(12.0, 60.0)
        await rig.until(lambda: rig.motion.doubt)
        doubt = rig.motion.doubt
        rig.motion.clear_faults()
        await asyncio.sleep(0.0 if ahead else 2.0)
        rig.motion.order(Target(0.0, 90.0, "storm"), stow=True)
        await rig.until(lambda: rig.motion.target, 1.0)
        await rig.until(lambda: rig.motion.target is None)
        assert rig.unit.place() == (0.0, 90.0)
        await asyncio.sleep(10.0)
        assert rig.motion.doubt == doubt, "a person says it again"
        (told,) = [text for text in rig.positioner_events if "cleared" in text]
        assert told == "nothing was cleared: a stow came first"

    run_motion(scenario, make=SlowToClear)


def test_a_slow_clear_goes_on_when_the_stow_needs_it_or_the_order_is_no_stow():
    async def scenario(rig):
        await wait_out_standstill(rig)
        for says, stow in (({}, False), ({"was_reset": True}, True)):
            rig.unit.telemetry_overrides |= says
            await asyncio.sleep(2.0)
            rig.motion.clear_faults()
            await asyncio.sleep(1.0)
            rig.motion.order(Target(0.0, 90.0 if stow else 70.0, "go"), stow=stow)
            await asyncio.sleep(3.0)
            assert rig.motion.target is None
            await rig.until(lambda: rig.motion.target, 5.0)
            assert rig.motion.doubt is None
            await rig.until(lambda: rig.motion.target is None)
        assert not [text for text in rig.positioner_events if "nothing was cleared" in text]

    run_motion(scenario, make=SlowToClear)
