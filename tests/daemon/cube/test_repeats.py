"""From which reading on a face that stands still is not believed."""

import math

import pytest

from daemon.cube.repeats import Repeats


def after(*values, every_s=5.0, irradiance=500.0, rounded=False):
    repeats = Repeats(every_s)
    for value in values:
        repeats.note(1, value)
    return repeats.frozen(1, irradiance, rounded=rounded)


def test_a_face_counts_as_frozen_from_the_seventh_identical_reading_on():
    assert [after(*[3.25] * count) for count in (1, 6, 7, 8)] == [False, False, True, True]


def test_a_reading_that_differs_restarts_the_count_of_repeats():
    assert not after(*[3.25] * 7, 3.26)
    assert not after(*[3.25] * 7, *[3.26] * 6)
    assert after(*[3.25] * 7, *[3.26] * 7)


def test_repeated_whole_numbers_count_as_frozen_and_repeated_zeros_or_gaps_do_not():
    assert after(*[1.0] * 7)
    assert not after(*[0.0] * 100)
    assert not after(*[math.nan] * 100)


def test_the_repeats_of_each_face_are_counted_separately():
    repeats = Repeats(5.0)
    for _ in range(7):
        repeats.note(1, 3.25)
    assert [repeats.frozen(face, 500.0, rounded=False) for face in range(4)] == [False, True, False, False]


@pytest.mark.parametrize(("count", "irradiance", "frozen"), [
    (180, 500.0, False),
    (181, 500.0, True),
    (181, 20.1, True),
    (181, 20.0, False),
])  # fmt: skip
def test_rounded_readings_may_repeat_for_half_an_hour_by_day_and_for_longer_in_the_dark(count, irradiance, frozen):
    assert after(*[500.0] * count, every_s=10.0, irradiance=irradiance, rounded=True) == frozen
