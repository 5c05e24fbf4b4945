"""Carries out many schedules; the results are the same whoever carries them out."""

import statistics
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from contextlib import closing
from dataclasses import dataclass, field, replace
from typing import Any

from daemon.base.words import pluralise
from daemon.studies.campaign.run import CampaignOutcome, run_schedule
from daemon.studies.campaign.schedule import Schedule
from daemon.studies.spread.errors import WorkersError
from daemon.studies.spread.workers import Workers, run_tasks


@dataclass(slots=True)
class CampaignSummary:
    """What the schedules of a campaign have shown so far.

    Attributes
    ----------
    hours
        Hours of virtual time.
    events, moves
        How many there were.
    stop_latencies_s
        How soon the axes truly stood after each stop in motion.
    failed
        The schedules that broke a promise, each with what it showed.
    done
        How many schedules were carried out, failed or not.
    workers_error
        Why the other schedules could not be carried out, or None.
    """

    hours: float = 0.0
    events: int = 0
    moves: int = 0
    stop_latencies_s: list[float] = field(default_factory=list)
    failed: list[tuple[Schedule, CampaignOutcome]] = field(default_factory=list)
    done: int = 0
    workers_error: WorkersError | None = None

    def add(self, schedule: Schedule, outcome: CampaignOutcome) -> None:
        """Count one more."""
        self.done += 1
        self.hours += schedule.hours
        self.events += len(schedule.events)
        self.moves += outcome.moves
        self.stop_latencies_s += outcome.stop_latencies_s
        if outcome.violations:
            self.failed.append((schedule, outcome))

    def as_dict(self) -> dict[str, Any]:
        """Return the summary for scripts; `failed` has the broken promises of each seed."""
        latencies = self.stop_latencies_s
        return {
            "schedules": self.done,
            "hours": self.hours,
            "events": self.events,
            "moves": self.moves,
            "stops_in_motion": len(latencies),
            "stop_median_s": statistics.median(latencies) if latencies else None,
            "stop_worst_s": max(latencies, default=None),
            "failed": {schedule.seed: sorted(outcome.broken_promises) for schedule, outcome in self.failed},
        }

    def lines(self) -> Iterator[str]:
        """Yield the summary in lines for people; they do not depend on the order in which the schedules ended."""
        yield (
            f"{pluralise(self.done, 'schedule')}, {self.hours:g} h of virtual time,"
            f" {pluralise(self.events, 'event')}, {pluralise(self.moves, 'move')},"
            f" {len(self.failed)} with a broken promise"
        )
        if self.stop_latencies_s:
            stops = pluralise(len(self.stop_latencies_s), "stop")
            yield (
                f"{stops} in motion: {statistics.median(self.stop_latencies_s):.2f}"
                f" s to standstill in truth at the median, {max(self.stop_latencies_s):.2f} s at worst"
            )
        broken = Counter(promise for _, outcome in self.failed for promise in outcome.broken_promises)
        for promise, count in sorted(broken.items()):
            seeds = sorted(schedule.seed for schedule, outcome in self.failed if promise in outcome.broken_promises)
            yield f"{promise}: {count} ({', '.join(map(str, seeds))})"


def run_many(
    schedules: Sequence[Schedule],
    workers: Workers,
    show: Callable[[Schedule, CampaignOutcome], None],
    *,
    with_log: bool = False,
) -> CampaignSummary:
    """Carry out schedules and return their summary; Ctrl-C ends it early, and what is done by then counts.

    Parameters
    ----------
    schedules
        What happens.
    workers
        Who carries it out.
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
    # A log costs much to send from another process, and nothing in this one.
    run = run_schedule if with_log or workers.is_this_process else _run_and_forget_log
    with closing(run_tasks(run, schedules, workers, apart=True)) as outcomes:
        try:
            for place, outcome in outcomes:
                summary.add(schedules[place], outcome)
                show(schedules[place], outcome)
        except KeyboardInterrupt:
            pass
        except WorkersError as error:
            summary.workers_error = error
    return summary


def run_all(
    schedules: Sequence[Schedule], workers: Workers, progress: Callable[[float], None]
) -> list[CampaignOutcome]:
    """Carry out schedules and return what each showed, in their order; `progress` takes the share done, 0..1."""
    outcomes: dict[int, CampaignOutcome] = {}
    for place, outcome in run_tasks(_run_without_healing, schedules, workers, apart=True):
        outcomes[place] = outcome
        progress(len(outcomes) / len(schedules))
    return [outcomes[place] for place in range(len(schedules))]


def _run_without_healing(schedule: Schedule) -> CampaignOutcome:
    return replace(run_schedule(schedule, heal=False), lines=())


def _run_and_forget_log(schedule: Schedule) -> CampaignOutcome:
    """Carry out a schedule; the log of a run that broke nothing is not worth sending to another process."""
    outcome = run_schedule(schedule)
    return outcome if outcome.violations else replace(outcome, lines=())
