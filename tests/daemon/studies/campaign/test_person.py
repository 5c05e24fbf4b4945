"""Whether the campaign notices a door that lies, a service that dies and a log that floods."""

import logging
from dataclasses import replace

import pytest

from daemon.service.operator import CommandError
from daemon.studies.campaign.command_channel import CommandReply, DirectCommandChannel
from daemon.studies.campaign.draw import draw_schedule
from daemon.studies.campaign.run import run_schedule
from daemon.studies.campaign.schedule import ScheduledEvent

STOP, GOTO, STOW = (
    ScheduledEvent(150.0, "command", "stop"),
    ScheduledEvent(145.0, "command", "goto", (-45.0, 30.0)),
    ScheduledEvent(170.0, "command", "stow"),
)
BAD = ScheduledEvent(150.0, "command", "bad", (0.0, 14.0))


class Lying:
    """A door that is honest except for some commands, which do what a test says."""

    def __init__(self, **lies):
        self._lies = lies
        self._honest = DirectCommandChannel()

    def has(self, name):
        return True

    async def give(self, service, name, value, why, place=0):
        lie = self._lies.get(name)
        if lie is None or (name == "goto" and value != BAD.value):
            return await self._honest.give(service, name, value, why, place)
        return lie(service)


def says(done, text="standing"):
    return lambda service: CommandReply(done, text)


def refuses(sentence):
    def lie(service):
        raise CommandError(sentence)

    return lie


def breaks(service):
    raise KeyError("something")


def kills(service):
    service.trackers[0].control.tick = None
    service.trackers[0].control.decide_again()
    return CommandReply(done=False, text="")


def floods(service):
    for number in range(500):
        logging.getLogger("heliocube.test").info("line %d", number)
    return CommandReply(done=False, text="")


def found(events, door, *, heal=False):
    outcome = run_schedule(replace(draw_schedule(1, 0.08), events=events), door, heal=heal)
    return outcome.broken_promises


@pytest.mark.parametrize(
    ("events", "lies", "promises"),
    [
        ((GOTO, STOP), {"stop": says(done=True)}, {"false-done", "moves-under-stop"}),
        ((STOP, STOW), {"stow": says(done=False)}, {"stop-undone"}),
        ((STOP, STOW), {"stow": refuses("no")}, {"refusal"}),
        ((STOP, STOW), {"stow": refuses("the stop\nends with auto")}, {"sentence"}),
        ((STOW,), {"stow": says(done=True, text="stowed")}, {"false-done"}),
        ((BAD,), {"goto": says(done=False)}, {"bad-input"}),
        ((STOP,), {"stop": breaks}, {"defect"}),
        ((STOP,), {"stop": kills}, {"service-died"}),
        ((STOP,), {"stop": floods}, {"log"}),
    ],
)
def test_the_campaign_notices_wrong_answers_a_service_that_dies_and_a_log_that_floods(events, lies, promises):
    assert promises <= found(events, Lying(**lies))


def test_a_count_lost_just_after_a_hold_does_not_make_its_answer_count_as_wrong():
    settles = replace(GOTO, value=(-10.0, 80.0))
    hold, slip = ScheduledEvent(200.0, "command", "hold"), ScheduledEvent(200.05, "fault", "b_slip")
    assert found((settles, hold, slip), DirectCommandChannel()) == set()


def test_the_campaign_notices_a_tracker_that_does_not_work_again():
    assert "does-not-recover" in found((STOP,), Lying(auto=says(done=True)), heal=True)
