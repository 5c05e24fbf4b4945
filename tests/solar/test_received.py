"""What the three planes receive, compared with skies whose irradiance on planes is known."""

import numpy as np
import pytest

from solar.energy import arrange_daylight, best_possible, build_sky, face_irradiances
from solar.ephemeris import Site
from solar.frames import Limits, normal_from_angles
from solar.laws.light import Light, irradiance_on
from solar.received import insolation, received_irradiance

SITE = Site(48.72, 2.21, 156.0)
LIMITS = Limits()
ALBEDO = 0.2
# 2022-06-21 and 2022-12-21, from 00:00 UTC, every ten minutes.
INSTANTS = np.concatenate([1655769600.0 + np.arange(0, 86400, 600.0), 1671580800.0 + np.arange(0, 86400, 600.0)])


def skies(model, dni, dhi):
    weather = arrange_daylight(INSTANTS, np.full(INSTANTS.size, dni), np.full(INSTANTS.size, dhi), SITE, 600.0)
    light = build_sky(weather, model)
    return weather, light, face_irradiances(light, ALBEDO)


@pytest.mark.parametrize(("dni", "dhi"), [(800.0, 90.0), (300.0, 250.0), (0.0, 120.0)])
def test_under_a_uniform_sky_every_plane_receives_what_the_sky_gives_it(dni, dhi):
    weather, light, faces = skies("isotropic", dni, dhi)
    a_deg, b_deg = 20.0 * np.sin(INSTANTS[: len(weather.utc_s)]), np.full(len(weather.utc_s), 60.0)
    found = received_irradiance(faces, weather.sun, a_deg, b_deg, LIMITS, ALBEDO)
    true = light.irradiance_on(normal_from_angles(a_deg, b_deg), ALBEDO)
    np.testing.assert_allclose(found.actual_w_m2, true, atol=1.0)
    bound = best_possible(weather, light, LIMITS, ALBEDO)
    np.testing.assert_allclose(found.best_w_m2, bound, atol=1.5)


def test_where_no_pose_sees_the_sun_the_best_irradiance_is_that_of_the_light_without_the_beam():
    site, limits = Site(68.0, 2.21, 0.0), Limits(-50.0, 50.0, 15.0, 60.0)
    day = INSTANTS[:144]
    weather = arrange_daylight(day, np.full(day.size, 600.0), np.full(day.size, 100.0), site, 600.0)
    light = build_sky(weather, "isotropic")
    low = np.full((2, len(weather.utc_s)), [[50.0], [15.0]])
    found = received_irradiance(face_irradiances(light, ALBEDO), weather.sun, *low, limits, ALBEDO)
    a_deg, b_deg = (grid.ravel() for grid in np.meshgrid(np.linspace(-50, 50, 41), np.linspace(15, 60, 19)))
    unseen = (weather.sun @ normal_from_angles(a_deg, b_deg).T).max(axis=-1) <= 0.0
    assert unseen.sum() > 10
    bound = best_possible(weather, light, limits, ALBEDO)
    np.testing.assert_allclose(found.best_w_m2[unseen], bound[unseen], atol=1.5)


def test_the_irradiance_on_planes_matches_a_calculation_by_hand():
    light = Light(np.array(500.0), np.array(100.0), np.array(30.0))
    sun, up, level, away = [0.6, 0.0, 0.8], [0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [-1.0, 0.0, 0.0]
    # The zenith face, and two vertical ones: 300 of beam or none, 50 of sky, 30 of the horizon, 50 of the ground.
    found = irradiance_on(light, sun, 0.2, [up, level, away])
    np.testing.assert_allclose(found, [500.0, 430.0, 130.0])


@pytest.mark.parametrize("model", ["perez1990", "perez1993"])
def test_under_a_perez_sky_the_estimated_gains_of_a_day_are_close_to_the_true_ones(model):
    weather, light, faces = skies(model, 350.0, 180.0)
    flat = np.zeros(len(weather.utc_s)), np.full(len(weather.utc_s), 90.0)
    found = received_irradiance(faces, weather.sun, *flat, LIMITS, ALBEDO)
    true = light.irradiance_on(normal_from_angles(*flat), ALBEDO)
    # A flat tracker loses some 30 % here; the model's loss is right to within 0.01 of the chronometric energy.
    said, so = (values.sum() / found.chronometric_w_m2.sum() for values in (found.actual_w_m2, true))
    assert said == pytest.approx(so, abs=0.01)
    bound = best_possible(weather, light, LIMITS, ALBEDO)
    assert found.best_w_m2.sum() == pytest.approx(bound.sum(), rel=0.03)


def test_no_pose_receives_more_than_the_bound_even_with_a_face_missing():
    weather, _, faces = skies("perez1990", 500.0, 150.0)
    faces[::3, 1] = np.nan
    a_deg, b_deg = np.linspace(-50, 50, len(weather.utc_s)), np.linspace(15, 90, len(weather.utc_s))
    found = received_irradiance(faces, weather.sun, a_deg, b_deg, LIMITS, ALBEDO)
    assert np.isfinite(found.best_w_m2).all()
    assert (found.best_w_m2 >= found.actual_w_m2).all()
    assert (found.best_w_m2 >= found.chronometric_w_m2).all()


def test_a_pose_at_the_limits_that_receives_more_than_the_closed_form_raises_the_bound():
    draw = np.random.default_rng(1)
    limits = Limits(-20.0, 20.0, 15.0, 90.0)
    suns = draw.normal(size=(300, 3)) * [1.0, 1.0, 0.3]
    suns[:, 2] = np.abs(suns[:, 2])
    suns /= np.linalg.norm(suns, axis=-1, keepdims=True)
    faces = draw.uniform(50.0, 700.0, size=(300, 4))
    a_deg, b_deg = (grid.ravel() for grid in np.meshgrid(np.linspace(-20, 20, 9), np.linspace(15, 90, 26)))
    found = received_irradiance(faces[:, None], suns[:, None], a_deg, b_deg, limits)
    known = np.isfinite(found.best_w_m2)
    assert (found.best_w_m2[known] >= found.actual_w_m2[known]).all()
    assert (found.best_w_m2.max(axis=-1) > found.best_w_m2.min(axis=-1) + 0.1).any(), "the closed form alone is less"


def test_two_missing_faces_a_sun_below_the_horizon_or_an_unknown_pose_give_nan_for_all_planes():
    day = np.array([0.6, 0.0, 0.8])
    faces = [[100.0] * 4, [np.nan, np.nan, 100.0, 100.0], [100.0] * 4, [100.0] * 4]
    suns = [day, day, [0.6, 0.0, -0.8], day]
    found = received_irradiance(faces, suns, [0.0, 0.0, 0.0, np.nan], [90.0] * 4, LIMITS)
    assert np.isnan(np.array(found)).tolist() == [[False, True, True, True]] * 3


def test_the_planes_of_a_single_instant_can_be_computed():
    found = received_irradiance((100.0, 100.0, 100.0, 150.0), [0.6, 0.0, 0.8], 0.0, 90.0, LIMITS)
    assert float(found.actual_w_m2) == pytest.approx(150.0, abs=1.0)


def test_insolation_is_summed_over_the_known_readings_and_does_not_bridge_gaps():
    utc_s = np.array([0.0, 5.0, 10.0, 15.0, 3600.0, 3605.0])
    power = np.array([720.0, 720.0, np.nan, 720.0, 720.0, 720.0])
    # 5 s for each known reading, and 60 s for the gap.
    assert insolation(utc_s, power) == pytest.approx((720.0 * 80.0 / 3.6e6, 80.0))
    assert insolation([0.0], [1.0]) == (0.0, 0.0)


@pytest.mark.parametrize(
    ("utc_s", "seconds"), [([], 0.0), ([5.0], 0.0), ([0.0, 10.0], 20.0), ([0.0, 60.0], 120.0), ([0.0, 61.0], 120.0)]
)
def test_in_the_insolation_of_two_readings_each_counts_for_at_most_60_s_and_fewer_give_zero(utc_s, seconds):
    assert insolation(utc_s, [720.0] * len(utc_s)) == pytest.approx((0.0002 * seconds, seconds))
