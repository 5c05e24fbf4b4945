from datetime import UTC, datetime

import numpy as np
import pytest

from solar import gain
from solar.calibration.selection import clear_sky_ghi
from solar.ephemeris import Site, sun_position
from solar.gain import real_sky

DAY_S = 86400.0


def series_of_day(latitude, n, dni, dhi):
    site = Site(latitude, 0.0, 0.0)
    year = real_sky.year_instants(0.0, 60.0)
    instants = real_sky.daylight(site, year[(n - 1) * 1440 : n * 1440])
    constant = np.ones(instants.size)
    return real_sky.sky_series(site, instants, dni * constant, dhi * constant, "isotropic")


# At the solstices Cooper's declination is the true one, and only refraction is left between the two.
@pytest.mark.parametrize("n", [172, 355])
@pytest.mark.parametrize("deviation", [0.0, 20.0])
@pytest.mark.parametrize(("latitude", "tilt"), [(48.7, 35.0), (-33.0, -35.0), (10.0, 40.0)])
def test_without_an_atmosphere_the_real_sky_has_the_ratios_of_the_theory(latitude, tilt, deviation, n):
    series = series_of_day(latitude, n, 1000.0, 0.0)
    assert (series.day == n).all()
    dual = real_sky.dual_irradiance(series, albedo=0.0).sum()
    static = real_sky.static_irradiance(series, tilt, deviation, albedo=0.0).sum()
    vertical = real_sky.vertical_irradiance(series, tilt, albedo=0.0).sum()
    horizontal = real_sky.horizontal_irradiance(series, tilt, deviation, albedo=0.0).sum()
    assert dual / static == pytest.approx(float(gain.k_ds(latitude, tilt, n, deviation)), rel=0.01)
    assert dual / vertical == pytest.approx(float(gain.k_dv(latitude, tilt, n)), rel=0.01)
    # The theory's horizontal axis counts light on its back as negative: it loses a little more when the sun is low.
    theory = float(gain.k_dh(latitude, tilt, n, deviation))
    assert theory * 0.96 < dual / horizontal < theory * 1.01


def test_under_a_uniform_cloud_a_flat_panel_beats_every_tracker():
    series = series_of_day(48.7, 100, 0.0, 200.0)
    flat = real_sky.static_irradiance(series, 0.0, albedo=0.0).sum()
    assert flat == pytest.approx(200.0 * series.day.size)
    assert real_sky.dual_irradiance(series, albedo=0.0).sum() < 0.8 * flat
    assert real_sky.vertical_irradiance(series, 60.0, albedo=0.0).sum() == pytest.approx(0.75 * flat)


def test_tilts_broadcast_against_instants():
    series = series_of_day(48.7, 100, 800.0, 100.0)
    tilts, deviations = np.array([[10.0], [40.0]]), np.array([0.0, 20.0, 40.0])
    assert real_sky.static_irradiance(series, tilts, deviations).shape == (2, 3, series.day.size)
    assert real_sky.horizontal_irradiance(series, tilts, deviations).shape == (2, 3, series.day.size)
    one = real_sky.horizontal_irradiance(series, 40.0, 20.0)
    assert real_sky.horizontal_irradiance(series, tilts, deviations)[1, 1] == pytest.approx(one)


def test_a_panel_to_the_east_has_its_energy_in_the_morning():
    series = series_of_day(48.7, 100, 800.0, 0.0)
    east = real_sky.static_irradiance(series, 60.0, 90.0, albedo=0.0)
    half = east.size // 2
    assert east[:half].sum() > 3.0 * east[half:].sum()


def test_a_clear_sky_is_bright_at_noon_and_its_best_tilt_flatter_than_the_theorys():
    site = Site(48.7, 2.2, 0.0)
    instants = real_sky.daylight(site, real_sky.year_instants(2.2, 1800.0))
    _, dni, dhi = clear_sky_ghi(site, instants)
    assert 850.0 < dni.max() < 1050.0
    assert 50.0 < dhi.max() < 200.0
    series = real_sky.sky_series(site, instants, dni, dhi)
    best = real_sky.best_tilt_vertical_sky(series, 0.01)
    assert best.low_deg < best.best_deg < best.high_deg
    assert 55.0 < best.best_deg < float(gain.best_tilt_vertical(48.7).tilt_deg)
    top = real_sky.vertical_irradiance(series, best.best_deg).sum()
    for edge in (best.low_deg, best.high_deg):
        assert real_sky.vertical_irradiance(series, edge).sum() / top == pytest.approx(0.99, abs=2e-4)


def test_instants_are_the_middles_of_365_solar_days():
    instants = real_sky.year_instants(90.0, 3600.0)
    assert instants.size == 365 * 24
    # Solar midnight at 90 deg East is 18 h UTC of the day before.
    assert datetime.fromtimestamp(instants[0], UTC) == datetime(2022, 12, 31, 18, 30, tzinfo=UTC)


def test_polar_night_leaves_no_instants_of_daylight():
    site = Site(80.0, 0.0, 0.0)
    assert real_sky.daylight(site, real_sky.year_instants(0.0, 3600.0)[:240]).size == 0


@pytest.mark.parametrize(("latitude", "tilt"), [(48.7, 35.0), (-33.0, -35.0)])
def test_the_horizontal_axis_turns_by_the_elevation_across_its_azimuth(latitude, tilt):
    series = series_of_day(latitude, 172, 1000.0, 0.0)
    azimuth, elevation = np.radians(series.azimuth_deg), np.radians(series.elevation_deg)
    east, north, up = np.sin(azimuth) * np.cos(elevation), np.cos(azimuth) * np.cos(elevation), np.sin(elevation)
    b, turned = np.radians(tilt), np.radians(40.0)
    # Maiga (2022), (28), with the true azimuth; across the axis the panel is on the sun's side of noon.
    across = np.where(east > 0.0, 1.0, -1.0) * (np.cos(turned) * east + np.sin(turned) * north)
    along = np.cos(turned) * north - np.sin(turned) * east
    cosine = np.cos(elevation) * across + up * (np.cos(b) * up - np.sin(b) * along)
    received = real_sky.horizontal_irradiance(series, tilt, 40.0, albedo=0.0)
    assert received == pytest.approx(1000.0 * np.maximum(cosine, 0.0), abs=1e-6)


@pytest.mark.parametrize("altitude_m", [0.0, 2000.0])
@pytest.mark.parametrize("n", [4, 185])
def test_the_clear_beam_is_that_of_ineichen_2008_by_hand(altitude_m, n):
    site = Site(35.0, 0.0, altitude_m)
    noon = real_sky.year_instants(0.0, 3600.0)[(n - 1) * 24 + 12 :][:1]
    # Aerosol 0.1 at 700 nm, 1.5 cm of water, the standard atmosphere's pressure; the distance of the sun by Spencer.
    aod, ln_w, ln_p = 0.1, np.log(1.5), np.log((1.0 - 2.25577e-5 * altitude_m) ** 5.25588)
    turn = 2.0 * np.pi * (n - 1) / 365.0
    extra = 1366.1 * (
        1.00011
        + 0.034221 * np.cos(turn)
        + 0.00128 * np.sin(turn)
        + 0.000719 * np.cos(2 * turn)
        + 7.7e-5 * np.sin(2 * turn)
    )
    above = extra * (0.12 * 1.5**0.56 * aod**2 + 0.97 * 1.5**0.032 * aod + 1.08 * 1.5**0.0051 + 0.071 * ln_p)
    depth = (1.82 + 0.056 * ln_w + 0.0071 * ln_w**2) * aod + 0.33 + 0.045 * ln_w + 0.0096 * ln_w**2
    depth += (0.0089 * 1.5 + 0.13) * ln_p
    power = (0.00925 * aod**2 + 0.0148 * aod - 0.0172) * ln_w - 0.7565 * aod**2 + 0.5057 * aod + 0.4557
    sine = np.sin(np.radians(sun_position(noon, *site).elevation_deg))
    _, dni, _ = clear_sky_ghi(site, noon)
    assert dni == pytest.approx(above * np.exp(-depth / sine**power), rel=2e-3)


def test_days_are_the_solar_days_of_the_site():
    site = Site(30.0, 150.0, 0.0)
    # Morning there is evening of the day before in Greenwich.
    instants = real_sky.daylight(site, real_sky.year_instants(150.0, 3600.0)[7 * 24 : 8 * 24])
    nothing = np.zeros(instants.size)
    series = real_sky.sky_series(site, instants, nothing, nothing, "isotropic")
    assert instants.size > 8
    assert set(series.day.tolist()) == {8}


def test_under_a_beam_alone_the_best_tilt_is_that_of_the_sums_and_1_percent_allows_8_degrees():
    series = series_of_day(48.7, 172, 1000.0, 0.0)
    elevation = np.radians(series.elevation_deg)
    expected = np.degrees(np.arctan2(np.cos(elevation).sum(), np.sin(elevation).sum()))
    best = real_sky.best_tilt_vertical_sky(series, 0.01, albedo=0.0)
    assert best.best_deg == pytest.approx(expected, abs=1e-3)
    assert (best.best_deg - best.low_deg, best.high_deg - best.best_deg) == pytest.approx((8.11, 8.11), abs=0.02)


def test_under_a_uniform_cloud_flat_is_best():
    best = real_sky.best_tilt_vertical_sky(series_of_day(48.7, 100, 0.0, 200.0), 0.01, albedo=0.0)
    # (1 + cos tilt)/2 = 0.99.
    assert best == pytest.approx((0.0, 0.0, np.degrees(np.arccos(0.98))), abs=0.02)


def test_with_the_sun_on_the_horizon_the_best_tilt_is_upright_and_the_search_ends_at_90_degrees():
    series = series_of_day(66.9, 355, 1000.0, 0.0)
    assert series.elevation_deg.max() < 0.3
    best = real_sky.best_tilt_vertical_sky(series, 0.01, albedo=0.0)
    assert 89.7 < best.best_deg < 90.0
    assert best.high_deg == 90.0


def test_a_panel_without_a_given_azimuth_faces_the_equator():
    series = series_of_day(48.7, 100, 800.0, 100.0)
    for device in (real_sky.static_irradiance, real_sky.horizontal_irradiance):
        np.testing.assert_array_equal(device(series, 40.0), device(series, 40.0, 0.0))
