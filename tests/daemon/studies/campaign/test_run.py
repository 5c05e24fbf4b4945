"""The campaign itself: the same seed is the same run, impossible orders are refused, a failure is made small."""

import json
import logging
import signal
from dataclasses import replace

import pytest

from daemon.base.errors import UserError
from daemon.base.timeloop import virtual_time
from daemon.rigs.campaign.faults import FAULTS
from daemon.studies.campaign.campaign import Campaign
from daemon.studies.campaign.command_channel import DirectCommandChannel
from daemon.studies.campaign.draw import COMMANDS, FAULT_SPANS, ROTATOR_FAULT_SPANS, draw_schedule
from daemon.studies.campaign.drawn_settings import AXIS_VARIANTS, CHOICES
from daemon.studies.campaign.growth import GrowthCheck
from daemon.studies.campaign.many import run_many
from daemon.studies.campaign.matrix import chosen_schedules, settings_of
from daemon.studies.campaign.reduce import reduce_schedule
from daemon.studies.campaign.run import CampaignRun, run_schedule
from daemon.studies.campaign.schedule import Schedule, ScheduledEvent
from daemon.studies.spread.workers import THIS_PROCESS, Workers
from sim_drivers.pozsol.core import FAULTS as UNIT_FAULTS


def test_a_seed_gives_the_same_schedule_and_the_same_run_each_time():
    schedule = draw_schedule(7, 0.2)
    assert schedule == draw_schedule(7, 0.2)
    assert schedule == Schedule.from_json(schedule.json())
    assert schedule != draw_schedule(8, 0.2)
    assert run_schedule(schedule, heal=False) == run_schedule(schedule, heal=False)


def test_a_campaign_in_two_processes_gives_the_same_lines_as_in_one():
    schedules = [draw_schedule(seed, 0.1) for seed in (3, 4)]
    one, two = (run_many(schedules, Workers(jobs), lambda *_: None, with_log=True) for jobs in (1, 2))
    assert sorted(one.lines()) == sorted(two.lines())
    assert one.done == 2


def test_every_fault_and_command_can_be_drawn():
    assert {*FAULT_SPANS, *ROTATOR_FAULT_SPANS} == set(FAULTS)
    events = [event for seed in range(400) for event in draw_schedule(seed, 3).events]
    assert {event.name for event in events} == {*FAULT_SPANS, *COMMANDS}


def test_every_fault_of_the_simulated_unit_is_in_the_campaign():
    names = {"unit_wind" if name == "wind" else "unit_snow" if name == "snow" else name for name in UNIT_FAULTS}
    assert names <= set(FAULTS)


def test_every_fault_can_begin_and_end_without_a_broken_promise():
    events = []
    for name in FAULT_SPANS:
        drawn = (
            event for seed in range(2000) for event in draw_schedule(seed, 1, only=[name]).events if event.name == name
        )
        event = next(drawn)
        at_s = 90.0 + 30 * len(events)
        events += [
            replace(event, at_s=at_s, lasts_s=min(event.lasts_s, 10.0)),
            ScheduledEvent(at_s + 20, "command", "clear"),
        ]
    hours = (events[-1].at_s + 60) / 3600
    assert run_schedule(replace(draw_schedule(1, hours), events=tuple(events)), heal=False).violations == ()


@pytest.mark.parametrize("lasts_s", [30.0, 3600.0], ids=["within-the-schedule", "to-the-end"])
def test_of_several_faces_that_are_faulty_at_once_each_works_again(tmp_path, lasts_s):
    broken = tuple(ScheduledEvent(60.0 + face, "fault", "face_stuck", (float(face), 0.0), lasts_s) for face in range(4))
    schedule = replace(draw_schedule(1, 0.05), events=broken)
    with virtual_time() as runner:
        loop = runner.get_loop()
        running = CampaignRun(loop, schedule, tmp_path, GrowthCheck(loop.time), DirectCommandChannel())
        runner.run(running.carry_out(heal=lasts_s > 3600.0 * schedule.hours))
    plant = running.plant
    assert min(plant.scene.sensor_voltage(face, plant.clock.utc()) for face in range(4)) > 1e-4


@pytest.mark.parametrize(
    ("event", "sentence"),
    [
        (ScheduledEvent(60, "fault", "lightning"), "no fault 'lightning'"),
        (ScheduledEvent(60, "command", "dance"), "no command 'dance'"),
    ],
)
def test_an_unknown_fault_or_command_in_a_schedule_is_refused_and_not_skipped(event, sentence):
    schedule = replace(draw_schedule(1, 0.2), events=(event,))
    with pytest.raises(UserError, match=sentence):
        run_schedule(schedule)


WIND = {"at_s": 60, "what": "fault", "name": "wind", "value": [20]}


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        ({"hours": "x"}, "its hours cannot be 'x'; name a seed-N.json"),
        ({"hours": float("nan")}, "its hours cannot be nan"),
        ({"start": "noon"}, "its start cannot be 'noon'"),
        ({"start": "1500-06-21T10:00"}, "its start cannot be '1500-06-21T10:00'"),
        ({"start": "9999-12-31T23:59"}, "its start cannot be '9999-12-31T23:59'"),
        ({"rehome": "never"}, "its rehome cannot be 'never'"),
        ({"sky": [800]}, "it has no sky.1"),
        ({"more": 1}, "it may not have more"),
        ({"settings": {"store": {"keep_days": 1}}}, "its settings.store.\\[key\\] cannot be 'store'"),
        ({"settings": {"limits": {"a_max_deg": 60}}}, "settings.limits.a_max_deg = 60: must be a number from -50"),
        ({"settings": {"safety": {"stow": 1}}}, "settings.safety.stow = 1: there is no such key; did you"),
        ({"law": "nonsense"}, "has a law 'nonsense'; choose from chronometric"),
        ({"events": [1]}, "its events.0 cannot be 1"),
        ({"events": [WIND | {"at_s": float("nan")}]}, "its events.0.at_s cannot be nan"),
        ({"events": [WIND | {"lasts_s": 1e300}]}, "its events.0.lasts_s cannot be 1e\\+300"),
        ({"events": [WIND | {"at_s": 90}, WIND]}, "wind at 60 s stands behind what happens at 90 s: put the events in"),
        ({"events": [WIND | {"value": []}]}, "the value of wind at 60 s must be 15.1..30"),
        ({"events": [WIND | {"name": "face_stuck", "value": [7, 1]}]}, "face_stuck at 60 s must be 0..3, 0..9.9"),
    ],
)
def test_a_schedule_file_that_cannot_be_run_is_refused_with_the_place_of_the_mistake(tmp_path, change, sentence):
    file = tmp_path / "mine.json"
    file.write_text(json.dumps(json.loads(draw_schedule(1, 0.2).json()) | change))
    with pytest.raises(UserError, match=sentence) as refused:
        chosen_schedules(1, 1, 1.0, (), (), file)
    assert str(file) in str(refused.value)


@pytest.mark.parametrize("text", ["", "[]", '{"hours": 1'])
def test_a_text_that_is_not_one_json_object_is_refused_as_a_schedule(text):
    with pytest.raises(ValueError, match="it is not one object in JSON"):
        Schedule.from_json(text)


def test_a_deliberately_bad_command_of_a_schedule_may_have_nan_as_its_target(tmp_path):
    file = tmp_path / "mine.json"
    event = {"at_s": 60, "what": "command", "name": "bad", "value": [float("nan"), 60]}
    file.write_text(json.dumps(json.loads(draw_schedule(1, 0.2).json()) | {"events": [event]}))
    (schedule,) = chosen_schedules(1, 1, 1.0, (), (), file)
    assert str(schedule.events[0]).endswith("nan 60")


@pytest.mark.parametrize(("positioner", "trackers"), [("pozsol", 1), ("pozsol", 10), ("rotctld", 1)])
def test_every_seed_draws_settings_that_a_service_accepts(positioner, trackers):
    drawn = [draw_schedule(seed, 0.1, trackers=trackers, positioner=positioner) for seed in range(40)]
    assert {len(settings_of(schedule).trackers) for schedule in drawn} == {trackers}
    ways = [way for ways in (CHOICES if positioner == "rotctld" else (*CHOICES, AXIS_VARIANTS)) for way in ways]
    assert {section for schedule in drawn for section in schedule.settings} == {name for way in ways for name in way}
    assert any(not schedule.settings for schedule in drawn)


class Pretended:
    """A run that breaks a promise if all needed events happen in order."""

    def __init__(self, *needed):
        self._needed = needed
        self.runs = 0

    def __call__(self, schedule):
        self.runs += 1
        names = [event.name for event in schedule.events if event.name in self._needed]
        broken = names == list(self._needed) and "attempts" in schedule.settings.get("motion", ())
        return replace(OUTCOME, violations=(BROKEN,) if broken else ())


OUTCOME = run_schedule(replace(draw_schedule(1, 0.02), events=()), heal=False)
BROKEN = type("Broken", (), {"promise": "a promise"})()


def test_a_failure_is_reduced_to_its_necessary_events_in_fewer_runs_than_there_are_events():
    names = [f"harmless {number}" for number in range(200)]
    names[150], names[160] = "stop", "own_tracking"
    events = tuple(ScheduledEvent(300.0 * (1 + at), "fault", name) for at, name in enumerate(names))
    pretended = Pretended("stop", "own_tracking")
    settings = {"motion": {"attempts": 1, "retry_after_s": 120.0}, "site": {"latitude_deg": 4.0}}
    schedule = replace(draw_schedule(1, 24), events=events, settings=settings)
    reduced = reduce_schedule(schedule, {"a promise"}, events[160].at_s + 5, pretended)
    assert [event.name for event in reduced.events] == ["stop", "own_tracking"]
    assert pretended.runs < 65
    assert reduced.settings == {"motion": {"attempts": 1}}
    assert reduced.hours < 6
    assert (reduced.begin - schedule.begin).total_seconds() == events[150].at_s - reduced.events[0].at_s
    assert logging.getLogger("heliocube").handlers == []


def test_each_failure_is_reduced_and_saved_as_a_schedule_that_can_be_run_alone(tmp_path, monkeypatch):
    # With this bound, a service says too much as soon as a person has given a command.
    monkeypatch.setattr("daemon.studies.campaign.growth.LINES_OF_A_COMMAND", -100)
    said, keep = [], tmp_path / "failures"
    given = tuple(ScheduledEvent(70.0 + 20 * at, "command", name) for at, name in enumerate(("stow", "auto", "clear")))
    schedule = replace(draw_schedule(7, 0.04), events=given)
    assert Campaign([schedule], THIS_PROCESS, said.append, keep, show=False).run(lambda _share: None) == 1
    (alone,) = chosen_schedules(1, 1, 1.0, (), (), keep / "seed-7.json")
    assert run_schedule(alone).broken_promises == {"log"}
    assert len(alone.events) == 1
    assert alone.text() in said
    assert any(f"heliocube campaign --schedule {keep / 'seed-7.json'}" in line for line in said)


@pytest.fixture
def _ctrl_c():
    """Give SIGINT the handler that a program starts with: the runner of the tests may have set another."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)


@pytest.mark.usefixtures("_ctrl_c")
def test_ctrl_c_ends_a_campaign_with_a_report_of_what_was_done(tmp_path):
    said = []
    schedules = [draw_schedule(seed, 0.02) for seed in (1, 2, 3)]
    study = Campaign(schedules, THIS_PROCESS, said.append, tmp_path / "failures", show=False)
    code = study.run(lambda share: share > 0.5 and signal.raise_signal(signal.SIGINT))
    assert code == 130
    assert said[0].startswith("2 schedules, 0.04 h")
    assert said[-1] == "ended before 1 more"
    assert not (tmp_path / "failures").exists()


@pytest.mark.usefixtures("_ctrl_c")
def test_a_failure_found_before_ctrl_c_is_saved_unreduced(tmp_path, monkeypatch):
    monkeypatch.setattr("daemon.studies.campaign.growth.LINES_OF_A_COMMAND", -100)
    said, keep = [], tmp_path / "failures"
    given = tuple(ScheduledEvent(70.0 + 20 * at, "command", name) for at, name in enumerate(("stow", "auto")))
    failing = replace(draw_schedule(7, 0.03), events=given)
    study = Campaign(
        [failing, draw_schedule(1, 0.02), draw_schedule(2, 0.02)], THIS_PROCESS, said.append, keep, show=False
    )
    assert study.run(lambda share: share > 0.5 and signal.raise_signal(signal.SIGINT)) == 1
    assert chosen_schedules(1, 1, 1.0, (), (), keep / "seed-7.json") == [failing]
    assert f"again: heliocube campaign --schedule {keep / 'seed-7.json'} --show" in said
