"""A task in a process of its own, begun for it: for work that looks at its process as a whole.

A worker of a cluster has sockets, threads and memory that come and go; and as a daemon it may have no processes of
`multiprocessing`.
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


class AloneDiedError(Exception):
    """The process has died over its task."""


def alone(work: Callable[[Task], Result], task: Task) -> Result:
    """Return what `work` makes of a task in a process of its own, or raise what it raises; `AloneDiedError`."""
    command = [sys.executable, "-m", __name__, str(os.getpid())]
    # Both ends are ours: what is read here was written a line below, by the same program.
    done = subprocess.run(command, input=pickle.dumps((work, task)), stdout=subprocess.PIPE, check=False)  # noqa: S603
    if done.returncode:
        raise AloneDiedError(f"ended with {done.returncode}")
    result, error = pickle.loads(done.stdout)  # noqa: S301
    if error is not None:
        raise error
    return result  # type: ignore[no-any-return]


def _main() -> None:
    threading.Thread(target=_end_with, args=(int(sys.argv[1]),), daemon=True).start()
    with os.fdopen(os.dup(1), "wb") as answer:
        os.dup2(2, 1)
        work, task = pickle.load(sys.stdin.buffer)  # noqa: S301
        try:
            found, failed = work(task), None
        except Exception as error:  # noqa: BLE001 - it is raised where it is waited for
            found, failed = None, error
        pickle.dump((found, failed), answer)


def _end_with(parent: int) -> None:
    while os.getppid() == parent:
        time.sleep(_LOOKS_EVERY_S)
    os._exit(1)


if __name__ == "__main__":
    _main()
