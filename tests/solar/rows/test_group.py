"""The shade that trackers of a group cast on each other, against rays traced one by one and against pvlib."""

import copy

import numpy as np
import pytest
from pvlib.shading import direct_martinez, shaded_fraction1d

from solar.frames import azimuth_from_direction, direction_from_azimuth, normal_from_angles
from solar.rows.group import TrackerGroup

LYNGBY_DEG = 55.79
SIDE = 80


def field(columns=3, rows=2, pitch_m=5.0, size_m=(2.0, 2.0), up_m=(), groups=3):
    east, north = (pitch_m * part.ravel() for part in np.meshgrid(np.arange(columns), np.arange(rows)))
    return TrackerGroup.from_map(east.tolist(), north.tolist(), up_m, size_m, LYNGBY_DEG, groups)


def traced(offsets_m, sun, a_deg, b_deg, size_m):
    """Return the shaded share of a module by rays from a lattice of its points."""
    normal = normal_from_angles(a_deg, b_deg)
    along = np.array([-np.sin(np.radians(b_deg)), 0.0, np.cos(np.radians(b_deg))])
    across = np.cross(along, normal)
    steps = (np.arange(SIDE) + 0.5) / SIDE - 0.5
    x, y = (part.ravel() for part in np.meshgrid(steps * size_m[0], steps * size_m[1]))
    points = np.outer(x, across) + np.outer(y, along)
    dark = np.zeros(len(points), dtype=bool)
    for offset in offsets_m[np.any(offsets_m != 0.0, axis=-1)]:
        way = ((offset - points) @ normal) / (sun @ normal)
        hit = points + np.outer(way, sun) - offset
        dark |= (way > 0.0) & (abs(hit @ across) < size_m[0] / 2) & (abs(hit @ along) < size_m[1] / 2)
    return dark.mean()


@pytest.mark.parametrize(("size_m", "up_m"), [((2.0, 2.0), ()), ((3.0, 1.0), (0.0, 0.4, 0.8, 0.1, 0.5, 0.9))])
def test_the_shaded_share_of_every_tracker_agrees_with_ray_tracing(size_m, up_m):
    group = field(4 if not up_m else 3, 2, 3.2, size_m, up_m)
    random = np.random.default_rng(7)
    together = 0
    for _ in range(60):
        sun = direction_from_azimuth(random.uniform(60, 300), random.uniform(3, 25), LYNGBY_DEG)
        a_deg, b_deg = random.uniform(-50, 50), random.uniform(15, 90)
        if sun @ normal_from_angles(a_deg, b_deg) < 0.1:
            continue
        found = group.shade_of_each(sun, a_deg, b_deg).share
        seen = [traced(offsets, sun, a_deg, b_deg, size_m) for offsets in group.offsets_m]
        np.testing.assert_allclose(found, seen, atol=3.0 / SIDE)
        worst = group.worst_shaded_share(sun, a_deg, b_deg)
        # The worst share is from one neighbour; several together shade more.
        assert worst <= found.max() + 1e-9 or worst == pytest.approx(found.max())
        together += bool((found > worst + 0.01).any())
    assert together > 3


def test_long_rows_shade_each_other_as_pvlib_says():
    group = TrackerGroup.from_map([0.0, 5.0], [0.0, 0.0], (), (2.0, 1e6), LYNGBY_DEG)
    azimuth, elevation = (part.ravel() for part in np.meshgrid([95.0, 120.0, 250.0], [4.0, 9.0, 16.0, 30.0]))
    sun = direction_from_azimuth(azimuth, elevation, LYNGBY_DEG)
    a_deg = np.where(azimuth < 180.0, -45.0, 45.0)
    expected = shaded_fraction1d(90.0 - elevation, azimuth, 180.0, a_deg, collector_width=2.0, pitch=5.0)
    np.testing.assert_allclose(group.worst_shaded_share(sun, a_deg, 90.0), expected, atol=1e-4)
    # Of two rows, the one towards the sun has no shade.
    np.testing.assert_allclose(group.shade(sun, a_deg, 90.0).share, expected / 2.0, atol=1e-4)
    assert (expected > 0.3).any()
    assert (expected == 0.0).any()


def test_bypass_groups_lose_as_much_beam_as_in_pvlibs_martinez_model():
    # With the sun due east or west the shadow moves only across the groups: it touches as many as it covers.
    for elevation_deg, side in ((4.0, 1), (9.0, 1), (15.0, 1), (4.0, -1), (9.0, -1), (15.0, -1)):
        sun = direction_from_azimuth(180.0 - 90.0 * side, elevation_deg, LYNGBY_DEG)
        places = field(2, 1).shade_of_each(sun, -45.0 * side, 90.0)
        share = places.share.max()
        lost = direct_martinez(1.0, 1.0, share, np.ceil(3.0 * share), 3)
        assert 0.1 < share < 0.9
        np.testing.assert_allclose(np.sort(places.lost), [0.0, lost], atol=1e-9)
        bare = field(2, 1, groups=0).shade_of_each(sun, -45.0 * side, 90.0)
        np.testing.assert_allclose(bare.lost, bare.share, atol=1e-12)


def test_flat_modules_have_no_shade_and_backs_to_the_sun_have_a_worst_share_of_1_but_lose_nothing():
    group, low = field(), direction_from_azimuth([90.0, 180.0, 270.0], 1.0, LYNGBY_DEG)
    np.testing.assert_array_equal(group.worst_shaded_share(low, 0.0, 90.0), 0.0)
    away = group.shade(low[0], 50.0, 90.0)
    assert (away.share, away.lost) == (0.0, 0.0)
    assert group.worst_shaded_share(low[0], 50.0, 90.0) == 1.0


def test_a_neighbour_on_the_equators_side_casts_shade_in_both_hemispheres():
    for latitude_deg, azimuth_deg in ((55.0, 180.0), (-30.0, 0.0)):
        group = TrackerGroup.from_map([0.0, 0.0], [0.0, 4.0], (), (2.0, 2.0), latitude_deg)
        towards = direction_from_azimuth(azimuth_deg, 10.0, latitude_deg)
        azimuth, _ = azimuth_from_direction(towards, latitude_deg)
        assert azimuth == pytest.approx(azimuth_deg)
        assert group.worst_shaded_share(towards, 0.0, 20.0) > 0.3


def test_equivalent_places_of_a_large_field_are_computed_once():
    group = field(20, 10, 5.0)
    assert group.count == 200
    assert len(group.offsets_m) < 60
    assert group.weights.sum() == pytest.approx(1.0)
    assert group.offsets_m.shape[1] == 25
    assert copy.deepcopy(group) is group


@pytest.mark.parametrize(
    ("positions", "size"),
    [
        (np.zeros((2, 3, 3)), (2, 2)),
        ([[0, 0, 0]], (2, 2)),
        ([[0, 0, 0], [np.nan, 0, 0]], (2, 2)),
        ([[0, 0], [1, 0]], (2, 2)),
        (np.eye(3), (-2, 2)),
    ],
)
def test_a_group_with_invalid_positions_or_module_size_is_refused(positions, size):
    with pytest.raises(ValueError, match="group"):
        TrackerGroup(positions, *size)


@pytest.mark.parametrize("size", [(2, 0), (0, 2), (2, -1), (np.inf, 2), (2, np.inf), (np.nan, 2), (2, 2, -1)])
def test_a_module_with_an_impossible_size_or_number_of_bypass_groups_is_refused(size):
    with pytest.raises(ValueError, match=r"a module of \S+ by \S+ m with \S+ groups is not possible"):
        TrackerGroup(np.eye(3), *size)


def test_modules_with_one_bypass_group_or_none_and_small_modules_are_accepted():
    assert [TrackerGroup(np.eye(3), 2, 1, groups).bypass_groups for groups in (0, 1)] == [0, 1]
    assert TrackerGroup(np.eye(3)[:2], 2, 1).size_m == (2.0, 1.0)
    assert TrackerGroup(np.eye(3)[:2], 0.5, 0.25).size_m == (0.5, 0.25)


def test_a_tracker_that_is_higher_on_the_map_is_higher_in_the_groups_offsets():
    group = TrackerGroup.from_map([0.0, 3.0], [0.0, 4.0], [0.0, 1.5], (2.0, 1.0), 48.0)
    # The frame's axes point south, east and up: north is negative.
    far = group.offsets_m.reshape(-1, 3)
    np.testing.assert_allclose(far[far[:, 2] > 0], [[-4.0, 3.0, 1.5]], atol=1e-9)


def test_a_neighbour_in_another_row_and_column_and_at_another_height_casts_shade():
    group = TrackerGroup.from_map([0.0, 3.0], [0.0, 4.0], [0.0, 1.5], (2.0, 2.0), 48.0)
    sun = np.array([-4.0, 3.0, 1.5]) / np.sqrt(27.25)
    # The sun is behind the neighbour's middle: all is shaded.
    assert group.worst_shaded_share(sun, -30.0, 90.0) == pytest.approx(1.0)


def test_the_shade_and_beam_share_of_many_suns_equal_those_of_each_alone():
    group = field()
    suns = direction_from_azimuth([90.0, 120.0, 250.0], [9.0, 20.0, 6.0], LYNGBY_DEG)
    together, share = group.shade(suns, 45.0, 90.0), group.beam_share(suns, 45.0, 90.0)
    alone = [group.shade(sun, 45.0, 90.0) for sun in suns]
    np.testing.assert_allclose(together, np.transpose(alone))
    np.testing.assert_allclose(share, [float(group.beam_share(sun, 45.0, 90.0)) for sun in suns])
    assert together.share[2] > 0.0 == together.share[0]


def test_the_beam_share_of_a_flat_field_is_the_sine_of_the_solar_elevation():
    suns = direction_from_azimuth([180.0, 200.0], [30.0, -5.0], LYNGBY_DEG)
    np.testing.assert_allclose(field().beam_share(suns, 0.0, 90.0), [0.5, 0.0], atol=1e-12)
