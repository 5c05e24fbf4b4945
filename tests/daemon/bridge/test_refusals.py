"""How refused datagrams are counted, and when they are logged."""

import logging

import pytest

from daemon.bridge.refusals import HOUR_S, QUIET_S, SILENCE_S, Refusal, ScanRefusedError, Tally

UTC_S = 1.7e9


@pytest.fixture
def log(caplog):
    caplog.set_level(logging.INFO, "heliocube.bridge")
    return caplog


def refuse(tally, kind, *times_s):
    for time_s in times_s:
        tally.refuse(ScanRefusedError(kind, "is wrong"), ("10.0.0.7", 40000), UTC_S + time_s, time_s)


def test_statistics_without_refused_datagrams_count_zero_and_name_no_last_refusal():
    found = Tally().statistics(lost=0)
    assert (found.accepted, found.refused, found.last_refusal, found.last_refusal_utc_s) == (0, 0, "", None)


def test_refusals_since_the_last_accepted_scan_are_listed_by_kind():
    tally = Tally()
    assert tally.since_accepted == ""
    refuse(tally, Refusal.SECOND_CUBE, 1.0)
    refuse(tally, Refusal.FORGED, 2.0, 3.0)
    text = "2 forged, 1 second cube since; the latest is forged: a datagram from 10.0.0.7:40000 is wrong"
    assert tally.since_accepted == f"the bridge refused {text}"
    tally.accept(4.0)
    assert tally.since_accepted == ""
    refuse(tally, Refusal.LATE, 5.0)
    assert tally.since_accepted.startswith("the bridge refused 1 late since; ")
    found = tally.statistics(lost=9)
    assert (found.accepted, found.lost, found.refused, found.forged, found.second_cube, found.late) == (
        1,
        9,
        4,
        2,
        1,
        1,
    )
    assert found.last_refusal_utc_s == UTC_S + 5.0


def test_the_first_refusal_of_a_kind_is_logged_and_then_counts_at_gaps_of_1_2_and_4_hours(log):
    tally = Tally()
    step_s = HOUR_S / 4
    refuse(tally, Refusal.FORGED, *(step_s * step for step in range(31)))
    told = [record.getMessage() for record in log.records]
    assert told[0] == ("forged: a datagram from 10.0.0.7:40000 is wrong; more of this kind are counted, not logged")
    counted = [text.split(": ")[1].split(";")[0] for text in told[1:]]
    # The summaries come after 1, 3 and 7 hours.
    assert counted == ["4 forged", "8 forged", "16 forged"]


def test_a_new_stretch_of_refusals_begins_without_old_counts_and_an_hour_to_its_summary(log):
    tally = Tally()
    refuse(tally, Refusal.FORGED, 0.0, HOUR_S, HOUR_S + 10.0)
    assert len(log.records) == 2
    # A new stretch: its summary leaves out what was counted and not logged in the one before.
    began_s = HOUR_S + QUIET_S + 10.0
    refuse(tally, Refusal.FORGED, began_s, began_s + HOUR_S - 1.0, began_s + HOUR_S)
    assert len(log.records) == 4
    assert "not logged yet: 2 forged; the latest was forged: " in log.records[-1].getMessage()
    refuse(tally, Refusal.FORGED, began_s + 3 * HOUR_S - 1.0)
    assert len(log.records) == 4
    refuse(tally, Refusal.FORGED, began_s + 3 * HOUR_S)
    assert len(log.records) == 5


@pytest.mark.parametrize(("quiet_s", "lines"), [(QUIET_S - 1.0, 1), (QUIET_S, 2)])
def test_six_quiet_hours_end_a_stretch_of_refusals(log, quiet_s, lines):
    tally = Tally()
    refuse(tally, Refusal.FORGED, 0.0, quiet_s)
    assert sum("more of this kind" in record.getMessage() for record in log.records) == lines


def test_the_end_of_a_gap_of_a_minute_between_scans_is_logged_once_per_stretch_of_refusals(log):
    tally = Tally()
    refuse(tally, Refusal.LATE, 0.0)
    tally.accept(SILENCE_S - 1.0)
    refuse(tally, Refusal.LATE, 100.0, 110.0, 120.0)
    tally.accept(100.0 + SILENCE_S)
    refuse(tally, Refusal.LATE, 200.0)
    tally.accept(300.0)
    told = [record.getMessage() for record in log.records if record.levelno == logging.INFO]
    assert told == ["scans are accepted again, 60 s and 3 refusals later"]
    refuse(tally, Refusal.LATE, QUIET_S + 300.0)
    tally.accept(QUIET_S + 400.0)
    assert log.records[-1].getMessage() == "scans are accepted again, 100 s and 1 refusals later"
