import time
from zoneinfo import ZoneInfo

import pytest

from daemon.base.clock import local_time
from daemon.commands.status.times import local_and_utc_time, local_date_and_time, localise_times, time_zone_text

EVENING = "2026-07-21T22:30:05.000Z"


@pytest.fixture(params=["Europe/Paris", "UTC", "UTC+25"])
def place(request, monkeypatch):
    monkeypatch.setenv("TZ", request.param)
    time.tzset()
    yield request.param
    monkeypatch.undo()
    time.tzset()


def test_times_show_local_time_first_and_utc_beside_it_each_with_its_date_where_needed(place):
    expected = {
        "Europe/Paris": (
            "2026-07-22 00:30:05 (2026-07-21 22:30:05 UTC)",
            "14:00:00 (12:00:00 UTC)",
            "2026-07-22 00:30:05",
            "local time, UTC+02:00",
        ),
        # No zone is a day from another: on such a machine, times are told in UTC.
        "UTC": ("2026-07-21 22:30:05 UTC", "12:00:00 UTC", "2026-07-21 22:30:05", "UTC"),
    }[place.removesuffix("+25")]
    noon, later = "2026-07-21T12:00:00.000Z", "2026-07-21T12:30:00.000Z"
    assert (
        local_and_utc_time(EVENING),
        local_and_utc_time(noon, later),
        local_date_and_time(EVENING),
        time_zone_text(EVENING),
    ) == expected
    assert local_and_utc_time(noon, "2026-07-23T12:00:00.000Z").startswith("2026-07-21 ")


def test_local_time_in_a_named_zone_does_not_depend_on_the_zone_of_the_machine(place):
    assert f"{local_time(0.0, ZoneInfo('Asia/Kolkata')):%H:%M %Z}" == "05:30 IST"


@pytest.mark.parametrize("place", ["Europe/Paris"], indirect=True)
@pytest.mark.usefixtures("place")
def test_utc_times_in_sentences_are_shown_with_local_time_and_other_text_stays():
    alarm = {"time": EVENING, "text": "the clock went from 2026-07-21 22:30 UTC to 2026-07-22 10:00:05 UTC", "count": 1}
    told = {**alarm, "text": "the clock went from 00:30 (2026-07-21 22:30 UTC) to 12:00:05 (10:00:05 UTC)"}
    assert localise_times({"alarms": [alarm], "wind": None}, "2026-07-22T11:00:00.000Z") == {
        "alarms": [told],
        "wind": None,
    }
    assert localise_times("until 2026-07-21 12:00 UTC") == "until 2026-07-21 14:00 (12:00 UTC)"
    for none in ("back at 9999-99-99 09:00 UTC", "12:00 UTC", EVENING):
        assert localise_times(none) == none
