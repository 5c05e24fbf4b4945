"""The link to a hand-driven positioner: what is forgotten when it is lost, and compared when it is back."""

import asyncio
import logging

import pytest

from daemon.base.records import MoveOutcome, Target
from drivers.errors import DriverHungError, LinkLostError, RefusedError
from tests.support.fake_positioner import FakePositioner, run_motion


def test_before_the_first_contact_moves_reference_runs_and_clears_are_refused():
    async def scenario(rig):
        with pytest.raises(RefusedError, match="cannot move: no telemetry yet"):
            rig.motion.order(Target(0.0, 80.0, "storm"), stow=True)
        with pytest.raises(RefusedError, match="cannot be homed: no telemetry"):
            rig.motion.home()
        with pytest.raises(RefusedError, match="cannot be cleared: no telemetry"):
            rig.motion.clear_faults()
        assert rig.motion.blocked is None
        assert rig.motion.pose is None
        assert not rig.motion.connected
        assert not rig.motion.moving

    run_motion(scenario, connects=False)


def test_a_stop_that_cannot_be_sent_raises_an_error_and_is_sent_when_the_link_is_back():
    async def scenario(rig):
        rig.unit.is_lost = True
        with pytest.raises(LinkLostError):
            await rig.motion.stop()
        assert not rig.motion.is_idle
        rig.unit.is_lost = False
        await asyncio.sleep(10.0)
        assert "halt" in rig.unit.sent[-2:]
        assert rig.motion.is_idle

    run_motion(scenario)


def test_orders_from_before_a_lost_link_are_forgotten_and_a_dropped_clear_is_reported():
    async def scenario(rig):
        rig.unit.is_lost = True
        rig.motion.order(Target(40.0, 60.0, "far"))
        rig.motion.clear_faults()
        await rig.until(lambda: not rig.motion.connected, 3.0)
        assert "nothing was cleared: the positioner was lost first" in rig.positioner_events
        rig.unit.is_lost = False
        await asyncio.sleep(20.0)
        rig.unit.is_lost = True
        rig.motion.home()
        await rig.until(lambda: not rig.motion.connected, 3.0)
        rig.unit.is_lost = False
        await asyncio.sleep(20.0)
        assert not rig.moves
        assert not [sent for sent in rig.unit.sent if sent[0] in ("clear", "home")]
        assert rig.positioner_events.count("nothing was cleared: the positioner was lost first") == 1

    run_motion(scenario)


@pytest.mark.parametrize(
    ("place", "jumps"),
    [((10.7, 60.7), False), ((10.9, 60.0), True), ((9.1, 60.0), True), ((10.0, 59.1), True), ((10.0, 60.9), True)],
)
def test_after_a_lost_link_the_pose_is_compared_with_the_pose_before_it(place, jumps):
    async def scenario(rig):
        await asyncio.sleep(10.0)
        rig.unit.is_lost = True
        await asyncio.sleep(3.0)
        assert not rig.motion.is_idle, "nobody knows"
        rig.unit.put(*place)
        rig.unit.is_lost = False
        await asyncio.sleep(15.0)
        doubt = rig.motion.doubt
        assert (doubt is not None) == jumps
        if jumps:
            stands = f"positioner stands at A {place[0]:.1f}, B {place[1]:.1f} deg"
            text = f"{stands}; before the loss it stood at A 10.0, B 60.0"
            assert doubt.startswith(text)
            assert doubt.endswith(": compare the angles with the arms, then clear or home it")
            assert sum(told.startswith(text) for told in rig.positioner_events) == 1

    def at_ten(clock):
        unit = FakePositioner(clock)
        unit.put(10.0, 60.0)
        return unit

    run_motion(scenario, make=at_ten)


def test_a_second_loss_during_the_first_halt_leaves_the_earlier_pose_to_be_compared():
    class LostAgain(FakePositioner):
        breaks_off = False

        async def halt(self):
            if self.breaks_off:
                # Long enough for the guard to look at it meanwhile.
                await asyncio.sleep(0.8)
                self.breaks_off = False
                raise LinkLostError("hand", "does not answer again")
            await super().halt()

    async def scenario(rig):
        await asyncio.sleep(10.0)
        rig.unit.is_lost = True
        await rig.until(lambda: not rig.motion.connected, 3.0)
        rig.unit.put(25.0, 40.0)
        rig.unit.breaks_off = True
        rig.unit.is_lost = False
        await asyncio.sleep(30.0)
        assert not rig.unit.breaks_off
        assert "before the loss it stood at A 0.0, B 60.0" in rig.motion.doubt

    run_motion(scenario, make=LostAgain)


def test_an_axis_that_was_under_way_when_the_link_was_lost_may_stand_elsewhere_without_doubt():
    async def scenario(rig):
        rig.motion.order(Target(40.0, 60.0, "far"))
        await asyncio.sleep(3.0)
        rig.unit.is_lost = True
        await asyncio.sleep(4.0)
        assert rig.moves[-1].outcome is MoveOutcome.LINK_LOST
        rig.unit.is_lost = False
        await asyncio.sleep(15.0)
        assert rig.motion.doubt is None
        assert 0.0 < rig.unit.place()[0] < 35.0

    run_motion(scenario)


def test_the_first_connection_is_logged_and_a_later_loss_and_return_are_reported(caplog):
    async def scenario(rig):
        assert not rig.positioner_events
        rig.unit.is_lost = True
        await asyncio.sleep(3.0)
        rig.unit.is_lost = False
        await asyncio.sleep(10.0)
        assert rig.positioner_events == [
            "the positioner is down: hand: does not answer",
            "the positioner is back: board, firmware 1, serial 7",
        ]

    with caplog.at_level(logging.INFO):
        run_motion(scenario)
    said = [record.getMessage() for record in caplog.records]
    assert said.count("the positioner is connected: board, firmware 1, serial 7") == 1


def test_a_driver_that_hangs_ends_motion_with_its_error_and_giving_up_blocks_the_positioner():
    async def scenario(rig):
        rig.unit.is_lost = True
        rig.unit.refuses["open"] = DriverHungError("hand", "hangs")

        async def hung():
            raise DriverHungError("hand", "hangs")

        rig.unit.open = hung
        await asyncio.sleep(30.0)

    with pytest.raises(DriverHungError):
        run_motion(scenario)

    async def given_up(rig):
        before = rig.changes
        rig.motion.give_up("the driver hangs")
        assert not rig.motion.connected
        assert rig.motion.blocked == "the driver hangs"
        assert rig.changes == before + 1

    run_motion(given_up)
