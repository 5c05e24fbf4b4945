"""The last word to a positioner whose link is given up."""

import asyncio
import contextlib
from collections.abc import Coroutine
from typing import Any

from drivers.errors import DeviceError


async def try_for(call: Coroutine[Any, Any, None], within_s: float) -> None:
    """Await a call of the driver for so long [s] at the most; whether it fails changes nothing for whoever parts."""
    with contextlib.suppress(DeviceError, TimeoutError):
        async with asyncio.timeout(within_s):
            await call
