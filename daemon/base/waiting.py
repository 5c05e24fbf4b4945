"""Waiting for an event, but not for ever."""

import asyncio


async def wait_at_most(event: asyncio.Event, duration_s: float) -> None:
    """Return when `event` is set or `duration_s` is over, whichever comes first, and leave the event cleared.

    For loops that look again after an interval and at once when woken. A timer that sets the event costs a tenth of
    `asyncio.timeout`, which matters for loops that run every few seconds of a simulated year.
    """
    timer = asyncio.get_running_loop().call_later(duration_s, event.set)
    try:
        await event.wait()
    finally:
        timer.cancel()
        event.clear()
