"""A last call to a positioner whose link is given up."""

import asyncio
import contextlib
from collections.abc import Coroutine
from typing import Any

from drivers.errors import DeviceError


async def try_for(call: Coroutine[Any, Any, None], within_s: float) -> None:
    """Await a call of the driver for `within_s` at the most; if it fails, nothing changes: the link is given up."""
    with contextlib.suppress(DeviceError, TimeoutError):
        async with asyncio.timeout(within_s):
            await call
