import asyncio
import contextlib
import threading
import time

import pytest

from drivers.errors import ConnectError, DeadlineError, DriverHungError, LinkLostError
from drivers.lines.threads import DeviceThread
from tests.support import PATIENCE_S


@pytest.fixture
def gate():
    """An event that releases every hung call at the end of a test."""
    event = threading.Event()
    yield event
    event.set()


def test_results_and_errors_come_back_as_they_are_and_calls_keep_their_order():
    async def scene():
        thread, seen = DeviceThread("voltmeter"), []
        calls = [thread.call(lambda i=i: seen.append(i) or i, 5.0) for i in range(5)]
        assert await asyncio.gather(*calls) == [0, 1, 2, 3, 4]
        assert seen == [0, 1, 2, 3, 4]

        def fail():
            raise DeadlineError("voltmeter", "too late")

        def time_out():
            raise TimeoutError("of the third party's own")

        with pytest.raises(DeadlineError, match="too late"):
            await thread.call(fail, 5.0)
        with pytest.raises(TimeoutError, match="third party"):
            await thread.call(time_out, 5.0)
        await thread.finish(lambda: seen.append("closed"), 5.0)
        assert seen[-1] == "closed"

    asyncio.run(scene())


def test_a_call_that_never_returns_is_a_lost_link_and_the_next_call_gets_a_new_thread(gate):
    async def scene():
        thread = DeviceThread("multiplexer")
        with pytest.raises(LinkLostError, match="did not return within"):
            await thread.call(gate.wait, 0.05)
        assert await thread.call(lambda: "alive", 5.0) == "alive"
        await thread.finish(lambda: None, 5.0)
        gate.set()

    asyncio.run(scene())


def test_a_result_in_time_counts_even_if_the_event_loop_was_blocked_beyond_the_deadline():
    async def scene():
        thread, ready = DeviceThread("positioner"), threading.Event()
        call = asyncio.create_task(thread.call(lambda: ready.set() or "sent", 0.05))
        await asyncio.sleep(0)
        # The call has ended in time, but its deadline passes before the loop looks.
        assert ready.wait(PATIENCE_S)
        time.sleep(0.2)  # noqa: ASYNC251 - the loop is held up on purpose
        assert await call == "sent"
        assert await thread.call(lambda: "the same", 5.0) == "the same"
        await thread.finish(lambda: None, 5.0)

    asyncio.run(scene())


def test_a_result_that_comes_after_its_deadline_is_discarded(gate):
    discarded = threading.Event()

    def connect():
        gate.wait()
        return "port"

    async def scene():
        thread = DeviceThread("positioner")
        with pytest.raises(LinkLostError):
            await thread.call(connect, 0.05, lambda port: port == "port" and discarded.set())
        gate.set()

    asyncio.run(scene())
    assert discarded.wait(PATIENCE_S)


def test_a_cancelled_call_finishes_in_its_thread_and_its_result_is_discarded(gate):
    discarded = threading.Event()

    async def scene():
        thread, started = DeviceThread("positioner"), threading.Event()

        def connect():
            started.set()
            gate.wait()
            return "port"

        call = asyncio.create_task(thread.call(connect, 5.0, lambda _port: discarded.set()))
        assert await asyncio.to_thread(started.wait, 5.0)
        call.cancel()
        with pytest.raises(asyncio.CancelledError):
            await call
        gate.set()
        await thread.finish(lambda: None, 5.0)

    asyncio.run(scene())
    assert discarded.wait(PATIENCE_S)


def test_closing_does_not_wait_for_hung_calls_and_eight_of_them_are_an_error_until_they_return(gate):
    async def scene():
        thread, hung = DeviceThread("voltmeter"), []

        def hang():
            hung.append("call")
            gate.wait()

        # On a busy machine a thread may begin too late to take its call.
        while len(hung) < 8:
            with pytest.raises(LinkLostError):
                await thread.call(hang, 0.1)
        with pytest.raises(DriverHungError, match="never returned"):
            await thread.call(lambda: None, 1.0)
        await thread.finish(lambda: None, 0.01)
        gate.set()
        async with asyncio.timeout(PATIENCE_S):
            while True:
                with contextlib.suppress(DriverHungError):
                    assert await thread.call(lambda: "alive", 30.0) == "alive"
                    break
                await asyncio.sleep(0.01)
        await thread.finish(lambda: None, 30.0)

    asyncio.run(scene())


def test_a_thread_that_cannot_be_started_is_a_connect_error_until_there_is_room_for_it():
    async def scene():
        thread, closed = DeviceThread("voltmeter"), []
        # No machine has room for such a stack.
        usual = threading.stack_size(1 << 40)
        try:
            with pytest.raises(ConnectError, match="no room for a thread"):
                await thread.call(lambda: 1, 5.0)
            await thread.finish(lambda: closed.append("in vain"), 5.0)
        finally:
            threading.stack_size(usual)
        assert await thread.call(lambda: 2, 5.0) == 2
        await thread.finish(lambda: closed.append("closed"), 5.0)
        assert closed == ["closed"]

    asyncio.run(scene())
