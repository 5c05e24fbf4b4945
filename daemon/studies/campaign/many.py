"""Many schedules, in this process or in several, with the same results."""

import multiprocessing
import signal
import statistics
from collections import Counter
from collections.abc import Callable, Generator, Iterable, Iterator, Sequence
from concurrent.futures import Future, ProcessPoolExecutor, as_completed
from dataclasses import dataclass, field, replace
from typing import Any

from daemon.studies.campaign.run import CampaignOutcome, run_schedule
from daemon.studies.campaign.schedule import Schedule


@dataclass(slots=True)
class CampaignSummary:
    """What the schedules of a campaign have shown so far.

    Attributes
    ----------
    hours
        Of virtual time.
    events, moves
        How many there were.
    stop_latencies_s
        How soon stops stood, in truth.
    failed
        The schedules that broke a promise, each with what it showed.
    done
        Their number, failed or not.
    """

    hours: float = 0.0
    events: int = 0
    moves: int = 0
    stop_latencies_s: list[float] = field(default_factory=list)
    failed: list[tuple[Schedule, CampaignOutcome]] = field(default_factory=list)
    done: int = 0

    def add(self, schedule: Schedule, outcome: CampaignOutcome) -> None:
        """Count one more."""
        self.done += 1
        self.hours += schedule.hours
        self.events += len(schedule.events)
        self.moves += outcome.moves
        self.stop_latencies_s += outcome.stop_latencies_s
        if outcome.violations:
            self.failed.append((schedule, outcome))

    def page(self) -> dict[str, Any]:
        """Return it for scripts; `failed` has the broken promises of each seed."""
        latencies = self.stop_latencies_s
        return {
            "schedules": self.done,
            "hours": self.hours,
            "events": self.events,
            "moves": self.moves,
            "stops_in_motion": len(latencies),
            "stop_median_s": statistics.median(latencies) if latencies else None,
            "stop_worst_s": max(latencies, default=None),
            "failed": {schedule.seed: sorted(outcome.promises) for schedule, outcome in self.failed},
        }

    def lines(self) -> Iterator[str]:
        """Yield it for people; the same for the same schedules, in whatever order they ended."""
        yield (
            f"{self.done} schedules, {self.hours:g} h of virtual time, {self.events} events, {self.moves} moves,"
            f" {len(self.failed)} with a broken promise"
        )
        if self.stop_latencies_s:
            yield (
                f"{len(self.stop_latencies_s)} stops in motion: {statistics.median(self.stop_latencies_s):.2f} s to"
                f" standstill in truth at the median, {max(self.stop_latencies_s):.2f} s at worst"
            )
        broken = Counter(promise for _, outcome in self.failed for promise in outcome.promises)
        for promise, count in sorted(broken.items()):
            seeds = sorted(schedule.seed for schedule, outcome in self.failed if promise in outcome.promises)
            yield f"{promise}: {count} ({', '.join(map(str, seeds))})"


def run_many(
    schedules: Sequence[Schedule],
    jobs: int,
    show: Callable[[Schedule, CampaignOutcome], None],
    *,
    with_log: bool = False,
) -> CampaignSummary:
    """Carry out schedules and return the sum of it; Ctrl-C ends it early, and what is done counts.

    Parameters
    ----------
    schedules
        What happens.
    jobs
        In how many processes; 1 for this one.
    show
        Called with each schedule as soon as it has been carried out.

    with_log
        Whether the outcomes that are shown have the log of runs that broke nothing, too.

    Raises
    ------
    UserError
        A schedule asks for something that simulator or service cannot do.
    """
    summary = CampaignSummary()
    outcomes = (
        _here(schedules)
        if jobs == 1
        else _in_processes(schedules, jobs, run_schedule if with_log else _run_and_forget_log)
    )
    try:
        for schedule, outcome in outcomes:
            summary.add(schedule, outcome)
            show(schedule, outcome)
    except KeyboardInterrupt:
        pass
    finally:
        outcomes.close()
    return summary


def run_all(schedules: Sequence[Schedule], jobs: int, progress: Callable[[float], None]) -> list[CampaignOutcome]:
    """Carry out schedules in so many processes and return what each showed, in their order.

    `progress` takes the share that is done, 0..1.
    """
    outcomes: dict[int, CampaignOutcome] = {}
    places = {id(schedule): place for place, schedule in enumerate(schedules)}
    found = _here(schedules, _run_once) if jobs == 1 else _in_processes(schedules, jobs, _run_once)
    for schedule, outcome in found:
        outcomes[places[id(schedule)]] = outcome
        progress(len(outcomes) / len(schedules))
    return [outcomes[place] for place in range(len(schedules))]


def _here(
    schedules: Iterable[Schedule], run: Callable[[Schedule], CampaignOutcome] = run_schedule
) -> Generator[tuple[Schedule, CampaignOutcome], None, None]:
    for schedule in schedules:
        yield schedule, run(schedule)


def _in_processes(
    schedules: Iterable[Schedule], jobs: int, run: Callable[[Schedule], CampaignOutcome]
) -> Generator[tuple[Schedule, CampaignOutcome], None, None]:
    # A fork begins at once, and needs no helper that outlives it.
    context = multiprocessing.get_context("fork" if "fork" in multiprocessing.get_all_start_methods() else None)
    with ProcessPoolExecutor(jobs, context, _ends_at_ctrl_c) as executor:
        futures: dict[Future[CampaignOutcome], Schedule] = {
            executor.submit(run, schedule): schedule for schedule in schedules
        }
        try:
            for future in as_completed(futures):
                yield futures[future], future.result()
        except BaseException:
            executor.shutdown(wait=False, cancel_futures=True)
            for process in multiprocessing.active_children():
                process.terminate()
            raise


def _ends_at_ctrl_c() -> None:
    # Quietly: the process that began it says what there is to say.
    signal.signal(signal.SIGINT, signal.SIG_DFL)


def _run_once(schedule: Schedule) -> CampaignOutcome:
    return replace(run_schedule(schedule, heal=False), lines=())


def _run_and_forget_log(schedule: Schedule) -> CampaignOutcome:
    """Carry out a schedule; the log of one that broke nothing is not worth its way between processes."""
    outcome = run_schedule(schedule)
    return outcome if outcome.violations else replace(outcome, lines=())
