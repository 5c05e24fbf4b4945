"""The states of an alarm: raised, acknowledged, cleared."""

import pytest

from daemon.base.alarms.alarms import Alarms
from daemon.base.alarms.kept import FILE_NAME, AlarmFile
from daemon.base.state import StateFolder

LATCHED, PLAIN = "move-failed", "stow-wanted"


class HandClock:
    def __init__(self):
        self.now = 100.0

    def monotonic(self):
        return self.now

    def utc(self):
        return 1.7e9 + self.now


class House:
    def __init__(self, directory=None):
        self.clock, self.records = HandClock(), []
        self.directory = directory
        self.alarms = self.started()

    def started(self):
        file = AlarmFile(StateFolder(self.directory))
        return Alarms(self.clock, self.records.append, file=file)

    def restart(self, after_s=5.0):
        self.alarms = self.started()
        self.clock.now += after_s

    @property
    def states(self):
        return {alarm.name: alarm.state for alarm in self.alarms.shown}

    @property
    def told(self):
        return [record.text for record in self.records]


@pytest.fixture
def house(tmp_path):
    return House(tmp_path)


def test_an_alarm_is_raised_acknowledged_and_gone_with_its_cause(house):
    house.alarms.set(PLAIN, "wind")
    house.clock.now += 60
    assert house.alarms.acknowledge("ana@lab", PLAIN, "on my way") == (PLAIN,)
    (alarm,) = house.alarms.active
    assert (alarm.state, alarm.acknowledged_by) == ("acknowledged", "ana@lab")
    assert alarm.acknowledged_utc_s - alarm.raised_utc_s == 60
    house.alarms.set(PLAIN, "more wind")
    assert house.alarms.active[0].acknowledged_by == "ana@lab"
    house.alarms.set(PLAIN, None)
    assert house.states == {}
    assert house.told == [
        f"raised {PLAIN}: wind",
        f"acknowledged {PLAIN} by ana@lab: on my way",
        f"cleared {PLAIN}: more wind",
    ]
    assert {record.subject for record in house.records} == {"alarm"}


def test_an_acknowledged_alarm_that_reports_something_new_is_raised_again(house):
    house.alarms.set(PLAIN, "south lies")
    house.alarms.acknowledge("ana@lab", PLAIN)
    house.clock.now += 60
    house.alarms.set(PLAIN, "south lies", of=["south"])
    assert house.states == {PLAIN: "acknowledged"}
    house.alarms.set(PLAIN, "south and west lie", of=["south", "west"])
    (alarm,) = house.alarms.active
    assert (alarm.state, alarm.text, alarm.raised_utc_s) == ("raised", "south and west lie", house.clock.utc())
    assert house.told[-1] == f"raised {PLAIN}: south and west lie"


def test_an_alarm_with_a_new_sentence_is_raised_again_though_its_sentences_share_words(house):
    house.alarms.set(PLAIN, "A is hot; B is hot", of=["A is hot", "B is hot"])
    house.alarms.acknowledge("ana@lab", PLAIN)
    house.alarms.set(PLAIN, "B is hot", of=["B is hot"])
    house.alarms.set(PLAIN, "B is hot; B is hotter (2)", of=["B is hot", "B is hotter (2)"])
    assert house.states == {PLAIN: "raised"}
    house.alarms.acknowledge("ana@lab", PLAIN)
    house.alarms.set(PLAIN, "B is hot; A is hot", of=["B is hot", "A is hot"])
    assert house.states == {PLAIN: "raised"}
    house.alarms.acknowledge("ana@lab", PLAIN)
    house.alarms.set(PLAIN, "hot is A; hot is B", of=["hot is B", "is A"])
    assert house.states == {PLAIN: "raised"}


def test_a_latched_alarm_stays_shown_until_it_is_acknowledged(house):
    house.alarms.set(LATCHED, "stalled")
    house.clock.now += 30
    house.alarms.set(LATCHED, None)
    assert house.states == {LATCHED: "cleared"}
    assert house.alarms.active == ()
    assert house.alarms.shown[0].cleared_utc_s == house.clock.utc()
    house.alarms.set(LATCHED, None)
    assert house.told.count(f"cleared {LATCHED}: stalled") == 1
    house.alarms.acknowledge("ana")
    assert house.states == {}


def test_an_acknowledged_latched_alarm_ends_with_its_cause_and_is_raised_anew_next_time(house):
    house.alarms.set(LATCHED, "stalled")
    house.alarms.acknowledge("ana")
    house.alarms.set(LATCHED, None)
    assert house.states == {}
    house.alarms.set(LATCHED, "stalled again")
    assert house.states == {LATCHED: "raised"}


def test_an_alarm_that_returns_before_it_is_acknowledged_keeps_its_first_time(house):
    house.alarms.set(LATCHED, "stalled")
    first_utc_s = house.clock.utc()
    house.alarms.set(LATCHED, None)
    house.clock.now += 600
    house.alarms.set(LATCHED, "stalled again")
    (alarm,) = house.alarms.active
    assert (alarm.raised_utc_s, alarm.text, alarm.cleared_utc_s) == (first_utc_s, "stalled again", None)


def test_an_alarm_can_be_acknowledged_once_and_only_while_it_is_shown(house):
    assert house.alarms.acknowledge("ana") == ()
    house.alarms.set(PLAIN, "wind")
    house.alarms.set(LATCHED, "stalled")
    assert house.alarms.acknowledge("ana", latched=True) == (LATCHED,)
    assert house.alarms.acknowledge("bob") == (PLAIN,)
    assert house.alarms.acknowledge("eve") == ()
    assert [alarm.acknowledged_by for alarm in house.alarms.active] == ["bob", "ana"]


def test_maintenance_hides_all_alarms_and_lasting_ones_are_raised_again_after_it(house):
    house.alarms.set(PLAIN, "wind")
    house.alarms.acknowledge("ana")
    house.alarms.set(LATCHED, "stalled")
    house.alarms.set(LATCHED, None)
    house.alarms.mute(muted=True)
    assert house.states == {}
    assert house.alarms.acknowledge("ana") == ()
    house.alarms.mute(muted=False)
    assert house.states == {PLAIN: "raised", LATCHED: "cleared"}


def test_a_restart_keeps_acknowledgements_and_latched_alarms_not_yet_acknowledged(house):
    for name in (PLAIN, LATCHED):
        house.alarms.set(name, "bad")
    house.alarms.acknowledge("ana", PLAIN)
    raised_utc_s = house.clock.utc()
    house.restart()
    assert house.states == {LATCHED: "cleared"}
    house.alarms.set(PLAIN, "bad")
    house.alarms.set(LATCHED, "bad")
    assert house.states == {PLAIN: "acknowledged", LATCHED: "raised"}
    assert {alarm.raised_utc_s for alarm in house.alarms.shown} == {raised_utc_s}
    house.alarms.acknowledge("ana")
    house.alarms.set(LATCHED, None)
    house.alarms.set(PLAIN, None)
    house.restart()
    assert house.states == {}


@pytest.mark.parametrize("cause", ["over", "late"])
def test_after_a_restart_an_alarm_that_cleared_or_returns_an_hour_later_is_raised_anew(house, cause):
    house.alarms.set(PLAIN, "bad")
    house.alarms.acknowledge("ana")
    house.restart()
    if cause == "over":
        house.alarms.set(PLAIN, None)
    else:
        house.clock.now += 3600
    house.alarms.set(PLAIN, "bad")
    assert house.states == {PLAIN: "raised"}


def test_after_a_restart_an_alarm_about_another_part_is_raised_anew(house):
    house.alarms.set(PLAIN, "south lies", of=["south"])
    house.alarms.acknowledge("ana")
    house.restart()
    house.alarms.set(PLAIN, "west lies", of=["west"])
    assert house.states == {PLAIN: "raised"}


def test_after_a_restart_in_maintenance_an_alarm_about_another_part_is_raised_anew(house):
    house.alarms.set(PLAIN, "south lies", of=["south"])
    house.alarms.acknowledge("ana")
    house.restart()
    house.alarms.mute(muted=True)
    house.alarms.set(PLAIN, "west lies", of=["west"])
    house.alarms.mute(muted=False)
    assert house.states == {PLAIN: "raised"}


@pytest.mark.parametrize("cause", ["over", "late"])
def test_a_second_restart_does_not_restore_an_acknowledgement_that_ended_after_the_first(house, cause):
    house.alarms.set(PLAIN, "bad")
    house.alarms.acknowledge("ana")
    house.restart()
    if cause == "late":
        house.clock.now += 3600
    house.alarms.set(PLAIN if cause == "over" else LATCHED, None)
    house.restart()
    house.alarms.set(PLAIN, "bad")
    assert house.states == {PLAIN: "raised"}


def test_alarms_that_are_neither_acknowledged_nor_latched_write_no_file(house):
    for _ in range(3):
        house.alarms.set(PLAIN, "wind")
        house.alarms.set(PLAIN, None)
    assert not (house.directory / FILE_NAME).exists()


@pytest.mark.parametrize(
    "content",
    [
        "{",
        '{"alarms": {"move-failed": {"text": 3}}}',
        '{"alarms": {"x": {"text": "", "raised_utc_s": NaN}}}',
        # No calendar goes so far: such an alarm could be kept and never be shown.
        '{"alarms": {"move-failed": {"text": "", "raised_utc_s": 1e18}}}',
        '{"alarms": {"move-failed": {"text": "", "raised_utc_s": 1.0, "acknowledged_utc_s": -1e18}}}',
    ],
)
def test_an_unusable_alarm_file_is_logged_and_written_anew(tmp_path, caplog, content):
    (tmp_path / FILE_NAME).write_text(content)
    house = House(tmp_path)
    assert house.states == {}
    assert "which alarms were acknowledged is not known" in caplog.text
    house.alarms.set(LATCHED, "stalled")
    house.restart()
    assert house.states == {LATCHED: "cleared"}
