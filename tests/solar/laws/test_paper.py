"""Pointing laws against hand-worked skies."""

import itertools
import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from solar.frames import angles_from_direction, direction_from_azimuth, separation_deg
from solar.laws.paper import chronometric, complete_poleward, mu_prime, sun_vector

anything = st.floats(allow_nan=True, allow_infinity=True)


def isotropic_faces(dni, dhi, azimuth_deg, elevation_deg, albedo=0.2):
    """East, south, west, zenith under equations (2)-(7)."""
    sun = direction_from_azimuth(azimuth_deg, elevation_deg, 48.7)
    ghi = dni * sun[2] + dhi
    vertical = dhi / 2 + albedo * ghi / 2
    return np.array(
        [
            dni * max(sun[1], 0) + vertical,
            dni * max(sun[0], 0) + vertical,
            dni * max(-sun[1], 0) + vertical,
            ghi,
        ]
    )


def test_mu_prime_agrees_with_a_hand_worked_morning():
    # I_min is the west face: (400 - 100, 500 - 100, 600), equations (12) and (14).
    a_deg, b_deg = angles_from_direction(mu_prime([500, 400, 100, 600]))
    assert a_deg == pytest.approx(math.degrees(math.asin(-400 / math.sqrt(300**2 + 400**2 + 600**2))))
    assert b_deg == pytest.approx(math.degrees(math.atan2(600, 300)))
    assert a_deg < 0, "a morning sun is east, and east is negative"


def test_mu_prime_lies_flat_under_a_uniform_sky():
    a_deg, b_deg = angles_from_direction(mu_prime(isotropic_faces(0, 200, 180, 30)))
    assert (a_deg, b_deg) == (pytest.approx(0), pytest.approx(90))


def test_noise_under_a_uniform_sky_does_not_tilt_the_tracker_south():
    noise = np.random.default_rng(3).normal(0, 0.3, (500, 4))
    _, b_deg = angles_from_direction(mu_prime(isotropic_faces(0, 200, 180, 30) + noise))
    assert (b_deg == 90).all()


def test_a_sun_north_of_the_east_west_plane_sets_b_to_90():
    _, b_deg = angles_from_direction(mu_prime(isotropic_faces(600, 80, 70, 20)))
    assert b_deg == 90


@pytest.mark.parametrize("azimuth", [100, 135, 180, 225, 260])
def test_sun_vector_with_the_true_albedo_points_at_the_sun_of_an_isotropic_sky(azimuth):
    faces = isotropic_faces(800, 100, azimuth, 35)
    vector = sun_vector(faces, albedo=0.2, uniform_threshold=0.0)
    assert separation_deg(vector, direction_from_azimuth(azimuth, 35, 48.7)) == pytest.approx(0, abs=1e-5)
    assert np.linalg.norm(vector) == pytest.approx(800)


def test_mu_prime_points_above_the_sun():
    faces = isotropic_faces(800, 100, 180, 35)
    _, b_deg = angles_from_direction(mu_prime(faces))
    assert 35 < b_deg < 45


def test_sun_vector_without_a_beam_looks_at_the_zenith():
    assert sun_vector(isotropic_faces(0, 200, 150, 40)) == pytest.approx([0, 0, 1])


@pytest.mark.parametrize("law", [mu_prime, sun_vector])
@given(faces=st.tuples(anything, anything, anything, anything))
def test_every_law_gives_a_finite_direction_or_nan_in_all_components(law, faces):
    direction = law(faces)
    assert np.isfinite(direction).all() or np.isnan(direction).all()
    if not np.isfinite(faces).all() or not faces[3] > 0:
        assert np.isnan(direction).all()


@pytest.mark.parametrize("law", [mu_prime, sun_vector])
@pytest.mark.parametrize("wrong", [5.0, [], [1.0, 2.0, 3.0], np.ones((4, 5)), np.ones((2, 8))])
def test_readings_without_four_faces_along_the_last_axis_are_refused(law, wrong):
    with pytest.raises(ValueError, match="East, South, West, Zenith along the last axis"):
        law(wrong)


@pytest.mark.parametrize("law", [mu_prime, sun_vector])
def test_laws_work_on_arrays(law):
    faces = np.stack([isotropic_faces(700, 90, azimuth, 30) for azimuth in (100, 180, 250)])
    together = law(faces.reshape(3, 1, 4))
    assert together.shape == (3, 1, 3)
    assert together[1, 0] == pytest.approx(law(faces[1]))


@pytest.mark.parametrize("law", [mu_prime, sun_vector])
def test_a_law_gives_the_same_direction_in_a_thousandth_of_the_light(law):
    faces = isotropic_faces(700, 90, 120, 30)
    assert 1e-3 * faces[3] < 1.0
    np.testing.assert_allclose(law(1e-3 * faces), 1e-3 * law(faces))


def test_chronometric_has_no_direction_at_night():
    assert chronometric([0.5, 0.5, 0.7]) == pytest.approx([0.5, 0.5, 0.7])
    assert np.isnan(chronometric([0.5, 0.5, -0.1])).all()


@pytest.mark.parametrize("vertical", [0.45, 0.5, 0.55, 0.6, 0.65, 0.7])
@pytest.mark.parametrize("zenith", [30.0, 150.0, 400.0])
def test_gains_that_are_three_percent_off_do_not_point_the_sun_vector_at_random_under_overcast(vertical, zenith):
    random = np.random.default_rng(4)
    gains = 1 + 0.03 * random.standard_normal((20_000, 4))
    faces = zenith * np.array([vertical, vertical, vertical, 1.0]) * gains + random.normal(0, 0.2, gains.shape)
    _, b_deg = angles_from_direction(sun_vector(faces))
    assert np.mean(b_deg < 45) < 0.01


def test_under_clear_skies_the_threshold_turns_the_sun_vector_by_less_than_0_1_degree():
    for azimuth, elevation in itertools.product((95, 140, 180, 230, 265), (8, 20, 40, 60)):
        dni = 1000 * 0.7 ** ((1 / np.sin(np.radians(elevation))) ** 0.678)
        faces = isotropic_faces(dni, 80, azimuth, elevation)
        changed = separation_deg(sun_vector(faces), sun_vector(faces, gain_uncertainty=0.0))
        assert changed < 0.1, (azimuth, elevation)


def test_the_threshold_of_the_sun_vector_is_two_standard_errors_of_its_formula():
    east, south, west, zenith, albedo, share = 310.0, 330.0, 280.0, 500.0, 0.2, 0.03
    up = zenith - 2 * west + albedo * zenith
    beam = math.sqrt((south - west) ** 2 + (east - west) ** 2 + up**2)
    sigma_over_g = math.sqrt(south**2 + west**2 + east**2 + west**2 + (1 + albedo) ** 2 * zenith**2 + 4 * west**2)
    just = beam / (2 * sigma_over_g)
    faces = [east, south, west, zenith]
    assert sun_vector(faces, gain_uncertainty=just * 0.999) == pytest.approx([south - west, east - west, up])
    assert sun_vector(faces, gain_uncertainty=just * 1.001) == pytest.approx([0, 0, 1])
    assert share < just


def test_a_negative_vertical_component_of_the_sun_vector_counts_as_zero():
    # 2 I_min - albedo I_Z = 800 - 80 is more than the 400 of the zenith face: nothing looks below the horizon.
    vector = sun_vector([400, 900, 400, 400], gain_uncertainty=0.0)
    assert vector == pytest.approx([500, 0, 0])


def test_a_difference_between_east_and_west_alone_counts_as_beam_in_the_sun_vector():
    # At dawn the sun is in the east: nothing from the south, nothing from above.
    vector = sun_vector([600, 240, 240, 400])
    assert vector == pytest.approx([0, 360, 0], abs=1e-9)


@pytest.mark.parametrize("azimuth_deg", [70.0, 290.0])
def test_poleward_of_the_east_west_plane_the_ephemeris_gives_the_component_that_no_face_sees(azimuth_deg):
    sun = direction_from_azimuth(azimuth_deg, 15.0, 48.7)
    seen = np.array([0.0, sun[1], sun[2]])
    assert separation_deg(complete_poleward(seen, sun), sun) == pytest.approx(0, abs=1e-9)
    assert complete_poleward(seen, sun)[0] < 0, "towards the pole"


def test_the_sun_vector_is_not_completed_while_the_sun_is_near_the_poles_azimuth():
    # There any error of the small east-west component would be blown up.
    sun = direction_from_azimuth(30.0, 5.0, 60.0)
    seen = np.array([0.0, 0.2, 0.1])
    assert complete_poleward(seen, sun) == pytest.approx(seen)


def test_the_sun_vector_is_not_completed_if_the_sun_is_equatorward_or_opposite_to_the_side_seen():
    for azimuth in (110.0, 290.0):
        seen = np.array([0.0, 0.8, 0.2])
        assert complete_poleward(seen, direction_from_azimuth(azimuth, 15.0, 48.7)) == pytest.approx(seen)
