"""The campaign on a rotator: every fault that it can have happens to it, and others are refused."""

from dataclasses import replace

import pytest

from daemon.base.errors import UserError
from daemon.base.records import Mode
from daemon.rigs.campaign.faults import ROTATOR_PLANT_FAULTS
from daemon.studies.campaign.command_channel import CommandReply, DirectCommandChannel
from daemon.studies.campaign.draw import draw_schedule
from daemon.studies.campaign.matrix import chosen_schedules
from daemon.studies.campaign.run import run_schedule
from daemon.studies.campaign.schedule import Schedule, ScheduledEvent

GOTO = ScheduledEvent(145.0, "command", "goto", (-45.0, 30.0))


class Forgetful(DirectCommandChannel):
    """A door that answers a stop with done and does nothing."""

    async def give(self, service, name, value, why, place=0):
        return CommandReply(True, "") if name == "stop" else await super().give(service, name, value, why, place)


def run(*events, door=None, heal=False):
    schedule = replace(
        draw_schedule(1, 0.1, positioner="rotctld"), events=events, sky=(700.0, 90.0), start="2022-06-21T12:00"
    )
    assert schedule == Schedule.from_json(schedule.json())
    return run_schedule(schedule, door, heal=heal)


def test_a_rotator_that_another_client_moves_enters_fault_and_recovers_with_no_broken_promise():
    sent = ScheduledEvent(120.0, "fault", "own_tracking", lasts_s=5.0)
    outcome = run(sent, heal=True)
    assert outcome.violations == ()
    assert Mode.FAULT in {mode for _, mode in outcome.entered_modes}


def test_the_campaign_times_a_stop_of_a_rotator_and_notices_one_that_does_not_reach_it():
    stop = ScheduledEvent(150.0, "command", "stop")
    (latency_s,) = run(GOTO, stop).stop_latencies_s
    assert latency_s < 0.7
    assert run(GOTO, stop, door=Forgetful()).broken_promises >= {"moves-under-stop"}


@pytest.mark.parametrize(("fault", "mode"), [("gone", True), ("stopless", False)])
def test_a_rotator_that_rotctld_loses_or_that_knows_no_stop_breaks_no_promise(fault, mode):
    begins = ScheduledEvent(148.0, "fault", fault, lasts_s=30.0)
    outcome = run(GOTO, begins, ScheduledEvent(150.0, "command", "stop"), heal=True)
    assert outcome.violations == ()
    assert (Mode.FAULT in {mode for _, mode in outcome.entered_modes}) is mode
    # A rotator that a stop does not reach breaks no promise about stops.
    assert len(outcome.stop_latencies_s) == (fault == "stopless")


def test_the_campaign_lets_a_rotator_leave_the_limits_during_a_move_but_never_its_range(monkeypatch):
    assert run(GOTO).violations == ()
    narrow = {"a": (0.0, 360.0), "b": (60.0, 90.0)}
    monkeypatch.setattr("daemon.rigs.campaign.plant.PlantTracker.range_deg", lambda _mount, axis: narrow[axis])
    assert "limits" in run(GOTO).broken_promises


def test_faults_that_the_chosen_positioner_cannot_have_are_refused_and_not_skipped(tmp_path):
    drawn = {
        event.name
        for seed in range(200)
        for event in chosen_schedules(1, seed, 3, (), (), None, 1, "rotctld")[0].events
        if event.what == "fault"
    }
    assert drawn == ROTATOR_PLANT_FAULTS
    with pytest.raises(UserError, match="a_slip cannot be simulated: a rotator behind rotctld has only"):
        chosen_schedules(1, 1, 1.0, ("a_slip",), (), None, 1, "rotctld")
    with pytest.raises(UserError, match="a_slip cannot be simulated"):
        run(ScheduledEvent(120.0, "fault", "a_slip"))
    with pytest.raises(UserError, match="gone cannot be simulated: only a rotator"):
        chosen_schedules(1, 1, 1.0, ("gone",), (), None)
    with pytest.raises(UserError, match="a rotator has nothing of positioner:drift"):
        chosen_schedules(1, 1, 1.0, ("positioner:drift",), (), None, 1, "rotctld")


@pytest.mark.parametrize(("positioner", "has"), [("pozsol", "reset_position_lost"), ("rotctld", "gone")])
def test_the_faults_drawn_for_a_component_are_those_that_the_chosen_positioner_can_have(positioner, has):
    schedules = chosen_schedules(100, 1, 1.0, ("positioner-link",), (), None, 1, positioner)
    drawn = {event.name for schedule in schedules for event in schedule.events if event.what == "fault"}
    assert has in drawn
    assert (drawn <= ROTATOR_PLANT_FAULTS) is (positioner == "rotctld")
