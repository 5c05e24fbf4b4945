"""Processes of this machine as workers."""

import multiprocessing
import os
import signal
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from typing import TypeVar

Task = TypeVar("Task")
Result = TypeVar("Result")


@contextmanager
def process_pool(jobs: int) -> "Iterator[ProcessPool]":
    """Have `jobs` processes for a while; an exception ends them, whatever they work on."""
    pool = ProcessPool(jobs)
    try:
        yield pool
    except BaseException:
        pool.end()
        raise
    pool.close()


class ProcessPool:
    """A number of processes; when one of them is killed, all are replaced."""

    death_errors: tuple[type[BaseException], ...] = (BrokenProcessPool,)
    most_deaths = 3

    def __init__(self, jobs: int) -> None:
        self._jobs = jobs
        self._executor = self._start()

    def capacity(self) -> int:
        """Return the number of processes."""
        return self._jobs

    def submit(self, work: Callable[[Task], Result], task: Task) -> Future[Result]:
        """Hand out a task."""
        return self._executor.submit(work, task)

    def replace_dead_workers(self) -> bool:
        """Start all processes anew: when one dies, the executor loses the others' work too."""
        self.end()
        self._executor = self._start()
        return True

    def check_alive(self) -> None:
        """Do nothing: the executor reports a dead process at once."""

    def close(self) -> None:
        """Let the processes end."""
        self._executor.shutdown()

    def end(self) -> None:
        """End the processes, whatever they work on."""
        processes = list((self._executor._processes or {}).values())  # noqa: SLF001 - nothing else tells whom to end
        for process in processes:
            process.terminate()
        self._executor.shutdown(cancel_futures=True)

    def _start(self) -> ProcessPoolExecutor:
        # A fork starts at once, and needs no helper process that outlives it.
        context = multiprocessing.get_context("fork" if "fork" in multiprocessing.get_all_start_methods() else None)
        return ProcessPoolExecutor(self._jobs, context, _begin)


def _begin() -> None:
    # Only the process that hands out the work heeds Ctrl-C and signals like it: it knows what is done. It ends these
    # processes by SIGTERM, so that signal gets its default action back in place of the inherited handler.
    signal.signal(signal.SIGTERM, signal.SIG_DFL)
    for number in (signal.SIGINT, getattr(signal, "SIGHUP", signal.SIGINT)):
        signal.signal(number, signal.SIG_IGN)
    threading.Thread(target=_end_with_parent, name="parent", daemon=True).start()


def _end_with_parent() -> None:
    parent = multiprocessing.parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)
