import pytest
from hypothesis import given
from hypothesis import strategies as st

from daemon.base.recurrence import Recurrence, Wording

HOUR_S = 3600.0
PLAINLY, OFTEN, QUIETLY = Wording.PLAINLY, Wording.OFTEN, Wording.QUIETLY


def test_the_first_few_are_told_plainly_and_the_next_by_its_number():
    recurrence = Recurrence(3)
    assert [recurrence.note(20.0 * turn) for turn in range(6)] == [PLAINLY] * 3 + [OFTEN] + [QUIETLY] * 2
    assert recurrence.how_often(120.0) == "6 times in the last hour"


def test_the_number_is_told_again_after_ten_minutes_one_hour_six_hours_and_then_every_six():
    recurrence = Recurrence(3)
    told_h = [time_s / HOUR_S for time_s in range(0, 86400, 20) if recurrence.note(float(time_s)) is OFTEN]
    assert told_h == pytest.approx([1 / 60, 1 / 60 + 1 / 6, 1 / 60 + 1, 1 / 60 + 6, 12 + 1 / 60, 18 + 1 / 60], abs=0.01)


def test_what_is_seldom_is_told_plainly_for_ever():
    recurrence = Recurrence(3)
    assert {recurrence.note(4.5 * HOUR_S * turn) for turn in range(100)} == {PLAINLY}


def test_it_is_over_after_half_an_hour_once_with_its_number_and_the_next_is_told_plainly():
    recurrence = Recurrence(3)
    for turn in range(10):
        recurrence.note(20.0 * turn)
    assert recurrence.over(200.0 + 1799.0, 200.0) == 0
    assert recurrence.over(200.0 + 1800.0, 200.0) == 10
    assert recurrence.over(200.0 + 1801.0, 200.0) == 0
    assert recurrence.note(2 * HOUR_S) is PLAINLY


def test_if_it_begins_anew_it_has_to_be_calm_for_twice_as_long():
    recurrence = Recurrence(3)
    for turn in range(4):
        recurrence.note(20.0 * turn)
    assert recurrence.over(2000.0, 60.0) == 4
    assert [recurrence.note(2000.0 + turn) for turn in range(2)] == [PLAINLY, OFTEN]
    assert recurrence.over(2000.0 + 1900.0, 2001.0) == 0
    assert recurrence.over(2001.0 + 3600.0, 2001.0) == 2


def test_after_twelve_hours_without_it_all_is_as_it_was():
    recurrence = Recurrence(3)
    for turn in range(10):
        recurrence.note(20.0 * turn)
    assert [recurrence.note(13 * HOUR_S + 20.0 * turn) for turn in range(4)] == [PLAINLY] * 3 + [OFTEN]


@given(pauses_s=st.lists(st.sampled_from((20.0, 600.0, 1900.0, 3700.0, 7300.0, 14500.0)), min_size=1, max_size=12))
def test_no_rhythm_of_a_day_makes_more_than_50_lines(pauses_s):
    recurrence, now_s, lines = Recurrence(6), 0.0, 0
    while now_s < 86400.0:
        for pause_s in pauses_s:
            said = recurrence.note(now_s)
            lines += {PLAINLY: 2, OFTEN: 1, QUIETLY: 0}[said]
            over_s = next((s for s in (1800, 3600, 7200, 14400, 21600) if s < pause_s), None)
            lines += over_s is not None and bool(recurrence.over(now_s + pause_s - 1.0, now_s + 1.0))
            now_s += pause_s
            if now_s >= 86400.0:
                break
    assert lines <= 50


def test_what_is_told_elsewhere_too_is_told_by_its_number_only_once():
    recurrence = Recurrence(3, reminds=False)
    told_s = [time_s for time_s in range(0, 86400, 20) if recurrence.note(float(time_s)) is not QUIETLY]
    assert told_s == [0, 20, 40, 60]
