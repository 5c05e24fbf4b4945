"""Event loops whose time is not the machine's: scaled for watching a rig, virtual for days in seconds.

Virtual time stands still while the program computes and while a job is out in a thread; when nothing is left to do it
jumps to the next timer. Datagrams on loopback arrive within the send call, so they are always seen before a jump.
"""

import asyncio
import gc
import heapq
import math
import selectors
import time
from asyncio import AbstractEventLoop, Future, TimerHandle
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import Executor
from contextlib import contextmanager
from contextvars import Context, copy_context
from functools import partial
from math import ceil
from typing import Any, NamedTuple, TypeVarTuple, cast

Arguments = TypeVarTuple("Arguments")

_DEADLOCK_AFTER_S = 10.0
_LOOK_EVERY_ROUNDS = 16
_RESOLUTION_S = 1e-9
_LONGEST_TURN_S = 1.0
_TIDY_TIMERS = 100
_GC_THRESHOLDS = (100_000, 20, 20)
# The callback that `asyncio.sleep`, and nothing else, sets for the end of its time.
_WAKE_SLEEPER = getattr(asyncio.futures, "_set_result_unless_cancelled", None)


class _DelegatingSelector(selectors.BaseSelector):
    """A real selector with its waiting replaced by a subclass."""

    def __init__(self) -> None:
        self._real = selectors.DefaultSelector()

    def register(self, fileobj: Any, events: int, data: Any = None) -> selectors.SelectorKey:
        return self._real.register(fileobj, events, data)

    def unregister(self, fileobj: Any) -> selectors.SelectorKey:
        return self._real.unregister(fileobj)

    def modify(self, fileobj: Any, events: int, data: Any = None) -> selectors.SelectorKey:
        return self._real.modify(fileobj, events, data)

    def get_map(self) -> Mapping[Any, selectors.SelectorKey]:
        return cast("Mapping[Any, selectors.SelectorKey]", self._real.get_map())

    def close(self) -> None:
        self._real.close()


class _ScaledSelector(_DelegatingSelector):
    def __init__(self, loop: "ScaledTimeLoop") -> None:
        super().__init__()
        self._loop = loop

    def select(self, timeout: float | None = None) -> list[tuple[selectors.SelectorKey, int]]:
        loop = self._loop
        due_s = math.inf if timeout is None else loop.time() + timeout
        events = self._real.select(None if timeout is None else max(due_s - loop.ideal_time_s(), 0.0) / loop.speed)
        loop.begin_turn(due_s)
        return events


class ScaledTimeLoop(asyncio.SelectorEventLoop):
    """An event loop whose clock runs `speed` times as fast as the machine's.

    If a busy machine lets the program wait for a tenth of a second, that is six seconds at 60 times real speed, longer
    than a device may be silent. So such time does not pass in one leap: the loop catches up as fast as the program can,
    from timer to timer, and no turn of the loop takes more than a second of it.

    Attributes
    ----------
    speed
        How many of its seconds pass in one of the machine's.
    """

    def __init__(self, speed: float) -> None:
        self.speed = speed
        self._start_s = time.monotonic()
        # Both numbers in one attribute, for threads ask for the time as well.
        self._turn = self._start_s, self._start_s
        super().__init__(_ScaledSelector(self))

    def time(self) -> float:
        """Scaled seconds, equal to the machine's monotonic clock at construction."""
        begun_s, begun_real_s = self._turn
        return begun_s + min((time.monotonic() - begun_real_s) * self.speed, _LONGEST_TURN_S)

    def ideal_time_s(self) -> float:
        """Return what the time would be if the program had always run when it was to."""
        return self._start_s + (time.monotonic() - self._start_s) * self.speed

    def begin_turn(self, at_most_s: float) -> None:
        """Set the time to what it should be, but not beyond the timer that was waited for."""
        self._turn = min(self.ideal_time_s(), at_most_s), time.monotonic()


class _Beat(NamedTuple):
    every_s: float
    call: Callable[[], bool]


class _Timer:
    """Stands in for `asyncio.TimerHandle`; it is cancelled if it has no callback."""

    __slots__ = ("_args", "_context", "_when_s", "callback")

    def __init__(self, when_s: float, callback: Callable[..., object], args: tuple[Any, ...], context: Context) -> None:
        self._when_s = when_s
        self.callback: Callable[..., object] | None = callback
        self._args = args
        self._context = context

    def when(self) -> float:
        """Return the virtual time at which it is due."""
        return self._when_s

    def cancel(self) -> None:
        """Let the timer call nothing."""
        self.callback, self._args = None, ()

    def cancelled(self) -> bool:
        """Tell whether the timer was cancelled."""
        return self.callback is None

    def run(self, loop: AbstractEventLoop) -> None:
        """Call back, unless cancelled."""
        if self.callback is None:
            return
        try:
            self._context.run(self.callback, *self._args)
        except (SystemExit, KeyboardInterrupt):
            raise
        except BaseException as error:  # noqa: BLE001 - as asyncio does: an error is reported, and the loop goes on
            loop.call_exception_handler({"message": f"Exception in timer {self.callback!r}", "exception": error})


_CANCELLED_TIMER = _Timer(0.0, print, (), copy_context())
_CANCELLED_TIMER.cancel()


class _VirtualSelector(_DelegatingSelector):
    def __init__(self) -> None:
        super().__init__()
        # Sockets are polled 200,000 times a day, nearly always in vain: the system's own poll takes half the time.
        poll = getattr(getattr(self._real, "_selector", None), "poll", self._real.select)
        self._has_events: Callable[[float], object] = poll
        # Both are heaps ordered by time, and for the same time by which was set first.
        self._beats: list[tuple[float, int, _Beat]] = []
        self._last_beat_number = 0
        self._timers: list[tuple[float, int, _Timer]] = []
        self._last_timer_number = 0
        self._tidy_at = _TIDY_TIMERS
        self._now_ns, self.now_s = 0, 0.0
        self.jobs = 0
        self._rounds = 0
        self.loop: AbstractEventLoop

    def set_timer(self, timer: _Timer) -> None:
        self._last_timer_number += 1
        heapq.heappush(self._timers, (timer.when(), self._last_timer_number, timer))
        if len(self._timers) > self._tidy_at:
            self._timers = [entry for entry in self._timers if not entry[2].cancelled()]
            heapq.heapify(self._timers)
            self._tidy_at = 2 * len(self._timers) + _TIDY_TIMERS

    def set_beat(self, beat: _Beat) -> Callable[[], None]:
        self._last_beat_number = number = self._last_beat_number + 1
        heapq.heappush(self._beats, (self.now_s + beat.every_s, number, beat))

        def end() -> None:
            # Change the list in place: a beat may call this while `_advance_time_to` works on the same list.
            self._beats[:] = [entry for entry in self._beats if entry[1] != number]
            heapq.heapify(self._beats)

        return end

    def select(self, timeout: float | None = None) -> list[tuple[selectors.SelectorKey, int]]:
        if timeout == 0:
            # Callbacks are waiting. Sockets are polled before time moves, and now and then here, so that none starves.
            self._rounds += 1
            self._run_timers()
            return self._real.select(0) if self._rounds % _LOOK_EVERY_ROUNDS == 0 else []
        if self._has_events(0):
            return self._real.select(0)
        self._drop_cancelled()
        if self.jobs or not (self._timers or self._beats):
            events = self._real.select(_DEADLOCK_AFTER_S)
            if not events:
                raise RuntimeError(
                    f"nothing happened for {_DEADLOCK_AFTER_S:g} s of real time and no timer is set: "
                    "the program waits for something that virtual time cannot bring"
                )
            return events
        if self._advance_time_to(self._timers[0][0] if self._timers else math.inf):
            self._run_timers()
        return []

    def _advance_time_to(self, until_s: float) -> bool:
        """Let time go on, with its beats; return False if one of them has set off something that has to run first."""
        beats = self._beats
        while beats:
            due_s, number, beat = beats[0]
            if due_s >= until_s:
                break
            self.skip(max(due_s - self.now_s, 0.0))
            heapq.heapreplace(beats, (self.now_s + beat.every_s, number, beat))
            if beat.call() or until_s == math.inf:
                return False
        self.skip(max(until_s - self.now_s, 0.0))
        return True

    def advance_if_idle(self, when_s: float) -> bool:
        """Let time go on to an instant if nothing else is to happen before; return False if something is."""
        self._drop_cancelled()
        if self.jobs or (self._timers and self._timers[0][0] <= when_s + max(_RESOLUTION_S, math.ulp(when_s))):
            return False
        return not self._has_events(0) and self._advance_time_to(when_s)

    def _drop_cancelled(self) -> None:
        while self._timers and self._timers[0][2].callback is None:
            heapq.heappop(self._timers)

    def _run_timers(self) -> None:
        # Called here: through the loop's own list of callbacks each would take a second round. Timers that are set
        # meanwhile wait for the next round. Time is rounded to whole nanoseconds, and to what a float can hold.
        due_s, last = self.now_s + max(_RESOLUTION_S, math.ulp(self.now_s)), self._last_timer_number
        while self._timers and self._timers[0][0] < due_s and self._timers[0][1] <= last:
            heapq.heappop(self._timers)[2].run(self.loop)

    def skip(self, duration_s: float) -> None:
        # Counted in whole nanoseconds, so that nothing is lost to rounding in a year.
        self._now_ns += ceil(duration_s * 1e9)
        self.now_s = self._now_ns / 1e9


class VirtualTimeLoop(asyncio.SelectorEventLoop):
    """An event loop that never waits: its time starts at 0 and jumps from timer to timer."""

    def __init__(self) -> None:
        self._virtual = _VirtualSelector()
        self._virtual.loop = self
        super().__init__(self._virtual)

    def time(self) -> float:
        """Virtual seconds since construction."""
        return self._virtual.now_s

    def call_later(
        self,
        delay: float,
        callback: Callable[[*Arguments], object],
        *args: *Arguments,
        context: Context | None = None,
    ) -> TimerHandle:
        """Call back after so many virtual seconds; a task that sleeps alone goes on at once."""
        when_s = self._virtual.now_s + delay
        if callback is _WAKE_SLEEPER and self._pass_sleep_if_alone(when_s):
            callback(*args)
            return cast("TimerHandle", _CANCELLED_TIMER)
        return self.call_at(when_s, callback, *args, context=context)

    def call_at(
        self,
        when: float,
        callback: Callable[[*Arguments], object],
        *args: *Arguments,
        context: Context | None = None,
    ) -> TimerHandle:
        """Call back at a virtual time, at a third of what a timer of asyncio's costs: a day has half a million."""
        if self.is_closed():
            raise RuntimeError("Event loop is closed")
        timer = _Timer(when, callback, args, context or copy_context())
        self._virtual.set_timer(timer)
        return cast("TimerHandle", timer)

    def _pass_sleep_if_alone(self, until_s: float) -> bool:
        """Let time go on while the running task sleeps, if nothing else is to happen before: it sees no difference.

        The task goes on at once then, at a fifth of the cost of a timer, a waking and a round of the loop.
        """
        task = asyncio.current_task(self)
        if task is None or task.cancelling() or getattr(self, "_ready", True):
            return False
        return self._virtual.advance_if_idle(until_s)

    def call_every(self, every_s: float, call: Callable[[], bool]) -> Callable[[], None]:
        """Call back again and again, at a tenth of what a timer costs; return a function that ends this.

        Parameters
        ----------
        every_s
            Virtual seconds between two calls.
        call
            Returns whether it has set off anything that has to run before time goes on. It runs in the context of this
            call, as with a timer.
        """
        return self._virtual.set_beat(_Beat(every_s, partial(copy_context().run, call)))

    def skip(self, duration_s: float) -> None:
        """Let time jump although timers are set: those that come due meanwhile run once, late, and see the new time."""
        self._virtual.skip(duration_s)

    def run_in_executor(
        self,
        executor: Executor | None,
        func: Callable[[*Arguments], Any],
        *args: *Arguments,
    ) -> Future[Any]:
        """Run a job in a thread; virtual time stands still until its result has been taken in."""
        future = super().run_in_executor(executor, func, *args)
        self._virtual.jobs += 1
        future.add_done_callback(self._job_done)
        return future

    def _job_done(self, _future: Future[Any]) -> None:
        self._virtual.jobs -= 1

    async def shutdown_default_executor(self, timeout: float | None = None) -> None:  # noqa: ARG002, ASYNC109
        """Wait for the threads as long as they take: a time limit (from Python 3.12 on) would be over in no time."""
        self._virtual.jobs += 1
        await super().shutdown_default_executor()
        self._virtual.jobs -= 1


@contextmanager
def virtual_time() -> Iterator[asyncio.Runner]:
    """Run in virtual time, seldom collecting garbage: a day makes hardly any cycles, and takes a thirtieth less."""
    often = gc.get_threshold()
    gc.set_threshold(*_GC_THRESHOLDS)
    try:
        with asyncio.Runner(loop_factory=VirtualTimeLoop) as runner:
            yield runner
    finally:
        gc.set_threshold(*often)


def call_every(every_s: float, call: Callable[[], bool]) -> Callable[[], None]:
    """Call back every `every_s` of the running loop's time, whatever loop it is; return a function that ends this."""
    loop = asyncio.get_running_loop()
    if isinstance(loop, VirtualTimeLoop):
        return loop.call_every(every_s, call)
    timer: asyncio.TimerHandle

    def again() -> None:
        nonlocal timer
        timer = loop.call_later(every_s, again)
        call()

    def end() -> None:
        timer.cancel()

    timer = loop.call_later(every_s, again)
    return end


async def call_until(every_s: float, call: Callable[[], bool]) -> None:
    """Call back every `every_s` until that returns True; in virtual time cheaper than a task that sleeps in between."""
    await wait_or_poll(asyncio.Event(), every_s, call)


async def wait_or_poll(event: asyncio.Event, every_s: float, call: Callable[[], bool]) -> None:
    """Return when `event` is set, or a call every `every_s` returns True, and leave the event cleared."""

    def beat() -> bool:
        if call():
            event.set()
        return event.is_set()

    end = call_every(every_s, beat)
    try:
        await event.wait()
    finally:
        end()
        event.clear()


def new_loop(speed: float) -> AbstractEventLoop:
    """Return an ordinary event loop for speed 1 and a scaled one otherwise."""
    return asyncio.SelectorEventLoop() if speed == 1.0 else ScaledTimeLoop(speed)


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
