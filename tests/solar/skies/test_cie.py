"""The sky of CIE types with drifting clouds."""

import numpy as np
import pytest

from solar.frames import FACE_NORMALS, direction_from_azimuth
from solar.skies.cie import cie_sky

NOON_UTC_S = 1465128000.0
# From the standard: each type's a, b, c, d, e, and the clearness at which the blend is this type alone.
TYPES = {
    1: (4.0, -0.70, 0.0, -1.0, 0.0, 1.0),
    6: (0.0, -1.0, 2.0, -1.5, 0.15, 1.3),
    8: (0.0, -1.0, 10.0, -3.0, 0.45, 2.2),
    12: (-1.0, -0.32, 10.0, -3.0, 0.45, 6.0),
}
SOUTH_37_DEG = np.array([0.6, 0.0, 0.8])
PLANES = np.vstack([FACE_NORMALS[:3], [[-1.0, 0.0, 0.0]], SOUTH_37_DEG[None, :]])


def sky_at(elevation, dni, dhi, utc_s=NOON_UTC_S, azimuth=180.0, structure=1.0):
    utc_s = np.atleast_1d(utc_s)
    sun = np.broadcast_to(direction_from_azimuth(azimuth, elevation, 50.0), (len(utc_s), 3))
    return cie_sky(sun, np.full(len(utc_s), dni), np.full(len(utc_s), dhi), utc_s, structure)


def by_the_formula(kind, sun, planes):
    """Return the irradiance on planes under a standard sky that gives 1 on a horizontal one, by patches of 1 deg."""
    a, b, c, d, e, _ = TYPES[kind]
    sine = (np.arange(90) + 0.5) * np.pi / 180
    azimuth = (np.arange(360) + 0.5) * np.pi / 180
    up, round_ = np.meshgrid(np.sin(sine), azimuth, indexing="ij")
    side = np.sqrt(1 - up**2)
    towards = np.stack([side * np.cos(round_), side * np.sin(round_), up], axis=-1)
    gamma = np.arccos(np.clip(towards @ sun, -1, 1))
    radiance = (1 + a * np.exp(b / up)) * (1 + c * (np.exp(d * gamma) - np.exp(d * np.pi / 2)) + e * np.cos(gamma) ** 2)
    radiance = radiance * side
    return np.array([(radiance * np.maximum(towards @ n, 0)).sum() for n in planes]) / (radiance * up).sum()


@pytest.mark.parametrize("kind", TYPES)
@pytest.mark.parametrize(("azimuth", "elevation"), [(180.0, 40.0), (120.0, 25.0)])
def test_at_the_clearness_of_a_cie_type_the_sky_is_the_standard_sky_of_that_type(kind, azimuth, elevation):
    dhi = 60.0
    # Clearness of Perez et al. (1990), solved for DNI.
    dni = (TYPES[kind][-1] - 1.0) * dhi * (1.0 + 1.041 * np.radians(90.0 - elevation) ** 3)
    light = sky_at(elevation, dni, dhi, azimuth=azimuth, structure=0.0)
    sun = light.sun[0]
    diffuse = light.irradiance_on(PLANES[:, None, :], 0.0)[:, 0] - dni * np.maximum(PLANES @ sun, 0)
    np.testing.assert_allclose(diffuse / dhi, by_the_formula(kind, sun, PLANES), atol=0.006)


def test_between_two_cie_types_the_sky_is_their_blend_in_the_logarithm_of_clearness():
    def south(dni):
        light = sky_at(40.0, dni, 200.0, structure=0.0)
        return float(light.irradiance_on(FACE_NORMALS[1][None, :], 0.0)[0]) - dni * np.cos(np.radians(40.0))

    dark, bright = south(0.0), south(200.0)
    # Clearness is 1 + (DNI/DHI)/(1 + 1.041 z^3); the types 1 and 6 blend in its logarithm up to 1.3.
    zenith_term = 1 + 1.041 * np.radians(50.0) ** 3
    end, middle = 0.3 * 200 * zenith_term, (1.3**0.5 - 1) * 200 * zenith_term
    assert dark < south(middle) < bright
    assert south(middle) == pytest.approx((dark + south(end)) / 2, rel=1e-4)


@pytest.mark.parametrize(("dni", "dhi"), [(0.0, 120.0), (150.0, 250.0), (900.0, 90.0)])
def test_a_horizontal_plane_receives_the_global_irradiance_whatever_the_clouds(dni, dhi):
    light = sky_at(35.0, dni, dhi, NOON_UTC_S + 300.0 * np.arange(50))
    assert light.irradiance_on(FACE_NORMALS[3][None, :]) == pytest.approx(
        dhi + dni * np.sin(np.radians(35.0)), rel=2e-3
    )


def lateral(light):
    """Return east less west, as a share of their mean: symmetric skies give 0 while the sun is south."""
    east, west = (light.irradiance_on(FACE_NORMALS[face][None, :], 0.0) for face in (0, 2))
    return (east - west) / (east + west)


def test_clouds_make_a_broken_sky_uneven_and_a_clear_one_much_less_so():
    minutes = NOON_UTC_S + 60.0 * np.arange(3000)
    smooth = sky_at(35.0, 150.0, 250.0, minutes, structure=0.0)
    assert abs(lateral(smooth)).max() < 1e-5
    broken, clear = (lateral(sky_at(35.0, *light, minutes)) for light in ((150.0, 250.0), (900.0, 90.0)))
    assert 0.07 < broken.std() < 0.12
    assert clear.std() < broken.std() / 4
    assert abs(broken.mean()) < broken.std() / 5


def test_clouds_drift_in_minutes_and_never_come_back():
    uneven = lateral(sky_at(35.0, 150.0, 250.0, NOON_UTC_S + 10.0 * np.arange(20000)))

    def alike(steps):
        return np.corrcoef(uneven[:-steps], uneven[steps:])[0, 1]

    assert alike(1) > 0.95
    assert alike(60) < 0.5
    assert max(alike(steps) for steps in range(360, 12000, 6)) < 0.75


WIND_TURNS_IN_S = 5.3 * 86400.0


def carried(turns, planes):
    """Return how much better the second plane follows the first after two minutes than the other way round."""
    begin_s = (np.ceil(NOON_UTC_S / WIND_TURNS_IN_S) + turns) * WIND_TURNS_IN_S
    light = sky_at(35.0, 150.0, 250.0, begin_s + 20.0 * np.arange(-900, 900))
    first, last = (light.irradiance_on(PLANES[plane][None, :], 0.0) for plane in planes)
    return np.corrcoef(first[:-6], last[6:])[0, 1] - np.corrcoef(first[6:], last[:-6])[0, 1]


@pytest.mark.parametrize(("turns", "planes"), [(0.25, (0, 2)), (0.5, (1, 3))])
def test_clouds_drift_the_opposite_way_when_the_wind_has_turned_by_half_a_circle(turns, planes):
    there, back = carried(turns, planes), carried(turns + 0.5, planes)
    assert min(abs(there), abs(back)) > 0.5
    assert there * back < 0.0


def test_clouds_have_changed_after_a_full_turn_of_the_wind():
    times_s = NOON_UTC_S + 60.0 * np.arange(3000)
    now, a_turn_later = (lateral(sky_at(35.0, 150.0, 250.0, times_s + late)) for late in (0.0, WIND_TURNS_IN_S))
    assert abs(np.corrcoef(now, a_turn_later)[0, 1]) < 0.5


def test_the_same_instant_has_the_same_clouds():
    whole = lateral(sky_at(35.0, 150.0, 250.0, NOON_UTC_S + 60.0 * np.arange(5000)))
    alone = lateral(sky_at(35.0, 150.0, 250.0, NOON_UTC_S + 60.0 * 4500))
    assert alone[0] == pytest.approx(whole[4500], abs=1e-5)


def test_without_diffuse_light_there_is_the_beam_alone():
    plane = np.array([[np.sin(np.radians(60.0)), 0.0, 0.5]])
    assert sky_at(30.0, 800.0, 0.0).irradiance_on(plane, 0.0)[0] == pytest.approx(800.0)
