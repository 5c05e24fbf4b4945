"""What a tracker harvests and what could be harvested, under lights for which every sum can be done by hand."""

import numpy as np
import pytest

from daemon.config.sections import LimitSettings, MotionSettings
from solar.energy import Drive, arrange_daylight, best_possible, harvest, steer_fixed_tilt
from solar.ephemeris import Site
from solar.frames import Limits

LIMITS = Limits()
LYNGBY = Site(55.79064, 12.52505, 50.0)
DAY_S = 86400.0


def morning():
    """Return three hours of one day."""
    utc_s = 1465113600.0 + 60.0 * np.arange(180)
    return arrange_daylight(utc_s, np.zeros(180), np.full(180, 100.0), LYNGBY)


def weather_of(dni, dhi, days=1):
    utc_s = 1465084800.0 + 60.0 * np.arange(1440 * days)  # 2016-06-05
    return arrange_daylight(utc_s, np.full(utc_s.size, dni), np.full(utc_s.size, dhi), LYNGBY)


class Peak:
    """A light that is brightest on a plane at two angles; it falls with the squares of the differences from them."""

    def __init__(self, a_deg, b_deg):
        self.place = a_deg, b_deg

    def irradiance_on(self, normals, _albedo):
        a_deg, b_deg = angles_of(normals)
        return 1000.0 - (a_deg - self.place[0]) ** 2 - (b_deg - self.place[1]) ** 2


class Shows:
    """A light whose irradiance is an angle of the plane: 0 for A, 1 for B."""

    def __init__(self, axis):
        self.axis = axis

    def irradiance_on(self, normals, _albedo):
        return angles_of(normals)[self.axis]


def angles_of(normals):
    return np.degrees(np.arcsin(-normals[..., 1])), np.degrees(np.arctan2(normals[..., 2], normals[..., 0]))


@pytest.mark.parametrize(
    ("place", "short"),
    [((10.26, 50.76), 0.03), ((-37.3, 21.3), 0.03), ((-50.0, 90.0), 1e-9), ((53.0, 10.0), 34.0), ((0.0, 99.0), 81.0)],
)
def test_the_best_pose_is_found_to_an_eighth_of_a_degree_and_within_the_limits(place, short):
    weather = morning()
    best = best_possible(weather, Peak(*place), LIMITS, 0.0)
    assert best.shape == weather.utc_s.shape
    assert np.all(best <= 1000.0 + 1e-6)
    np.testing.assert_allclose(1000.0 - best, short, atol=0.032 if short < 1 else 0.05)


def test_a_move_turns_a_first_then_b_at_the_drives_speed_and_harvests_at_the_poses_on_its_way():
    weather = morning()
    steps = weather.shape[0]
    drive = Drive(speed_deg_per_s=0.05, deadband_deg=0.6, samples=3)

    def steer(step, a, b):
        return (np.array([-2.5]), np.array([88.0])) if step >= 60 else (a, b)

    shown = [harvest(weather, Shows(axis), 0.0, drive, steer) for axis in (0, 1)]
    a_sum = -(0.5 + 1.5 + 2.25) / 3 - 2.5 * (steps - 61)
    b_sum = 90 * 60 + (90 + 90 + 89.75) / 3 + (89.0 + 88.25 + 88) / 3 + 88 * (steps - 62)
    assert shown[0].energy_kwh_m2[0] == pytest.approx(a_sum / 60e3)
    assert shown[1].energy_kwh_m2[0] == pytest.approx(b_sum / 60e3)
    for result in shown:
        assert (result.travel_deg[0], result.moves[0], result.return_deg[0]) == pytest.approx((4.5, 1, 4.5))


@pytest.mark.parametrize(("apart_deg", "moves"), [(0.59, 0), (0.61, 1)])
@pytest.mark.parametrize("share", [1.0, -1.0, 0.5])
def test_a_target_within_the_deadband_is_not_driven_to_except_by_an_ideal_drive(apart_deg, moves, share):
    weather = morning()
    light = Shows(0)

    def steer(_step, a, b):
        return np.full_like(a, share * apart_deg), np.full_like(b, 90.0 - (1 - abs(share)) * apart_deg)

    real = harvest(weather, light, 0.0, Drive(0.9, 0.6, 2), steer)
    assert real.moves[0] == moves
    assert real.travel_deg[0] == pytest.approx(apart_deg * moves)
    ideal = harvest(weather, light, 0.0, Drive(np.inf, 0.6, 1), steer)
    assert ideal.moves[0] == 1
    assert ideal.energy_kwh_m2[0] == pytest.approx(share * apart_deg * weather.shape[0] / 60e3)


def test_light_that_is_taken_from_the_plane_is_subtracted_from_the_harvest():
    weather = morning()
    light = Shows(1)
    free, taken = (
        harvest(weather, light, 0.0, Drive(np.inf, 0.0, samples), steer_fixed_tilt(weather, 30.0), what)
        for samples, what in ((1, None), (2, lambda a_deg, b_deg: a_deg + b_deg / 3))
    )
    assert free.energy_kwh_m2[0] == pytest.approx(60.0 * weather.shape[0] / 60e3)
    assert taken.energy_kwh_m2[0] == pytest.approx(40.0 * weather.shape[0] / 60e3)


def test_weather_is_laid_out_in_solar_days_of_the_site():
    weather = weather_of(500.0, 100.0, days=3)
    assert weather.first_day == 16957
    assert (weather.day.min(), weather.step.min()) == (0, 0)
    # 2016-06-05 and the two days after, each from sunrise to sunset: at 12.5 deg east noon is at 11:10 UTC.
    assert np.bincount(weather.day).tolist() == [np.count_nonzero(weather.day == day) for day in range(3)]
    noon = weather.sun[:, 2].argmax()
    assert weather.utc_s[noon] % DAY_S == pytest.approx(11.14 * 3600, abs=300)
    sparse = arrange_daylight(weather.utc_s[::5], weather.dni_w_m2[::5], weather.dhi_w_m2[::5], LYNGBY, 300.0)
    assert sparse.shape[0] * 5 == pytest.approx(weather.shape[0], abs=5)
    np.testing.assert_allclose(sparse.by_day(sparse.dhi_w_m2), weather.by_day(weather.dhi_w_m2), rtol=0.01)
    np.testing.assert_allclose(weather.by_day(weather.dhi_w_m2), 0.1 * np.bincount(weather.day) / 60.0)


def test_missing_weather_is_left_out_negative_values_are_zero_and_no_weather_by_day_is_refused():
    utc_s = 1465128000.0 + 60.0 * np.arange(4)
    weather = arrange_daylight(
        utc_s, np.array([-5.0, np.nan, 500.0, 1.0]), np.array([-1.0, 100.0, np.nan, 2.0]), LYNGBY
    )
    assert weather.utc_s.tolist() == [utc_s[0], utc_s[3]]
    assert (weather.dni_w_m2.tolist(), weather.dhi_w_m2.tolist()) == ([0.0, 1.0], [0.0, 2.0])
    with pytest.raises(ValueError, match="no record with the sun above the horizon and dni and dhi present"):
        arrange_daylight(utc_s, np.full(4, np.nan), np.ones(4), LYNGBY)
    with pytest.raises(ValueError, match="no record with the sun above"):
        arrange_daylight(utc_s + 43200.0, np.ones(4), np.ones(4), LYNGBY)


def test_a_day_without_light_among_others_has_no_type_and_weather_without_any_light_is_refused():
    dhi = np.repeat([0.0, 20.0], 1440)
    assert weather_of(0.0, dhi, days=2).day_types().tolist() == [-1, 3]
    with pytest.raises(ValueError, match="no record has any light while the sun is above the horizon"):
        weather_of(0.0, 0.0)


@pytest.mark.parametrize(("dni", "dhi", "kind"), [(0.0, 20.0, 3), (0.2, 0.1, 1), (900.0, 50.0, 0), (400.0, 150.0, 1)])
def test_a_day_has_its_type_however_weak_its_light_is(dni, dhi, kind):
    assert weather_of(dni, dhi).day_types().tolist() == [kind]


def test_the_default_deadband_and_limits_of_a_study_are_those_of_the_service():
    assert Drive().deadband_deg == MotionSettings().deadband_deg
    limits = LimitSettings()
    assert Limits() == Limits(limits.a_min_deg, limits.a_max_deg, limits.b_min_deg, limits.b_max_deg)
