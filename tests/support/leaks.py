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
    """Notes what is still pending where an event loop is closed, which cancels it without a word."""

    def __init__(self, patch):
        self.left = []
        close = asyncio.Runner.close

        def closing(runner):
            loop = runner._loop
            if loop is not None and not loop.is_closed():
                # What has been told to end may take the loop's next turn to do it.
                self.left += [repr(task) for task in asyncio.all_tasks(loop) if not task.cancelling()]
            close(runner)

        patch.setattr(asyncio.Runner, "close", closing)


@pytest.fixture(autouse=True)
def nothing_leaks():
    """Fail a test that leaves a task, a thread, a file descriptor or a process behind, whatever its tier."""
    # What was there before, libraries above all, is no test's garbage: to look through it cost a tenth of a second.
    gc.freeze()
    threads, descriptors, before = set(threading.enumerate()), _descriptors(), children()
    root = logging.getLogger()
    handlers, level = [*root.handlers], root.level
    with pytest.MonkeyPatch.context() as patch:
        tasks = _Tasks(patch)
        yield
    # Commands that run until they are ended direct the log to a stream that ends with their test.
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
        # A library's thread may be about to close what it has read.
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


# With the paths of pathlib both would take three times as long, and every test asks four times.
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
    _, asked_on = forks.kept()
    return {number: target for number, target in found.items() if int(number) not in asked_on}


def children() -> dict[int, str]:
    """Return the processes that this one has started and not waited for, with what they run."""
    found = forks.running()
    # The kernel's own list: to ask every process of the machine for its parent took more time than most tests.
    origin, _ = forks.kept()
    tasks = os.listdir("/proc/self/task")  # noqa: PTH208
    for number in set(" ".join(_read(f"/proc/self/task/{task}/children") for task in tasks).split()):
        if int(number) not in origin:
            found[int(number)] = _read(f"/proc/{number}/cmdline").replace("\0", " ") or "ended, not awaited"
    return found


def _read(file: str) -> str:
    # A process or a thread may end while it is looked at.
    try:
        with open(file, encoding="utf-8", errors="replace") as opened:  # noqa: PTH123
            return opened.read()
    except OSError:
        return ""
