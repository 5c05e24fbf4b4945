"""The time that a report covers."""

from datetime import UTC, datetime

import pytest

from daemon.studies.report.span import RequestedSpan


def utc_s(text):
    return datetime.fromisoformat(text).replace(tzinfo=UTC).timestamp()


@pytest.mark.parametrize(
    ("longitude_deg", "start"),
    [(0.0, "2022-10-14T00:00"), (150.0, "2022-10-13T14:00"), (-75.0, "2022-10-14T05:00")],
)
def test_the_day_of_a_report_begins_at_the_solar_midnight_of_the_site(longitude_deg, start):
    span = RequestedSpan(day="2022-10-14").span(longitude_deg, utc_s("2023-01-01"))
    assert (span.start_utc_s, span.duration_s) == (utc_s(start), 86400.0)
    assert (span.name, span.title) == ("2022-10-14", "2022-10-14")


@pytest.mark.parametrize(
    ("longitude_deg", "now", "yesterday"),
    [
        (150.0, "2022-10-14T13:59", "2022-10-13"),
        (150.0, "2022-10-14T14:01", "2022-10-14"),
        (-75.0, "2022-10-14T04:59", "2022-10-12"),
    ],
)
def test_yesterday_is_the_solar_day_before_the_present_one_at_the_site(longitude_deg, now, yesterday):
    assert RequestedSpan(day="yesterday").span(longitude_deg, utc_s(now)).name == yesterday


def test_a_day_that_is_not_over_ends_now_and_a_longer_span_is_divided_into_days():
    now = utc_s("2022-10-16T06:00")
    assert RequestedSpan(day="today").span(0.0, now).duration_s == 6 * 3600.0
    span = RequestedSpan(start="2022-10-14", end="2022-10-20").span(0.0, now)
    assert [day.duration_s for day in span.days()] == [86400.0, 86400.0, 6 * 3600.0]
    assert span.name == "2022-10-14_2022-10-20"


@pytest.mark.parametrize(("last", "title"), [("2022-10-17", "2022-10-10 to 2022-10-16"), ("2022-10-11", "2022-10-10")])
def test_a_span_of_days_is_titled_by_the_last_day_that_is_included(last, title):
    span = RequestedSpan(start="2022-10-10", end=last).span(2.2, utc_s("2023-01-01"))
    assert (span.title, span.name) == (title, f"2022-10-10_{last}")


def test_instants_of_a_span_are_in_utc_and_not_in_the_time_of_the_site():
    span = RequestedSpan(start="2022-10-14T08:00+02:00", end="2022-10-14T07:00").span(150.0, utc_s("2023-01-01"))
    assert (span.start_utc_s, span.duration_s) == (utc_s("2022-10-14T06:00"), 3600.0)
    assert span.title == "2022-10-14 06:00 to 2022-10-14 07:00 UTC"
