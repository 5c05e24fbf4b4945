"""The fourth face from three, and the paper's laws with it."""

from functools import partial

import numpy as np
import pytest

from solar.energy import Drive, arrange_daylight, build_sky, face_irradiances, harvest
from solar.ephemeris import Site
from solar.frames import Limits
from solar.laws import chronometric, flat, mu_prime, sun_vector
from solar.laws.law import Moment, TrackerFacts
from solar.laws.steer import steer_by_readings
from solar.laws.three_faces import fill_missing_face

LYNGBY = Site(55.79064, 12.52505, 50.0)
HAZY = 250.0, 150.0
CLEAR = 700.0, 90.0
NIGHTS = 1476230400.0  # 2016-10-12


def day(dni_w_m2, dhi_w_m2):
    utc_s = NIGHTS + 60.0 * np.arange(1440)
    weather = arrange_daylight(utc_s, np.full(1440, dni_w_m2), np.full(1440, dhi_w_m2), LYNGBY)
    light = build_sky(weather, "perez1990")
    return weather, light, face_irradiances(light, 0.2)


@pytest.mark.parametrize("face", range(4))
@pytest.mark.parametrize("weather", [HAZY, CLEAR])
def test_a_missing_face_is_estimated_from_the_other_three_while_the_sun_is_up(weather, face):
    minutes, _, faces = day(*weather)
    up = minutes.sun[:, 2] > 0.2
    sun, faces = minutes.sun[up], faces[up]
    without = faces.copy()
    without[:, face] = np.nan
    found = fill_missing_face(without, sun)
    np.testing.assert_array_equal(np.delete(found, face, axis=1), np.delete(faces, face, axis=1))
    off = np.abs(found[:, face] - faces[:, face])
    assert off.max() < 0.25 * faces[:, face].max()


def test_readings_of_four_faces_and_of_two_faces_are_left_unchanged():
    sun = np.array([0.6, 0.0, 0.8])
    four, two = np.array([200.0, 500.0, 150.0, 600.0]), np.array([np.nan, 500.0, np.nan, 600.0])
    np.testing.assert_array_equal(fill_missing_face(four, sun), four)
    np.testing.assert_array_equal(fill_missing_face(two, sun), two)
    both = fill_missing_face(np.array([four, two]), sun)
    np.testing.assert_array_equal(both, [four, two])


@pytest.mark.parametrize("face", range(4))
def test_a_dead_face_counts_as_one_that_is_missing(face):
    minutes, _, faces = day(*CLEAR)
    up = minutes.sun[:, 2] > 0.2
    sun, faces = minutes.sun[up], faces[up]
    dead, without = faces.copy(), faces.copy()
    dead[:, face], without[:, face] = 0.3, np.nan
    # A dead face that would have no beam is as dark as others without beam: then nothing contradicts it.
    found, expected = fill_missing_face(dead, sun), fill_missing_face(without, sun)
    replaced = (found == expected).all(axis=-1)
    assert replaced.mean() > 0.95
    np.testing.assert_array_equal(found[~replaced], dead[~replaced])


def test_a_missing_face_is_estimated_even_if_one_of_the_other_three_is_nearly_dark():
    sun = np.array([0.6, 0.0, 0.8])
    found = fill_missing_face(np.array([np.nan, 500.0, 1.0, 600.0]), sun)
    assert np.isfinite(found).all()


@pytest.mark.parametrize("law", [mu_prime, sun_vector, flat, chronometric])
def test_a_dark_zenith_face_is_believed_only_while_the_other_faces_are_dark_too(law):
    made = law.build(law.SETTINGS(), TrackerFacts(LYNGBY, Limits(), 5.0, 300.0, NIGHTS))
    assert not made.believes_zenith((500.0, 600.0, 100.0, 0.3), NIGHTS)
    assert made.believes_zenith((0.3, 0.4, 0.2, 0.3), NIGHTS)


@pytest.mark.parametrize("law", [mu_prime, sun_vector])
@pytest.mark.parametrize("face", range(4))
def test_with_three_faces_a_law_harvests_as_its_fast_steering_does_and_within_1_percent_of_four(law, face):
    weather, light, faces = day(*HAZY)
    without = faces.copy()
    without[:, face] = np.nan
    settings = law.SETTINGS()
    steers = (
        law.steer(settings, weather, faces, Limits()),
        law.steer(settings, weather, without, Limits()),
        steer_by_readings(partial(law.build, settings), weather, without, Limits()),
    )
    healthy, fast, slow = (float(harvest(weather, light, 0.2, Drive(), steer).energy_kwh_m2[0]) for steer in steers)
    assert slow == pytest.approx(fast, rel=1e-9)
    assert fast == pytest.approx(healthy, rel=0.01)


@pytest.mark.parametrize("law", [mu_prime, sun_vector])
def test_with_three_faces_a_law_gives_no_target_while_the_suns_position_is_unknown(law):
    noon = NIGHTS + 43200.0
    made = law.build(law.SETTINGS(), TrackerFacts(LYNGBY, Limits(), 5.0, 300.0, noon))
    faces = 200.0, np.nan, 150.0, 300.0
    assert made.aim(Moment(noon, faces, None)).target is not None
    assert made.aim(Moment(noon, faces, None, sun_known=False)).target is None
