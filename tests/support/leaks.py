"""Nothing may leak out of a test: no task of any event loop, no thread, no file descriptor, no child process."""

import asyncio
import contextlib
import gc
import logging
import os
import signal
import threading
import time

import pytest

from tests.support import forks

_ENDS_WITHIN_S = 5.0


class _Tasks:
    """Notes which tasks are still pending when an event loop is closed, which cancels them without a word."""

    def __init__(self, patch):
        self.left = []
        close = asyncio.Runner.close

        def closing(runner):
            loop = runner._loop
            if loop is not None and not loop.is_closed():
                # A task that has been cancelled may need one more turn of the loop to end.
                self.left += [repr(task) for task in asyncio.all_tasks(loop) if not task.cancelling()]
            close(runner)

        patch.setattr(asyncio.Runner, "close", closing)


@pytest.fixture(autouse=True)
def nothing_leaks():
    """Fail a test that leaves a task, a thread, a file descriptor or a process behind, whatever its tier."""
    # Objects from before, above all of libraries, are not this test's garbage: searching them cost a tenth of a second.
    gc.freeze()
    threads, descriptors, before = set(threading.enumerate()), _descriptors(), children()
    root = logging.getLogger()
    handlers, level = [*root.handlers], root.level
    with pytest.MonkeyPatch.context() as patch:
        tasks = _Tasks(patch)
        yield
    # Commands that run until they are ended log to a stream that is closed with their test.
    for handler in [handler for handler in root.handlers if handler not in handlers]:
        root.removeHandler(handler)
    root.setLevel(level)
    logging.captureWarnings(capture=False)
    gc.collect()
    left = [thread for thread in threading.enumerate() if thread not in threads and thread.is_alive()]
    for thread in left:
        thread.join(_ENDS_WITHIN_S)
    opened = _opened_since(descriptors)
    deadline_s = time.monotonic() + _ENDS_WITHIN_S
    while opened and time.monotonic() < deadline_s:
        # A library's thread may be about to close a file that it has read.
        time.sleep(0.05)
        opened = _opened_since(descriptors)
    started = {number: command for number, command in children().items() if number not in before}
    for number in started:
        with contextlib.suppress(ProcessLookupError):
            os.kill(number, signal.SIGKILL)
    assert not started, f"the test left processes running: {started}"
    assert not tasks.left, f"the test left tasks pending at the end of their loop: {tasks.left}"
    assert not [thread.name for thread in left if thread.is_alive()], "the test left threads running"
    assert not opened, f"the test left file descriptors open: {opened}"


def _opened_since(before: dict[str, str]) -> dict[str, str]:
    return {number: target for number, target in _descriptors().items() if number not in before}


# Plain os functions: pathlib would make both functions three times as slow, and every test calls them four times.
def _descriptors() -> dict[str, str]:
    found = {}
    for number in os.listdir("/proc/self/fd"):  # noqa: PTH208
        try:
            target = os.readlink(f"/proc/self/fd/{number}")  # noqa: PTH115
        except OSError:
            continue
        # Regular files of imported data (time zones, compiled caches) are the interpreter's, not the test's.
        if target.startswith(("socket:", "pipe:", "/dev/pt", "anon_inode:")) or (
            "/tmp" in target and "site-packages" not in target
        ):
            found[number] = target
    _, asked_on = forks.origin_handles()
    return {number: target for number, target in found.items() if int(number) not in asked_on}


def children() -> dict[int, str]:
    """Return the child processes that nobody has waited for, with their commands."""
    found = forks.running()
    # The kernel's own list of children: asking every process of the machine for its parent took longer than most tests.
    origin, _ = forks.origin_handles()
    tasks = os.listdir("/proc/self/task")  # noqa: PTH208
    for number in set(" ".join(_read(f"/proc/self/task/{task}/children") for task in tasks).split()):
        if int(number) not in origin:
            found[int(number)] = _read(f"/proc/{number}/cmdline").replace("\0", " ") or "ended, not awaited"
    return found


def _read(file: str) -> str:
    # A process or a thread may end while it is being read.
    try:
        with open(file, encoding="utf-8", errors="replace") as opened:  # noqa: PTH123
            return opened.read()
    except OSError:
        return ""
