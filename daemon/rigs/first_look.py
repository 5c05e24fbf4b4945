"""A look at a positioner that something other than the service is about to move."""

import asyncio

from daemon.base.clock import Clock
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
