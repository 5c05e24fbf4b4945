"""Scaled and virtual time."""

import asyncio
import gc
import itertools
import math
import socket
import time
from contextvars import ContextVar

import pytest

from daemon.base.timeloop import ScaledTimeLoop, VirtualTimeLoop, call_every, call_until, virtual_time, wait_or_poll

NAME = ContextVar("name", default="")


def test_a_virtual_day_of_timers_passes_at_once_and_in_order():
    async def day():
        loop = asyncio.get_running_loop()
        seen = []

        async def tick(period):
            while True:
                await asyncio.sleep(period)
                seen.append((round(loop.time(), 6), period))

        async with asyncio.TaskGroup() as group:
            tasks = [group.create_task(tick(period)) for period in (3600.0, 5400.0)]
            await asyncio.sleep(86400.0 + 1)
            for task in tasks:
                task.cancel()
        return seen, loop.time()

    with asyncio.Runner(loop_factory=VirtualTimeLoop) as runner:
        seen, end = runner.run(day())
    assert end == pytest.approx(86401.0)
    assert len(seen) == 24 + 16
    assert seen == sorted(seen, key=lambda entry: entry[0])


def test_a_datagram_on_loopback_arrives_before_virtual_time_jumps():
    async def exchange():
        loop = asyncio.get_running_loop()
        arrivals = []

        class Receiver(asyncio.DatagramProtocol):
            def datagram_received(self, data, addr):
                arrivals.append((loop.time(), data))

        transport, _ = await loop.create_datagram_endpoint(Receiver, local_addr=("127.0.0.1", 0))
        address = transport.get_extra_info("sockname")
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender:
            for number in range(50):
                sender.sendto(b"%d" % number, address)
                await asyncio.sleep(5.0)
        transport.close()
        return arrivals

    with asyncio.Runner(loop_factory=VirtualTimeLoop) as runner:
        arrivals = runner.run(exchange())
    assert [data for _, data in arrivals] == [b"%d" % number for number in range(50)]
    assert [when for when, _ in arrivals] == pytest.approx([5.0 * number for number in range(50)])


def test_virtual_time_stands_still_while_a_thread_works():
    async def work():
        async with asyncio.timeout(1.0):
            await asyncio.to_thread(time.sleep, 0.05)
        return asyncio.get_running_loop().time()

    with asyncio.Runner(loop_factory=VirtualTimeLoop) as runner:
        assert runner.run(work()) < 0.001


def test_virtual_time_stands_still_while_threads_end():
    async def work():
        loop = asyncio.get_running_loop()
        loop.call_later(10.0, print)
        loop.run_in_executor(None, time.sleep, 0.05)
        # As asyncio's runner ends a loop from Python 3.12 on.
        await loop.shutdown_default_executor(timeout=1.0)
        return loop.time()

    with asyncio.Runner(loop_factory=VirtualTimeLoop) as runner:
        assert runner.run(work()) < 0.001


def test_a_program_that_waits_for_ever_in_virtual_time_gets_an_error(monkeypatch):
    monkeypatch.setattr("daemon.base.timeloop._DEADLOCK_AFTER_S", 0.05)

    async def hang():
        await asyncio.Event().wait()

    loop = VirtualTimeLoop()
    task = loop.create_task(hang())
    with pytest.raises(RuntimeError, match="virtual time cannot bring"):
        loop.run_until_complete(task)
    task.cancel()
    loop.run_until_complete(asyncio.gather(task, return_exceptions=True))
    loop.close()


def test_a_sleep_of_a_scaled_minute_lasts_a_minute_by_the_loop_and_less_than_half_of_it_in_truth():
    async def minute():
        loop = asyncio.get_running_loop()
        before, before_real_s = loop.time(), time.monotonic()
        await asyncio.sleep(60.0)
        return loop.time() - before, time.monotonic() - before_real_s

    with asyncio.Runner(loop_factory=lambda: ScaledTimeLoop(6000.0)) as runner:
        scaled_s, real_s = runner.run(minute())
    assert scaled_s >= 60.0
    # It takes a hundredth of a second; even a machine that is busy with other work takes no thousand times as long.
    assert real_s < 30.0


def test_scaled_time_lost_while_the_loop_was_blocked_is_made_up_for_in_small_steps():
    async def seconds():
        loop = asyncio.get_running_loop()
        seen, began_s = [loop.time()], time.monotonic()
        # Half a second, half a minute of the loop's time, in which nothing else runs.
        loop.call_soon(time.sleep, 0.5)
        behind_s = math.inf
        while len(seen) < 20 or behind_s > 5.0:
            assert len(seen) < 20_000, f"{behind_s:.0f} s are not made up for"
            await asyncio.sleep(1.0)
            behind_s = 60.0 * (time.monotonic() - began_s) - (loop.time() - seen[0])
            assert behind_s >= -0.5, "it does not run ahead"
            seen.append(loop.time())
        return seen

    with asyncio.Runner(loop_factory=lambda: ScaledTimeLoop(60.0)) as runner:
        seen = runner.run(seconds())
    # Each wait may begin and end up to a second late.
    steps = [after - before for before, after in itertools.pairwise(seen)]
    assert min(steps) >= 0.999
    assert max(steps) <= 3.0


def test_a_function_called_every_second_runs_between_the_timers_until_it_is_ended():
    async def scenario():
        loop, calls = asyncio.get_running_loop(), []
        start_s, woken = loop.time(), asyncio.Event()

        def call():
            calls.append(loop.time() - start_s)
            if len(calls) == 3:
                woken.set()
            return len(calls) == 3

        end = call_every(1.0, call)
        loop.call_later(60.0, int)
        await woken.wait()
        assert loop.time() - start_s == pytest.approx(3.0, abs=1e-6), "who is woken runs before time goes on"
        await asyncio.sleep(2.5)
        end()
        assert calls == pytest.approx([1, 2, 3, 4, 5], abs=1e-6)
        await asyncio.sleep(2.0)
        assert len(calls) == 5

    with asyncio.Runner(loop_factory=VirtualTimeLoop) as runner:
        runner.run(scenario())


@pytest.mark.parametrize("loop", [asyncio.SelectorEventLoop, VirtualTimeLoop])
def test_a_periodic_call_runs_in_the_context_of_the_task_that_asked_for_it(loop):
    async def worker(name, seen):
        NAME.set(name)
        await call_until(0.01, lambda: seen.append(NAME.get()) or seen.count(name) >= 2)

    async def scenario():
        seen = []
        async with asyncio.timeout(60.0):
            await asyncio.gather(worker("roof", seen), worker("field", seen))
        return set(seen)

    with asyncio.Runner(loop_factory=loop) as runner:
        assert runner.run(scenario()) == {"roof", "field"}


def test_a_timer_that_raises_or_sets_itself_again_for_ever_blocks_nothing_else():
    async def scenario():
        loop, told, turns = asyncio.get_running_loop(), [], []
        loop.set_exception_handler(lambda _, context: told.append(context["exception"]))

        def again():
            turns.append(loop.time())
            loop.call_later(0.0, again)

        for _ in range(300):
            loop.call_later(1.0, turns.clear).cancel()
        late = loop.call_later(0.5, turns.append, 0.5)
        loop.call_later(0.5, lambda: 1 / 0)
        loop.call_later(0.5, late.cancel)
        await asyncio.sleep(0.75)
        assert [type(error) for error in told] == [ZeroDivisionError]
        assert turns == [0.5], "those of one instant are called in the order in which they were set"
        assert late.when() == pytest.approx(0.5)
        again()
        for _ in range(10):
            await asyncio.sleep(0)
        assert 5 < len(turns) < 30
        loop.stop()

    loop = VirtualTimeLoop()
    task = loop.create_task(scenario())
    loop.run_forever()
    loop.close()
    task.result()


def test_call_until_returns_at_the_instant_of_success_and_then_calls_no_more():
    async def scenario():
        loop, calls = asyncio.get_running_loop(), []

        def call():
            calls.append(loop.time())
            return len(calls) == 3

        await call_until(0.1, call)
        assert loop.time() == calls[-1] == pytest.approx(0.3, abs=1e-6)
        with pytest.raises(TimeoutError):
            async with asyncio.timeout(1.0):
                await call_until(0.3, lambda: calls.append(loop.time()) or False)
        await asyncio.sleep(60.0)
        assert len(calls) == 3 + 3

    with asyncio.Runner(loop_factory=VirtualTimeLoop) as runner:
        runner.run(scenario())


@pytest.mark.parametrize("years", [0.5, 0.54, 1.0, 2.0, 20.0])
def test_timers_are_exact_after_half_a_year_to_twenty_years_of_virtual_time(years):
    async def main():
        loop = asyncio.get_running_loop()
        loop.skip(years * 365.25 * 86400.0)
        beaten = []
        end = loop.call_every(1.0, lambda: beaten.append(loop.time()))
        begun_s = loop.time()
        for _ in range(100):
            before_s = loop.time()
            await asyncio.sleep(0.05)
            assert loop.time() - before_s == pytest.approx(0.05, abs=1e-6)
        with pytest.raises(TimeoutError):
            async with asyncio.timeout(3.3):
                await asyncio.sleep(1e9)
        end()
        assert loop.time() - begun_s == pytest.approx(8.3, abs=1e-5)
        assert len(beaten) == 8

    with asyncio.Runner(loop_factory=VirtualTimeLoop) as runner:
        runner.run(main())


def test_a_timer_can_be_years_away():
    async def main():
        await asyncio.sleep(20 * 365.25 * 86400.0)
        return asyncio.get_running_loop().time()

    with asyncio.Runner(loop_factory=VirtualTimeLoop) as runner:
        assert runner.run(main()) == pytest.approx(20 * 365.25 * 86400.0)


@pytest.mark.parametrize("loop", [asyncio.SelectorEventLoop, VirtualTimeLoop])
def test_look_until_ends_when_its_look_succeeds_or_the_event_is_set(loop):
    async def scenario():
        running, event, looks = asyncio.get_running_loop(), asyncio.Event(), []

        def look():
            looks.append(running.time())
            return len(looks) == 3

        await wait_or_poll(event, 0.01, look)
        found = len(looks), event.is_set()
        running.call_soon(event.set)
        await wait_or_poll(event, 3600.0, look)
        return found, len(looks), event.is_set()

    with asyncio.Runner(loop_factory=loop) as runner:
        assert runner.run(scenario()) == ((3, False), 3, False)


def test_a_task_that_sleeps_alone_sees_the_same_order_as_among_other_timers():
    async def course(others):
        loop, seen = asyncio.get_running_loop(), []

        async def sleeper():
            for number in range(4):
                await asyncio.sleep(1.0)
                seen.append(("task", number, round(loop.time(), 6)))

        end = call_every(0.7, lambda: bool(seen.append(("beat", round(loop.time(), 6)))))
        loop.call_later(2.5, lambda: seen.append(("timer", round(loop.time(), 6))))
        loop.call_later(3.0, lambda: seen.append(("at the same time", round(loop.time(), 6))))
        # Other timers, one at every instant, so that the sleeper is not alone.
        timers = [loop.call_later(0.1 * tick, lambda: None) for tick in range(1, 40)] if others else []
        await sleeper()
        end()
        for timer in timers:
            timer.cancel()
        return seen

    def run(others):
        with asyncio.Runner(loop_factory=VirtualTimeLoop) as runner:
            return runner.run(course(others))

    alone = run(others=False)
    assert alone == run(others=True)
    assert [entry[0] for entry in alone[:4]] == ["beat", "task", "beat", "task"]


def test_a_task_that_was_cancelled_does_not_sleep_first():
    async def scenario():
        asyncio.current_task().cancel()
        try:
            await asyncio.sleep(3600.0)
        except asyncio.CancelledError:
            return asyncio.get_running_loop().time()

    with asyncio.Runner(loop_factory=VirtualTimeLoop) as runner:
        assert runner.run(scenario()) < 1.0


def test_garbage_collection_is_rare_in_virtual_time_and_as_frequent_as_before_after_it():
    def fails(runner):
        assert isinstance(runner.get_loop(), VirtualTimeLoop)
        seen.append(gc.get_threshold())
        raise KeyError

    often, seen = gc.get_threshold(), []
    gc.set_threshold(700, 10, 10)
    try:
        with pytest.raises(KeyError), virtual_time() as runner:
            fails(runner)
        after = gc.get_threshold()
    finally:
        gc.set_threshold(*often)
    assert seen[0][0] >= 100_000
    assert after == (700, 10, 10)
