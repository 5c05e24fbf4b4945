"""What happened to the axes while the link was down: a count that was lost meanwhile is no reference any more."""

import asyncio
import contextlib

import pytest

from daemon.base.timeloop import VirtualTimeLoop
from drivers.errors import LinkLostError
from drivers.positioners.pozsol.geometry import AxisSetup, Triangle
from drivers.positioners.pozsol.positioner import PozsolPositioner
from sim_drivers.pozsol.core import PositionerCore
from sim_drivers.pozsol.setup import Setup
from sim_drivers.transports import InMemoryStream
from solar.frames import Angles

A = AxisSetup(Triangle(300.0, 300.0, 90.0, -52.0), -50.0, 50.0)
B = AxisSetup(Triangle(300.0, 300.0, 37.5, 13.0), 15.0, 90.0)
OUTAGE_S = 1200.0


class Cable:
    """A driver and its unit, with a cable between them that can be pulled."""

    def __init__(self):
        self.now = asyncio.get_running_loop().time
        self.core = PositionerCore(self.now(), Setup(own_target=lambda _now: Angles(-10.0, 80.0)))
        self.line = InMemoryStream(self.core, self.now)
        self.positioner = PozsolPositioner(self.line, self.now, A, B)

    async def out(self, upset=None):
        """Pull the cable, upset the unit, and open again after longer than the unit keeps its reset mark."""
        self.line.link_up = False
        await self.positioner.close()
        if upset is not None:
            upset(self.now())
        await asyncio.sleep(OUTAGE_S)
        self.core.advance(self.now())
        self.line.link_up = True
        await self.positioner.open()
        return await self.positioner.read_telemetry()

    async def home_both(self):
        for axis in ("a", "b"):
            await self.positioner.home(axis)
            for _ in range(200):
                await asyncio.sleep(1.0)
                await self.positioner.read_telemetry()
        return await self.positioner.read_telemetry()


def run(act):
    """Run a scene with a driver whose unit stands at 0 and 90 degrees and has been read once."""

    async def scene():
        cable = Cable()
        await cable.positioner.open()
        await cable.positioner.read_telemetry()
        await act(cable)

    with asyncio.Runner(loop_factory=VirtualTimeLoop) as runner:
        runner.run(scene())


def test_a_count_lost_while_the_link_is_down_is_in_doubt_although_the_reset_mark_is_gone():
    async def act(cable):
        seen = await cable.out(lambda now: cable.core.power_cycle(now, keep_position=False))
        assert (seen.was_reset, seen.a_deg, seen.b_deg) == (False, -52.0, 13.0)
        assert "axis A has the count 0, and had 229 when it was seen last" in seen.reference_doubt
        assert "axis B has the count 0, and had 282 when it was seen last" in seen.reference_doubt
        again = await cable.out()
        assert again.reference_doubt == seen.reference_doubt
        assert (await cable.home_both()).reference_doubt == ""
        assert cable.core.truth(cable.now()) == pytest.approx((-52.0, 13.0), abs=0.3)

    run(act)


def test_a_restart_during_an_outage_that_keeps_the_count_leaves_no_doubt_if_its_mark_is_gone():
    async def act(cable):
        assert (await cable.out(cable.core.power_cycle)).reference_doubt == ""

    run(act)


@pytest.mark.parametrize("shown", [True, False])
def test_a_move_that_goes_on_while_the_link_is_down_leaves_no_doubt(shown):
    async def act(cable):
        # A silent unit takes the target, but telemetry does not show it any more.
        cable.line.silent = not shown
        moving = asyncio.ensure_future(cable.positioner.move_to(-10.0, 80.0))
        await asyncio.wait((moving,), timeout=0.5)
        cable.line.silent = False
        seen = await cable.out()
        with contextlib.suppress(LinkLostError):
            await moving
        assert (seen.a_deg, seen.b_deg) == pytest.approx((-10.0, 80.0), abs=0.5)
        assert seen.reference_doubt == ""

    run(act)


@pytest.mark.parametrize("fault", ["own_tracking", "button_in"])
def test_an_axis_moved_while_the_link_is_down_is_in_doubt_unless_the_unit_tracks_by_itself(fault):
    async def act(cable):
        seen = await cable.out(lambda now: cable.core.inject(fault, now))
        assert seen.a_deg < -9.0
        assert seen.reference_doubt.startswith("axis A has the count") is (fault == "button_in")

    run(act)


async def homed(cable):
    return (await cable.home_both()).reference_doubt


@pytest.mark.parametrize(("axis", "fault"), [("b", "re_reference"), ("a", "button_in")])
def test_an_axis_that_is_on_its_switch_after_an_outage_is_in_doubt_until_two_reference_runs(axis, fault):
    async def act(cable):
        await cable.positioner.move_to(0.0, 60.0)
        await asyncio.sleep(60.0)
        await cable.positioner.read_telemetry()
        seen = await cable.out(lambda now: cable.core.inject(fault, now))
        assert seen.reference_doubt.startswith(f"axis {axis.upper()} has the count -")
        if fault == "button_in":
            cable.core.repair(fault, cable.now())
        assert "home it again" in await homed(cable)
        assert await homed(cable) == ""

    run(act)


def test_a_reference_run_that_ends_while_the_link_is_down_leaves_a_doubt_until_one_more_run():
    async def act(cable):
        homing = asyncio.ensure_future(cable.positioner.home("b"))
        await asyncio.wait((homing,), timeout=3.0)
        seen = await cable.out()
        with contextlib.suppress(LinkLostError):
            await homing
        assert seen.b_deg == pytest.approx(13.0, abs=0.2)
        assert seen.reference_doubt == "the reference run of B did not end"
        assert await homed(cable) == ""

    run(act)


def test_a_doubtful_count_lost_in_an_outage_stays_in_doubt_after_homing_on_a_stuck_switch():
    async def act(cable):
        def upset(now):
            cable.core.power_cycle(now, keep_position=False)
            cable.core.inject("a_switch_closed", now)

        await cable.positioner.home("a")
        await asyncio.sleep(2.0)
        await cable.positioner.halt()
        seen = await cable.out(upset)
        assert seen.reference_doubt.startswith("the reference run of A did not end; axis A has the count 0")
        for _ in range(3):
            assert "its low end switch may be stuck" in await homed(cable)

    run(act)


def test_the_position_assumed_for_a_wrong_end_switch_stays_known_after_the_count_is_lost():
    async def act(cable):
        await cable.positioner.home("a")
        await asyncio.sleep(5.0)
        cable.core.inject("a_slip", cable.now())
        for _ in range(100):
            await asyncio.sleep(1.0)
            await cable.positioner.read_telemetry()
        await cable.positioner.move_to(-30.0, 90.0)
        await asyncio.sleep(60.0)
        seen = await cable.positioner.read_telemetry()
        stands, _ = cable.positioner.standing()
        assert "home it again" in seen.reference_doubt
        assert abs(stands - seen.position_a) > 4.0
        await cable.out(lambda now: cable.core.power_cycle(now, keep_position=False))
        assert cable.positioner.standing()[0] == pytest.approx(stands, abs=0.1)

    run(act)
