"""At the end of the whole service nothing moves on, and nothing is said to stand unless telemetry has shown it."""

import asyncio
import logging

import pytest

from daemon.base.records import Target
from drivers.errors import RefusedError
from tests.support.motion import send_foreign_b_target
from tests.support.phases import now, wait_for_long_rest, wait_for_rest


def ended(run_rig, caplog, act):
    """Run until `act` is over, and return what was logged about motion at the end, and whether it moves."""

    async def scenario(rig):
        await wait_for_long_rest(rig)
        await act(rig)

    with caplog.at_level(logging.INFO):
        rig = run_rig(scenario)
    now = rig.clock.monotonic()
    said = [record.getMessage() for record in caplog.records if record.name == "heliocube.service"]
    return said[-1], rig.unit.truth(now) != rig.unit.truth(now + 60)


def test_at_the_end_motion_that_nobody_ordered_is_stopped_too(run_rig, caplog):
    async def act(rig):
        send_foreign_b_target(rig, 85.0)
        await asyncio.sleep(0.2)

    said, moves = ended(run_rig, caplog, act)
    assert said == "motion stopped: telemetry shows both axes standing"
    assert not moves


def test_at_the_end_an_ordered_move_is_stopped_and_seen_to_stand(run_rig, caplog):
    async def act(rig):
        rig.motion.order(Target(40, 15, "far"))
        await asyncio.sleep(3)

    said, moves = ended(run_rig, caplog, act)
    assert said == "motion stopped: telemetry shows both axes standing"
    assert not moves


def test_at_the_end_control_does_not_order_a_long_stow_again(run_rig, caplog):
    async def act(rig):
        rig.motion.order(Target(-50, 15, "far from stow"))
        await wait_for_rest(rig)
        rig.control.stow("storm")
        # The order is more than a minute old: with the next look, control would give it again.
        await asyncio.sleep(70)
        assert rig.motion.moving

    said, moves = ended(run_rig, caplog, act)
    assert said == "motion stopped: telemetry shows both axes standing"
    assert not moves


def test_at_the_end_no_new_move_is_accepted(run_rig, caplog):
    async def act(rig):
        async def orders():
            while not refused:
                try:
                    rig.motion.order(Target(20, 60, "late"))
                except RefusedError as error:
                    refused.append(error.message)
                await asyncio.sleep(0.01)

        refused = rig.refused = []
        rig.late = asyncio.create_task(orders())
        rigs.append(rig)
        await asyncio.sleep(0.5)

    rigs = []
    said, moves = ended(run_rig, caplog, act)
    assert said == "motion stopped: telemetry shows both axes standing"
    assert not moves
    assert rigs[0].refused == ["the service ends"]


@pytest.mark.parametrize(
    ("trouble", "words"),
    [("deaf", "stop was sent, and no telemetry has shown the axes standing since"), ("unplug", "could not be sent")],
)
def test_at_the_end_axes_not_seen_to_stand_are_reported_as_not_known_to_be_stopped(run_rig, caplog, trouble, words):
    async def act(rig):
        rig.motion.order(Target(40, 15, "far"))
        await asyncio.sleep(2)
        if trouble == "deaf":
            rig.unit.inject("deaf", rig.clock.monotonic())
        else:
            rig.cables.positioner.link_up = False
        await asyncio.sleep(1)

    said, moves = ended(run_rig, caplog, act)
    assert moves
    assert said.startswith("motion is not known to be stopped: ")
    assert words in said
    assert "last seen " in said
    assert "look at the tracker" in said


def test_at_the_end_a_driver_that_never_answers_does_not_keep_the_service_from_ending(run_rig, caplog):
    async def act(rig):
        rig.positioner.stop = lambda: asyncio.sleep(1e6)
        rig.end_s = rig.clock.monotonic()
        rigs.append(rig)

    rigs = []
    said, _ = ended(run_rig, caplog, act)
    assert said.startswith("motion is not known to be stopped: ")
    assert rigs[0].clock.monotonic() - rigs[0].end_s < 12


def test_the_port_is_released_at_the_end(run_rig):
    closed = []

    async def scenario(rig):
        await wait_for_long_rest(rig)
        close = rig.positioner.close

        async def noted():
            closed.append(now(rig))
            await close()

        rig.positioner.close = noted

    run_rig(scenario)
    assert len(closed) == 1
