"""Alarms, put together from what the service told of them."""

import pandas as pd
import pytest

from daemon.studies.report.material import of_tables
from daemon.studies.report.span import ReportSpan
from daemon.studies.report.told import AlarmSpan, alarms_of
from solar.ephemeris import Site

T0 = 1665705600.0


@pytest.fixture
def alarms():
    """The alarms of events of the subject alarm, one a minute."""

    def find(*texts):
        index = pd.to_datetime([T0 + 60.0 * n for n in range(len(texts))], unit="s", utc=True)
        events = pd.DataFrame({"subject": "alarm", "text": texts}, index=index)
        none = events.iloc[:0]
        tables = dict.fromkeys(("scans", "decisions", "moves", "poses", "modes", "curves"), none) | {"events": events}
        (material,) = of_tables(tables, ReportSpan(T0, T0 + 86400.0, "day"), Site(48.7, 0.0, 0.0), "here", "tables")
        return alarms_of(material)

    return find


def test_one_that_is_raised_again_is_another_one(alarms):
    assert alarms(
        "raised wind: no wind", "cleared wind: no wind", "raised wind: again", "acknowledged wind by ana"
    ) == [
        AlarmSpan("wind", "no wind", T0, T0 + 60.0),
        AlarmSpan("wind", "again", T0 + 120.0, None, "ana"),
    ]


def test_one_that_is_raised_anew_while_it_is_on_tells_the_newest_which_nobody_has_seen(alarms):
    found = alarms("raised face: south", "acknowledged face by ana", "raised face: south and west", "raised x: y")
    assert found[0] == AlarmSpan("face", "south and west", T0, None)


def test_one_that_was_on_before_has_no_beginning(alarms):
    assert alarms("cleared wind: no wind") == [AlarmSpan("wind", "no wind", None, T0)]


def test_what_is_acknowledged_without_being_raised_here_is_none(alarms):
    assert alarms("acknowledged wind by ana: seen") == []


def test_what_older_services_wrote_is_paired_by_its_text(alarms):
    assert alarms("the store is full", "over: the store is full") == [
        AlarmSpan("", "the store is full", T0, T0 + 60.0),
    ]
