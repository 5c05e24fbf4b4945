"""The phases of a tracker's day that tests wait for, how long they last, and what was told."""

import asyncio

from daemon.base.records import Event, Mode, ModeChange


def now(rig):
    return rig.clock.monotonic()


def modes(rig):
    return [change.after for change in rig.records_of(ModeChange)]


def positioner_events(rig):
    return [event.text for event in rig.records_of(Event) if event.subject == "positioner"]


async def wait_for_tracking(rig):
    await rig.until_mode(Mode.TRACKING, 120)


async def wait_for_move(rig):
    """Wait for a move to be well on its way."""
    await wait_for_tracking(rig)
    await rig.until(lambda: rig.motion.target is not None, 5, "a move")
    await asyncio.sleep(3)
    assert rig.motion.target is not None


async def wait_for_rest(rig):
    await rig.until(lambda: not rig.motion.moving, 300, "rest")


async def wait_for_long_rest(rig):
    """Wait until the tracker is in TRACKING and stands, with its last move long over."""
    await wait_for_tracking(rig)
    await wait_for_rest(rig)
    await asyncio.sleep(20)


async def wait_for_homing(rig):
    await rig.until(lambda: rig.motion.homing, 10, "homing")
    await rig.until(lambda: not rig.motion.homing, 900, "the end of homing")
