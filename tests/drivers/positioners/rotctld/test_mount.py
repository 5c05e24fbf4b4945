"""Azimuth and elevation under the tracker's angles."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.positioners.rotctld.driver import RotctldSettings
from drivers.positioners.rotctld.mount import Mount, RotatorPosition, UnreachableError, angles, position_from_angles
from solar.frames import Limits, azimuth_from_direction, equator_azimuth_deg, normal_from_angles

FULL = Mount(0.0, 360.0, 0.0, 90.0, 180.0)


def mount(azimuth, elevation=(0.0, 90.0), equator=180.0):
    return Mount(*azimuth, *elevation, equator)


@given(st.floats(-50, 50), st.floats(15, 90), st.sampled_from([48.7, -33.9]))
def test_tracker_angles_are_converted_to_azimuth_and_elevation_of_their_normal_and_back(a_deg, b_deg, latitude_deg):
    equator_deg = equator_azimuth_deg(latitude_deg)
    found = position_from_angles(a_deg, b_deg, equator_deg)
    azimuth_deg, elevation_deg = azimuth_from_direction(normal_from_angles(a_deg, b_deg), latitude_deg)
    assert found.elevation_deg == pytest.approx(float(elevation_deg), abs=1e-4)
    if elevation_deg < 89.9:
        assert (found.azimuth_deg - float(azimuth_deg) + 180.0) % 360.0 - 180.0 == pytest.approx(0.0, abs=1e-4)
    assert angles(*found, equator_deg) == pytest.approx((a_deg, b_deg), abs=1e-3)


@given(st.floats(-50, 50), st.floats(15, 90), st.sampled_from([0.1, 1.0, 3.0]), st.tuples(*2 * [st.floats(-0.5, 0.5)]))
def test_no_angle_is_further_than_rests_within_from_where_the_rotator_steps_let_it_rest(a_deg, b_deg, step_deg, shift):
    # Nobody says where steps are counted from: so every shift within a step is tried.
    sent = FULL.place(a_deg, b_deg)
    rests = RotatorPosition(*(each + share * step_deg for each, share in zip(sent, shift, strict=True)))
    off_deg = np.abs(np.subtract(angles(*rests, 180.0), (a_deg, b_deg)))
    within_deg = RotctldSettings(resolution_deg=step_deg).rests_within(Limits(-50.0, 50.0, 15.0, 90.0))
    assert np.all(off_deg <= np.add(within_deg, 0.05 * step_deg))


@pytest.mark.parametrize(
    ("place", "expected"),
    [((180, 45), (0, 45)), ((270, 40), (50, 90)), ((129.03, 9.58), (-50, 15)), ((217.01, 33.83), (30, 40))],
)
def test_known_azimuths_and_elevations_give_the_expected_angles_in_both_hemispheres(place, expected):
    assert angles(*place, 180.0) == pytest.approx(expected, abs=0.02)
    # South of the equator the same angles are on the other side; east stays east.
    azimuth_deg, elevation_deg = place
    assert angles(180.0 - azimuth_deg, elevation_deg, 0.0) == pytest.approx(expected, abs=0.02)


@pytest.mark.parametrize(
    ("turns", "equator", "a_deg", "azimuth_deg"),
    [
        ((0, 360), 180.0, 30, 219.23),
        ((-180, 180), 180.0, 30, -140.77),
        ((-180, 180), 180.0, -30, 140.77),
        ((-180, 450), 180.0, -30, 140.77),
        ((-180, 450), 180.0, 30, 219.23),
        ((-270, 450), 180.0, 30, 219.23),
        ((180, 540), 0.0, 30, 320.77),
        ((0, 360), 0.0, -30, 39.23),
        ((0, 360), 0.0, 30, 320.77),
        ((-180, 450), 0.0, 30, 320.77),
        ((-180, 450), 0.0, -30, 399.23),
    ],
)
def test_a_target_azimuth_is_given_in_a_turn_within_the_range_of_the_rotator(turns, equator, a_deg, azimuth_deg):
    found = mount(turns, equator=equator).place(a_deg, 45.0)
    assert found.azimuth_deg == pytest.approx(azimuth_deg, abs=0.01)
    assert turns[0] <= found.azimuth_deg <= turns[1]


@given(
    st.lists(st.tuples(st.floats(-50, 50), st.floats(15, 89)), min_size=2),
    st.sampled_from([(-180.0, 450.0), (0.0, 720.0)]),
)
def test_all_target_azimuths_stay_within_half_a_turn_so_that_cables_are_never_wound_up(places, turns):
    # All azimuths of a day are within half a turn, and each place always has the same one.
    seen = [mount(turns).place(a_deg, b_deg).azimuth_deg for a_deg, b_deg in places]
    assert max(seen) - min(seen) <= 180.0 + 1e-6
    assert [mount(turns).place(a_deg, b_deg).azimuth_deg for a_deg, b_deg in places] == seen


def test_the_rotator_keeps_its_azimuth_at_the_zenith():
    assert FULL.place(0.0, 90.0, RotatorPosition(123.0, 20.0)) == (123.0, 90.0)
    assert FULL.place(0.3, 89.8, RotatorPosition(123.0, 20.0)) == (123.0, 90.0)
    # A rotator that stands beyond its range comes back into it.
    assert mount((100, 200)).place(0.0, 90.0, RotatorPosition(250.0, 20.0)) == (200.0, 90.0)


@pytest.mark.parametrize(("b_deg", "azimuth_deg"), [(89.6, 123.0), (89.4, 180.0), (90.4, 123.0), (90.6, 0.0)])
def test_the_azimuth_is_kept_only_within_half_a_degree_of_the_zenith(b_deg, azimuth_deg):
    assert FULL.place(0.0, b_deg, RotatorPosition(123.0, 20.0)).azimuth_deg % 360.0 == pytest.approx(azimuth_deg)


@pytest.mark.parametrize("place", [(0.0, 90.0), (0.2, 89.7), (20.0, 70.0)])
def test_an_unreachable_target_is_refused_with_the_range_of_the_rotator(place):
    low = mount((0, 360), (0, 60))
    with pytest.raises(UnreachableError, match=r"elevation .*rotator turns azimuth 0 to 360 and elevation 0 to 60 deg"):
        low.place(*place)
    assert low.place(0.0, 50.0) == pytest.approx((180.0, 50.0))


def test_the_ends_of_the_azimuth_range_belong_to_the_range():
    east = mount((90, 270)).place(-50.0, 90.0)
    west = mount((90, 270)).place(50.0, 90.0)
    assert (east.azimuth_deg, west.azimuth_deg) == pytest.approx((90.0, 270.0))


@pytest.mark.parametrize(
    ("turns", "said", "counted"),
    [((-180, 180), 190.0, -170.0), ((0, 360), -10.0, 350.0), ((-180, 450), 400.0, 400.0), ((0, 90), 200.0, 200.0)],
)
def test_a_reported_azimuth_is_taken_in_the_turn_of_the_range(turns, said, counted):
    assert mount(turns).unwrap_azimuth(said) == counted


@pytest.mark.parametrize(
    ("turns", "before", "said", "counted"),
    [
        ((0, 360), 0.0, -0.1, -0.1),
        ((0, 360), 0.1, 359.9, -0.1),
        ((0, 360), 359.9, 0.1, 360.1),
        ((0, 360), 10.0, 300.0, 300.0),
        ((-180, 450), 355.0, 2.0, 362.0),
        ((0, 90), 80.0, 200.0, 200.0),
    ],
)
def test_a_reported_azimuth_near_an_end_of_the_range_continues_from_the_previous_reading(turns, before, said, counted):
    assert mount(turns).unwrap_azimuth(said, before) == pytest.approx(counted)


def test_an_angle_that_is_not_a_number_is_unreachable():
    for a_deg, b_deg in ((np.nan, 45.0), (0.0, np.nan)):
        with pytest.raises((UnreachableError, ValueError)):
            FULL.place(a_deg, b_deg)
