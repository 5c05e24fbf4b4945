import pytest
from hypothesis import given
from hypothesis import strategies as st

from daemon.base.recurrence import LogBudget, RateLimit, Recurrence, ReportStyle

HOUR_S = 3600.0
INDIVIDUAL, SUMMARY, SILENT = ReportStyle.INDIVIDUAL, ReportStyle.SUMMARY, ReportStyle.SILENT


def test_the_first_few_occurrences_are_logged_plainly_and_the_next_with_its_number():
    recurrence = Recurrence(3)
    assert [recurrence.note(20.0 * turn) for turn in range(6)] == [INDIVIDUAL] * 3 + [SUMMARY] + [SILENT] * 2
    assert recurrence.how_often(120.0) == "6 times in the last hour"


def test_the_number_is_logged_again_after_ten_minutes_one_hour_six_hours_and_then_every_six():
    recurrence = Recurrence(3)
    told_h = [time_s / HOUR_S for time_s in range(0, 86400, 20) if recurrence.note(float(time_s)) is SUMMARY]
    assert told_h == pytest.approx([1 / 60, 1 / 60 + 1 / 6, 1 / 60 + 1, 1 / 60 + 6, 12 + 1 / 60, 18 + 1 / 60], abs=0.01)


def test_a_rare_event_is_always_logged_plainly():
    recurrence = Recurrence(3)
    assert {recurrence.note(4.5 * HOUR_S * turn) for turn in range(100)} == {INDIVIDUAL}


def test_a_recurrence_ends_once_after_half_an_hour_with_its_number_and_the_next_is_plain():
    recurrence = Recurrence(3)
    for turn in range(10):
        recurrence.note(20.0 * turn)
    assert recurrence.end_if_calm(200.0 + 1799.0, 200.0) == 0
    assert recurrence.end_if_calm(200.0 + 1800.0, 200.0) == 10
    assert recurrence.end_if_calm(200.0 + 1801.0, 200.0) == 0
    assert recurrence.note(2 * HOUR_S) is INDIVIDUAL


def test_a_recurrence_that_begins_again_ends_only_after_twice_as_long_a_calm():
    recurrence = Recurrence(3)
    for turn in range(4):
        recurrence.note(20.0 * turn)
    assert recurrence.end_if_calm(2000.0, 60.0) == 4
    assert [recurrence.note(2000.0 + turn) for turn in range(2)] == [INDIVIDUAL, SUMMARY]
    assert recurrence.end_if_calm(2000.0 + 1900.0, 2001.0) == 0
    assert recurrence.end_if_calm(2001.0 + 3600.0, 2001.0) == 2


def test_after_more_than_twelve_hours_of_calm_occurrences_are_logged_plainly_again():
    recurrence = Recurrence(3)
    for turn in range(10):
        recurrence.note(20.0 * turn)
    assert [recurrence.note(13 * HOUR_S + 20.0 * turn) for turn in range(4)] == [INDIVIDUAL] * 3 + [SUMMARY]


@given(pauses_s=st.lists(st.sampled_from((20.0, 600.0, 1900.0, 3700.0, 7300.0, 14500.0)), min_size=1, max_size=12))
def test_no_pattern_of_recurrence_logs_more_than_50_lines_a_day(pauses_s):
    recurrence, now_s, lines = Recurrence(6), 0.0, 0
    while now_s < 86400.0:
        for pause_s in pauses_s:
            said = recurrence.note(now_s)
            lines += {INDIVIDUAL: 2, SUMMARY: 1, SILENT: 0}[said]
            over_s = next((s for s in (1800, 3600, 7200, 14400, 21600) if s < pause_s), None)
            lines += over_s is not None and bool(recurrence.end_if_calm(now_s + pause_s - 1.0, now_s + 1.0))
            now_s += pause_s
            if now_s >= 86400.0:
                break
    assert lines <= 50


def test_a_recurrence_without_reminders_logs_its_number_only_once():
    recurrence = Recurrence(3, reminds=False)
    told_s = [time_s for time_s in range(0, 86400, 20) if recurrence.note(float(time_s)) is not SILENT]
    assert told_s == [0, 20, 40, 60]


def test_a_flood_is_logged_a_few_times_and_then_only_with_its_number():
    budget = LogBudget("bad greetings", few=2)
    lines = [budget.spend(turn / 1000.0, f"greeting {turn} is bad") for turn in range(700_000)]
    said = [line for line in lines if line]
    assert said[:2] == ["greeting 0 is bad", "greeting 1 is bad"]
    rest = "more, and only their number is logged while they go on; latest: greeting"
    assert said[2:] == [f"bad greetings: 1 {rest} 2 is bad", f"bad greetings: 600000 {rest} 600002 is bad"]
    assert budget.count == 700_000


def test_the_number_of_unlogged_lines_of_a_flood_is_logged_half_an_hour_after_its_end():
    budget = LogBudget("bad greetings", few=2)
    for turn in range(1000):
        budget.spend(turn / 1000.0, "a greeting is bad")
    assert budget.poll_flood_summary(1700.0) == ""
    assert budget.poll_flood_summary(1860.0) == "bad greetings: 997 more, the last 31 min ago"
    assert budget.poll_flood_summary(9000.0) == ""
    assert budget.spend(9001.0, "a greeting is bad") == "a greeting is bad"


@given(
    bursts=st.lists(
        st.tuples(st.integers(1, 200), st.sampled_from((0.001, 1.0, 61.0, 700.0, 1900.0, 4000.0, 8000.0))),
        min_size=1,
        max_size=6,
    )
)
def test_no_pattern_of_floods_logs_more_than_100_lines_a_day_and_each_message_is_counted(bursts):
    budget, now_s, sent, lines = LogBudget("bad greetings"), 0.0, 0, []
    while now_s < 86400.0 and sent < 20_000:
        for number, pause_s in bursts:
            lines += [budget.spend(now_s, "a greeting is bad") for _ in range(number)]
            sent += number
            now_s += pause_s
            lines.append(budget.poll_flood_summary(now_s))
    lines = [line for line in lines if line]
    assert len(lines) <= 100
    assert budget.count == sent


def test_a_rate_limit_lets_a_burst_pass_and_then_so_many_a_second():
    limit = RateLimit(2.0, 5)
    assert [limit.admit(100.0) for _ in range(7)] == [True] * 5 + [False] * 2
    assert [limit.admit(100.0 + 0.25 * turn) for turn in range(1, 9)] == [False, True] * 4
    assert [limit.admit(1e6) for _ in range(7)] == [True] * 5 + [False] * 2
