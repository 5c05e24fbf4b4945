"""From which reading on a face that stands still is not believed."""

import math

import pytest

from daemon.cube.repeats import Repeats


def after(*values, every_s=5.0, irradiance=500.0, rounded=False):
    repeats = Repeats(every_s)
    for value in values:
        repeats.note(1, value)
    return repeats.frozen(1, irradiance, rounded=rounded)


def test_the_seventh_reading_of_the_same_digits_is_one_too_many():
    assert [after(*[3.25] * count) for count in (1, 6, 7, 8)] == [False, False, True, True]


def test_one_that_differs_begins_anew():
    assert not after(*[3.25] * 7, 3.26)
    assert not after(*[3.25] * 7, *[3.26] * 6)
    assert after(*[3.25] * 7, *[3.26] * 7)


def test_a_whole_number_is_as_suspicious_as_any_and_nothing_at_all_is_not():
    assert after(*[1.0] * 7)
    assert not after(*[0.0] * 100)
    assert not after(*[math.nan] * 100)


def test_each_face_is_counted_by_itself():
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
def test_what_comes_in_steps_may_stand_still_for_half_an_hour_and_in_the_dark(count, irradiance, frozen):
    assert after(*[500.0] * count, every_s=10.0, irradiance=irradiance, rounded=True) == frozen
