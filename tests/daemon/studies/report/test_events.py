"""Alarms, put together from the service's events."""

import re
from zoneinfo import ZoneInfo

import pandas as pd
import pytest

from daemon.base.records import Event, Mode, ModeChange, Pose
from daemon.studies.report.events import AlarmSpan, alarms_of
from daemon.studies.report.material import read_material, split_by_tracker
from daemon.studies.report.page import findings_of, page_of
from daemon.studies.report.span import ReportSpan, RequestedSpan
from solar.ephemeris import Site
from tests.support.stored_day import DAY_S, T0, open_store


@pytest.fixture
def alarms():
    """Returns the alarms that events of the subject alarm describe, one event a minute."""

    def find(*texts):
        index = pd.to_datetime([T0 + 60.0 * n for n in range(len(texts))], unit="s", utc=True)
        events = pd.DataFrame({"subject": "alarm", "text": texts}, index=index)
        none = events.iloc[:0]
        tables = dict.fromkeys(("scans", "decisions", "moves", "poses", "modes", "curves"), none) | {"events": events}
        (material,) = split_by_tracker(
            tables, ReportSpan(T0, T0 + 86400.0, "day"), Site(48.7, 0.0, 0.0), "here", "tables"
        )
        return alarms_of(material)

    return find


def test_an_alarm_that_is_raised_again_after_its_end_is_another_alarm(alarms):
    assert alarms(
        "raised wind: no wind", "cleared wind: no wind", "raised wind: again", "acknowledged wind by ana"
    ) == [
        AlarmSpan("wind", "no wind", T0, T0 + 60.0),
        AlarmSpan("wind", "again", T0 + 120.0, None, "ana"),
    ]


def test_an_alarm_raised_anew_while_it_is_on_has_its_newest_text_and_is_not_acknowledged(alarms):
    found = alarms("raised face: south", "acknowledged face by ana", "raised face: south and west", "raised x: y")
    assert found[0] == AlarmSpan("face", "south and west", T0, None)


def test_an_alarm_that_was_on_before_the_first_event_has_no_beginning(alarms):
    assert alarms("cleared wind: no wind") == [AlarmSpan("wind", "no wind", None, T0)]


def test_an_acknowledgement_of_an_alarm_that_was_not_raised_makes_no_alarm(alarms):
    assert alarms("acknowledged wind by ana: seen") == []


def test_alarm_events_of_older_services_are_paired_by_their_text(alarms):
    assert alarms("the store is full", "over: the store is full") == [
        AlarmSpan("", "the store is full", T0, T0 + 60.0),
    ]


def page_of_the_second_day(directory):
    (material,) = read_material(directory, RequestedSpan(day="2022-10-15"), None, T0 + 3 * DAY_S, lambda _: None)
    return re.sub(r"<[^>]+>", " ", page_of(findings_of(material, ZoneInfo("Europe/Paris"))))


def night(store, start):
    """Keep the poses of a tracker that stands still for a day."""
    for minute in range(0, 1440, 5):
        store.keep(Pose(start + 60.0 * minute, 0.0, 0.0, 90.0, False, "roof"))


def test_an_alarm_and_a_hold_that_last_from_the_day_before_are_in_the_report_of_the_day(tmp_path):
    store = open_store(tmp_path)
    for hour, text in (
        (8.0, "raised cube-face: the south face is dead"),
        (8.5, "acknowledged cube-face by ana"),
        (9.0, "raised clock: not synchronised"),
        (10.0, "cleared clock: not synchronised"),
    ):
        store.keep(Event(T0 + hour * 3600.0, 0.0, "alarm", text, ""))
    store.keep(ModeChange(T0 + 16.0 * 3600.0, 0.0, Mode.TRACKING, Mode.HOLD, "stopped by ana", "roof"))
    night(store, T0 + DAY_S)
    store.close()
    page = page_of_the_second_day(tmp_path)
    assert "the records have 1 alarm, no stows" in page
    row = r"2022-10-14 08:00:00\s+2022-10-14 10:00:00\s+40 h 00 min, still on\s+the south face is dead\s+ana"
    assert re.search(row, page)
    assert "not synchronised" not in page
    assert re.search(r"hold\s+23\.9\s+99\.7", page)


def test_an_alarm_raised_by_an_earlier_run_of_the_service_is_not_taken_as_still_on(tmp_path):
    store = open_store(tmp_path)
    store.keep(Event(T0 + 8.0 * 3600.0, 0.0, "alarm", "raised cube-face: the south face is dead", ""))
    store.close()
    store = open_store(tmp_path)
    night(store, T0 + DAY_S)
    store.close()
    assert "No alarm was raised, and none was on." in page_of_the_second_day(tmp_path)
