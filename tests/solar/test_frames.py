"""Angles, normals and directions."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from solar.frames import (
    Limits,
    angles_from_direction,
    azimuth_from_direction,
    direction_from_azimuth,
    equator_azimuth_deg,
    normal_from_angles,
    separation_deg,
)

LIMITS = Limits()
inside_a = st.floats(-50, 50)
inside_b = st.floats(15, 90)


def test_normals_from_angles_agree_with_the_papers_figure_9():
    assert normal_from_angles(0, 90) == pytest.approx([0, 0, 1])
    assert normal_from_angles(0, 15) == pytest.approx([math.cos(math.radians(15)), 0, math.sin(math.radians(15))])
    east = normal_from_angles(-50, 90)
    assert east == pytest.approx([0, math.sin(math.radians(50)), math.cos(math.radians(50))])


@given(inside_a, inside_b)
def test_angles_are_recovered_from_their_normal(a_deg, b_deg):
    a_back, b_back = angles_from_direction(normal_from_angles(a_deg, b_deg))
    assert a_back == pytest.approx(a_deg, abs=1e-6)
    assert b_back == pytest.approx(b_deg, abs=1e-6)


@given(inside_a, inside_b, st.floats(1e-3, 1e4))
def test_the_angles_of_a_direction_do_not_depend_on_its_length(a_deg, b_deg, length):
    a_back, b_back = angles_from_direction(normal_from_angles(a_deg, b_deg) * length)
    assert (a_back, b_back) == (pytest.approx(a_deg, abs=1e-6), pytest.approx(b_deg, abs=1e-6))


@given(st.floats(allow_nan=False, allow_infinity=False), st.floats(allow_nan=False, allow_infinity=False))
def test_clipped_angles_are_inside_the_limits(a_deg, b_deg):
    assert LIMITS.contain(*LIMITS.clip(a_deg, b_deg))


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf])
def test_nan_and_infinite_angles_are_outside_the_limits_and_clipping_them_is_refused(bad):
    assert not LIMITS.contain(bad, 45)
    assert not LIMITS.contain(0, bad)
    with pytest.raises(ValueError, match="finite"):
        LIMITS.clip(bad, 45)
    with pytest.raises(ValueError, match="finite"):
        LIMITS.clip(0, bad)


@pytest.mark.parametrize("direction", [(0, 0, 0), (math.nan, 0, 1), (0, math.inf, 1), (0, 0, math.nan)])
def test_a_zero_nan_or_infinite_direction_gives_nan_angles(direction):
    assert np.isnan(angles_from_direction(direction)).all()


@pytest.mark.parametrize(("latitude_deg", "azimuth_deg"), [(0.0, 180.0), (0.1, 180.0), (-0.1, 0.0)])
def test_the_frame_on_the_equator_is_that_of_the_northern_hemisphere(latitude_deg, azimuth_deg):
    assert equator_azimuth_deg(latitude_deg) == azimuth_deg


def test_noon_sun_faces_the_equator_in_both_hemispheres():
    north = direction_from_azimuth(180, 40, latitude_deg=48)
    south = direction_from_azimuth(0, 40, latitude_deg=-33)
    assert north == pytest.approx(south)
    assert angles_from_direction(south) == (pytest.approx(0, abs=1e-9), pytest.approx(40))


def test_a_morning_sun_is_east_in_both_hemispheres():
    for azimuth, latitude in ((120, 48), (60, -33)):
        a_deg, _ = angles_from_direction(direction_from_azimuth(azimuth, 30, latitude))
        assert a_deg < 0


@given(st.floats(0, 359.9), st.floats(-89, 89), st.sampled_from([-40.0, 0.0, 55.0]))
def test_azimuth_and_elevation_are_recovered_from_their_direction(azimuth, elevation, latitude):
    back, up = azimuth_from_direction(direction_from_azimuth(azimuth, elevation, latitude), latitude)
    assert (back - azimuth + 180) % 360 - 180 == pytest.approx(0, abs=1e-6)
    assert up == pytest.approx(elevation, abs=1e-9)


def test_the_separation_of_known_directions_is_right():
    assert separation_deg([1, 0, 0], [0, 2, 0]) == pytest.approx(90)
    assert separation_deg(normal_from_angles(0, 45), normal_from_angles(0, 45.001)) == pytest.approx(0.001, rel=1e-6)


def test_the_separation_from_a_zero_nan_or_infinite_direction_is_nan():
    ways = np.array([[0.0, 0.0, 0.0], [0.0, 0.0, 2.0], [math.nan, 0.0, 1.0], [math.inf, 0.0, 1.0]])
    for found in (separation_deg(ways, [0.0, 0.0, 1.0]), separation_deg([0.0, 0.0, 1.0], ways)):
        assert found.tolist() == pytest.approx([math.nan, 0.0, math.nan, math.nan], nan_ok=True)
