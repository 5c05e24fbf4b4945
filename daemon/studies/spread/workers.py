"""One code path for every study of many tasks: in this process, in several, or on a cluster."""

from collections import Counter, deque
from collections.abc import Callable, Generator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, wait
from contextlib import AbstractContextManager, closing
from dataclasses import dataclass
from typing import Generic, Protocol, TypeVar

from daemon.base.errors import InterruptedEarlyError, UserError
from daemon.studies.spread.errors import WorkersError

Task = TypeVar("Task")
Result = TypeVar("Result")

_LOOKS_EVERY_S = 5.0


class Pool(Protocol):
    """Workers behind the interface of `concurrent.futures`."""

    death_errors: tuple[type[BaseException], ...]
    """What the future of a task raises if its worker has died."""
    most_deaths: int
    """After this many deaths over one task, the task is the cause, most likely by the memory that it needs."""

    def capacity(self) -> int:
        """Return how many tasks are worth handing out at a time, 1 at least."""

    def submit(self, work: Callable[[Task], Result], task: Task) -> "Future[Result]":
        """Hand out a task."""

    def replace_dead_workers(self) -> bool:
        """Replace workers that died, and tell whether all tasks that were handed out are lost with them."""

    def check_alive(self) -> None:
        """Raise `WorkersError` if no worker is left; called while no task ends."""


@dataclass(frozen=True, slots=True)
class Workers:
    """Who carries out the tasks of a study.

    Attributes
    ----------
    jobs
        How many processes of this machine; 1 is this process alone.
    cluster
        Address of a dask scheduler to use in their place: HOST:PORT.
    """

    jobs: int = 1
    cluster: str | None = None

    @property
    def is_this_process(self) -> bool:
        """Whether this process works itself."""
        return self.cluster is None and self.jobs == 1


THIS_PROCESS = Workers()


def run_tasks(
    work: Callable[[Task], Result], tasks: Sequence[Task], workers: Workers = THIS_PROCESS, *, apart: bool = False
) -> Generator[tuple[int, Result], None, None]:
    """Yield the place of each task with its result, in the order in which they end.

    A task whose worker dies is handed out again. Closing the generator, as Ctrl-C does, ends the tasks under way.

    Parameters
    ----------
    work
        A function of a module; its result depends on its task alone, so that it is the same wherever it runs.
    tasks, workers
        What is to be done, and by whom.
    apart
        Whether the work examines its whole process, as a search for leaks does; on a cluster it then runs in a process
        of its own, and not in the worker's.

    Raises
    ------
    WorkersError
        There is no such cluster, it runs something else, it is gone, or too many workers have died over one task.
    """
    if workers.is_this_process:
        for place, task in enumerate(tasks):
            yield place, work(task)
        return
    with _pool(workers, len(tasks), apart=apart) as pool:
        yield from _TaskDistributor(pool, work, tasks).results()


def check_workers(workers: Workers) -> None:
    """Raise `UserError` if the cluster cannot be used: for studies that begin with long work in this process."""
    if workers.cluster is not None:
        with _pool(workers, 1, apart=False):
            pass


def gather(
    work: Callable[[Task], Result], tasks: Sequence[Task], workers: Workers, progress: Callable[[float], None]
) -> tuple[list[Result], UserError | None]:
    """Return the results in the order of their tasks, and the error that ended the work early, or None.

    Ctrl-C, lost workers or a task that cannot be done end it early; without any result yet, the error is raised.
    `progress` takes the share done, 0..1.
    """
    found: dict[int, Result] = {}
    ended: UserError | None = None
    with closing(run_tasks(work, tasks, workers)) as outcomes:
        try:
            for place, result in outcomes:
                found[place] = result
                progress(len(found) / len(tasks))
        except KeyboardInterrupt:
            if not found:
                raise
            ended = InterruptedEarlyError("interrupted")
        except UserError as error:
            if not found:
                raise
            ended = error
    return [found[place] for place in sorted(found)], ended


def _pool(workers: Workers, tasks: int, *, apart: bool) -> AbstractContextManager[Pool]:
    if workers.cluster is not None:
        from daemon.studies.spread.cluster import cluster_pool  # noqa: PLC0415 - of an extra, and seconds of imports

        return cluster_pool(workers.cluster, apart=apart)
    from daemon.studies.spread.processes import process_pool  # noqa: PLC0415 - this process alone needs none

    return process_pool(min(workers.jobs, max(tasks, 1)))


class _TaskDistributor(Generic[Task, Result]):
    """Hands out tasks, no more than there is room for: thousands of them would burden a scheduler."""

    def __init__(self, pool: Pool, work: Callable[[Task], Result], tasks: Sequence[Task]) -> None:
        self._pool = pool
        self._work = work
        self._tasks = tasks
        self._waiting = deque(range(len(tasks)))
        self._places_by_future: dict[Future[Result], int] = {}
        self._deaths: Counter[int] = Counter()

    def results(self) -> Generator[tuple[int, Result], None, None]:
        while self._waiting or self._places_by_future:
            dead = self._hand_out()
            ended = set() if dead else wait(self._places_by_future, _LOOKS_EVERY_S, FIRST_COMPLETED).done
            if not ended and not dead:
                self._pool.check_alive()
            for future in ended:
                place = self._places_by_future.pop(future)
                try:
                    result = future.result()
                except self._pool.death_errors:
                    dead.append(place)
                else:
                    yield place, result
            if dead:
                self._requeue_dead(dead)

    def _hand_out(self) -> list[int]:
        """Hand out tasks while there is room; return the task that found no worker alive, if there was one."""
        while self._waiting and len(self._places_by_future) < self._pool.capacity():
            place = self._waiting.popleft()
            try:
                future = self._pool.submit(self._work, self._tasks[place])
            except self._pool.death_errors:
                return [place]
            self._places_by_future[future] = place
        return []

    def _requeue_dead(self, dead: list[int]) -> None:
        if self._pool.replace_dead_workers():
            dead += self._places_by_future.values()
            self._places_by_future.clear()
        self._deaths.update(dead)
        for place in dead:
            if self._deaths[place] == self._pool.most_deaths:
                raise WorkersError(
                    f"every worker that took task {place + 1} of {len(self._tasks)} has died: look whether its machine"
                    " has run out of memory, and let fewer of them work at a time"
                )
        self._waiting.extendleft(sorted(dead, reverse=True))
