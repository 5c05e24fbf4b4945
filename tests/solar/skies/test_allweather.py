"""The all-weather sky."""

import numpy as np
import pytest

from solar.frames import direction_from_azimuth
from solar.skies.allweather import all_weather_sky

NORMALS = np.array([[0.0, 1, 0], [1, 0, 0], [0, -1, 0], [0, 0, 1]])


def sky_at(elevation, dni, dhi, azimuth=180.0):
    sun = direction_from_azimuth(azimuth, elevation, 50.0)[None, :]
    return all_weather_sky(sun, np.array([dni]), np.array([dhi]), np.array([1360.0]))


def tilted(tilt_deg):
    tilt = np.radians(tilt_deg)
    return np.array([[np.sin(tilt), 0.0, np.cos(tilt)]])


@pytest.mark.parametrize(("elevation", "dni", "dhi"), [(5, 0, 20), (30, 100, 200), (30, 800, 90), (60, 900, 100)])
def test_a_horizontal_plane_receives_the_global_irradiance(elevation, dni, dhi):
    light = sky_at(elevation, dni, dhi)
    ghi = dhi + dni * np.sin(np.radians(elevation))
    assert light.irradiance_on(tilted(0.0))[0] == pytest.approx(ghi, rel=2e-3)


def test_light_round_the_sun_falls_on_the_faces_that_look_there():
    east, south, west, _ = (sky_at(30, 700, 120).irradiance_on(n[None, :], 0.0)[0] for n in NORMALS)
    # The beam alone gives 606 on south; what south gets beyond that is more than twice what the sides get.
    assert south - 700 * np.cos(np.radians(30)) > 2 * east
    assert east == pytest.approx(west, rel=1e-6)


def test_an_overcast_sky_is_darkest_at_the_horizon():
    light = sky_at(40, 0.0, 150.0)
    vertical = light.irradiance_on(np.array([[0.0, 1.0, 0.0]]), 0.0)[0]
    assert 0.3 * 150 < vertical < 0.5 * 150


def test_without_diffuse_light_there_is_the_beam_alone():
    assert sky_at(30, 800.0, 0.0).irradiance_on(tilted(60.0), 0.0)[0] == pytest.approx(800.0)


def test_many_planes_and_many_instants_broadcast():
    sun = direction_from_azimuth(np.linspace(90, 270, 7), np.full(7, 30.0), 50.0)
    light = all_weather_sky(sun, np.full(7, 500.0), np.full(7, 150.0), np.full(7, 1360.0))
    together = light.irradiance_on(NORMALS[:, None, :])
    assert together.shape == (4, 7)
    np.testing.assert_allclose(together[1], light.irradiance_on(np.broadcast_to(NORMALS[1], (7, 3))))


# Two skies for each of the eight kinds of day: elevation [deg], DNI, DHI, and what the sky gives on planes that look
# east, south, north and south at a tilt of 37 deg [W/m2]. The formula itself, summed over patches of 1 deg, gives the
# same within 1.6 %.
SKIES = [
    (20, 0, 40, 18.074, 18.281, 17.572, 35.465),
    (50, 10, 300, 125.205, 149.231, 109.303, 281.497),
    (25, 40, 110, 64.883, 137.329, 43.516, 155.811),
    (55, 60, 260, 110.511, 182.170, 76.571, 287.013),
    (20, 60, 90, 53.421, 118.846, 37.532, 130.999),
    (60, 150, 260, 97.008, 169.343, 66.854, 283.982),
    (30, 150, 130, 69.212, 157.087, 46.353, 182.505),
    (50, 250, 230, 94.794, 186.100, 63.283, 272.240),
    (25, 300, 120, 65.312, 153.527, 43.603, 173.501),
    (60, 450, 220, 86.870, 146.516, 62.291, 240.390),
    (30, 500, 110, 60.691, 137.374, 42.765, 156.929),
    (55, 650, 150, 70.605, 123.187, 53.530, 177.075),
    (25, 650, 90, 52.567, 123.876, 37.358, 134.951),
    (60, 800, 130, 61.805, 99.682, 50.169, 148.842),
    (15, 600, 50, 33.203, 77.764, 27.138, 79.094),
    (65, 950, 90, 42.532, 62.904, 35.280, 98.778),
]


def test_the_irradiance_on_planes_has_the_pinned_values_in_each_of_eight_kinds_of_day():
    elevation, dni, dhi, *expected = np.array(SKIES).T
    sun = direction_from_azimuth(np.full(len(SKIES), 180.0), elevation, 50.0)
    planes = np.array([[0.0, 1, 0], [1, 0, 0], [-1, 0, 0], [0.6, 0, 0.8]])[:, None, :]
    light = all_weather_sky(sun, dni, dhi, np.full(len(SKIES), 1360.0))
    beam = dni * np.maximum((planes * sun).sum(axis=-1), 0.0)
    np.testing.assert_allclose(light.irradiance_on(planes, 0.0) - beam, expected, rtol=1e-4)
    ground = light.irradiance_on(planes, 0.5) - light.irradiance_on(planes, 0.0)
    ghi = dhi + dni * np.sin(np.radians(elevation))
    np.testing.assert_allclose(ground, 0.25 * ghi * np.array([1, 1, 1, 0.2])[:, None])
