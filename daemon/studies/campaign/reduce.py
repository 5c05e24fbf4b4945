"""Reduces a failure to the events and settings that it takes, so that people can read it and run it in a second."""

from collections.abc import Callable, Collection
from dataclasses import replace
from datetime import timedelta

from daemon.config.file import ConfigError
from daemon.studies.campaign.run import CampaignOutcome, run_schedule
from daemon.studies.campaign.schedule import Schedule

_BEFORE_FIRST_S = 120.0
_AFTER_LAST_S = 60.0
_SHARES = (0.95, 0.9, 0.75, 0.5, 0.25)


def reduce_schedule(
    schedule: Schedule,
    promises: Collection[str],
    broken_s: float | None = None,
    again: Callable[[Schedule], CampaignOutcome] = run_schedule,
) -> Schedule:
    """Return a schedule that still breaks one of these promises, and has no event or setting that can be left out.

    Parameters
    ----------
    schedule, promises
        What failed, and what it broke.
    broken_s
        When it broke. What came later is left out first, then as much as possible of what came long before.
    again
        Carries out a schedule.
    """

    def fails(fewer: Schedule) -> bool:
        try:
            return bool(again(fewer).broken_promises & set(promises))
        except ConfigError:
            # Some settings only go together.
            return False

    if broken_s is not None:
        schedule = _first_that(fails, [_up_to_time(schedule, broken_s)], schedule)
        late = [_from_event(schedule, round(share * len(schedule.events))) for share in _SHARES]
        schedule = _first_that(fails, late, schedule)
    for section, values in schedule.settings.items():
        for name in values:
            schedule = _first_that(fails, [_with_default(schedule, section, name)], schedule)
    size = len(schedule.events)
    while size:
        at = 0
        while at < len(schedule.events):
            fewer = replace(schedule, events=schedule.events[:at] + schedule.events[at + size :])
            if fails(fewer):
                schedule = fewer
            else:
                at += size
        # Halves first: a day has hundreds of events, and most have nothing to do with the failure.
        size //= 2
    return schedule


def _first_that(fails: Callable[[Schedule], bool], tries: Collection[Schedule], schedule: Schedule) -> Schedule:
    return next((fewer for fewer in tries if fails(fewer)), schedule)


def _with_default(schedule: Schedule, section: str, name: str) -> Schedule:
    settings = {
        each: {key: values[key] for key in values if (each, key) != (section, name)}
        for each, values in schedule.settings.items()
    }
    return replace(schedule, settings={each: values for each, values in settings.items() if values})


def _up_to_time(schedule: Schedule, end_s: float) -> Schedule:
    events = tuple(event for event in schedule.events if event.at_s <= end_s)
    return replace(schedule, hours=min(schedule.hours, (end_s + _AFTER_LAST_S) / 3600), events=events)


def _from_event(schedule: Schedule, first: int) -> Schedule:
    """Return the schedule from shortly before an event on, with the sun where it was."""
    if not 0 < first < len(schedule.events):
        return schedule
    earlier_s = (schedule.events[first].at_s - _BEFORE_FIRST_S) // 60 * 60
    if earlier_s <= 0:
        return schedule
    events = tuple(replace(event, at_s=round(event.at_s - earlier_s, 2)) for event in schedule.events[first:])
    start = (schedule.begin + timedelta(seconds=earlier_s)).replace(tzinfo=None).isoformat()
    return replace(schedule, start=start, hours=schedule.hours - earlier_s / 3600, events=events)
