import numpy as np
import pytest

from sim_drivers.scene import Scene
from sim_drivers.weather import GeneratedWeather
from solar.calibration.comparison import fitted_offset, lag_s, series_gain
from solar.calibration.selection import block_means, clear_and_stable, clear_sky_ghi, night_offset
from solar.ephemeris import DAY_S, Site, sun_direction, sun_position

SIRTA = Site(48.717607, 2.209002, 156.0)
MIDNIGHT = 1_647_302_400.0  # 2022-03-15


def clouds(utc_s):
    return 500.0 + 200.0 * np.sin(utc_s / 97.0) + 100.0 * np.sin(utc_s / 41.0 + 1.0)


def test_block_means_are_taken_over_the_readings_that_exist():
    utc_s = np.array([0.0, 10.0, 50.0, 60.0, 200.0])
    middles, means = block_means(
        utc_s, np.array([[1.0, 2.0], [2.0, np.nan], [3.0, 4.0], [5.0, 6.0], [7.0, np.nan]]), 60.0
    )
    assert middles.tolist() == [20.0, 60.0, 200.0]
    np.testing.assert_array_equal(means, [[2.0, 3.0], [5.0, 6.0], [7.0, np.nan]])
    middles, means = block_means(np.zeros(0), np.zeros((0, 4)), 60.0)
    assert (middles.shape, means.shape) == ((0,), (0, 4))


def test_a_clear_day_is_selected_despite_a_gain_10_percent_too_low_and_a_cloudy_one_is_not():
    utc_s = MIDNIGHT + np.arange(0.0, 86400.0, 60.0)
    clear, _, _ = clear_sky_ghi(SIRTA, utc_s)
    high = clear_and_stable(utc_s, clear, SIRTA)
    assert 400 < np.count_nonzero(high) < 620
    np.testing.assert_array_equal(clear_and_stable(utc_s, 0.9 * clear, SIRTA), high)
    assert not clear_and_stable(utc_s, 0.5 * clear, SIRTA).any()
    assert not clear_and_stable(utc_s, clear * (1.0 + 0.1 * np.sin(utc_s / 200.0)), SIRTA).any()
    with_hole = clear.copy()
    with_hole[700:760] = np.nan
    assert not clear_and_stable(utc_s, with_hole, SIRTA)[700:760].any()
    assert not clear_and_stable(utc_s[:2], clear[:2], SIRTA).any()


def test_the_night_offset_is_the_median_of_the_dark_readings_and_nan_without_any():
    utc_s = MIDNIGHT + np.arange(0.0, 86400.0, 60.0)
    readings = np.where(utc_s < MIDNIGHT + 3 * 3600.0, 0.05, 40.0)[:, None] * [1.0, -1.0]
    readings[0] = 30.0, 30.0
    evening = utc_s > MIDNIGHT + 12 * 3600.0
    offset, error, count = night_offset(utc_s[~evening][:180], readings[~evening][:180], SIRTA)
    np.testing.assert_allclose(offset, [0.05, -0.05])
    np.testing.assert_allclose(error, 0.0)
    assert count == 180
    by_day = slice(600, 700)
    offset, _, count = night_offset(utc_s[by_day], readings[by_day], SIRTA)
    assert np.isnan(offset).tolist() == [True, True]
    assert count == 0


def test_night_begins_six_degrees_below_the_horizon():
    utc_s = MIDNIGHT + np.arange(0.0, 86400.0, 60.0)
    elevation_deg = sun_position(utc_s, *SIRTA).elevation_deg
    _, _, count = night_offset(utc_s, np.zeros((utc_s.size, 1)), SIRTA)
    assert count == np.count_nonzero(elevation_deg < -6.0)


def test_in_the_error_of_the_night_offset_the_readings_of_half_an_hour_count_as_one():
    utc_s = MIDNIGHT + np.arange(0.0, 3 * 3600.0, 60.0)
    strays = np.where(np.arange(utc_s.size) % 2, 0.01, -0.01)[:, None] * [1.0, 3.0]
    _, error, _ = night_offset(utc_s, 0.05 + strays, SIRTA)
    sigma = 1.4826 * np.array([0.01, 0.03])
    np.testing.assert_allclose(error, 1.2533 * sigma / np.sqrt(6))


@pytest.mark.parametrize(("share", "stable"), [(0.79, False), (0.81, True), (1.24, True), (1.26, False)])
def test_readings_from_0_8_to_1_25_of_the_clear_sky_are_accepted_as_clear_and_no_others(share, stable):
    utc_s = MIDNIGHT + np.arange(36_000.0, 50_400.0, 60.0)
    clear, _, _ = clear_sky_ghi(SIRTA, utc_s)
    assert clear_and_stable(utc_s, share * clear, SIRTA)[60:180].all() == stable


@pytest.mark.parametrize(("percent", "stable"), [(0.99, True), (1.01, False)])
def test_a_sky_counts_as_stable_up_to_1_percent_of_spread_in_half_an_hour(percent, stable):
    utc_s = MIDNIGHT + np.arange(36_000.0, 50_400.0, 60.0)
    clear, _, _ = clear_sky_ghi(SIRTA, utc_s)
    wave = 1.0 + percent / 100.0 * np.where(np.arange(utc_s.size) % 2, 1.0, -1.0)
    assert clear_and_stable(utc_s, 1.2 * wave * clear, SIRTA)[60:180].all() == stable


@pytest.mark.parametrize(("missing", "stable"), [(6, True), (7, True), (8, False)])
def test_a_sky_counts_as_stable_only_with_four_fifths_of_the_half_hours_readings_present(missing, stable):
    utc_s = MIDNIGHT + np.arange(36_000.0, 50_400.0, 60.0)
    clear, _, _ = clear_sky_ghi(SIRTA, utc_s)
    clear[105 : 105 + missing] = np.nan
    assert clear_and_stable(utc_s, clear, SIRTA)[[104, 105 + missing]].all() == stable


def test_clear_sky_is_selected_only_with_the_sun_at_least_10_degrees_up():
    utc_s = MIDNIGHT + np.arange(0.0, 86_400.0, 60.0)
    clear, _, _ = clear_sky_ghi(SIRTA, utc_s)
    high = sun_position(utc_s, *SIRTA).elevation_deg[clear_and_stable(utc_s, clear, SIRTA)]
    assert 10.0 <= high.min() < 12.0


@pytest.mark.parametrize("ahead_s", [-90.0, -7.5, 0.0, 37.0, 200.0])
def test_the_lag_between_two_clocks_is_found_from_passing_clouds(ahead_s):
    reference, sensor = np.arange(0.0, 7200.0, 10.0), np.arange(3.0, 7200.0, 5.0)
    found = lag_s(reference, clouds(reference), sensor + ahead_s, 0.1 * clouds(sensor))
    assert found == pytest.approx(ahead_s, abs=1.0)


@pytest.mark.parametrize(("first", "second"), [((0.0, 7200.0), (0.0, 2400.0)), ((0.0, 7200.0), (6000.0, 7200.0))])
def test_the_lag_is_found_from_the_time_that_both_series_cover(first, second):
    for reference_s, sensor_s in ((first, second), (second, first)):
        reference, sensor = np.arange(*reference_s, 10.0), np.arange(*sensor_s, 10.0)
        found = lag_s(reference, clouds(reference), sensor + 37.0, clouds(sensor))
        assert found == pytest.approx(37.0, abs=1.0)


def test_the_lag_between_readings_of_every_second_is_found_to_a_tenth_of_a_second():
    utc_s = np.arange(0.0, 3600.0)
    assert lag_s(utc_s, clouds(utc_s), utc_s + 2.3, clouds(utc_s), largest_s=3.0) == pytest.approx(2.3, abs=0.1)


@pytest.mark.parametrize("step_s", [10.0, 60.0])
def test_the_lag_between_slow_readings_is_not_biased_to_whole_steps(step_s):
    sky = Scene(SIRTA, GeneratedWeather("variable", SIRTA, 1))
    utc_s = MIDNIGHT + np.arange(0.0, 86400.0, step_s)
    ghi = np.array([sky.irradiances(now).zenith_w_m2 for now in utc_s.tolist()])
    assert lag_s(utc_s, ghi, utc_s + 37.0, 0.1 * ghi) == pytest.approx(37.0, abs=0.05 * step_s)


def test_no_lag_is_found_under_a_steady_sky_or_from_five_readings():
    utc_s = np.arange(0.0, 7200.0, 10.0)
    noise = np.random.default_rng(1).standard_normal((2, utc_s.size))
    assert np.isnan(lag_s(utc_s, 500.0 + noise[0], utc_s, 50.0 + noise[1]))
    assert np.isnan(lag_s(utc_s, np.full(utc_s.size, 500.0), utc_s, np.full(utc_s.size, 50.0)))
    assert np.isnan(lag_s(utc_s[:5], clouds(utc_s[:5]), utc_s[:5], clouds(utc_s[:5])))


def test_the_lag_is_found_from_the_clouds_in_spite_of_a_drift_of_the_sensor():
    utc_s = np.arange(0.0, 7200.0, 10.0)
    found = lag_s(utc_s, clouds(utc_s), utc_s + 37.0, 0.1 * clouds(utc_s) + 0.1 * utc_s)
    assert found == pytest.approx(37.0, abs=1.0)


@pytest.mark.parametrize(("lasts_s", "tells"), [(640.0, False), (760.0, True)])
def test_a_lag_is_found_only_if_the_series_are_long_enough_for_the_largest_lag_on_both_sides(lasts_s, tells):
    utc_s = np.arange(0.0, lasts_s, 10.0)
    found = lag_s(utc_s, clouds(utc_s), utc_s, clouds(utc_s))
    assert found == pytest.approx(0.0, abs=1.0) if tells else np.isnan(found)
    found = lag_s(utc_s, clouds(utc_s), utc_s, clouds(utc_s), largest_s=100.0)
    assert found == pytest.approx(0.0, abs=1.0)


@pytest.mark.parametrize(("count", "tells"), [(19, False), (20, True)])
def test_fewer_than_twenty_readings_give_no_lag(count, tells):
    many, few = np.arange(0.0, 7200.0, 10.0), np.linspace(0.0, 7190.0, count)
    for first, second in ((few, many), (many, few)):
        found = lag_s(first, first % 3000.0, second, second % 3000.0, largest_s=1500.0)
        assert np.isfinite(found) == tells


def test_a_lag_at_the_edge_of_the_searched_range_is_rejected():
    utc_s = np.arange(0.0, 3600.0, 5.0)
    assert np.isnan(lag_s(utc_s, clouds(utc_s), utc_s + 60.0, clouds(utc_s), largest_s=60.0))
    assert np.isfinite(lag_s(utc_s, clouds(utc_s), utc_s + 50.0, clouds(utc_s), largest_s=60.0))


@pytest.mark.parametrize(
    ("per_series", "volts", "used"), [(4, 50.0, 0), (5, 50.0, 3), (5, 0.1, 3), (5, 0.0, 0), (5, -1.0, 0)]
)
def test_a_series_counts_only_with_five_readings_and_a_positive_voltage(per_series, volts, used):
    utc_s = np.concatenate([1200.0 * place + np.arange(per_series) for place in range(3)])
    if used:
        found = series_gain(utc_s, np.full(utc_s.size, 500.0), np.full(utc_s.size, volts))
        assert found.series_utc_s.tolist() == [600.0, 1800.0, 3000.0]
    else:
        with pytest.raises(ValueError, match="only 0 series of clear and stable sky; at least 3 are needed"):
            series_gain(utc_s, np.full(utc_s.size, 500.0), np.full(utc_s.size, volts))


@pytest.mark.parametrize(("off", "kept"), [(0.019, True), (0.021, False), (-0.019, True), (-0.021, False)])
def test_a_series_is_kept_within_2_percent_of_the_others_and_dropped_beyond(off, kept):
    found = series_gain(*series([10.0] * 300 + [10.0 * (1.0 + off)]))
    assert found.kept[-1] == kept


def series(ratios, per_series=10):
    utc_s = np.arange(len(ratios) * per_series) * 120.0
    voltage = np.full(utc_s.size, 50.0)
    return utc_s, np.repeat(ratios, per_series) * voltage, voltage


def test_the_gain_is_the_mean_of_the_series_with_students_interval():
    found = series_gain(*series([10.0, 10.1, 9.9]))
    assert found.gain_w_m2_per_mv.value == pytest.approx(10.0)
    assert found.gain_w_m2_per_mv.half_width == pytest.approx(4.302653 * 0.1 / np.sqrt(3.0), rel=1e-6)


def test_a_series_that_strays_is_dropped_and_fewer_than_three_series_are_refused():
    found = series_gain(*series([10.0, 10.1, 9.9, 10.0, 12.0]))
    assert found.kept.tolist() == [True] * 4 + [False]
    assert found.gain_w_m2_per_mv.value == pytest.approx(10.0)
    with pytest.raises(ValueError, match="fewer than 3 are left"):
        series_gain(*series([10.0, 12.0, 14.0]))
    with pytest.raises(ValueError, match="only 2 series"):
        series_gain(*series([10.0, 10.0]))


def test_a_solar_day_that_utc_midnight_divides_counts_as_one_day():
    # Two days at 180 E, each in two halves of UTC days: the six-hourly ratios are not independent days.
    utc_s = np.concatenate([day * 86400.0 + 64800.0 + np.arange(720) * 60.0 for day in range(2)])
    reference = np.repeat([495.0, 505.0, 495.0, 505.0], 360)
    found = series_gain(utc_s, reference, np.full(utc_s.size, 50.0), 180.0)
    assert found.series_gains.size == 72
    by_series = 1.993943 * np.std(found.series_gains, ddof=1) / np.sqrt(72)
    assert found.gain_w_m2_per_mv.half_width == pytest.approx(by_series, rel=1e-6)


def test_with_three_days_the_interval_of_the_gain_is_based_on_days_and_not_on_series():
    utc_s = np.concatenate([day * 86400.0 + np.arange(120) * 60.0 for day in range(3)])
    reference = np.repeat([495.0, 500.0, 505.0], 120)
    found = series_gain(utc_s, reference, np.full(utc_s.size, 50.0))
    assert found.series_gains.size == 18
    assert found.gain_w_m2_per_mv.half_width == pytest.approx(4.302653 * 0.1 / np.sqrt(3.0), rel=1e-6)


def test_the_offset_is_found_from_a_fitted_line_and_a_fit_to_two_readings_is_refused():
    irradiance = np.array([200.0, 400.0, 600.0, 800.0])
    found = fitted_offset(np.arange(4.0), irradiance, 0.1 * irradiance + 0.05)
    assert found.value == pytest.approx(0.05)
    assert found.half_width == pytest.approx(0.0, abs=1e-6)
    with pytest.raises(ValueError, match="2 readings"):
        fitted_offset(np.arange(2.0), irradiance[:2], irradiance[:2])


def test_the_confidence_interval_of_the_fitted_offset_matches_a_calculation_by_hand():
    # The residuals are +-0.01 mV and change neither mean nor slope: s2 = 4e-4/2, Student's t 4.302653.
    irradiance, left = np.array([0.0, 200.0, 400.0, 600.0]), np.array([0.01, -0.01, -0.01, 0.01])
    found = fitted_offset(np.arange(4.0), irradiance, 0.1 * irradiance + 0.05 + left)
    assert found.value == pytest.approx(0.05)
    assert found.half_width == pytest.approx(4.302653 * np.sqrt(2e-4 * (1.0 / 4.0 + 300.0**2 / 200_000.0)), rel=1e-6)
    assert fitted_offset(np.arange(3.0), irradiance[:3], 0.1 * irradiance[:3] + 0.05).value == pytest.approx(0.05)


@pytest.mark.parametrize("days", [1, 5])
def test_the_interval_of_the_fitted_offset_holds_for_a_tilted_sensor_that_misses_grazing_light(days):
    # Tilted half a degree towards the south-east, and 2 % missed at 80 deg: the line is bent alike on every day.
    times = MIDNIGHT + np.arange(0.0, days * DAY_S, 60.0)
    sun = sun_direction(times, *SIRTA)
    times, sun = times[sun[:, 2] > 0.2], sun[sun[:, 2] > 0.2]
    ghi, dni, _ = clear_sky_ghi(SIRTA, times)
    missed = 0.02 * (np.degrees(np.arccos(sun[:, 2])) / 80.0) ** 4
    sensed = ghi * (1.0 - missed) + np.radians(0.35) * dni * (sun[:, 0] + sun[:, 1])
    found = fitted_offset(times, ghi, 0.1 * sensed + 0.05)
    assert abs(found.value - 0.05) < found.half_width < 1.0


def test_three_readings_that_fill_a_half_hour_make_only_the_middle_one_clear_and_stable():
    utc_s = MIDNIGHT + 43_200.0 + np.array([-700.0, 0.0, 700.0])
    clear, _, _ = clear_sky_ghi(SIRTA, utc_s)
    # Three readings of 700 s fill the half hour around the middle one; around the first and the last are only two.
    assert clear_and_stable(utc_s, clear, SIRTA).tolist() == [False, True, False]


def test_block_means_are_placed_at_the_middle_of_their_readings():
    assert [part.tolist() for part in block_means(np.array([600.0, 630.0]), np.array([1.0, 3.0]), 60.0)] == [
        [615.0],
        [2.0],
    ]
    assert block_means(np.array([630.0]), np.array([3.0]), 60.0)[0].tolist() == [630.0]


def test_a_night_reading_with_a_missing_face_is_left_out_of_the_offset():
    utc_s = MIDNIGHT + 60.0 * np.arange(7)
    readings = np.stack([np.arange(7.0), -np.arange(7.0)], axis=-1)
    readings[6, 1] = np.nan
    offset, _, count = night_offset(utc_s, readings, SIRTA)
    assert (offset.tolist(), count) == ([2.5, -2.5], 6)


@pytest.mark.parametrize("ahead_s", [34.0, -26.0])
def test_a_lag_between_two_steps_of_the_search_is_found_whatever_the_unit_of_the_readings(ahead_s):
    def slow(utc_s):
        return 500.0 + 200.0 * np.sin(utc_s / 400.0) + 100.0 * np.sin(utc_s / 170.0 + 1.0)

    utc_s = np.arange(0.0, 21_600.0, 60.0)
    found = lag_s(utc_s, slow(utc_s), utc_s + ahead_s, 1e-12 * slow(utc_s))
    assert found == pytest.approx(ahead_s, abs=0.3)
