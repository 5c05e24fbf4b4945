"""A thread of its own for one instrument's blocking calls, each with a deadline.

Third-party drivers block, and some never return. The event loop waits here without being held up; a call that does not
come back is left behind with its thread, and the next one gets a new thread.
"""

import asyncio
import threading
from collections.abc import Callable
from concurrent.futures import Future
from dataclasses import dataclass, field
from queue import SimpleQueue
from typing import Any, TypeVar

from drivers.errors import ConnectError, DriverHungError, LinkLostError

T = TypeVar("T")

# Each hung call keeps its thread; beyond this the driver under it is broken and more threads do not help.
_MOST_HUNG = 8


def thread_start_error(device: str) -> ConnectError:
    """Return the error for a thread that cannot be had now."""
    return ConnectError(
        device,
        "this machine has no room for a thread: too little memory, or more tasks than the unit allows (TasksMax)",
    )


class DeviceThread:
    """Runs the calls of one instrument one after the other.

    Parameters
    ----------
    device
        Role of the instrument, for errors and the thread's name.
    """

    def __init__(self, device: str) -> None:
        self._device = device
        self._worker: _Worker | None = None
        self._abandoned_workers: list[_Worker] = []

    async def call(
        self, function: Callable[[], T], deadline_s: float, discard: Callable[[T], object] | None = None
    ) -> T:
        """Return what `function` returns in the thread; raise what it raises.

        Parameters
        ----------
        function
            The blocking call.
        deadline_s
            Longest wait, calls before it included.
        discard
            Called in the thread with a result that comes after nobody waits for it any more, such as a port to close.

        Raises
        ------
        LinkLostError
            The call did not return in time. The session that it belongs to must not be used again.
        DriverHungError
            Too many calls have never returned.
        ConnectError
            There is no room for the thread.
        """
        worker = self._worker or self._start()
        job = _Job(function, discard)
        worker.jobs.put(job)
        limit = asyncio.timeout(deadline_s)
        try:
            async with limit:
                result: T = await asyncio.wrap_future(job.future)
        except BaseException:
            late = job.give_up()
            # An event loop that was held up finds the deadline past although the result came in time: return that.
            if limit.expired() and job.future.done() and not job.future.cancelled():
                came: T = job.future.result()
                return came
            if late is not None:
                worker.jobs.put(_Job(late, None))
            if limit.expired():
                self._abandon(worker)
                message = f"a call of its driver did not return within {deadline_s:g} s"
                raise LinkLostError(self._device, message) from None
            raise
        return result

    async def finish(self, function: Callable[[], object] | None, deadline_s: float) -> None:
        """Run a last call, if any, and end the thread; waits at most `deadline_s`, never raises a device's error."""
        if self._worker is None and function is None:
            return
        try:
            worker = self._worker or self._start()
        except ConnectError:
            return
        self._abandon(worker, function)
        try:
            async with asyncio.timeout(deadline_s):
                await asyncio.wrap_future(worker.ended)
        except TimeoutError:
            return

    def _start(self) -> "_Worker":
        self._abandoned_workers = [worker for worker in self._abandoned_workers if not worker.ended.done()]
        if len(self._abandoned_workers) >= _MOST_HUNG:
            raise DriverHungError(self._device, f"{_MOST_HUNG} calls of its driver never returned")
        try:
            self._worker = _Worker(f"heliocube-{self._device}")
        except RuntimeError:
            raise thread_start_error(self._device) from None
        return self._worker

    def _abandon(self, worker: "_Worker", last: Callable[[], object] | None = None) -> None:
        if last is not None:
            worker.jobs.put(_Job(last, None))
        worker.jobs.put(None)
        if self._worker is worker:
            self._worker = None
            self._abandoned_workers.append(worker)


@dataclass
class _Job:
    function: Callable[[], Any]
    discard: Callable[[Any], object] | None
    future: "Future[Any]" = field(default_factory=Future)
    lock: threading.Lock = field(default_factory=threading.Lock)
    given_up: bool = False

    def run(self) -> None:
        if not self.future.set_running_or_notify_cancel():
            return
        try:
            result = self.function()
        except BaseException as error:  # noqa: BLE001 - handed to whoever waits, as it is
            self.future.set_exception(error)
            return
        with self.lock:
            if not self.given_up:
                self.future.set_result(result)
                return
        if self.discard is not None:
            self.discard(result)

    def give_up(self) -> Callable[[], object] | None:
        """Note that nobody waits any more; return how to discard a result that had come in the same instant."""
        with self.lock:
            self.given_up = True
        discard, future = self.discard, self.future
        if discard is None or not future.done() or future.cancelled() or future.exception() is not None:
            return None
        return lambda: discard(future.result())


class _Worker:
    def __init__(self, name: str) -> None:
        self.jobs: SimpleQueue[_Job | None] = SimpleQueue()
        self.ended: Future[None] = Future()
        # A caller that gives up waiting for the end must not cancel it.
        self.ended.set_running_or_notify_cancel()
        # A daemon, so that a call that never returns does not keep the process from ending.
        threading.Thread(target=self._run, name=name, daemon=True).start()

    def _run(self) -> None:
        while (job := self.jobs.get()) is not None:
            job.run()
        self.ended.set_result(None)
