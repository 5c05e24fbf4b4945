"""Laws in the benchmark: the fast way of each, and the way of any law."""

from functools import partial

import numpy as np
import pytest

from solar.energy import Drive, build_sky, faces_under, harvest, lay_out
from solar.ephemeris import Site
from solar.frames import Limits
from solar.laws import chronometric, flat, mu_prime, optimal_live, sun_vector
from solar.laws.steer import by_readings, by_the_mean

pytestmark = pytest.mark.slow

LIMITS = Limits()
LYNGBY = Site(55.79064, 12.52505, 50.0)
IDEAL = Drive(np.inf, 0.0, 1)


@pytest.fixture(scope="module")
def two_days():
    """Return two days under a sky that changes every half hour, and what the faces read."""
    utc_s = 1465084800.0 + 60.0 * np.arange(2 * 1440)  # 2016-06-05
    sunny = (utc_s // 1800) % 2
    weather = lay_out(utc_s, 700.0 * sunny, np.full(utc_s.size, 150.0), LYNGBY)
    light = build_sky(weather, "isotropic")
    return weather, light, faces_under(light, 0.2)


@pytest.mark.parametrize("law", [mu_prime, sun_vector, chronometric])
def test_a_law_run_reading_by_reading_harvests_what_its_fast_way_does(two_days, law):
    weather, light, faces = two_days
    settings = law.SETTINGS()
    ways = (
        law.steer(settings, weather, faces, LIMITS),
        by_readings(partial(law.build, settings), *two_days[::2], LIMITS),
    )
    fast, slow = (harvest(weather, light, 0.2, IDEAL, steer).energy_kwh_m2 for steer in ways)
    # The fast chronometric tracker follows the sun at every step, the slow one every five minutes.
    assert slow == pytest.approx(fast, rel=5e-3 if law is chronometric else 1e-12)


def test_the_optimal_law_reading_by_reading_comes_near_its_fast_way_and_keeps_its_plan(two_days):
    weather, light, faces = two_days
    settings = optimal_live.SETTINGS(moves_per_day=40)
    ways = (
        optimal_live.steer(settings, weather, faces, LIMITS),
        by_readings(partial(optimal_live.build, settings), weather, faces, LIMITS),
    )
    fast, slow = (harvest(weather, light, 0.2, IDEAL, steer) for steer in ways)
    assert slow.energy_kwh_m2 == pytest.approx(fast.energy_kwh_m2, rel=5e-3)
    assert (slow.moves <= 40).all()


def test_a_step_that_is_longer_than_the_mean_is_its_own_mean():
    utc_s = 1465084800.0 + 300.0 * np.arange(288)
    weather = lay_out(utc_s, 700.0 * (utc_s // 1800 % 2), np.full(utc_s.size, 150.0), LYNGBY, 300.0)
    faces = faces_under(build_sky(weather, "isotropic"), 0.2)
    asked = []
    by_the_mean(weather, faces, LIMITS, lambda means: asked.append(means) or means[..., :3])
    np.testing.assert_array_equal(asked[0], weather.gridded(faces, np.nan))


def test_flat_never_moves(two_days):
    weather, light, faces = two_days
    done = harvest(
        weather, light, 0.2, Drive(), by_readings(partial(flat.build, flat.SETTINGS()), weather, faces, LIMITS)
    )
    assert not done.moves.any()
