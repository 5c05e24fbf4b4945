"""The look at a positioner before a program other than the service moves it."""

import asyncio

from daemon.base.clock import Clock
from daemon.base.state import StateFolder
from daemon.config.settings import Settings
from daemon.motion import doubts
from daemon.tracker import wishes
from daemon.tracker.wishes import kept_wishes
from drivers.errors import RefusedError
from drivers.interfaces import Positioner, Telemetry

LONG_ENOUGH_S = 7.0
"""Long enough for two statuses: a POZSOL sends one every 3.24 s."""
_LOOKS_EVERY_S = 0.1


async def watch_telemetry(positioner: Positioner, clock: Clock, seconds: float = LONG_ENOUGH_S) -> Telemetry:
    """Read telemetry for `seconds` and return the last: a contradiction shows only in two statuses after each other.

    Raises `DeviceError` if the positioner falls silent.
    """
    until_s = clock.monotonic() + seconds
    while True:
        seen = await positioner.read_telemetry()
        if clock.monotonic() >= until_s:
            return seen
        await asyncio.sleep(_LOOKS_EVERY_S)


def check_noted_obstacles(settings: Settings, seen: Telemetry) -> None:
    """Raise `RefusedError` if the service, which does not run now, has noted why it would not move the positioner."""
    directory = settings.store.directory
    # The notes of a simulated rig are about another unit.
    if directory is None or not settings.real:
        return
    folder = StateFolder(directory)
    standstill_reason = kept_wishes(folder).standstill_reason
    if standstill_reason is not None:
        raise RefusedError(
            "positioner",
            f"is not moved, because {directory / wishes.FILE_NAME} has noted that it is {standstill_reason};"
            " 'heliocube auto' ends that while the service runs, and nothing else does",
        )
    noted = doubts.kept_doubts(folder, seen)
    if noted:
        raise RefusedError(
            "positioner",
            f"is not moved, because {directory / doubts.FILE_NAME} has noted: {'; '.join(noted)};"
            " 'heliocube home' or 'heliocube clear' ends that while the service runs",
        )
