"""The law `optimal` over time."""

import math
from dataclasses import replace

import numpy as np
import pytest

from solar.ephemeris import sun_direction
from solar.frames import Limits, angles_within, direction_from_azimuth, normal_from_angles, separation_deg
from solar.laws.light import dot_with_normal, economical_pose
from solar.laws.optimal import OptimalLaw, OptimalSettings
from solar.skies.sky import sky

pytestmark = pytest.mark.slow

LIMITS = Limits()
SITE = (48.7176, 2.2090, 156.0)
NOON = 1665576000.0  # 2022-10-12 12:00 UTC
SETTINGS = OptimalSettings()
NORMALS = np.array([[0.0, 1, 0], [1, 0, 0], [0, -1, 0], [0, 0, 1]])


def faces_at(utc_s, dni, dhi):
    return sky("isotropic", sun_direction(utc_s, *SITE), dni, dhi, 1360.0).irradiance_on(NORMALS)


def day(dni_of_minute, *, settings=SETTINGS, minutes=240, dhi=150.0, start=NOON - 7200, fault=None):
    """Run the law by the minute; returns the poses and the law."""
    law = OptimalLaw(settings, LIMITS)
    a, b, poses = 0.0, 90.0, []
    for minute in range(minutes):
        utc_s = start + 60.0 * minute
        faces = faces_at(utc_s, dni_of_minute(minute), dhi)
        if fault is not None:
            faces[fault] = np.nan
        law.observe(faces, sun_direction(utc_s, *SITE), 60.0)
        ahead = sun_direction(utc_s + settings.lead_s, *SITE)
        choice = law.decide(a, b, ahead, 1.0 - minute / minutes)
        a, b = float(choice.a_deg), float(choice.b_deg)
        poses.append((a, b))
    return np.array(poses), law


def off_sun_deg(pose, utc_s):
    return float(separation_deg(normal_from_angles(*pose), sun_direction(utc_s, *SITE)))


def test_a_clear_sky_is_followed_within_a_few_degrees_by_a_few_moves_an_hour():
    poses, law = day(lambda _minute: 800.0, dhi=80.0)
    off = [off_sun_deg(pose, NOON - 7200 + 60 * (minute + 1)) for minute, pose in enumerate(poses)]
    assert max(off[5:]) < 5.0
    assert law.moves <= 4 * 12


def test_under_a_sky_without_beam_the_law_stays_flat_and_makes_no_move():
    poses, law = day(lambda _minute: 0.0)
    np.testing.assert_allclose(poses[-1], [0.0, 90.0], atol=2.0)
    assert law.moves == 0


def test_a_gap_of_one_minute_in_the_beam_causes_no_move_and_a_long_one_does():
    steady, _ = day(lambda _minute: 800.0)
    blink, _ = day(lambda minute: 0.0 if minute == 120 else 800.0)
    assert np.abs(blink[121] - steady[121]).sum() < 5.0
    cloud, _ = day(lambda minute: 0.0 if minute >= 120 else 800.0)
    assert cloud[-1][1] > 80.0


def test_the_law_lies_as_flat_as_the_limits_allow_while_no_pose_can_face_the_sun():
    # Near midnight of a summer far in the north: the sun is behind the tracker, where the axis does not go.
    limits, place, evening = Limits(-50.0, 50.0, 15.0, 60.0), (68.0, 2.2090, 0.0), 1655850600.0  # 2022-06-21 22:30
    sun = sun_direction(evening, *place)
    law = OptimalLaw(replace(SETTINGS, price_per_degree_w_m2=0.0), limits)
    for _ in range(60):
        law.observe(sky("isotropic", sun, 600.0, 100.0, 1320.0).irradiance_on(NORMALS), sun, 60.0)
    choice = law.decide(50.0, 15.0, sun, 1.0)
    assert choice.move
    np.testing.assert_allclose((choice.a_deg, choice.b_deg), (0.0, 60.0), atol=1.0)


@pytest.mark.parametrize("thrift", [0.0, 0.09, -1.0, 101.0, math.nan])
def test_a_thrift_outside_0_1_to_100_is_refused(thrift):
    with pytest.raises(ValueError, match=r"not in 0\.1\.\.100"):
        OptimalSettings(thrift=thrift)


def test_the_law_travels_less_with_a_higher_thrift():
    def sky_of(minute):
        return 700.0 if (minute // 7) % 2 else 0.0

    travelled = [float(day(sky_of, settings=replace(SETTINGS, thrift=t))[1].travelled_deg) for t in (0.25, 1.0, 8.0)]
    assert travelled[0] > travelled[1] > travelled[2]


@pytest.mark.parametrize(("travel", "moves"), [(0.0, 250), (60.0, 250), (300.0, 250), (1300.0, 0), (1300.0, 7)])
def test_the_days_budget_of_travel_and_of_moves_is_never_exceeded(travel, moves):
    settings = replace(SETTINGS, travel_per_day_deg=travel, moves_per_day=moves)
    poses, law = day(lambda minute: 800.0 * (minute % 20 < 10), settings=settings)
    way = np.abs(np.diff(poses, axis=0, prepend=[[0.0, 90.0]])).sum(axis=1)
    assert way.sum() <= travel + 1e-9
    assert np.count_nonzero(way) <= moves
    assert law.moves == np.count_nonzero(way)
    assert law.travelled_deg == pytest.approx(way.sum())


@pytest.mark.parametrize("fault", range(4))
def test_with_one_face_missing_the_sun_is_still_followed(fault):
    poses, _ = day(lambda _minute: 800.0, dhi=80.0, fault=fault)
    assert off_sun_deg(poses[-1], NOON + 7200) < 6.0


@pytest.mark.parametrize(("azimuth_deg", "face", "a_deg"), [(80.0, 0, -50.0), (280.0, 2, 50.0)])
def test_a_low_sun_is_followed_even_if_the_only_face_that_would_show_it_is_dead(azimuth_deg, face, a_deg):
    # A clear April dawn in steps of a minute: under its beam the east face would read 80 to 150 W/m2.
    law = OptimalLaw(SETTINGS, LIMITS)
    for elevation_deg, side, zenith in ((0.2, 2.5, 4.4), (0.5, 4.0, 6.7), (1.3, 7.4, 11.2), (1.5, 8.4, 12.6)):
        faces = np.array([side, side, side, zenith])
        faces[face] = 0.2
        sun = direction_from_azimuth(azimuth_deg, elevation_deg, SITE[0])
        law.observe(faces, sun, 60.0)
    choice = law.choose(0.0, 90.0, sun, 1.0)
    assert choice.move
    assert choice.a_deg == pytest.approx(a_deg, abs=1.0)


def test_with_two_faces_missing_the_law_is_chronometric():
    poses, law = day(lambda _minute: 0.0, fault=[0, 3])
    assert not law.expect().known
    a_deg, b_deg = angles_within(sun_direction(NOON + 7200 - 60 + 240, *SITE), LIMITS)
    np.testing.assert_allclose(poses[-1], [a_deg, b_deg], atol=2.5)


def test_the_gain_of_a_move_and_its_price_by_length_and_thrift_match_a_calculation_by_hand():
    # Without faces the sun counts, as 500 W/m2 of beam, from A 10 to near 0 deg and from B 60 to near 30 deg.
    sun = normal_from_angles(0.0, 30.0)
    choice = OptimalLaw(replace(SETTINGS, thrift=2.0), LIMITS).choose(10.0, 60.0, sun, 1.0)
    # Each axis stops where another degree would gain exactly its price of 0.05 W/m2.
    short_deg = math.degrees(math.asin(0.05 / (500.0 * math.radians(1.0))))
    assert short_deg == pytest.approx(0.33, abs=0.01)
    assert choice.b_deg == pytest.approx(30.0 + short_deg)
    assert choice.a_deg == pytest.approx(short_deg, rel=1e-4)
    assert choice.price_w_m2 == pytest.approx(2.0 * (0.15 + 0.025 * (40.0 - choice.a_deg - (choice.b_deg - 30.0))))
    gained = math.cos(math.radians(choice.a_deg)) * math.cos(math.radians(choice.b_deg - 30.0))
    assert choice.gain_w_m2 == pytest.approx(
        500.0 * (gained - math.cos(math.radians(10.0)) * math.cos(math.radians(30.0)))
    )


@pytest.mark.parametrize("place", [(10.0, 60.0), (-40.0, 20.0), (0.0, 90.0), (30.0, 31.0)])
@pytest.mark.parametrize("pose", [(-30.0, 40.0), (0.0, 30.0), (20.0, 75.0)])
@pytest.mark.parametrize("price", [0.01, 0.1, 0.3])
def test_an_axis_goes_as_far_as_its_last_degree_pays_and_no_further(place, pose, price):
    vector = 200.0 * normal_from_angles(*pose)
    here = np.asarray(place)
    a, b = economical_pose(vector, place, angles_within(vector, LIMITS)[0], price, LIMITS)
    reached = np.array([float(a), float(b)])

    def worth(angles):
        return float(dot_with_normal(vector, *angles)) - price * np.abs(angles - here).sum()

    # The axes are chosen one after the other, which loses a hundredth of a W/m2.
    grid = [np.array([one, other]) for one in np.arange(-50.0, 50.1, 1.0) for other in np.arange(15.0, 90.1, 1.0)]
    assert worth(reached) >= max(worth(angles) for angles in grid) - 0.02
    assert LIMITS.contain(*reached)
    # Never beyond the best, and never away from it.
    assert (np.abs(reached - np.asarray(pose)) <= np.abs(here - np.asarray(pose)) + 1e-6).all()


def test_towards_a_best_pose_beyond_the_limits_each_axis_moves_right_to_its_limit():
    # The slope does not vanish there: nothing is left out before the limit.
    vector = 300.0 * normal_from_angles(-80.0, 5.0)
    a, b = economical_pose(vector, (0.0, 90.0), angles_within(vector, LIMITS)[0], 0.05, LIMITS)
    assert (a, b) == (LIMITS.a_min_deg, LIMITS.b_min_deg)


def test_no_axis_moves_at_a_huge_price_per_degree_and_both_move_all_the_way_at_none():
    vector = 200.0 * normal_from_angles(20.0, 40.0)
    best_a, _ = angles_within(vector, LIMITS)
    assert economical_pose(vector, (0.0, 90.0), best_a, 1e12, LIMITS) == (0.0, 90.0)
    np.testing.assert_allclose(economical_pose(vector, (0.0, 90.0), best_a, 0.0, LIMITS), (20.0, 40.0), atol=1e-9)


def test_a_budget_used_faster_than_the_daylight_raises_the_price_by_the_sixth_power_of_the_ratio():
    # 0.8 of the travel is left for 0.9 of the daylight. Without a price per degree no axis stops short.
    law = OptimalLaw(replace(SETTINGS, price_per_degree_w_m2=0.0), LIMITS)
    sun = normal_from_angles(0.0, 30.0)
    usual = law.choose(10.0, 60.0, sun, 1.0).price_w_m2
    law.book(260.0)
    assert (law.travelled_deg, law.moves) == (260.0, 1)
    assert law.choose(10.0, 60.0, sun, 0.9).price_w_m2 == pytest.approx(usual * (0.9 / 0.8) ** 6)
    assert law.choose(10.0, 60.0, sun, 0.7).price_w_m2 == pytest.approx(usual)


def test_after_a_gap_of_half_an_hour_the_memory_of_the_light_starts_anew():
    law = OptimalLaw(SETTINGS, LIMITS)
    for minute in range(30):
        law.observe(faces_at(NOON + 60 * minute, 800.0, 100.0), sun_direction(NOON + 60 * minute, *SITE), 60.0)
    law.observe(np.full(4, np.nan), sun_direction(NOON + 3600, *SITE), 1800.0)
    assert not law.expect().known
    law.observe(faces_at(NOON + 3660, 0.0, 200.0), sun_direction(NOON + 3660, *SITE), 60.0)
    assert law.expect().light.beam == pytest.approx(0.0, abs=1.0)


def test_days_computed_side_by_side_give_the_same_poses_as_one_by_one():
    both = OptimalLaw(SETTINGS, LIMITS, (2,))
    single = [OptimalLaw(SETTINGS, LIMITS) for _ in range(2)]
    pose = np.array([[0.0, 0.0], [90.0, 90.0]])
    alone = pose.T.copy()
    for minute in range(60):
        utc_s = NOON + 60.0 * minute
        faces = np.stack([faces_at(utc_s, 700.0, 100.0), faces_at(utc_s, 700.0 * (minute % 9 < 4), 200.0)])
        sun, ahead = sun_direction(utc_s, *SITE), sun_direction(utc_s + SETTINGS.lead_s, *SITE)
        both.observe(faces, np.stack([sun, sun]), 60.0)
        choice = both.decide(pose[0], pose[1], np.stack([ahead, ahead]), 0.5)
        pose = np.stack([choice.a_deg, choice.b_deg])
        for index, law in enumerate(single):
            law.observe(faces[index], sun, 60.0)
            one = law.decide(alone[index][0], alone[index][1], ahead, 0.5)
            alone[index] = float(one.a_deg), float(one.b_deg)
    np.testing.assert_allclose(pose.T, alone)


def test_a_new_day_resets_the_budget_and_takes_over_what_the_day_taught():
    _, law = day(lambda minute: 800.0 * (minute % 20 < 10))
    assert law.moves > 0
    before = law.site.learned
    law.new_day()
    assert law.site.learned != before, "what the day taught is taken over"
    assert law.moves == 0
    assert law.travelled_deg == 0


def test_while_the_sun_is_below_the_horizon_the_law_makes_no_move():
    law = OptimalLaw(SETTINGS, LIMITS)
    choice = law.decide(10.0, 40.0, np.array([0.6, 0.7, -0.4]), 0.0)
    assert not choice.move
    assert (choice.a_deg, choice.b_deg) == (10.0, 40.0)
