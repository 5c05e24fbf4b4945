"""The workers of a dask cluster: machines that have the same heliocube, behind one scheduler."""

import logging
import math
import platform
import threading
import time
import warnings
from collections.abc import Callable, Iterator
from concurrent.futures import CancelledError, Executor, Future
from contextlib import contextmanager
from functools import lru_cache, partial
from importlib.metadata import version
from typing import Any, TypeVar

from daemon.base.errors import UserError
from daemon.studies.spread.errors import WorkersError
from daemon.studies.spread.new_process import ProcessDiedError, run_in_new_process

Task = TypeVar("Task")
Result = TypeVar("Result")

CONNECTS_WITHIN_S = 10.0
WORKERS_WITHIN_S = 60.0
_CLOSES_WITHIN_S = 5.0
_COUNTS_EVERY_S = 5.0
_TASKS_A_THREAD = 2
# Another release of these may change a last digit. A study gives the same bytes everywhere, or refuses and says why.
_COMPARED_PACKAGES = ("heliocube", "numpy", "pandas", "pvlib", "scipy")
# These loggers print tracebacks of a lost connection for as long as the program runs. Errors here say what matters.
_NOISY_LOGGERS = ("distributed", "distributed.client", "tornado.application")
_UNREADABLE = "deserialization of the task graph"
# One task at a time in a process, whatever the number of the worker's threads.
_TASK_LOCK = threading.Lock()


@contextmanager
def cluster_pool(address: str, *, apart: bool) -> "Iterator[ClusterPool]":
    """Connect to a scheduler for a while; tasks that are not done at the end are called off."""
    try:
        from distributed import Client, KilledWorker  # noqa: PLC0415 - of an extra
        from distributed.comm.addressing import parse_address, parse_host_port  # noqa: PLC0415 - as above
    except ImportError:
        raise UserError(
            "--cluster needs dask.distributed: pip install --require-hashes -r deploy/lock/cluster.txt,"
            " or 'heliocube[cluster]'; or take --jobs"
        ) from None
    _mute_loggers()
    try:
        parse_host_port(parse_address(address)[1])
    except ValueError as error:
        raise UserError(f"--cluster: '{address}' is not an address, such as 192.168.1.5:8786: {error}") from None
    client = _connected(Client, address)
    pool = ClusterPool(client, address, (KilledWorker, ProcessDiedError), apart=apart)
    try:
        pool.wait()
        yield pool
    except CancelledError:
        raise pool.scheduler_gone_error() from None
    except ImportError as error:
        raise WorkersError(f"--cluster: a worker of {address} lacks a module that this machine has: {error}") from None
    except RuntimeError as error:
        if _UNREADABLE not in str(error):
            raise
        raise WorkersError(
            f"--cluster: the scheduler at {address} cannot load the work: install the same heliocube there"
        ) from None
    finally:
        pool.executor.shutdown(wait=False)
        client.close(timeout=_CLOSES_WITHIN_S)


class ClusterPool:
    """A pool on `distributed.Client.get_executor`; the scheduler itself hands out again the tasks of a dead worker."""

    most_deaths = 1
    """The scheduler tries some workers before it gives a task up."""

    def __init__(self, client: Any, address: str, died: tuple[type[BaseException], ...], *, apart: bool) -> None:
        self.death_errors = died
        self.executor: Executor = client.get_executor(pure=False)
        self._client = client
        self._address = address
        self._apart = apart
        self._threads = 0
        self._last_count_s = -math.inf
        self._missing_since: float | None = None

    def capacity(self) -> int:
        """Return twice the number of threads, so that no worker waits for its next task to arrive."""
        if time.monotonic() - self._last_count_s > _COUNTS_EVERY_S:
            self._count()
        return max(_TASKS_A_THREAD * self._threads, 1)

    def submit(self, work: Callable[[Task], Result], task: Task) -> Future[Result]:
        """Hand out a task."""
        return self.executor.submit(partial(_on_worker, _versions(), work, apart=self._apart), task)

    def replace_dead_workers(self) -> bool:
        """Do nothing: the scheduler has given up that one task only, and has workers for the others."""
        return False

    def wait(self) -> None:
        """Wait for the first worker."""
        try:
            self._client.wait_for_workers(1, timeout=CONNECTS_WITHIN_S)
        except TimeoutError:
            raise self._no_workers_error() from None
        self._check_releases()

    def check_alive(self) -> None:
        """Count the workers; there may be none for up to a minute, while they are started again."""
        self._count()
        if self._threads:
            self._missing_since = None
            return
        now = time.monotonic()
        self._missing_since = self._missing_since or now
        if now - self._missing_since > WORKERS_WITHIN_S:
            raise self._no_workers_error()

    def scheduler_gone_error(self) -> WorkersError:
        """Return what to say when the scheduler has gone away."""
        return WorkersError(f"--cluster: the scheduler at {self._address} is gone: start it and its workers again")

    def _no_workers_error(self) -> WorkersError:
        if self._last_count_s > -math.inf:
            return WorkersError(
                f"--cluster: all workers of the scheduler at {self._address} are gone: their logs say why; a worker"
                f" without this heliocube ends at its first task; then start 'dask worker {self._address}' again"
            )
        return WorkersError(
            f"--cluster: the scheduler at {self._address} has no workers: start 'dask worker {self._address}'"
        )

    def _count(self) -> None:
        try:
            self._threads = sum(self._client.nthreads().values())
        except (OSError, TimeoutError, ValueError):
            raise self.scheduler_gone_error() from None
        self._last_count_s = time.monotonic()

    def _check_releases(self) -> None:
        """Raise `WorkersError` for a worker with other releases: one without heliocube dies over its first task."""
        try:
            told = self._client.get_versions(packages=[name for name, _ in _versions()[1:]])["workers"]
        except (OSError, TimeoutError, ValueError):
            raise self.scheduler_gone_error() from None
        for worker, known in told.items():
            for name, wanted in _versions()[1:]:
                if known and (there := known["packages"].get(name)) != wanted:
                    raise _release_error(f"at {worker}", name, there, wanted)


def _connected(connect: Callable[..., Any], address: str) -> Any:
    try:
        with warnings.catch_warnings():
            warnings.filterwarnings("error", message="Mismatched versions", category=Warning)
            return connect(address, timeout=CONNECTS_WITHIN_S, set_as_default=False)
    except Warning as error:
        told = " ".join(str(error).split())
        raise WorkersError(f"--cluster: {address} has other releases than this machine: {told}") from None
    except (OSError, TimeoutError):
        raise WorkersError(
            f"--cluster: no scheduler answers at {address} within {CONNECTS_WITHIN_S:g} s: start 'dask scheduler' there"
        ) from None


def _mute_loggers() -> None:
    for name in _NOISY_LOGGERS:
        logging.getLogger(name).setLevel(logging.CRITICAL + 1)


@lru_cache
def _versions() -> tuple[tuple[str, str], ...]:
    major, minor, _ = platform.python_version_tuple()
    return (("Python", f"{major}.{minor}"), *((name, version(name)) for name in _COMPARED_PACKAGES))


def _release_error(where: str, name: str, there: str | None, wanted: str) -> WorkersError:
    has = f"has {name} {there}" if there else f"lacks {name}"
    return WorkersError(f"--cluster: the worker {where} {has}, and this machine uses {wanted}: install the same there")


def _on_worker(
    theirs: tuple[tuple[str, str], ...], work: Callable[[Task], Result], task: Task, *, apart: bool
) -> Result:
    """Carry out a task on the worker that it has come to, or refuse it."""
    for (name, wanted), (_, here) in zip(theirs, _versions(), strict=True):
        if wanted != here:
            raise _release_error(f"on {platform.node()}", name, here, wanted)
    if apart:
        return run_in_new_process(work, task)
    with _TASK_LOCK:
        return work(task)
