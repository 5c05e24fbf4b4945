"""A look at a positioner that something other than the service is about to move."""

import asyncio

from daemon.base.clock import Clock
from daemon.base.state import StateFolder
from daemon.config.settings import Settings
from daemon.motion.reference import FILE_NAME, kept_doubts
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
    doubts = kept_doubts(StateFolder(directory), seen) if settings.real else ()
    if directory is not None and doubts:
        raise RefusedError(
            "positioner",
            f"is not moved, because {directory / FILE_NAME} has noted: {'; '.join(doubts)};"
            " 'heliocube home' or 'heliocube clear' ends that while the service runs",
        )
