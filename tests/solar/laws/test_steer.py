"""Laws in the benchmark: the fast way of each law, and the way that works for any law."""

from functools import partial

import numpy as np
import pytest

from solar.energy import Drive, arrange_daylight, build_sky, face_irradiances, harvest
from solar.ephemeris import Site
from solar.frames import Angles, Limits
from solar.laws import chronometric, flat, mu_prime, optimal_live, sun_vector
from solar.laws.law import Aim, Law
from solar.laws.steer import steer_by_mean, steer_by_readings, steer_towards

pytestmark = pytest.mark.slow

LIMITS = Limits()
LYNGBY = Site(55.79064, 12.52505, 50.0)
IDEAL = Drive(np.inf, 0.0, 1)


@pytest.fixture(scope="module")
def two_days():
    """Return two days under a sky that changes every half hour, and what the faces read."""
    utc_s = 1465084800.0 + 60.0 * np.arange(2 * 1440)  # 2016-06-05
    sunny = (utc_s // 1800) % 2
    weather = arrange_daylight(utc_s, 700.0 * sunny, np.full(utc_s.size, 150.0), LYNGBY)
    light = build_sky(weather, "isotropic")
    return weather, light, face_irradiances(light, 0.2)


@pytest.mark.parametrize("law", [mu_prime, sun_vector, chronometric])
def test_a_law_run_reading_by_reading_harvests_what_its_fast_steering_does(two_days, law):
    weather, light, faces = two_days
    settings = law.SETTINGS()
    ways = (
        law.steer(settings, weather, faces, LIMITS),
        steer_by_readings(partial(law.build, settings), *two_days[::2], LIMITS),
    )
    fast, slow = (harvest(weather, light, 0.2, IDEAL, steer).energy_kwh_m2 for steer in ways)
    # The fast chronometric tracker follows the sun at every step, the slow one every five minutes.
    assert slow == pytest.approx(fast, rel=5e-3 if law is chronometric else 1e-12)


def test_steering_towards_the_sun_equals_the_chronometric_law_and_points_to_the_past_sun_if_delayed(two_days):
    weather, _, faces = two_days
    a, b = np.zeros(2), np.full(2, 90.0)
    clock = chronometric.steer(chronometric.SETTINGS(), weather, faces, LIMITS)
    now, late = (steer_towards(weather, weather.sun, LIMITS, steps) for steps in (0, 30))
    for step in (0, 200, 400):
        np.testing.assert_allclose(now(step, a, b), clock(step, a, b))
        np.testing.assert_allclose(late(step + 30, a, b), now(step, a, b))
    np.testing.assert_array_equal(late(29, a, b), (a, b))
    assert np.abs(np.subtract(now(430, a, b), late(430, a, b))).max() > 1.0


def test_the_optimal_law_run_by_readings_harvests_nearly_as_its_fast_steering_and_keeps_its_budget(two_days):
    weather, light, faces = two_days
    settings = optimal_live.SETTINGS(moves_per_day=40)
    ways = (
        optimal_live.steer(settings, weather, faces, LIMITS),
        steer_by_readings(partial(optimal_live.build, settings), weather, faces, LIMITS),
    )
    fast, slow = (harvest(weather, light, 0.2, IDEAL, steer) for steer in ways)
    assert slow.energy_kwh_m2 == pytest.approx(fast.energy_kwh_m2, rel=5e-3)
    assert (slow.moves <= 40).all()


def test_a_mean_covers_the_last_steps_within_its_length_and_a_longer_step_is_its_own_mean():
    utc_s = 1465084800.0 + 300.0 * np.arange(288)
    weather = arrange_daylight(utc_s, 700.0 * (utc_s // 1800 % 2), np.full(utc_s.size, 150.0), LYNGBY, 300.0)
    faces = face_irradiances(build_sky(weather, "isotropic"), 0.2)
    asked = []
    steer_by_mean(weather, faces, LIMITS, lambda means: asked.append(means) or means[..., :3])
    grid = weather.gridded(faces, np.nan)
    np.testing.assert_array_equal(asked[0], grid)
    steer_by_mean(weather, faces, LIMITS, lambda means: asked.append(means) or means[..., :3], mean_s=900.0)
    np.testing.assert_allclose(asked[1][2:], (grid[2:] + grid[1:-1] + grid[:-2]) / 3.0)
    # Before the first step there was no reading.
    assert np.isnan(asked[1][:2]).all()


class Listener(Law):
    """Notes its calls, and goes back by 3 and 4 deg at each aim but the first."""

    def __init__(self, tracker):
        super().__init__(tracker)
        self.heard, self.asked, self.booked = [], [], []

    def observe(self, reading):
        """Note the reading."""
        self.heard.append(reading)

    def affords(self, _distance_deg):
        """Whether this is one of its first two moves."""
        return len(self.booked) < 2

    def book(self, distance_deg):
        """Note the distance."""
        self.booked.append(distance_deg)

    def aim(self, now):
        """Go back by 3 and 4 deg, but not at first."""
        self.asked.append(now)
        target = Angles(now.heading.a_deg - 3.0, now.heading.b_deg - 4.0) if len(self.asked) > 1 else None
        return Aim(azimuth_deg=np.nan, elevation_deg=np.nan, sun=self.sun(now.utc_s), target=target)


def test_a_law_hears_each_reading_once_before_the_step_that_it_steers():
    utc_s = 1465084800.0 + 300.0 * np.arange(288)
    weather = arrange_daylight(utc_s, np.full(utc_s.size, 700.0), np.full(utc_s.size, 150.0), LYNGBY, 300.0)
    faces = face_irradiances(build_sky(weather, "isotropic"), 0.2)
    made = []
    steer = steer_by_readings(lambda tracker: made.append(Listener(tracker)) or made[-1], weather, faces, LIMITS)
    a, b = np.zeros(1), np.full(1, 90.0)
    for step in range(5):
        a, b = steer(step, a, b)
    (law,) = made
    first = weather.utc_s[:4].tolist()
    assert [reading.utc_s for reading in law.heard] == [now.utc_s for now in law.asked] == first
    np.testing.assert_array_equal([reading.faces_w_m2 for reading in law.heard], faces[:4])
    assert (law.booked, a.tolist(), b.tolist()) == ([7.0, 7.0], [-6.0], [82.0])


def test_the_flat_law_never_moves(two_days):
    weather, light, faces = two_days
    done = harvest(
        weather, light, 0.2, Drive(), steer_by_readings(partial(flat.build, flat.SETTINGS()), weather, faces, LIMITS)
    )
    assert not done.moves.any()
