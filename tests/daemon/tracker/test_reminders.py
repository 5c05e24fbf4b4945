"""What people are reminded of, and when, to the second."""

import logging
from datetime import datetime
from types import SimpleNamespace

import pytest

from daemon.base.alarms.alarms import Alarms
from daemon.base.alarms.kept import AlarmFile
from daemon.base.reconnect import Outage
from daemon.base.records import Event, Mode
from daemon.base.state import StateFolder
from daemon.config.sections import SiteSettings
from daemon.tracker.modes import DataState
from daemon.tracker.reminders import Reminders
from daemon.tracker.wishes import PROGRAM, Wish, Wishes

HOUR_S = 3600.0


def utc_s(text):
    return datetime.fromisoformat(f"{text}+00:00").timestamp()


class Desk:
    """Reminders with a clock that a test sets, and what they have raised and told."""

    def __init__(self, start="2022-10-12T14:00", directory=None, **site):
        self._utc_s = utc_s(start)
        self.records = []
        self._alarms = Alarms(self, lambda _record: None, file=AlarmFile(StateFolder(directory)))
        self.reminders = Reminders(self, SiteSettings(**site), self._alarms, self.records.append)
        self.motion = SimpleNamespace(connected=True, outage=Outage(logging.getLogger("test"), "the positioner"))

    def utc(self):
        return self._utc_s

    def monotonic(self):
        return self._utc_s - 1.6e9

    def at(self, text):
        self._utc_s = utc_s(text)

    def later(self, seconds):
        self._utc_s += seconds

    def raised(self, wishes=None, *, sun_known=True):
        self.reminders.remind(wishes or Wishes(), sun_known=sun_known)
        return {alarm.name: alarm.text for alarm in self._alarms.active}

    def watched(self, mode=Mode.TRACKING, *, sun_known=True):
        data = {Mode.FALLBACK: DataState.BAD, Mode.TRACKING: DataState.FRESH}.get(mode, DataState.WAITING)
        situation = SimpleNamespace(data=data, data_why="no good scan", night_why=None)
        self.reminders.watch(self.motion, mode, situation, sun_known=sun_known)
        return {alarm.name: alarm.text for alarm in self._alarms.active}

    def acknowledge(self):
        return self._alarms.acknowledge("ana")

    def told(self, wishes):
        self.raised(wishes)
        return [record.text for record in self.records if isinstance(record, Event)]


def test_a_positioner_that_has_not_answered_for_a_minute_raises_an_alarm():
    desk = Desk()
    assert desk.watched() == {}
    desk.motion.connected = False
    desk.motion.outage.down(desk.monotonic(), "unplugged")
    desk.later(59.0)
    assert desk.watched() == {}
    desk.later(1.0)
    told = {"positioner-down": "for a minute or more the positioner has not answered, or only for moments: unplugged"}
    assert desk.watched() == told
    desk.motion.connected = True
    assert desk.watched() == told
    desk.later(14.0)
    assert desk.watched() == told, "it may be gone again at once"
    desk.later(1.0)
    assert desk.watched() == {}
    desk.later(100.0)
    desk.watched()
    desk.motion.connected = False
    desk.later(59.0)
    assert desk.watched() == {}, "it has answered until then"


def test_a_positioner_that_answers_only_for_moments_because_of_a_bad_contact_raises_an_alarm():
    desk = Desk()
    desk.watched()
    for _ in range(2):
        desk.motion.connected = False
        desk.watched()
        desk.later(25.0)
        desk.watched()
        desk.motion.connected = True
        desk.watched()
        desk.later(4.0)
        assert desk.watched() == {}
    desk.motion.connected = False
    assert desk.watched() == {}
    desk.later(2.0)
    assert set(desk.watched()) == {"positioner-down"}


def test_a_positioner_whose_driver_never_comes_back_from_opening_it_raises_an_alarm():
    desk = Desk()
    desk.motion.connected = False
    desk.later(60.0)
    assert desk.watched()["positioner-down"].endswith(": its driver has not come back from opening it")


def test_a_quarter_of_an_hour_without_readings_raises_an_alarm_and_counts_anew_each_time():
    desk = Desk()
    for _ in range(2):
        assert desk.watched(Mode.FALLBACK) == {}
        desk.later(899.0)
        assert desk.watched(Mode.FALLBACK) == {}
        desk.later(1.0)
        told = {"no-readings": "tracking by the ephemeris for a quarter of an hour: no good scan"}
        assert desk.watched(Mode.FALLBACK) == told
        assert "standing" in desk.watched(Mode.FALLBACK, sun_known=False)["no-readings"]
        assert desk.watched() == {}


@pytest.mark.parametrize(("between", "seen_before"), [(Mode.STARTING, True), (Mode.TRACKING, False)])
def test_an_acknowledged_no_readings_alarm_is_new_after_a_restart_only_if_readings_came_between(
    tmp_path, between, seen_before
):
    for start, first, acknowledged in [("14:00", Mode.TRACKING, True), ("14:20", between, not seen_before)]:
        desk = Desk(f"2022-10-12T{start}", tmp_path)
        desk.watched(first)
        desk.watched(Mode.FALLBACK)
        desk.later(900.0)
        assert list(desk.watched(Mode.FALLBACK)) == ["no-readings"]
        assert desk.acknowledge() == (("no-readings",) if acknowledged else ())


@pytest.mark.parametrize(("age_s", "first_s"), [(HOUR_S, 23 * HOUR_S), (30 * HOUR_S, 18 * HOUR_S), (None, 24 * HOUR_S)])
def test_a_reminder_of_maintenance_comes_every_day_at_the_hour_at_which_it_began(age_s, first_s):
    desk = Desk()
    began_s = None if age_s is None else desk.utc() - age_s
    wishes = Wishes(maintenance=Wish(why="bearings", by="ana", since_utc_s=began_s))
    desk.told(wishes)
    for times in (1, 2):
        desk.later(first_s - 1.0 if times == 1 else 24 * HOUR_S - 1.0)
        assert len(desk.told(wishes)) == times - 1
        desk.later(1.0)
        assert len(desk.told(wishes)) == len(desk.told(wishes)) == times
    assert desk.told(wishes)[-1].startswith("still in maintenance by ana")
    desk.told(Wishes())
    desk.later(48 * HOUR_S)
    assert len(desk.told(Wishes())) == 2


@pytest.mark.parametrize("name", ["hold", "snow"])
@pytest.mark.parametrize(
    ("since", "now", "forgotten"),
    [
        ("2022-10-12T14:00", "2022-10-12T23:59", False),
        # The sun rises at 6:08.
        ("2022-10-12T14:00", "2022-10-13T06:00", False),
        ("2022-10-12T14:00", "2022-10-13T06:12", True),
        ("2022-10-13T03:00", "2022-10-13T05:00", False),
        ("2022-10-12T05:00", "2022-10-13T05:00", True),
        ("2022-10-12T06:12", "2022-10-12T20:00", False),
    ],
)
def test_a_hold_or_snow_that_has_outlasted_a_sunrise_raises_the_alarm_of_a_forgotten_hold(name, since, now, forgotten):
    desk, wishes = Desk(since), Wishes(**{name: Wish(why="measuring", since_utc_s=utc_s(since))})
    assert desk.raised(wishes) == {}
    desk.at(now)
    assert desk.raised(wishes, sun_known=False) == {}
    assert ("hold-forgotten" in desk.raised(wishes)) == forgotten
    assert desk.raised() == {}


def test_a_hold_or_snow_that_is_asked_for_anew_after_a_night_ends_the_alarm_of_a_forgotten_hold():
    desk = Desk()
    desk.at("2022-10-13T08:00")
    old, new = (Wish(why="measuring", since_utc_s=utc_s(f"2022-10-{day}T07:30")) for day in (12, 13))
    assert "hold-forgotten" in desk.raised(Wishes(hold=old))
    for name in ("hold", "snow"):
        assert desk.raised(Wishes(**{name: new})) == {}


def test_where_the_sun_does_not_set_a_hold_counts_as_forgotten_from_the_suns_lowest_point_on():
    desk = Desk("2022-06-20T23:00", latitude_deg=78.0, longitude_deg=0.0)
    wishes = Wishes(hold=Wish(why="measuring", since_utc_s=desk.utc()))
    desk.at("2022-06-20T23:50")
    assert desk.raised(wishes) == {}
    desk.at("2022-06-21T00:20")
    assert "hold-forgotten" in desk.raised(wishes)


def test_a_hold_by_the_program_raises_release_changed_and_no_alarm_of_a_forgotten_hold():
    desk, began_s = Desk(), utc_s("2022-10-10T14:00")
    wishes = Wishes(hold=Wish(why="another release", by=PROGRAM, since_utc_s=began_s))
    assert list(desk.raised(wishes)) == ["release-changed"]
