"""The settings of the laws by the cube take effect, in the law that runs and in the fast way alike."""

import numpy as np
import pytest

from solar.energy import arrange_daylight
from solar.ephemeris import Site
from solar.frames import Angles, Limits
from solar.laws import mu_prime, optimal_live, sun_vector
from solar.laws.law import Moment, TrackerFacts

LYNGBY = Site(55.79064, 12.52505, 50.0)
NOON = 1465124400.0  # 2016-06-05 11:00
# South reads more than the sides, by 1.5 % of the zenith face.
NEARLY_EVEN = (100.0, 103.0, 100.0, 200.0)
HAZY = (100.0, 140.0, 100.0, 250.0)
SUNNY = (150.0, 420.0, 150.0, 700.0)


def built(law, **settings):
    tracker = TrackerFacts(site=LYNGBY, limits=Limits(), scan_every_s=5.0, decide_every_s=300.0, utc_s=NOON)
    return law.build(law.SETTINGS(**settings), tracker)


def aim(law, faces, **settings):
    return built(law, **settings).aim(Moment(NOON, faces, Angles(0.0, 90.0)))


def stepped(law, faces, **settings):
    utc_s = NOON + 60.0 * np.arange(30)
    weather = arrange_daylight(utc_s, np.ones(30), np.ones(30), LYNGBY)
    steer = law.steer(law.SETTINGS(**settings), weather, np.tile(faces, (30, 1)), Limits())
    a, b = np.zeros(1), np.full(1, 90.0)
    for step in range(weather.shape[0]):
        a, b = steer(step, a, b)
    return float(a[0]), float(b[0])


@pytest.mark.parametrize(
    ("law", "faces", "settings"),
    [
        (mu_prime, NEARLY_EVEN, {"uniform_threshold": 0.02}),
        (sun_vector, HAZY, {"uniform_threshold": 0.3}),
        (sun_vector, SUNNY, {"albedo": 0.6}),
        (sun_vector, HAZY, {"gain_uncertainty": 0.2}),
    ],
)
def test_each_setting_changes_the_direction_of_the_live_law_and_of_its_fast_steering(law, faces, settings):
    usual, changed = aim(law, faces), aim(law, faces, **settings)
    assert abs(changed.elevation_deg - usual.elevation_deg) > 0.5
    usual, changed = stepped(law, faces), stepped(law, faces, **settings)
    assert np.hypot(changed[0] - usual[0], changed[1] - usual[1]) > 0.5


@pytest.mark.parametrize("law", [mu_prime, sun_vector])
def test_the_fast_steering_points_where_the_law_does(law):
    target = aim(law, SUNNY).target
    assert stepped(law, SUNNY) == pytest.approx((target.a_deg, target.b_deg), abs=0.5)


def test_learned_values_and_the_motion_used_in_a_day_are_shown_separately():
    shown = built(optimal_live).shown()
    assert set(shown) == {"learned", "today"}
    assert set(shown["today"]) == {"travelled_deg", "moves"}
    assert not {"day", "travelled_deg", "moves"} & set(shown["learned"])
