"""Turning out of the shade of rows: pvlib's angle where one axis turns, and the nearest pose where two do."""

import numpy as np
import pytest
from pvlib.tracking import singleaxis

from solar.ephemeris import Site, sun_position
from solar.frames import Limits, angles_within, direction_from_azimuth, normal_from_angles, separation_deg
from solar.rows.backtrack import backtracked_poses, out_of_shade
from solar.rows.group import TrackerGroup

LYNGBY = Site(55.79064, 12.52505, 50.0)
LIMITS = Limits()
LONG_M, WIDTH_M, PITCH_M = 1e5, 2.0, 5.0
FIELD = TrackerGroup.from_map([0, 5, 10, 0, 5, 10], [0, 0, 0, 5, 5, 5], (), (WIDTH_M, WIDTH_M), LYNGBY[0])


@pytest.fixture(scope="module")
def year():
    """Return the suns of a year, at a step of two hours and some minutes, so that every time of day occurs."""
    utc_s = 1451606400.0 + 8220.0 * np.arange(3800)
    sun = sun_position(utc_s, *LYNGBY)
    up = sun.elevation_deg > 0.5
    azimuth, elevation = sun.azimuth_deg[up], sun.elevation_deg[up]
    return direction_from_azimuth(azimuth, elevation, LYNGBY[0]), azimuth, elevation


@pytest.mark.parametrize("across", ["east", "north"])
def test_long_rows_of_single_axis_trackers_turn_back_to_pvlibs_backtracking_angle(year, across):
    sun, azimuth, elevation = year
    places = [0.0, PITCH_M, 2 * PITCH_M]
    if across == "east":
        limits, size_m, axis_deg = Limits(-50, 50, 90, 90), (WIDTH_M, LONG_M), 180.0
        group = TrackerGroup.from_map(places, [0.0] * 3, (), size_m, LYNGBY[0])
    else:
        limits, size_m, axis_deg = Limits(0, 0, 15, 90), (LONG_M, WIDTH_M), 90.0
        group = TrackerGroup.from_map([0.0] * 3, places, (), size_m, LYNGBY[0])
    wanted = angles_within(sun, limits)
    a_deg, b_deg = out_of_shade(group, [sun], *wanted, limits)
    found = a_deg if across == "east" else 90.0 - b_deg
    largest = 50.0 if across == "east" else 75.0
    expected = singleaxis(
        90.0 - elevation, azimuth, axis_azimuth=axis_deg, max_angle=largest, backtrack=True, gcr=WIDTH_M / PITCH_M
    )["tracker_theta"]
    lowest = -largest if across == "east" else 0.0
    np.testing.assert_allclose(found, np.clip(expected, lowest, largest), atol=0.1)
    turned = separation_deg(normal_from_angles(a_deg, b_deg), normal_from_angles(*wanted)) > 1.0
    assert 0.2 < turned.mean() < 0.6


def test_dual_axis_trackers_turn_to_the_nearest_pose_without_shade_that_is_no_steeper(year):
    sun = year[0][::80]
    wanted = angles_within(sun, LIMITS)
    a_deg, b_deg = out_of_shade(FIELD, [sun], *wanted, LIMITS)
    assert (FIELD.worst_shaded_share(sun, a_deg, b_deg) <= 1e-6).all()
    normals, before = normal_from_angles(a_deg, b_deg), normal_from_angles(*wanted)
    assert (normals[:, 2] >= before[:, 2] - 1e-9).all()
    every_a, every_b = np.meshgrid(np.arange(-50.0, 50.1, 0.5), np.arange(15.0, 90.1, 0.5))
    pose_grid = normal_from_angles(every_a.ravel(), every_b.ravel())
    turned = np.flatnonzero(FIELD.worst_shaded_share(sun, *wanted) > 0.0)
    assert turned.size > 8
    for row in turned:
        # The poses of the lattice are up to half a degree from the best.
        nearer = separation_deg(pose_grid, before[row]) < separation_deg(normals[row], before[row]) - 0.4
        level = nearer & (pose_grid[:, 2] >= before[row, 2])
        assert (FIELD.worst_shaded_share(sun[row], every_a.ravel()[level], every_b.ravel()[level]) > 0.0).all()


@pytest.mark.parametrize("groups", [0, 1, 3])
def test_a_group_set_to_turn_back_only_if_it_pays_does_so_only_where_it_gets_more_beam(year, groups):
    sun = year[0][::10]
    wanted = angles_within(sun, LIMITS)
    east_m, north_m = [0, 5, 10, 0, 5, 10], [0, 0, 0, 5, 5, 5]
    asked, always = (
        TrackerGroup.from_map(east_m, north_m, (), (WIDTH_M, WIDTH_M), LYNGBY[0], groups, only_if_it_pays=pays)
        for pays in (True, False)
    )
    turned = out_of_shade(always, [sun], *wanted, LIMITS)
    np.testing.assert_array_equal(backtracked_poses(always, [sun], *wanted, LIMITS), turned)
    here, there = (asked.beam_share(sun, *pose) for pose in (wanted, turned))
    better = there > here
    assert better.any()
    assert (there < here).any()
    expected = np.where(better, turned, wanted)
    np.testing.assert_array_equal(backtracked_poses(asked, [sun], *wanted, LIMITS), expected)


def test_unshaded_and_nan_poses_are_left_unchanged_beside_a_shaded_one_that_turns():
    sun = direction_from_azimuth([180.0, 180.0, 100.0], [50.0, 50.0, 8.0], LYNGBY[0])
    a_deg, b_deg = out_of_shade(FIELD, [sun], np.array([1.25, np.nan, -40.0]), np.array([50.5, 50.0, 60.0]), LIMITS)
    assert (a_deg[0], b_deg[0]) == (1.25, 50.5)
    assert np.isnan(a_deg[1])
    assert (a_deg[2], b_deg[2]) != (-40.0, 60.0)


def test_the_pose_out_of_the_shade_stays_nearly_the_same_from_sunset_on():
    azimuths, elevations = [295.0, 295.0, 295.0], [0.06, 0.0, -4.0]
    poses = [
        out_of_shade(FIELD, [direction_from_azimuth(azimuth, elevation, LYNGBY[0])], 45.0, 40.0, LIMITS)
        for azimuth, elevation in zip(azimuths, elevations, strict=True)
    ]
    normals = normal_from_angles(*np.array(poses).T)
    assert separation_deg(normals, normals[0]).max() < 0.5


def test_a_pose_chosen_for_two_suns_has_no_shade_under_either():
    evening = [direction_from_azimuth(azimuth, up, LYNGBY[0]) for azimuth, up in ((262.0, 9.0), (265.0, 7.0))]
    wanted = angles_within(evening[0], LIMITS)
    at_once, lasting = (out_of_shade(FIELD, suns, *wanted, LIMITS) for suns in (evening[:1], evening))
    assert (
        FIELD.worst_shaded_share(evening[0], *at_once) <= 1e-6 < 0.05 < FIELD.worst_shaded_share(evening[1], *at_once)
    )
    assert max(FIELD.worst_shaded_share(sun, *lasting) for sun in evening) <= 1e-6
    again = out_of_shade(FIELD, evening, *at_once, LIMITS)
    assert max(FIELD.worst_shaded_share(sun, *again) for sun in evening) <= 1e-6


def test_on_a_slope_where_every_pose_is_shaded_the_least_shaded_one_is_taken():
    sun = direction_from_azimuth(180.0, 3.0, LYNGBY[0])
    south_is_higher = TrackerGroup.from_map([0, 0], [0, 4.0], [0.8, 0.0], (50.0, 2.0), LYNGBY[0])
    a_deg, b_deg = out_of_shade(south_is_higher, [sun], 0.0, 15.0, Limits(-10, 10, 15, 60))
    every = np.meshgrid(np.arange(-10.0, 10.1, 1.0), np.arange(15.0, 60.1, 1.0))
    pose_grid = south_is_higher.worst_shaded_share(sun, *every)
    assert pose_grid.min() > 0.01
    assert south_is_higher.worst_shaded_share(sun, a_deg, b_deg) <= pose_grid.min() + 1e-3


def test_an_unknown_sun_leaves_its_own_pose_unchanged_and_other_poses_turn():
    sun = direction_from_azimuth(100.0, 8.0, LYNGBY[0])
    pairs = np.stack([sun, [np.nan] * 3]), np.stack([sun, sun])
    a_deg, b_deg = out_of_shade(FIELD, pairs, np.array([-40.0, -40.0]), np.array([60.0, 60.0]), LIMITS)
    assert (a_deg[1], b_deg[1]) == (-40.0, 60.0)
    assert (a_deg[0], b_deg[0]) != (-40.0, 60.0)
