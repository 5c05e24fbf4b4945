import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pvlib import irradiance
from pvlib.atmosphere import get_relative_airmass

from solar.frames import direction_from_azimuth
from solar.skies.sky import SKY_MODELS, normal_from_tilt, plane_of_array, sky

LATITUDE = 48.7
UP = np.array([0.0, 0.0, 1.0])
EXTRA = 1361.0
models = st.sampled_from(SKY_MODELS)
irradiances = st.floats(0.0, 1400.0)
tilts = st.floats(0.0, 180.0)
azimuths = st.floats(0.0, 360.0)


def sun_at(azimuth_deg, elevation_deg):
    return direction_from_azimuth(azimuth_deg, elevation_deg, LATITUDE)


def test_the_irradiance_on_four_faces_under_an_isotropic_sky_matches_a_calculation_by_hand():
    # Sun in the South at 30 deg: DNI 800, DHI 100, so GHI = 800/2 + 100 = 500; a vertical face gets half of the vault
    # (50) and half of the ground (0.2 * 500 / 2 = 50); the South face also 800 cos 30 deg.
    faces = normal_from_tilt([90.0, 90.0, 90.0, 0.0], [90.0, 180.0, 270.0, 180.0], LATITUDE)
    received = plane_of_array(faces, sun_at(180.0, 30.0), 800.0, 100.0, EXTRA, model="isotropic", albedo=0.2)
    assert received == pytest.approx([100.0, 100.0 + 800.0 * np.sqrt(0.75), 100.0, 500.0])


def test_hay_and_davies_place_the_anisotropy_index_of_the_diffuse_light_at_the_sun():
    # DNI of half the extraterrestrial: half of DHI 100 comes from the sun's direction. Sun at 30 deg, plane facing it:
    # 680.5 + 50/sin 30 + 50 (1 + sin 30)/2 + 0.
    facing = sun_at(180.0, 30.0)
    received = plane_of_array(facing, facing, EXTRA / 2, 100.0, EXTRA, model="haydavies", albedo=0.0)
    assert received == pytest.approx(EXTRA / 2 + 100.0 + 50.0 * 0.75)


@pytest.mark.parametrize(("model", "lowest_deg"), [("isotropic", 0.1), ("haydavies", 1.0), ("perez1990", 5.0)])
def test_transposition_agrees_with_pvlib_in_every_sky_and_on_every_plane(model, lowest_deg):
    random, count = np.random.default_rng(4), 20000
    elevation, sun_azimuth = random.uniform(lowest_deg, 90.0, count), random.uniform(0.0, 360.0, count)
    tilt, azimuth = random.uniform(0.0, 180.0, count), random.uniform(0.0, 360.0, count)
    zenith, air_mass = 90.0 - elevation, get_relative_airmass(90.0 - elevation)
    # Brightness up to 1: beyond that it is bounded here and not in pvlib.
    dhi = random.uniform(0.001, 1.0, count) * EXTRA / air_mass
    # Such ratios of beam to diffuse light spread the skies over all clearness bins.
    dni = np.where(random.random(count) < 0.1, 0.0, dhi * 10.0 ** random.uniform(-2.0, 1.5, count))
    expected = irradiance.get_total_irradiance(
        tilt, azimuth, zenith, sun_azimuth, dni, dni * np.cos(np.radians(zenith)) + dhi, dhi,
        dni_extra=EXTRA, airmass=air_mass, albedo=0.2, model=model.removesuffix("1990"),
    )  # fmt: skip
    ours = plane_of_array(
        normal_from_tilt(tilt, azimuth, LATITUDE), sun_at(sun_azimuth, elevation), dni, dhi, EXTRA, model=model
    )
    usual = dni < EXTRA
    assert np.count_nonzero(usual) > 10000
    assert ours[usual] == pytest.approx(expected["poa_global"][usual], rel=1e-9, abs=1e-9)


@given(models, st.floats(-90.0, 90.0), azimuths, irradiances, irradiances, tilts, azimuths, st.floats(0.0, 1.0))
def test_irradiance_is_never_negative_and_never_nan(model, elevation, sun_azimuth, dni, dhi, tilt, azimuth, albedo):
    normal = normal_from_tilt(tilt, azimuth, LATITUDE)
    received = plane_of_array(normal, sun_at(sun_azimuth, elevation), dni, dhi, EXTRA, model=model, albedo=albedo)
    assert np.isfinite(received)
    assert received >= 0.0


@given(models, st.floats(-90.0, 90.0), azimuths, irradiances, irradiances)
def test_a_horizontal_plane_receives_the_global_irradiance(model, elevation, azimuth, dni, dhi):
    overhead = sky(model, sun_at(azimuth, elevation), dni, dhi, EXTRA)
    closed = dni * max(np.sin(np.radians(elevation)), 0.0) + dhi
    assert overhead.ghi_w_m2 == pytest.approx(closed)
    assert overhead.irradiance_on(UP) == pytest.approx(closed, rel=1e-9, abs=1e-9)
    assert overhead.irradiance_on(-UP, albedo=0.3) == pytest.approx(0.3 * closed, rel=1e-9, abs=1e-9)


@given(st.floats(0.1, 90.0), azimuths, irradiances, irradiances, tilts, azimuths)
def test_the_isotropic_sky_is_equation_one_of_the_paper(elevation, sun_azimuth, dni, dhi, tilt, azimuth):
    cosine = irradiance.aoi_projection(tilt, azimuth, 90.0 - elevation, sun_azimuth)
    beta = np.radians(tilt)
    ghi = dni * np.sin(np.radians(elevation)) + dhi
    expected = dni * max(cosine, 0.0) + dhi * (1 + np.cos(beta)) / 2 + 0.2 * ghi * (1 - np.cos(beta)) / 2
    normal = normal_from_tilt(tilt, azimuth, LATITUDE)
    ours = plane_of_array(normal, sun_at(sun_azimuth, elevation), dni, dhi, EXTRA, model="isotropic")
    assert ours == pytest.approx(expected, abs=1e-6)


@given(models, st.floats(-90.0, 0.0), tilts, azimuths)
def test_below_the_horizon_there_is_no_beam_and_twilight_is_uniform(model, elevation, tilt, azimuth):
    normal = normal_from_tilt(tilt, azimuth, LATITUDE)
    received = plane_of_array(normal, sun_at(100.0, elevation), 900.0, 10.0, EXTRA, model=model, albedo=0.0)
    assert received == pytest.approx(10.0 * (1 + np.cos(np.radians(tilt))) / 2)


@given(models, st.floats(0.1, 89.0))
def test_a_plane_with_its_back_to_the_sun_gets_no_beam(model, elevation):
    overhead = sky(model, sun_at(180.0, elevation), 900.0, 100.0, EXTRA)
    assert overhead.beam_on(normal_from_tilt(90.0, 0.0, LATITUDE)) == 0.0


@given(models, azimuths, irradiances, irradiances)
def test_east_and_west_swap_when_the_sun_is_mirrored(model, azimuth, dni, dhi):
    east, west = normal_from_tilt(90.0, 90.0, LATITUDE), normal_from_tilt(90.0, 270.0, LATITUDE)
    here = sky(model, sun_at(azimuth, 20.0), dni, dhi, EXTRA)
    mirrored = sky(model, sun_at(-azimuth, 20.0), dni, dhi, EXTRA)
    assert here.irradiance_on(east) == pytest.approx(mirrored.irradiance_on(west), abs=1e-6)


def test_four_faces_over_many_instants_broadcast():
    faces = normal_from_tilt([90.0, 90.0, 90.0, 0.0], [90.0, 180.0, 270.0, 180.0], LATITUDE)
    elevation = np.linspace(-10.0, 60.0, 7)
    received = sky("perez1990", sun_at(150.0, elevation), 700.0, 90.0, EXTRA).irradiance_on(faces[:, None, :])
    assert received.shape == (4, 7)
    one = sky("perez1990", sun_at(150.0, elevation[5]), 700.0, 90.0, EXTRA).irradiance_on(faces[2])
    assert received[2, 5] == pytest.approx(one)


def test_negative_night_values_count_as_zero_and_nan_stays_nan():
    assert plane_of_array(UP, sun_at(0.0, -40.0), -3.0, -1.5, EXTRA) == 0.0
    assert np.isnan(plane_of_array(UP, sun_at(180.0, 40.0), np.nan, 100.0, EXTRA))
    assert np.isnan(plane_of_array(UP, sun_at(180.0, 40.0), 500.0, np.nan, EXTRA))


def test_an_unknown_model_is_refused_by_name():
    with pytest.raises(ValueError, match=r"no sky model 'perez'; choose one of isotropic, haydavies, perez1990"):
        sky("perez", UP, 0.0, 0.0, EXTRA)


@pytest.mark.parametrize("model", SKY_MODELS)
def test_the_beam_on_a_plane_includes_circumsolar_light_and_is_zero_from_behind(model):
    sun = sun_at(180.0, 30.0)[None, :]
    light = sky(model, sun, np.array([700.0]), np.array([120.0]), np.array([EXTRA]))
    assert light.beam_on(sun) == pytest.approx(700.0 + light.circumsolar_w_m2)
    assert light.beam_on(-sun) == pytest.approx(0.0)
    assert light.beam_on(UP[None, :]) == pytest.approx((700.0 + light.circumsolar_w_m2) * 0.5)
    assert (light.circumsolar_w_m2[0] > 30.0) == (model != "isotropic")
