from functools import cache

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from sim_drivers.weather import GeneratedWeather, Noise
from solar.ephemeris import Site, extraterrestrial_dni, sun_direction, sun_position
from solar.skies.sky import plane_of_array

pytestmark = pytest.mark.slow

SIRTA = Site(48.717607, 2.209002, 156.0)
CAPE_TOWN = Site(-33.92, 18.42, 25.0)
KINDS = ("clear", "overcast", "variable", "broken")
DAY = 1665532800.0 + np.arange(0.0, 86400.0)  # 12 October 2022
FIELDS = ("ghi_w_m2", "dni_w_m2", "dhi_w_m2", "wind_speed_m_s", "temp_air_degc")


@cache
def day_of(kind, seed=1):
    return GeneratedWeather(kind, SIRTA, seed).at(DAY)


@pytest.mark.parametrize("kind", KINDS)
@settings(max_examples=25)
@given(st.integers(0, 2**40), st.lists(st.floats(0.0, 2.5e9), min_size=1, max_size=5))
def test_an_instants_weather_does_not_depend_on_chunks_or_order(kind, seed, instants):
    weather = GeneratedWeather(kind, SIRTA, seed)
    together = weather.at(np.array(instants))
    for position in reversed(range(len(instants))):
        alone = GeneratedWeather(kind, SIRTA, seed).at(np.array([instants[position]]))
        for field in FIELDS:
            assert getattr(alone, field)[0] == pytest.approx(getattr(together, field)[position], abs=1e-4)


@pytest.mark.parametrize("kind", KINDS)
def test_the_same_seed_gives_the_same_day_and_another_seed_another(kind):
    first, again, other = day_of(kind), GeneratedWeather(kind, SIRTA, 1).at(DAY), day_of(kind, seed=2)
    for field in FIELDS:
        assert np.array_equal(getattr(first, field), getattr(again, field))
    for field in ("ghi_w_m2", "wind_speed_m_s", "temp_air_degc"):
        assert not np.array_equal(getattr(first, field), getattr(other, field))


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("site", [SIRTA, CAPE_TOWN])
def test_generated_weather_is_finite_ghi_is_beam_plus_diffuse_and_the_night_is_dark(kind, site):
    weather = GeneratedWeather(kind, site, 3)
    now, sun = weather.at(DAY), sun_position(DAY, *site)
    for field in FIELDS:
        assert np.isfinite(getattr(now, field)).all()
    for field in FIELDS[:4]:
        assert (getattr(now, field) >= 0.0).all()
    night = sun.elevation_deg <= 0.0
    assert night.any()
    assert now.ghi_w_m2[night].max() == 0.0
    assert now.dni_w_m2[night].max() == 0.0
    beam = now.dni_w_m2 * np.maximum(np.sin(np.radians(sun.elevation_deg)), 0.0)
    assert now.ghi_w_m2 == pytest.approx(beam + now.dhi_w_m2)
    assert weather.covers(DAY).all()


def test_a_clear_day_is_mostly_beam_and_smooth():
    for seed in range(5):
        clear = day_of("clear", seed)
        assert 0.1 < clear.dhi_w_m2.sum() / clear.ghi_w_m2.sum() < 0.35
        assert 600.0 < clear.dni_w_m2.max() < 1000.0
        assert np.abs(np.diff(clear.dni_w_m2)).max() < 1.0


def test_an_overcast_day_has_no_beam_and_a_tenth_to_a_third_of_the_clear_light():
    for seed in range(5):
        clear, overcast = day_of("clear", seed), day_of("overcast", seed)
        assert overcast.dni_w_m2.max() == 0.0
        light = clear.ghi_w_m2 > 1.0
        share = overcast.dhi_w_m2[light] / clear.ghi_w_m2[light]
        assert share.min() >= 0.1
        assert share.max() <= 0.35
        assert np.abs(np.diff(overcast.dhi_w_m2)).max() < 1.0


def test_a_variable_day_has_clear_thick_and_broken_spells_with_ramps_of_seconds():
    noon = slice(8 * 3600, 16 * 3600)
    for seed in range(5):
        clear, variable = day_of("clear", seed), day_of("variable", seed)
        beam = variable.dni_w_m2[noon] / clear.dni_w_m2[noon]
        assert 0.15 < np.mean(beam > 0.99) < 0.85
        assert 0.15 < np.mean(beam < 0.01) < 0.85
        assert longest_run(beam > 0.99) > 600
        assert longest_run(beam < 0.01) > 600
        crossings = np.count_nonzero(np.diff(beam > 0.5))
        assert 6 <= crossings <= 200
        # Each second takes at most half of the beam: a cloud's edge takes two seconds or more to pass over the sun.
        assert np.abs(np.diff(beam)).max() < 0.5
        assert np.mean(np.abs(np.diff(beam)) > 0.02) > 0.001


def test_cloud_edges_lift_irradiance_towards_the_sun_above_1000_w_m2_and_above_a_clear_sky():
    sun = sun_direction(DAY, *SIRTA)

    def towards_sun(now):
        return plane_of_array(sun, sun, now.dni_w_m2, now.dhi_w_m2, extraterrestrial_dni(DAY)).max()

    for seed in range(5):
        lifted = towards_sun(day_of("variable", seed))
        assert lifted > 1000.0
        assert lifted > 1.03 * towards_sun(day_of("clear", seed))


@pytest.mark.parametrize("kind", KINDS)
def test_wind_is_gusty_but_smooth_and_temperature_fits_the_season(kind):
    now = day_of(kind)
    assert now.wind_speed_m_s.min() > 0.5
    assert now.wind_speed_m_s.max() < 10.0
    assert np.ptp(now.wind_speed_m_s) > 1.0
    assert np.abs(np.diff(now.wind_speed_m_s)).max() < 0.5
    year = 1640995200.0 + np.arange(0.0, 365 * 86400.0, 4 * 3600.0)
    for site, warm in ((SIRTA, 6), (CAPE_TOWN, 0)):
        months = GeneratedWeather(kind, site, 1).at(year).temp_air_degc[: 12 * 180].reshape(12, 180).mean(axis=1)
        assert -5.0 < months.min() < months.max() < 35.0
        assert months[warm] > months[(warm + 6) % 12] + 5.0


@given(st.integers(0, 2**63 - 1))
def test_noise_is_uniform_over_the_unit_interval_and_differs_by_name_and_seed(seed):
    index = np.arange(-2000, 2000)
    numbers = Noise(seed).uniform("a", index)
    assert numbers.min() >= 0.0
    assert numbers.max() < 1.0
    assert abs(numbers.mean() - 0.5) < 0.05
    assert abs(np.corrcoef(numbers[:-1], numbers[1:])[0, 1]) < 0.1
    assert abs(np.corrcoef(numbers, Noise(seed).uniform("b", index))[0, 1]) < 0.1
    assert abs(np.corrcoef(numbers, Noise(seed ^ 1).uniform("a", index))[0, 1]) < 0.1


def test_an_unknown_kind_is_refused_by_name():
    with pytest.raises(ValueError, match="no weather 'rainy'; choose one of clear, overcast, variable, broken"):
        GeneratedWeather("rainy", SIRTA, 1)


def longest_run(flags):
    edges = np.flatnonzero(np.diff(np.concatenate(([0], flags.astype(np.int8), [0]))))
    return int((edges[1::2] - edges[::2]).max(initial=0))


def test_broken_cloud_comes_and_goes_as_measured():
    minutes = 1648771200.0 + np.arange(0.0, 60 * 86400.0, 60.0)
    clear, now = (GeneratedWeather(kind, SIRTA, 1).at(minutes) for kind in ("clear", "broken"))
    day = sun_position(minutes, *SIRTA).elevation_deg > 10.0
    beam = (now.dni_w_m2 / np.maximum(clear.dni_w_m2, 1.0))[day]
    diffuse = (now.dhi_w_m2 / np.maximum(clear.ghi_w_m2, 1.0))[day]
    assert np.mean(beam < 0.02) == pytest.approx(0.47, abs=0.08)
    assert np.mean(beam < 0.7) == pytest.approx(0.72, abs=0.08)
    assert np.mean(diffuse[beam < 0.02]) == pytest.approx(0.36, abs=0.03)
    assert np.mean(diffuse[beam >= 0.7]) == pytest.approx(0.32, abs=0.04)
    shines = now.dni_w_m2[day] > 120.0
    assert np.mean(shines[1:] != shines[:-1]) * 60.0 == pytest.approx(5.5, abs=1.5)
