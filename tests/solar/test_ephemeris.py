import numpy as np
import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pvlib.irradiance import get_extra_radiation
from pvlib.solarposition import get_solarposition
from scipy.optimize import brentq

from solar import ephemeris
from solar.ephemeris import (
    Site,
    SunDirection,
    SunElevation,
    extraterrestrial_dni,
    sun_day,
    sun_direction,
    sun_position,
)
from solar.frames import azimuth_from_direction, direction_from_azimuth, separation_deg

SIRTA = (48.717607, 2.209002, 156.0)
CAPE_TOWN = (-33.92, 18.42, 25.0)
TROMSO = (69.65, 18.96, 10.0)
FIJI = (-18.14, 178.44, 6.0)
ALTIPLANO = (0.0, -78.45, 3800.0)
SITES = (SIRTA, CAPE_TOWN, TROMSO, FIJI, ALTIPLANO)
# 1970 to 2050, where the polynomials for terrestrial time are valid.
UTC_S = st.floats(0.0, 2.5e9)


def utc(text: str) -> float:
    return pd.Timestamp(text, tz="UTC").timestamp()


@pytest.mark.parametrize("site", SITES)
def test_positions_agree_with_pvlib_at_any_time_of_eighty_years(site):
    instants = np.random.default_rng(1).uniform(0.0, 2.5e9, 2000)
    expected = get_solarposition(pd.to_datetime(instants, unit="s", utc=True), *site, delta_t=None)
    sun = sun_position(instants, *site)
    across = (sun.azimuth_deg - expected["azimuth"] + 180.0) % 360.0 - 180.0
    assert np.abs(across * np.cos(np.radians(sun.geometric_elevation_deg))).max() < 1e-5
    assert np.abs(sun.elevation_deg - expected["apparent_elevation"]).max() < 1e-5
    assert np.abs(sun.geometric_elevation_deg - expected["elevation"]).max() < 1e-5


@pytest.mark.parametrize("remembered", [0, 5, 1000])
def test_positions_of_whole_days_agree_with_pvlib_whatever_the_size_of_the_cache_of_days(monkeypatch, remembered):
    monkeypatch.setattr(ephemeris, "REMEMBERED_WHOLE_DAYS", remembered)
    monkeypatch.setattr(ephemeris, "_whole_days", {})
    begin_s = utc("2021-06-01")
    for first, last in ((4, 7), (5, 9), (2, 20), (3, 8), (3, 8)):
        instants = begin_s + np.arange(first * 86400.0, last * 86400.0, 1111.0)
        expected = get_solarposition(pd.to_datetime(instants, unit="s", utc=True), *SIRTA, delta_t=None)
        assert np.abs(sun_position(instants, *SIRTA).azimuth_deg - expected["azimuth"]).max() < 1e-4
        assert len(ephemeris._whole_days) <= remembered


def test_the_sun_position_of_the_example_of_reda_and_andreas_2004_is_reproduced():
    # Reda & Andreas (2004), appendix A.5: 17 October 2003, 12:30:30 at UTC-7; their pressure and temperature differ.
    sun = sun_position(utc("2003-10-17T19:30:30"), 39.742476, -105.1786, 1830.14)
    assert sun.geometric_elevation_deg == pytest.approx(90.0 - 50.12790, abs=2e-4)
    assert sun.azimuth_deg == pytest.approx(194.34024, abs=2e-4)


@given(UTC_S)
def test_one_instant_gives_floats_equal_to_those_of_an_array(instant):
    one, many = sun_position(instant, *SIRTA), sun_position(np.array([[instant, instant + 7200.0]]), *SIRTA)
    assert isinstance(one.azimuth_deg, float)
    assert many.elevation_deg.shape == (1, 2)
    assert one.elevation_deg == pytest.approx(many.elevation_deg[0, 0], abs=1e-9)
    assert one.azimuth_deg == pytest.approx(many.azimuth_deg[0, 0], abs=1e-7)


@pytest.mark.parametrize("site", SITES)
def test_the_sun_moves_evenly_through_whole_hours_midnight_and_the_wrap_of_right_ascension(site):
    # Right ascension wraps at the equinox, on 20 March at 3:06.
    instants = utc("2024-03-19T12:00:00") + np.arange(0.0, 1.5 * 86400.0, 10.0)
    sun = sun_position(instants, *site)
    # Without refraction, which near the horizon and below it changes by more than the sun moves.
    directions = direction_from_azimuth(sun.azimuth_deg, sun.geometric_elevation_deg, site[0])
    steps = separation_deg(directions[:-1], directions[1:])
    assert steps == pytest.approx(10.0 * 360.0 / 86400.0, abs=2e-5)


def test_by_day_the_apparent_sun_moves_evenly_through_whole_hours():
    equinox = utc("2024-03-20T00:00:00") + np.arange(0.0, 86400.0, 10.0)
    steps = separation_deg(sun_direction(equinox[:-1], *SIRTA), sun_direction(equinox[1:], *SIRTA))
    daylight = sun_position(equinox[:-1], *SIRTA).elevation_deg > 0.0
    assert np.all(np.abs(steps[daylight] - 10.0 * 360.0 / 86164.0) < 0.003)


@pytest.mark.parametrize("site", SITES)
def test_the_direction_is_the_unit_vector_of_azimuth_and_elevation(site):
    instants = utc("2022-10-12") + np.arange(0.0, 86400.0, 3600.0)
    sun, direction = sun_position(instants, *site), sun_direction(instants, *site)
    azimuth, elevation = azimuth_from_direction(direction, site[0])
    assert np.linalg.norm(direction, axis=-1) == pytest.approx(1.0)
    assert elevation == pytest.approx(sun.elevation_deg)
    assert azimuth == pytest.approx(sun.azimuth_deg)


def test_at_noon_the_sun_stands_on_the_equators_side_in_both_hemispheres():
    for site in (SIRTA, CAPE_TOWN):
        noon = sun_day(utc("2022-10-12T12:00"), *site).noon_utc_s
        south, east, up = sun_direction(noon, *site)
        assert south > 0.3
        assert east == pytest.approx(0.0, abs=1e-3)
        assert up > 0.0


def test_extraterrestrial_irradiance_agrees_with_pvlib_and_peaks_in_january():
    days = pd.date_range("2023-01-01", "2023-12-31", tz="UTC")
    seconds = (days - pd.Timestamp(0, tz="UTC")) / pd.Timedelta(seconds=1)
    ours = extraterrestrial_dni(seconds.to_numpy())
    assert ours == pytest.approx(get_extra_radiation(days, method="nrel").to_numpy(), rel=1e-5)
    assert int(np.argmax(ours)) < 10
    assert extraterrestrial_dni(float(seconds[0])).shape == ()


@pytest.mark.parametrize("site", [SIRTA, CAPE_TOWN, FIJI, ALTIPLANO])
@pytest.mark.parametrize("date", ["2022-10-12T00:10", "2022-02-11T12:00", "2022-11-03T23:50"])
def test_sunrise_noon_and_sunset_are_those_of_the_solar_day_around_the_instant(site, date):
    day = sun_day(utc(date), *site)
    limb = sun_position(np.array([day.sunrise_utc_s, day.sunset_utc_s]), *site).geometric_elevation_deg
    # Upper limb on the horizon: 34' of refraction and 16' of radius below it.
    assert limb == pytest.approx(-0.8333, abs=0.001)
    assert day.sunrise_utc_s < day.noon_utc_s < day.sunset_utc_s
    assert abs(day.noon_utc_s - utc(date)) < 12.3 * 3600.0
    near = day.noon_utc_s + np.linspace(-600.0, 600.0, 5)
    assert day.highest_elevation_deg == pytest.approx(sun_position(near, *site).elevation_deg.max(), abs=0.01)


@pytest.mark.parametrize("site", [(35.7, 139.7, 0.0), (61.2, -149.9, 0.0)])
@pytest.mark.parametrize("date", ["2026-03-20T12:00", "2026-06-21T12:00", "2026-09-21T12:00"])
def test_sunrise_and_sunset_are_true_to_the_second_far_from_greenwich_too(site, date):
    # Tokyo and Anchorage, where the first estimate is off by minutes around the equinoxes.
    day = sun_day(utc(date), *site)

    def above_deg(utc_s):
        return sun_position(utc_s, *site).geometric_elevation_deg + 0.8333

    for found in (day.sunrise_utc_s, day.sunset_utc_s):
        assert found == pytest.approx(brentq(above_deg, found - 900.0, found + 900.0, xtol=0.1), abs=1.0)


SUVA = (-18.1416, 178.4419, 6.0)
CHATHAM = (-43.95, -176.55, 10.0)
GISBORNE = (-38.66, 178.02, 10.0)


@pytest.mark.parametrize(
    ("site", "date"),
    [
        (SUVA, "2025-09-20T00:00"),
        (CHATHAM, "2025-02-19T00:00"),
        (GISBORNE, "2025-09-25T00:00"),
        ((0.0, 180.0, 0.0), "2025-09-02T00:00"),
        ((0.0, -180.0, 0.0), "2025-09-02T00:00"),
    ],
)
def test_near_the_date_line_the_solar_day_is_the_one_around_the_instant_on_every_date(site, date):
    for instant in utc(date) + 86400.0 * np.arange(-4.0, 5.0):
        day = sun_day(instant, *site)
        assert day.sunrise_utc_s < instant < day.sunset_utc_s
        assert abs(day.noon_utc_s - instant) < 12.3 * 3600.0
        equatorward_deg = (sun_position(day.noon_utc_s, *site).azimuth_deg + 90.0) % 180.0 - 90.0
        assert equatorward_deg == pytest.approx(0.0, abs=1e-4)


@pytest.mark.parametrize(
    ("site", "date", "rise_h", "set_h"),
    [
        # At its highest point it is 0.03 deg above the horizon, or 0.03 deg below.
        ((68.4, 17.0, 0.0), "2024-01-07T11:00", -0.20, 0.20),
        ((67.5, -140.0, 0.0), "2024-12-16T21:00", None, None),
        # At its lowest point it is 0.02 deg below; the night after, it does not set.
        ((66.2, 25.0, 0.0), "2024-06-09T10:00", -11.84, None),
        ((78.2, 15.6, 0.0), "2024-08-24T11:00", None, 11.14),
    ],
)
def test_sunrise_and_sunset_are_right_where_the_sun_only_just_crosses_the_horizon_or_just_does_not(
    site, date, rise_h, set_h
):
    day = sun_day(utc(date), *site)
    for found_s, expected_h in ((day.sunrise_utc_s, rise_h), (day.sunset_utc_s, set_h)):
        if expected_h is None:
            assert found_s is None
        else:
            assert (found_s - day.noon_utc_s) / 3600.0 == pytest.approx(expected_h, abs=0.02)
            assert sun_position(found_s, *site).geometric_elevation_deg == pytest.approx(-0.8333, abs=2e-4)


@pytest.mark.parametrize("latitude_deg", [67.5, 78.2, -89.9])
def test_at_high_latitudes_the_sun_never_sets_before_it_rises(latitude_deg):
    for instant in utc("2024-01-01T12:00") + 86400.0 * np.arange(0.0, 366.0, 10.0):
        day = sun_day(instant, latitude_deg, 15.0, 0.0)
        if day.sunrise_utc_s is not None and day.sunset_utc_s is not None:
            assert day.sunrise_utc_s < day.sunset_utc_s


def test_the_solar_day_of_a_site_is_computed_once_for_all_instants_in_it():
    one = sun_day(1665705600.0, 48.7, 2.2, 156.0)
    assert sun_day(1665705600.0 + 36000.0, 48.7, 2.2, 156.0) is one
    assert sun_day(1665705600.0 + 36000.0, 48.7, 2.3, 156.0) != one


def test_polar_night_and_polar_day_have_no_sunrise_and_differ_in_the_noon_elevation():
    night, day = sun_day(utc("2022-12-21T12:00"), *TROMSO), sun_day(utc("2022-06-21T12:00"), *TROMSO)
    assert night.sunrise_utc_s is None
    assert night.sunset_utc_s is None
    assert night.highest_elevation_deg < 0.0
    assert day.sunrise_utc_s is None
    assert day.highest_elevation_deg > 40.0


@pytest.mark.parametrize("zone", [None, "UTC", "Europe/Paris"])
@pytest.mark.parametrize("unit", ["s", "ms", "us", "ns"])
def test_dates_of_any_time_zone_and_unit_give_the_same_results_as_seconds_since_1970(zone, unit):
    utc_s = np.array([1665705600.0, 1665727200.5])
    dates = pd.to_datetime(utc_s, unit="s", utc=True).tz_convert(zone).as_unit(unit)
    seconds = np.floor(utc_s) if unit == "s" else utc_s
    for instants in (dates, pd.Series(dates), dates.to_numpy(dtype=f"datetime64[{unit}]")):
        np.testing.assert_array_equal(sun_position(instants, *SIRTA), sun_position(seconds, *SIRTA))
        np.testing.assert_array_equal(extraterrestrial_dni(instants), extraterrestrial_dni(seconds))


@pytest.mark.parametrize("zone", ["UTC", "Asia/Kolkata"])
def test_a_single_date_with_or_without_time_zone_gives_the_same_sun_as_seconds_since_1970(zone):
    stamp = pd.Timestamp("2024-02-29T12:00", tz=zone)
    expected = sun_position(stamp.timestamp(), *SIRTA)
    for instant in (stamp, stamp.to_pydatetime(), stamp.tz_convert(None).to_pydatetime()):
        assert sun_position(instant, *SIRTA) == expected
        assert sun_day(instant, *SIRTA) == sun_day(stamp.timestamp(), *SIRTA)


@pytest.mark.parametrize("wrong", ["2024-02-29", ["noon"], pd.NaT, [pd.Timestamp(0)], np.array([1.7e9], np.float32)])
def test_an_instant_of_an_unsuitable_type_is_refused_and_seconds_since_1970_are_suggested(wrong):
    with pytest.raises(ValueError, match="seconds since 1970"):
        sun_position(wrong, *SIRTA)


@pytest.mark.parametrize(
    "wrong",
    [
        pd.DataFrame({"ghi": [1.0]}, index=pd.DatetimeIndex(["2024-02-29"])),
        pd.to_timedelta([1, 2], unit="s"),
        np.timedelta64(5, "s"),
        np.array([True]),
        np.array([1.7e9 + 1j]),
    ],
)
def test_data_frames_durations_booleans_and_complex_numbers_are_refused_as_instants(wrong):
    with pytest.raises(
        ValueError, match="a time is seconds since 1970, a datetime, dates of numpy or an index of them"
    ):
        sun_position(wrong, *SIRTA)


def test_the_solar_day_of_an_array_of_instants_is_refused():
    with pytest.raises(ValueError, match=r"takes one instant, not an array of \(2,\)"):
        sun_day(np.array([1.7e9, 1.71e9]), *SIRTA)


@pytest.mark.parametrize("wrong", [1665705600e3, -1665705600e6, np.datetime64("NaT", "s"), pd.DatetimeIndex(["NaT"])])
def test_milliseconds_microseconds_and_nat_are_refused_as_instants(wrong):
    with pytest.raises(ValueError, match="no milliseconds"):
        sun_position(wrong, *SIRTA)


@pytest.mark.parametrize(
    ("function", "instant"),
    [
        (sun_position, np.nan),
        (sun_position, np.array([0.0, np.nan])),
        (sun_direction, np.inf),
        (sun_day, np.nan),
    ],
)
def test_a_nan_or_infinite_instant_is_refused(function, instant):
    with pytest.raises(ValueError, match="finite seconds since 1970"):
        function(instant, *SIRTA)


# Within an hour and across its end, back again, another day, and the start of 1970.
ASKED_UTC_S = [1.7e9 + offset_s for offset_s in (0.0, 59.9, 60.0, 3540.0, 3599.0, 3600.0, 7300.0, 10.0, -1.0, 8e4)] + [
    0.0
]


@pytest.mark.parametrize("site", [Site(48.7, 2.2, 156.0), Site(-33.9, 18.4, 0.0)])
def test_the_sun_elevation_by_the_minute_is_that_at_the_beginning_of_the_minute(site):
    elevation = SunElevation(site)
    for utc_s in ASKED_UTC_S:
        assert elevation(utc_s) == pytest.approx(sun_position(utc_s // 60.0 * 60.0, *site).elevation_deg, abs=1e-9)


@pytest.mark.parametrize("site", [Site(48.7, 2.2, 156.0), Site(-33.9, 18.4, 0.0)])
def test_the_sun_direction_interpolated_within_a_minute_agrees_with_the_exact_one(site):
    direction = SunDirection(site)
    for utc_s in ASKED_UTC_S:
        np.testing.assert_allclose(direction(utc_s), sun_direction(np.array([utc_s]), *site)[0], atol=1e-5)


def test_an_empty_array_of_instants_gives_empty_arrays_of_positions_and_directions():
    assert all(angles.shape == (0,) for angles in sun_position(np.empty(0), 48.7, 2.2, 156.0))
    assert sun_direction(np.empty(0), 48.7, 2.2, 156.0).shape == (0, 3)
