"""The all-weather sky."""

import numpy as np
import pytest

from solar.allweather import all_weather_sky
from solar.frames import direction_from_azimuth

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
    # The beam alone gives 606 on south; what it gets beyond that is twice and more of what the sides get.
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
