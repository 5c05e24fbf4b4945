"""A face that jumps alone for a minute, and faces that change with the light."""

import numpy as np
import pytest

from solar.energy import arrange_daylight, build_sky, face_irradiances
from solar.ephemeris import Site
from solar.faces.jumps import find_jumps

SITE = Site(55.79064, 12.52505, 50.0)
JUNE_UTC_S = 1655283600.0  # 2022-06-15 09:00
DECEMBER_UTC_S = 1671098400.0  # 2022-12-15 10:00
MINUTES = np.arange(30)
ALL = [True] * 4


def half_hour(at_utc_s, passing, model="perez1990"):
    """Return faces with a sensor's noise under a beam that clouds weaken to a tenth, and the sun's directions."""
    beam_w_m2 = 700.0 * np.where(passing, 0.1, 1.0)
    weather = arrange_daylight(at_utc_s + 60.0 * MINUTES, beam_w_m2, np.full(30, 100.0), SITE, 60.0)
    faces = face_irradiances(build_sky(weather, model), 0.2)
    return faces + np.random.default_rng(1).normal(0.0, 0.3, faces.shape), weather.sun


@pytest.mark.parametrize("model", ["perez1990", "perez1993", "cie"])
@pytest.mark.parametrize("at_utc_s", [JUNE_UTC_S, DECEMBER_UTC_S])
def test_a_cloud_of_one_minute_is_not_taken_for_a_jump_of_a_face(at_utc_s, model):
    faces, sun = half_hour(at_utc_s, MINUTES % 10 == 5, model)
    found = find_jumps(faces)
    assert not found.sure.any()
    assert not found.repeated(sun, ALL).any()


def by_sorting(faces):
    """The same with the median of five taken by a sort, which puts NaN after all numbers."""
    starts = np.clip(np.arange(len(faces)) - 2, 0, len(faces) - 5)
    middle = np.array([np.sort(faces[start : start + 5], axis=0)[2] for start in starts])
    apart = np.abs(faces - middle)
    others = np.stack([np.delete(apart, face, axis=1).max(axis=1) for face in range(4)], axis=1)
    sure, unsure = ((apart > low) & (others < share * apart) for low, share in ((80.0, 0.05), (15.0, 0.2)))
    return sure, np.where(unsure, middle, faces)


@pytest.mark.parametrize("missing", [0.0, 0.05, 0.5])
def test_jumps_are_found_by_the_median_of_five_minutes_even_with_missing_readings(missing):
    random = np.random.default_rng(3)
    for size in (3.0, 10.0, 30.0) * 10:
        faces = 300.0 + random.normal(0.0, size, (random.integers(5, 31), 4))
        faces[random.random(faces.shape) < 0.1] += random.choice([-200.0, 100.0, 1000.0])
        faces[random.random(faces.shape) < missing] = np.nan
        for found, expected in zip(find_jumps(faces), by_sorting(faces), strict=True):
            np.testing.assert_array_equal(found, expected)


@pytest.mark.parametrize("length", [1, 2])
@pytest.mark.parametrize("at_w_m2", [0.0, 1350.0])
@pytest.mark.parametrize("face", [1, 3])
def test_a_face_that_jumps_repeatedly_for_a_minute_or_two_is_found_and_its_jumps_are_smoothed_out(
    face, at_w_m2, length
):
    faces, sun = half_hour(JUNE_UTC_S, MINUTES < 0)
    sound = faces.copy()
    jumped = np.isin(MINUTES % 10, [3, 4][:length])
    faces[jumped, face] = at_w_m2
    found = find_jumps(faces)
    assert np.flatnonzero(found.sure.any(axis=1)).tolist() == np.flatnonzero(jumped).tolist()
    assert found.repeated(sun, ALL).tolist() == [place == face for place in range(4)]
    assert found.without_jumps == pytest.approx(sound, abs=5.0)


def test_one_jump_accuses_no_face_and_neither_does_one_at_the_end_that_may_not_come_back():
    faces, sun = half_hour(JUNE_UTC_S, MINUTES < 0)
    faces[[10, 11, 29], 1] = 0.0
    assert not find_jumps(faces).repeated(sun, ALL).any()


def test_beside_a_dead_zenith_face_a_cloud_before_a_low_sun_accuses_no_other_face():
    faces, sun = half_hour(DECEMBER_UTC_S + 3000.0, MINUTES % 10 == 5)
    faces[:, 3] = np.random.default_rng(2).normal(0.0, 0.3, 30)
    found = find_jumps(faces)
    assert found.sure[:, 1].any(), "the sun reaches neither east nor west"
    assert not found.repeated(sun, ALL).any()
