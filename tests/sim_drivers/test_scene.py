from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from sim_drivers.scene import PERFECT_SENSORS, FaceGeometry, Scene, SensorModel, default_faces
from sim_drivers.weather import GeneratedWeather, WeatherError
from sim_drivers.weather_files import MeasuredWeather, load_weather
from solar.ephemeris import Site, extraterrestrial_dni, sun_day, sun_direction, sun_position
from solar.frames import Limits, angles_from_direction, separation_deg
from solar.skies.sky import SKY_MODELS, plane_of_array

pytestmark = pytest.mark.slow

SIRTA = Site(48.717607, 2.209002, 156.0)
CAPE_TOWN = Site(-33.92, 18.42, 25.0)
LYNGBY = Site(55.79064, 12.52505, 50.0)
MIDNIGHT = 1665532800.0  # 12 October 2022
EAST, SOUTH, WEST, ZENITH = range(4)
CLEAR_DAY, MIXED_DAY = 1465084800.0, 1458000000.0  # 5 June and 15 March 2016


def scene(kind="clear", site=SIRTA, seed=1, sensors=PERFECT_SENSORS, **options):
    return Scene(site, GeneratedWeather(kind, site, seed), seed=seed, sensors=sensors, **options)


def voltages(a_scene, utc_s):
    return [a_scene.sensor_voltage(face, utc_s) for face in range(4)]


@given(st.floats(0.0, 86400.0), st.sampled_from(["clear", "overcast", "variable"]), st.sampled_from(SKY_MODELS))
def test_perfect_sensors_give_a_tenth_of_a_millivolt_per_watt(offset, kind, model):
    here = scene(kind, sky_model=model)
    truth = here.irradiances(MIDNIGHT + offset)
    assert voltages(here, MIDNIGHT + offset) == pytest.approx([1e-4 * value for value in truth])
    state = here.sky_state(MIDNIGHT + offset)
    assert truth.zenith_w_m2 == pytest.approx(state.ghi_w_m2)


@pytest.mark.parametrize("offset", [0.0, 30000.0, 43200.25, 46799.5, 61000.0])
def test_sun_irradiance_and_wind_of_the_scene_are_those_of_its_weather_and_site(offset):
    here, instant = scene("variable", albedo=0.3), np.array([MIDNIGHT + offset])
    weather = GeneratedWeather("variable", SIRTA, 1).at(instant)
    sun, direction = sun_position(MIDNIGHT + offset, *SIRTA), sun_direction(instant, *SIRTA)
    state = here.sky_state(MIDNIGHT + offset)
    assert here.sun_angles(MIDNIGHT + offset) == pytest.approx((sun.azimuth_deg, sun.elevation_deg), abs=1e-4)
    assert state.dni_w_m2 == pytest.approx(weather.dni_w_m2[0], abs=0.5)
    assert state.dhi_w_m2 == pytest.approx(weather.dhi_w_m2[0], abs=0.5)
    assert state.ghi_w_m2 == pytest.approx(weather.ghi_w_m2[0], abs=0.5)
    facing = plane_of_array(
        direction, direction, weather.dni_w_m2, weather.dhi_w_m2, extraterrestrial_dni(instant), albedo=0.3
    )
    a_deg, b_deg = angles_from_direction(direction[0])
    assert here.plane_of_array(a_deg, b_deg, MIDNIGHT + offset) == pytest.approx(facing[0], abs=1.0)
    assert here.wind_speed(MIDNIGHT + offset) == pytest.approx(weather.wind_speed_m_s[0], abs=0.05)


def test_the_module_receives_ghi_when_flat_and_the_irradiance_of_a_face_when_it_looks_its_way():
    here, noon = scene(), MIDNIGHT + 40000.0
    truth = here.irradiances(noon)
    assert here.plane_of_array(0.0, 90.0, noon) == pytest.approx(truth.zenith_w_m2)
    assert here.plane_of_array(0.0, 0.0, noon) == pytest.approx(truth.south_w_m2)
    assert here.plane_of_array(-90.0, 90.0, noon) == pytest.approx(truth.east_w_m2)
    assert here.plane_of_array(90.0, 90.0, noon) == pytest.approx(truth.west_w_m2)


@pytest.mark.parametrize("site", [SIRTA, CAPE_TOWN])
def test_the_east_face_is_bright_in_the_morning_west_in_the_evening_and_the_equator_face_at_noon(site):
    here, day = scene(site=site), sun_day(MIDNIGHT + 43200.0, *site)
    morning, evening = here.irradiances(day.noon_utc_s - 12000.0), here.irradiances(day.noon_utc_s + 12000.0)
    noon = here.irradiances(day.noon_utc_s)
    assert morning.east_w_m2 > 4.0 * morning.west_w_m2
    assert evening.west_w_m2 > 4.0 * evening.east_w_m2
    assert noon.south_w_m2 > 2.0 * noon.east_w_m2


def test_faces_can_be_turned_and_a_scene_needs_four_of_them():
    north = FaceGeometry(0.0, 90.0)
    east, _, west, zenith = default_faces(SIRTA.latitude_deg)
    turned, noon = scene(faces=(east, north, west, zenith)), MIDNIGHT + 42300.0
    assert turned.irradiances(noon).south_w_m2 < 0.3 * scene().irradiances(noon).south_w_m2
    with pytest.raises(ValueError, match=r"four faces \(east, south, west, zenith\), not 3"):
        scene(faces=(east, west, zenith))


def test_the_scene_does_not_depend_on_the_order_in_which_instants_are_asked():
    instants = MIDNIGHT + np.random.default_rng(2).uniform(0.0, 86400.0, 40)
    jumping, steady = scene("variable"), scene("variable")
    shuffled = {instant: jumping.irradiances(instant) for instant in instants}
    for instant in np.sort(instants):
        assert steady.irradiances(instant) == shuffled[instant]


def test_sensor_readings_repeat_with_the_same_seed_and_differ_with_another():
    def readings(seed):
        here = Scene(SIRTA, GeneratedWeather("variable", SIRTA, 1), seed=seed)
        return [here.sensor_voltage(step % 4, MIDNIGHT + 5.0 * step) for step in range(9000)]

    assert readings(1) == readings(1)
    assert readings(1) != readings(2)


def test_noise_has_the_deviation_that_was_asked_for_and_no_bias():
    here = scene(sensors=replace(PERFECT_SENSORS, noise_mv=0.02))
    dark_mv = 1e3 * np.array([here.sensor_voltage(EAST, MIDNIGHT) for _ in range(20000)])
    assert dark_mv.std() == pytest.approx(0.02, rel=0.03)
    assert abs(dark_mv.mean()) < 0.001


def test_each_sensor_keeps_a_gain_error_of_its_own():
    noon = MIDNIGHT + 43200.0
    gains = []
    for seed in range(60):
        here = Scene(
            SIRTA,
            GeneratedWeather("overcast", SIRTA, 1),
            seed=seed,
            sensors=replace(PERFECT_SENSORS, gain_error=0.01),
        )
        gains.append(np.array(voltages(here, noon)) / np.array(here.irradiances(noon)) * 1e4)
        later = np.array(voltages(here, noon + 1800.0)) / np.array(here.irradiances(noon + 1800.0)) * 1e4
        assert later == pytest.approx(gains[-1])
    assert np.std(gains) == pytest.approx(0.01, rel=0.2)
    assert np.mean(gains) == pytest.approx(1.0, abs=0.003)
    assert np.abs(np.corrcoef(np.transpose(gains)) - np.eye(4)).max() < 0.5


def test_the_cosine_error_is_below_one_per_cent_up_to_80_degrees_and_grows_beyond():
    incidence_deg = np.arange(0.0, 90.0, 0.5)
    missing = 1.0 - SensorModel().response(np.cos(np.radians(incidence_deg)))
    assert missing[0] == pytest.approx(0.0)
    assert np.all(np.diff(missing) >= 0.0)
    assert missing[incidence_deg <= 80.0].max() < 0.01
    assert missing[incidence_deg == 85.0][0] > 0.03
    assert missing.max() < 0.15


def test_the_cosine_error_takes_from_the_beam_only():
    noon = MIDNIGHT + 42300.0
    bent = replace(PERFECT_SENSORS, cosine_error=0.1)
    overcast, clear = scene("overcast", sensors=bent, sky_model="isotropic"), scene(sensors=bent)
    assert voltages(overcast, noon) == pytest.approx([1e-4 * value for value in overcast.irradiances(noon)])
    # Near noon the sun grazes the East and West faces: they miss much of what little beam reaches them.
    lost = 1.0 - np.array(voltages(clear, noon)) / (1e-4 * np.array(clear.irradiances(noon)))
    assert lost[ZENITH] == pytest.approx(0.1 * (56.2 / 80.0) ** 4, abs=0.006)
    assert lost.min() >= 0.0


def test_a_shade_or_a_broken_sensor_affects_one_face_until_it_is_removed():
    here, noon = scene(), MIDNIGHT + 43200.0
    whole, sound = here.irradiances(noon), voltages(here, noon)
    here.shade(SOUTH, 0.25)
    here.break_sensor(WEST, stuck_at_v=0.3)
    here.break_sensor(EAST)
    assert here.irradiances(noon).south_w_m2 == pytest.approx(0.25 * whole.south_w_m2)
    assert here.irradiances(noon).west_w_m2 == whole.west_w_m2
    assert voltages(here, noon) == pytest.approx([0.0, 0.25 * sound[SOUTH], 0.3, sound[ZENITH]])
    here.shade(SOUTH, 1.0)
    here.repair_sensor(WEST)
    here.repair_sensor(EAST)
    assert voltages(here, noon) == sound
    for factor in (-0.1, 1.1, np.nan):
        with pytest.raises(ValueError, match="share of 0 to 1"):
            here.shade(SOUTH, factor)


def measured_minutes(count, wind):
    instants = MIDNIGHT + 43200.0 + 60.0 * np.arange(count)
    light = np.full(count, 100.0)
    values = {"ghi": light, "dni": light, "dhi": light, "wind_speed": np.full(count, wind), "temp_air": light}
    return instants, values


def test_wind_speed_is_none_where_the_weather_has_no_wind():
    for wind, expected in ((np.nan, None), (4.0, 4.0)):
        instants, values = measured_minutes(90, wind)
        here = Scene(SIRTA, MeasuredWeather("it", instants, values))
        assert here.wind_speed(float(instants[3])) == expected


def test_a_gap_or_the_end_of_the_weather_stops_the_scene_with_its_reason_and_not_earlier():
    instants, values = measured_minutes(180, 4.0)
    kept = (np.arange(180) < 40) | (np.arange(180) > 110)
    values = {name: value[kept] for name, value in values.items()}
    here = Scene(SIRTA, MeasuredWeather("it", instants[kept] + 0.5, values), sensors=PERFECT_SENSORS)
    begin, end = instants[39] + 0.5, instants[111] + 0.5
    questions = (
        lambda utc_s: here.sensor_voltage(ZENITH, utc_s),
        lambda utc_s: here.irradiances(utc_s).zenith_w_m2,
        lambda utc_s: here.plane_of_array(0.0, 90.0, utc_s),
        lambda utc_s: here.sky_state(utc_s).ghi_w_m2,
    )
    for ask in questions:
        for edge in (begin, end, instants[0] + 0.5, instants[-1] + 0.5):
            assert ask(edge) > 0.0
        for inside in (begin + 0.01, begin + 1800.0, end - 0.01):
            with pytest.raises(WeatherError, match=r"gap from 2022-10-12T12:39:00Z to 2022-10-12T13:51:00Z"):
                ask(inside)
        for outside in (instants[0] + 0.49, instants[-1] + 0.51):
            with pytest.raises(WeatherError, match=r"it runs from 2022-10-12T12:00:00Z to 2022-10-12T14:59:00Z"):
                ask(outside)
        assert ask(MIDNIGHT) == 0.0, "a night needs no weather to be dark"


def sun_vectors(here, instants, *, albedo):
    """Equation (11) with DHI = 2 I_min - albedo I_Z, on each minute's true irradiances: vectors (n, 3)."""
    east, south, west, zenith = np.array([here.irradiances(instant) for instant in instants]).T
    shaded = np.minimum(east, west)
    return np.stack([south - shaded, east - west, zenith - (2.0 * shaded - albedo * zenith)], axis=-1)


def clear_day_errors(measured, model, *, albedo=0.2):
    weather = load_weather(measured / "dtu_lyngby_2016" / "2016-06.csv.gz")
    here = Scene(LYNGBY, weather, sky_model=model, albedo=0.2, sensors=PERFECT_SENSORS)
    instants = CLEAR_DAY + np.arange(0.0, 86400.0, 60.0)
    sun, direction = sun_position(instants, *LYNGBY), sun_direction(instants, *LYNGBY)
    # North of the East-West line the sun is behind three vertical faces at once, and no cube can tell how far.
    seen = (sun.elevation_deg > 15.0) & (direction[:, 0] > 0.0)
    return separation_deg(sun_vectors(here, instants[seen], albedo=albedo), direction[seen])


def test_on_the_measured_clear_day_the_cube_finds_the_sun_within_3_degrees(measured):
    errors = clear_day_errors(measured, "perez1990")
    assert errors.size > 500
    assert errors.mean() < 2.0
    assert np.mean(errors < 3.0) > 0.99
    assert errors.max() < 3.2


@pytest.mark.parametrize("model", ["isotropic", "haydavies"])
def test_without_a_horizon_band_the_cube_finds_the_sun_exactly(measured, model):
    assert clear_day_errors(measured, model).max() < 1e-6


def test_without_the_albedo_term_the_cube_misses_the_sun_by_several_degrees(measured):
    assert clear_day_errors(measured, "perez1990", albedo=0.0).mean() > 6.0


def test_on_the_measured_mixed_day_facing_the_sun_wins_in_sunshine_and_flat_wins_under_cloud(measured):
    weather = load_weather(measured / "dtu_lyngby_2016" / "2016-03.csv.gz")
    here = Scene(LYNGBY, weather, sensors=PERFECT_SENSORS)
    sunny, cloudy = [], []
    for instant in MIXED_DAY + np.arange(8 * 3600.0, 15 * 3600.0, 60.0):
        state = here.sky_state(instant)
        facing = Limits().clip(*map(float, angles_from_direction(sun_direction(instant, *LYNGBY))))
        gain = here.plane_of_array(*facing, instant) / here.plane_of_array(0.0, 90.0, instant)
        if state.dni_w_m2 > 300.0:
            sunny.append(gain)
        elif state.dni_w_m2 < 1.0:
            cloudy.append(gain)
    assert len(sunny) > 10
    assert len(cloudy) > 60
    assert min(sunny) > 1.2
    assert np.mean(cloudy) < 0.95
