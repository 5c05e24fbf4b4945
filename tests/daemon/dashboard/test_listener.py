"""A browser that waits for news, and disconnects at the instant when they come."""

import asyncio

import pytest

from daemon.dashboard.upstream import Listener


@pytest.mark.parametrize("turns", range(4))
def test_a_listener_that_is_cancelled_as_a_message_arrives_does_not_wait_on(turns):
    async def scene():
        listener = Listener()
        waiting = asyncio.create_task(listener.next())
        await asyncio.sleep(0.01)
        listener.put("roof", "news")
        for _ in range(turns):
            await asyncio.sleep(0)
        if waiting.cancel():
            with pytest.raises(asyncio.CancelledError):
                await waiting
        else:
            assert waiting.result() == ["news"]

    asyncio.run(scene())
