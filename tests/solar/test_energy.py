"""The benchmark's engine, and the law's claims on measured weather."""

import numpy as np
import pytest

from daemon.studies.energy.benchmark import read_minute_weather
from solar.energy import (
    SKIES,
    Drive,
    arrange_daylight,
    best_possible,
    build_sky,
    face_irradiances,
    harvest,
    steer_fixed_tilt,
)
from solar.ephemeris import Site
from solar.frames import Limits, angles_within, normal_from_angles
from solar.laws import chronometric, mu_prime, optimal_live, sun_vector

pytestmark = pytest.mark.slow

LIMITS = Limits()
LYNGBY = Site(55.79064, 12.52505, 50.0)
IDEAL = Drive(np.inf, 0.0, 1)
DAY_S = 86400.0


def weather_of(dni, dhi, days=1, site=LYNGBY):
    utc_s = 1465084800.0 + 60.0 * np.arange(1440 * days)  # 2016-06-05
    return arrange_daylight(utc_s, np.full(utc_s.size, dni), np.full(utc_s.size, dhi), site)


def steered(law, weather, faces=None):
    return law.steer(law.SETTINGS(), weather, faces, LIMITS)


@pytest.fixture(scope="module")
def january_and_june(measured):
    files = [measured / "dtu_lyngby_2016" / f"2016-{month}.csv.gz" for month in ("01", "06")]
    utc_s, dni, dhi, warnings, simulated = read_minute_weather(files, LYNGBY)
    # The warning tells of January's gap by day and of the months between; they count as missing.
    (warning,) = warnings
    assert "1574.2 h of daylight are missing, the first after 2016-01-" in warning
    assert not simulated
    return arrange_daylight(utc_s, dni, dhi, LYNGBY)


def test_the_chronometric_tracker_harvests_dni_by_incidence_and_its_share_of_an_even_sky():
    weather = weather_of(800.0, 100.0)
    light = build_sky(weather, "isotropic")
    result = harvest(weather, light, 0.0, IDEAL, steered(chronometric, weather))
    normals = normal_from_angles(*angles_within(weather.sun, LIMITS))
    beam = 800.0 * np.maximum(np.sum(normals * weather.sun, axis=1), 0.0)
    sky = 100.0 * (1.0 + normals[:, 2]) / 2.0
    assert result.energy_kwh_m2[0] == pytest.approx((beam + sky).sum() / 60e3)


def test_a_flat_plane_receives_the_global_irradiance_and_travels_nowhere():
    weather = weather_of(500.0, 100.0)
    light = build_sky(weather, "perez1990")
    result = harvest(weather, light, 0.2, IDEAL, steer_fixed_tilt(weather, 0.0))
    ghi = (500.0 * weather.sun[:, 2] + 100.0).sum() / 60e3
    assert result.energy_kwh_m2[0] == pytest.approx(ghi)
    assert result.travel_deg[0] == result.moves[0] == 0


def test_travel_counts_both_axes_and_takes_time():
    weather = weather_of(0.0, 100.0)
    light = build_sky(weather, "isotropic")

    def steer(step, a, b):
        return (np.array([40.0]), np.array([60.0])) if step >= 600 else (a, b)

    fast, slow = (harvest(weather, light, 0.0, Drive(speed, 0.0), steer) for speed in (np.inf, 0.01))
    assert fast.travel_deg[0] == pytest.approx(70.0)
    assert slow.travel_deg[0] == pytest.approx(70.0)
    assert fast.return_deg[0] == pytest.approx(70.0)
    assert fast.moves[0] == slow.moves[0] == 1
    assert slow.energy_kwh_m2[0] > fast.energy_kwh_m2[0]


def test_days_are_solar_days_wherever_the_site_lies():
    for longitude in (-170.0, -60.0, 0.0, 90.0, 175.0):
        weather = weather_of(500.0, 100.0, days=3, site=Site(40.0, longitude, 0.0))
        counts = np.bincount(weather.day)
        assert weather.shape[0] < 1000
        assert counts[1:-1].min() > 800


def test_weather_without_daylight_and_an_unknown_sky_model_are_refused():
    with pytest.raises(ValueError, match="no record with the sun"):
        arrange_daylight(np.array([1465084800.0]), np.array([0.0]), np.array([0.0]), LYNGBY)
    with pytest.raises(ValueError, match="choose one of isotropic"):
        build_sky(weather_of(1.0, 1.0), "rainbow")


def test_day_types_follow_the_diffuse_fraction():
    for (dni, dhi), expected in {(800, 50): 0, (300, 150): 1, (30, 150): 2, (0, 100): 3}.items():
        assert weather_of(float(dni), float(dhi)).day_types()[0] == expected


@pytest.mark.parametrize("model", SKIES)
def test_no_law_harvests_more_than_the_best_possible(model):
    weather = weather_of(400.0, 200.0)
    light = build_sky(weather, model)
    best = weather.by_day(best_possible(weather, light, LIMITS, 0.2))
    faces = face_irradiances(light, 0.2)
    steers = [
        steered(chronometric, weather),
        steered(mu_prime, weather, faces),
        steered(sun_vector, weather, faces),
        steered(optimal_live, weather, faces),
    ]
    for steer in steers:
        assert (harvest(weather, light, 0.2, IDEAL, steer).energy_kwh_m2 <= best * 1.0001).all()


@pytest.mark.shared_data
@pytest.mark.parametrize("model", SKIES)
def test_on_measured_weather_the_optimal_law_takes_over_75_percent_of_the_possible_gain(january_and_june, model):
    weather = january_and_june
    light = build_sky(weather, model)
    faces = face_irradiances(light, 0.2)
    bound = weather.by_day(best_possible(weather, light, LIMITS, 0.2))
    sun = harvest(weather, light, 0.2, IDEAL, steered(chronometric, weather)).energy_kwh_m2
    paper = harvest(weather, light, 0.2, Drive(), steered(mu_prime, weather, faces))
    ours = harvest(weather, light, 0.2, Drive(), steered(optimal_live, weather, faces))
    share = (ours.energy_kwh_m2 - sun).sum() / (bound - sun).sum()
    assert share > 0.75
    assert ours.travel_deg.mean() + ours.return_deg.mean() < 650
    types = weather.day_types()
    for kind in range(4):
        assert ours.energy_kwh_m2[types == kind].sum() > paper.energy_kwh_m2[types == kind].sum()
    assert (ours.energy_kwh_m2[types == 0] > 0.999 * sun[types == 0]).all()


@pytest.mark.shared_data
def test_the_optimal_law_run_over_many_days_at_once_harvests_on_a_day_what_it_does_on_it_alone(january_and_june):
    weather = january_and_june
    light = build_sky(weather, "perez1990")
    faces = face_irradiances(light, 0.2)
    learned = optimal_live.learned_by_day(weather, faces)
    chosen = weather.day == 5
    alone = arrange_daylight(weather.utc_s[chosen], weather.dni_w_m2[chosen], weather.dhi_w_m2[chosen], LYNGBY)
    start = type(learned)(*(float(getattr(learned, name)[5]) for name in type(learned).__slots__))
    steer = optimal_live.steer(optimal_live.SETTINGS(), alone, faces[chosen], LIMITS, start)
    one = harvest(alone, build_sky(alone, "perez1990"), 0.2, Drive(), steer)
    steer = steered(optimal_live, weather, faces)
    many = harvest(weather, light, 0.2, Drive(), steer)
    assert one.energy_kwh_m2[0] == pytest.approx(many.energy_kwh_m2[5])
    assert one.travel_deg[0] == pytest.approx(many.travel_deg[5])
