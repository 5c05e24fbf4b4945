"""Runs a task in a new process of its own: for work that examines its whole process.

A worker of a cluster will not do: its sockets, threads and memory come and go. As a daemon process it may not start
processes of `multiprocessing` either.
"""

import os
import pickle
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from typing import TypeVar

Task = TypeVar("Task")
Result = TypeVar("Result")

_LOOKS_EVERY_S = 1.0


class ProcessDiedError(Exception):
    """The process died while it worked on its task."""


def run_in_new_process(work: Callable[[Task], Result], task: Task) -> Result:
    """Return the result of `work` on a task in its own process, or raise its error; `ProcessDiedError` if that dies."""
    command = [sys.executable, "-m", __name__, str(os.getpid())]
    # Safe to unpickle: the same program writes this answer, in `_main`.
    done = subprocess.run(command, input=pickle.dumps((work, task)), stdout=subprocess.PIPE, check=False)  # noqa: S603
    if done.returncode:
        raise ProcessDiedError(f"ended with {done.returncode}")
    result, error = pickle.loads(done.stdout)  # noqa: S301
    if error is not None:
        raise error
    return result  # type: ignore[no-any-return]


def _main() -> None:
    threading.Thread(target=_exit_with_parent, args=(int(sys.argv[1]),), daemon=True).start()
    with os.fdopen(os.dup(1), "wb") as answer:
        os.dup2(2, 1)
        work, task = pickle.load(sys.stdin.buffer)  # noqa: S301
        try:
            found, failed = work(task), None
        except Exception as error:  # noqa: BLE001 - it is raised where it is waited for
            found, failed = None, error
        pickle.dump((found, failed), answer)


def _exit_with_parent(parent: int) -> None:
    while os.getppid() == parent:
        time.sleep(_LOOKS_EVERY_S)
    os._exit(1)


if __name__ == "__main__":
    _main()
