"""The laws among neighbours: out of their shade, or where most light is collected despite it; and alone as ever."""

from dataclasses import replace

import numpy as np
import pytest

from solar.energy import arrange_daylight, build_sky, face_irradiances
from solar.ephemeris import Site, sun_direction, sun_position
from solar.frames import Angles, Limits, angles_within, direction_from_azimuth, normal_from_angles
from solar.laws import chronometric, mu_prime, optimal_live
from solar.laws.in_rows import best_poses_of_group, taken_by_neighbours
from solar.laws.law import Moment, Reading, TrackerFacts
from solar.laws.light import Light, aim_vector, dot_with_normal
from solar.laws.optimal import OptimalLaw, OptimalSettings
from solar.laws.steer import steer_by_readings
from solar.rows.backtrack import out_of_shade
from solar.rows.group import TrackerGroup

LIMITS = Limits()
NORMALS = np.array([[0, 1, 0], [1, 0, 0], [0, -1, 0], [0, 0, 1]])
LYNGBY = Site(55.79064, 12.52505, 50.0)
EAST_M, NORTH_M = [0, 5, 10, 0, 5, 10], [0, 0, 0, 5, 5, 5]
FIELD = TrackerGroup.from_map(EAST_M, NORTH_M, (), (2.0, 2.0), LYNGBY[0], only_if_it_pays=False)
FAR_APART = TrackerGroup.from_map([0, 1e5], [0, 0], (), (2.0, 2.0), LYNGBY[0])
EVENING = 1474644900.0  # 2016-09-23 15:35 UTC
MORNING = 1458712800.0  # 2016-03-23 06:00 UTC, the sun 7 deg up


@pytest.fixture(scope="module")
def clear_day():
    """Return a clear day in March in steps of five minutes, and what the faces read."""
    utc_s = 1458691200.0 + 300.0 * np.arange(288)
    weather = arrange_daylight(utc_s, np.full(utc_s.size, 750.0), np.full(utc_s.size, 70.0), LYNGBY, 300.0)
    return weather, face_irradiances(build_sky(weather, "isotropic"), 0.2)


def facts(group, utc_s=MORNING):
    return TrackerFacts(site=LYNGBY, limits=LIMITS, scan_every_s=5.0, decide_every_s=300.0, utc_s=utc_s, group=group)


def steps_of(steer, weather):
    steps, days = weather.shape
    a, b = np.zeros(days), np.full(days, 90.0)
    poses = []
    for step in range(steps):
        a, b = steer(step, a, b)
        poses.append((a.copy(), b.copy()))
    return np.array(poses)


@pytest.mark.parametrize("law", [chronometric, mu_prime, optimal_live])
def test_without_neighbours_in_reach_every_decision_is_that_of_a_tracker_alone(clear_day, law):
    weather, faces = clear_day
    settings = law.SETTINGS()
    alone = steps_of(law.steer(settings, weather, faces, LIMITS), weather)
    np.testing.assert_array_equal(
        steps_of(law.steer(settings, weather, faces, LIMITS, group=FAR_APART), weather), alone
    )
    builds = [lambda told, group=group: law.build(settings, replace(told, group=group)) for group in (None, FAR_APART)]
    one_by_one = [steps_of(steer_by_readings(build, weather, faces, LIMITS), weather) for build in builds]
    np.testing.assert_array_equal(*one_by_one)


@pytest.mark.parametrize("law", [chronometric, mu_prime])
def test_the_fast_steering_turns_out_of_the_shade_as_the_law_itself_does(clear_day, law):
    weather, faces = clear_day
    settings = law.SETTINGS()
    fast = steps_of(law.steer(settings, weather, faces, LIMITS, group=FIELD), weather)
    alone = steps_of(law.steer(settings, weather, faces, LIMITS), weather)
    slow = steps_of(
        steer_by_readings(lambda told: law.build(settings, replace(told, group=FIELD)), weather, faces, LIMITS), weather
    )
    assert np.abs(fast - alone).max() > 20.0
    if law is mu_prime:
        np.testing.assert_allclose(slow, fast, atol=1e-9)
    else:
        # The fast way takes the sun of each step, and the law that of the step before.
        np.testing.assert_allclose(slow[2:-3], fast[1:-4], atol=1e-9)


def test_a_law_that_turns_back_out_of_the_shade_says_so_and_reports_the_direction_that_it_wanted():
    sun = sun_position(MORNING, *LYNGBY)
    alone, among = (
        chronometric.build(chronometric.SETTINGS(), facts(group)).aim(Moment(MORNING, None, None))
        for group in (None, FIELD)
    )
    assert among.azimuth_deg == alone.azimuth_deg == pytest.approx(sun.azimuth_deg)
    to_sun = direction_from_azimuth(sun.azimuth_deg, sun.elevation_deg, LYNGBY[0])
    assert FIELD.worst_shaded_share(to_sun, *alone.target) > 0.1
    assert FIELD.worst_shaded_share(to_sun, *among.target) <= 1e-6
    assert LIMITS.contain(*among.target)
    assert "turned back by" in among.why
    assert among.why.startswith(alone.why)
    assert "turned back" not in alone.why


def test_while_the_suns_position_is_unknown_a_law_does_not_turn_out_of_the_shade():
    faces = (600.0, 300.0, 50.0, 200.0)
    law = mu_prime.build(mu_prime.SETTINGS(), facts(FIELD))
    sure, unsure = (law.aim(Moment(MORNING, faces, None, sun_known=known)).target for known in (True, False))
    alone = mu_prime.build(mu_prime.SETTINGS(), facts(None)).aim(Moment(MORNING, faces, None)).target
    assert sure != alone
    assert unsure == alone


@pytest.mark.parametrize("groups", [0, 3])
@pytest.mark.parametrize(("beam", "diffuse"), [(800.0, 60.0), (150.0, 150.0), (0.8, 0.06)])
def test_the_best_pose_among_neighbours_collects_no_less_than_the_pose_alone_or_turned_back(groups, beam, diffuse):
    field = TrackerGroup.from_map(EAST_M, NORTH_M, (), (2.0, 2.0), LYNGBY[0], groups)
    azimuth, elevation = (part.ravel() for part in np.meshgrid([95.0, 130.0, 180.0, 250.0], [3.0, 8.0, 15.0]))
    sun = direction_from_azimuth(azimuth, elevation, LYNGBY[0])
    beams, zero = np.full(azimuth.size, beam), np.zeros(azimuth.size)
    vector = aim_vector(Light(beams, zero + diffuse, zero), sun)
    alone = angles_within(vector, LIMITS)
    best = best_poses_of_group(field, vector, beams, [sun], alone, LIMITS)
    back = out_of_shade(field, [sun], *alone, LIMITS)

    def collected(pose):
        return dot_with_normal(vector, *pose) - taken_by_neighbours(field, beams, [sun], *pose)

    assert (collected(best) >= collected(alone)).all()
    assert (collected(best) >= collected(back)).all()
    assert (collected(best) > collected(alone) + beam / 200.0).any()
    assert all(LIMITS.contain(*pose) for pose in zip(*best, strict=True))


@pytest.mark.parametrize("way_deg", [(0.0, 90.0), (-40.0, 75.0)])
def test_where_neighbours_cast_shade_the_optimal_law_moves_all_the_way_to_the_best_pose(way_deg):
    sun = sun_direction(MORNING, *LYNGBY)
    vector = 500.0 * sun
    alone = angles_within(vector, LIMITS)
    best = best_poses_of_group(FIELD, vector, np.array(500.0), [sun], alone, LIMITS)
    choice = OptimalLaw(OptimalSettings(thrift=4.0), LIMITS, group=FIELD).choose(*way_deg, sun, 1.0)
    assert choice.move
    assert taken_by_neighbours(FIELD, np.array(500.0), [sun], *alone) > 0.0
    np.testing.assert_array_equal((choice.a_deg, choice.b_deg), best)


def test_the_light_lost_to_neighbours_over_several_suns_is_the_mean_of_that_under_each():
    suns = [direction_from_azimuth(265.0, elevation, LYNGBY[0]) for elevation in (12.0, 6.0)]
    pose, beam = (45.0, 40.0), np.array(700.0)
    both, each = (
        taken_by_neighbours(FIELD, beam, suns, *pose),
        [taken_by_neighbours(FIELD, beam, [s], *pose) for s in suns],
    )
    assert both == pytest.approx(sum(each) / 2.0)
    assert 0.0 < each[0] != each[1] > 0.0
    lit = suns[0] @ normal_from_angles(*pose)
    assert each[0] == pytest.approx(700.0 * lit * FIELD.shade(suns[0], *pose).lost)


def test_the_optimal_law_counts_the_shade_of_all_the_time_that_a_pose_is_to_last():
    evening, lower = (sun_direction(EVENING + seconds, *LYNGBY) for seconds in (240.0, 600.0))
    law = OptimalLaw(OptimalSettings(), LIMITS, group=FIELD)
    law.observe(700.0 * np.maximum(NORMALS @ evening, 0.0) + [40.0, 40.0, 40.0, 70.0], evening, 60.0)
    at_once, lasting = (law.choose(0.0, 90.0, evening, 0.1, later) for later in (None, lower))

    def collected(choice):
        taken = taken_by_neighbours(FIELD, np.array(700.0), [evening, lower], choice.a_deg, choice.b_deg)
        return dot_with_normal(choice.vector, choice.a_deg, choice.b_deg) - taken

    assert collected(lasting) > collected(at_once) + 5.0


@pytest.mark.parametrize("lasts", [False, True])
def test_the_gain_of_a_move_counts_the_shade_at_the_old_pose_and_at_the_new_one(lasts):
    # With so low a sun the best pose has some shade too.
    sun, later = (direction_from_azimuth(265.0, elevation, LYNGBY[0]) for elevation in (5.0, 3.0))
    law = OptimalLaw(OptimalSettings(), LIMITS, group=FIELD)
    law.observe(700.0 * np.maximum(NORMALS @ sun, 0.0) + [40.0, 40.0, 40.0, 70.0], sun, 60.0)
    before = (50.0, 15.0)
    choice = law.choose(*before, sun, 0.1, later if lasts else None)
    suns = [sun, later] if lasts else [sun]
    poses = (choice.a_deg, choice.b_deg), before
    there, here = (taken_by_neighbours(FIELD, law.expect().light.beam, suns, *pose) for pose in poses)
    more, less = (dot_with_normal(choice.vector, *pose) for pose in poses)
    assert choice.move
    assert here > there + 20.0 > 200.0
    assert choice.gain_w_m2 == pytest.approx((more - there) - (less - here))


def test_no_pose_on_a_lattice_of_1_degree_collects_more_than_the_best_pose_among_neighbours():
    sun, beam = direction_from_azimuth(130.0, 15.0, LYNGBY[0]), np.array(150.0)
    vector = aim_vector(Light(beam, beam, np.array(0.0)), sun)
    best = best_poses_of_group(FIELD, vector, beam, [sun], angles_within(vector, LIMITS), LIMITS)
    every = np.meshgrid(np.arange(-50.0, 51.0), np.arange(15.0, 91.0))
    of_best, of_every = (
        dot_with_normal(vector, *pose) - taken_by_neighbours(FIELD, beam, [sun], *pose) for pose in (best, every)
    )
    assert of_best >= of_every.max()


def test_the_optimal_law_leaves_a_shaded_pose_that_a_tracker_alone_would_keep():
    """A move out of a pose that has become shaded is worth more than its gain without shade."""
    to_sun = direction_from_azimuth(*sun_position(MORNING, *LYNGBY)[:2], LYNGBY[0])
    faces = 700.0 * np.maximum(NORMALS @ to_sun, 0.0)
    faces += np.array([40.0, 40.0, 40.0, 70.0])
    laws = [optimal_live.build(optimal_live.SETTINGS(), facts(group)) for group in (None, FIELD)]
    for law in laws:
        for scan in range(120):
            law.observe(Reading(MORNING - 600.0 + 5.0 * scan, 5.0 * scan, tuple(faces)))
    alone = laws[0].aim(Moment(MORNING, tuple(faces), Angles(0.0, 90.0))).target
    # A tracker alone would stay here; this one turns out of the shade.
    stays, turns = (law.aim(Moment(MORNING + 1.0, tuple(faces), alone)) for law in laws)
    assert stays.target is None
    assert turns.target is not None
    assert FIELD.shade(to_sun, *turns.target).lost < FIELD.shade(to_sun, *alone).lost
