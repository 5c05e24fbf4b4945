"""A look at a positioner that something other than the service is about to move."""

import asyncio

from daemon.base.clock import Clock
from daemon.base.state import StateFolder
from daemon.config.settings import Settings
from daemon.motion import reference
from daemon.motion.reference import kept_doubts
from daemon.tracker import wishes
from daemon.tracker.wishes import kept_wishes
from drivers.errors import RefusedError
from drivers.interfaces import Positioner, Telemetry

LONG_ENOUGH_S = 7.0
"""For two statuses, of which a POZSOL sends one every 3.24 s."""
_LOOKS_EVERY_S = 0.1


async def watched(positioner: Positioner, clock: Clock, seconds: float = LONG_ENOUGH_S) -> Telemetry:
    """Return the last look of so long a time: what contradicts itself shows in two statuses, one after the other.

    Raises `DeviceError` where the positioner falls silent.
    """
    until_s = clock.monotonic() + seconds
    while True:
        seen = await positioner.read_telemetry()
        if clock.monotonic() >= until_s:
            return seen
        await asyncio.sleep(_LOOKS_EVERY_S)


def refuse_noted(settings: Settings, seen: Telemetry) -> None:
    """Raise `RefusedError` for what its service, which is not at work now, has noted: that would not move it either."""
    directory = settings.store.directory
    # What a simulated rig has noted is of another unit.
    if directory is None or not settings.real:
        return
    folder = StateFolder(directory)
    stillness = kept_wishes(folder).stillness
    if stillness is not None:
        raise RefusedError(
            "positioner",
            f"is not moved, because {directory / wishes.FILE_NAME} has noted that it is {stillness}; 'heliocube auto'"
            " ends that while the service runs, and nothing else does",
        )
    doubts = kept_doubts(folder, seen)
    if doubts:
        raise RefusedError(
            "positioner",
            f"is not moved, because {directory / reference.FILE_NAME} has noted: {'; '.join(doubts)};"
            " 'heliocube home' or 'heliocube clear' ends that while the service runs",
        )
