"""A slice of the fault campaign: some seeds, and the schedules that once broke a promise.

The whole of it is ``heliocube campaign``.
"""

from pathlib import Path

import pytest

from daemon.studies.campaign.draw import COMMANDS, FAULT_SPANS, draw_schedule
from daemon.studies.campaign.run import run_schedule
from daemon.studies.campaign.schedule import Schedule

HOURS = 1.0
SEEDS = (121, 304, 581, 783, 1891)
FAILED_ONCE = sorted((Path(__file__).parent / "failed_once").glob("*.json"))


def shown(schedule, outcome):
    broken = "\n".join(map(str, outcome.violations))
    again = f"heliocube campaign --from {schedule.seed} --seeds 1 --hours {schedule.hours}"
    again += f" --trackers {schedule.trackers} --show"
    return f"{broken}\n{schedule.text()}\nagain: {again}"


def test_the_seeds_draw_every_fault_and_every_command():
    drawn = {event.name for seed in SEEDS for event in draw_schedule(seed, HOURS).events}
    assert drawn >= {*FAULT_SPANS, *COMMANDS}


# The same seeds each time: a change that breaks one fails before it lands and after. `.ci/run` takes fresh seeds.
@pytest.mark.parametrize("seed", SEEDS)
def test_fault_campaign_with_fixed_seeds_breaks_no_promise(seed):
    schedule = draw_schedule(seed, HOURS)
    outcome = run_schedule(schedule)
    assert not outcome.violations, shown(schedule, outcome)


def test_fault_campaign_of_three_trackers_breaks_no_promise():
    schedule = draw_schedule(2263, HOURS, trackers=3)
    outcome = run_schedule(schedule)
    assert not outcome.violations, shown(schedule, outcome)


@pytest.mark.parametrize("path", FAILED_ONCE, ids=lambda path: path.stem)
def test_schedules_that_failed_once_break_no_promise_again(path):
    schedule = Schedule.from_json(path.read_text())
    outcome = run_schedule(schedule)
    assert not outcome.violations, shown(schedule, outcome)
