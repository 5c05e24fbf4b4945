"""The campaign on a service with several trackers: each has to keep every promise, and answers only for itself."""

import json
from dataclasses import replace

import pytest

from daemon.base.errors import UserError
from daemon.studies.campaign.command_channel import DirectCommandChannel
from daemon.studies.campaign.draw import draw_schedule
from daemon.studies.campaign.matrix import chosen_schedules
from daemon.studies.campaign.run import run_schedule
from daemon.studies.campaign.schedule import Schedule, ScheduledEvent

GOTO = ScheduledEvent(145.0, "command", "goto", (-45.0, 30.0), tracker=1)
TURNS_BY_ITSELF = ScheduledEvent(200.0, "fault", "own_tracking", lasts_s=30.0, tracker=1)


class MixedUp:
    """A door through which some commands reach other trackers than they should."""

    def __init__(self, **places):
        self._places = places
        self._honest = DirectCommandChannel()

    def has(self, name):
        return self._honest.has(name)

    async def give(self, service, name, value, why, place=0):
        return await self._honest.give(service, name, value, why, self._places.get(name, place))


def run(*events, door=None, heal=False):
    schedule = replace(draw_schedule(1, 0.12, trackers=2), events=events, sky=(700.0, 90.0), start="2022-06-21T12:00")
    return run_schedule(schedule, door, heal=heal)


def test_a_seed_draws_the_same_events_at_the_same_times_for_several_trackers_as_for_one():
    alone, several = draw_schedule(7, 3), draw_schedule(7, 3, trackers=3)
    assert {event.tracker for event in alone.events} == {0}
    assert {event.tracker for event in several.events} == {0, 1, 2, None}
    assert [replace(event, tracker=0) for event in several.events] == list(alone.events)
    assert several == Schedule.from_json(several.json())
    assert several == draw_schedule(7, 3, trackers=3)


def test_a_schedule_for_a_tracker_that_does_not_exist_is_refused(tmp_path):
    file = tmp_path / "mine.json"
    file.write_text(replace(draw_schedule(1, 0.2), events=(GOTO,)).json())
    with pytest.raises(UserError, match="goto is for tracker 1, and there are 1, from 0"):
        chosen_schedules(1, 1, 1.0, (), (), file)


def test_an_old_schedule_that_names_no_trackers_is_for_one_tracker(tmp_path):
    old = json.loads(draw_schedule(1, 0.2).json())
    del old["trackers"]
    for event in old["events"]:
        del event["tracker"]
    assert Schedule.from_json(json.dumps(old)) == draw_schedule(1, 0.2)


def test_every_tracker_recovers_and_works_again_without_a_broken_promise():
    stop = ScheduledEvent(150.0, "command", "stop", tracker=None)
    assert run(GOTO, stop, TURNS_BY_ITSELF, heal=True).violations == ()


def test_the_campaign_notices_a_command_that_reaches_another_tracker():
    hold = ScheduledEvent(150.0, "command", "hold", tracker=1)
    assert "mixed-up" in run(hold, door=MixedUp(hold=0)).broken_promises


@pytest.mark.parametrize("also", [(), (replace(TURNS_BY_ITSELF, at_s=148.0, tracker=0),)])
def test_the_campaign_notices_a_stop_that_misses_a_tracker_whatever_is_wrong_with_another(also):
    stop = ScheduledEvent(150.0, "command", "stop", tracker=None)
    broken = [found for found in run(GOTO, *also, stop, door=MixedUp(stop=0)).violations if found.text.startswith("t1")]
    assert "moves-under-stop" in {found.promise for found in broken}
