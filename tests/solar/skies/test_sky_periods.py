"""Periods by the diffuse fraction."""

import itertools

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from solar.skies.sky_periods import Period, diffuse_fraction_of_faces, sky_periods

HOUR = 3600.0


def at(*hours_and_fractions):
    """One reading every 5 s; each pair is a duration in hours and its diffuse fraction."""
    fraction = np.concatenate([np.full(round(hours * 720), value) for hours, value in hours_and_fractions])
    return np.arange(fraction.size) * 5.0, fraction


def test_the_papers_day_has_three_periods():
    time, fraction = at((3, 0.2), (2, 1.0), *[(0.1, value) for value in (0.3, 1.0) * 20])
    assert sky_periods(time, fraction) == [
        Period("clear", 0.0, 3 * HOUR),
        Period("overcast", 3 * HOUR, 5 * HOUR),
        Period("variable", 5 * HOUR, 9 * HOUR),
    ]


def test_half_an_hour_of_sun_is_no_clear_period():
    time, fraction = at((2, 1.0), (0.5, 0.2), (2, 1.0))
    assert [period.kind for period in sky_periods(time, fraction)] == ["overcast", "variable", "overcast"]


def test_one_reading_ends_no_period_and_one_minute_does():
    time, fraction = at((2, 0.2))
    fraction[700] = 0.9
    assert [period.kind for period in sky_periods(time, fraction)] == ["clear"]
    fraction[696:708] = 0.9
    # 58 min before it are too few, and 61 min after it enough.
    assert [period.kind for period in sky_periods(time, fraction)] == ["variable", "clear"]


def test_the_night_between_two_days_is_no_period():
    time, fraction = at((2, 0.2), (2, 0.2))
    time[1440:] += 10 * HOUR
    assert sky_periods(time, fraction) == [Period("clear", 0.0, 2 * HOUR), Period("clear", 12 * HOUR, 14 * HOUR)]


def test_unknown_diffuse_fractions_alone_give_no_period():
    assert sky_periods([0.0, 5.0], [np.nan, np.nan]) == []


@given(st.lists(st.sampled_from([0.1, 0.7, 1.0, np.nan]), min_size=1, max_size=400))
def test_periods_do_not_overlap_and_contain_every_known_reading(values):
    time = np.arange(len(values)) * 60.0
    periods = sky_periods(time, values, shortest_s=600.0)
    for one, other in itertools.pairwise(periods):
        assert one.start_utc_s < one.end_utc_s <= other.start_utc_s
    inside = sum(((time >= period.start_utc_s) & (time < period.end_utc_s)).astype(int) for period in periods)
    known = np.isfinite(values)
    assert np.all(np.asarray(inside)[known] == 1) if periods else not known.any()


def test_the_diffuse_fraction_of_a_uniform_sky_is_found_from_the_four_faces():
    # DHI 100, DNI 500 at 30 deg in the south-west, albedo 0.2: GHI 350, shaded face 50 + 35.
    faces = [85.0, 391.2, 391.2, 350.0]
    assert diffuse_fraction_of_faces(faces) == pytest.approx(100 / 350)
    assert diffuse_fraction_of_faces([60.0, 60.0, 60.0, 100.0]) == pytest.approx(1.0)
    assert np.isnan(diffuse_fraction_of_faces([0.0, 0.0, 0.0, 0.0]))


@pytest.mark.parametrize(
    ("faces", "fraction"),
    [
        ((300.0, 100.0, 400.0, 500.0), 1.0),
        ((275.0, 100.0, 400.0, 500.0), 0.9),
        ((20.0, 100.0, 400.0, 500.0), 0.0),
        ((0.0, 0.0, 0.0, 0.0), np.nan),
        ((0.1, 0.1, 0.1, 0.5), 0.2),
    ],
)
def test_the_diffuse_fraction_of_faces_stays_within_0_to_1_and_is_nan_in_the_dark(faces, fraction):
    assert diffuse_fraction_of_faces(faces) == pytest.approx(fraction, nan_ok=True)
