"""The course of one move: never faster than its drive, and cut short where steel ends it."""

from itertools import pairwise

import pytest
from hypothesis import given
from hypothesis import strategies as st

from sim_drivers.pozsol.profile import plan_coasting, plan_drive_to
from sim_drivers.pozsol.setup import AxisDrive

POSITIONS = st.floats(-300, 300)
SPEEDS = st.floats(-3.13, 3.13)


@given(POSITIONS, SPEEDS, POSITIONS)
def test_a_move_is_continuous_never_exceeds_its_speed_and_ends_within_its_overshoot_of_the_target(
    start, velocity, target
):
    drive = AxisDrive()
    profile = plan_drive_to(10.0, start, velocity, target, drive)
    assert abs(profile.end - target) <= drive.overshoot_mm + 1e-9
    assert profile.at(10.0) == pytest.approx((start, velocity), abs=1e-6)
    assert profile.at(profile.end_s) == (profile.end, 0.0)
    steps = 200
    dt = (profile.end_s - 10.0) / steps
    states = [profile.at(10.0 + i * dt) for i in range(steps + 1)]
    for (x0, _), (x1, v1) in pairwise(states):
        assert abs(v1) <= drive.speed_mm_s + 1e-9
        assert abs(x1 - x0) <= drive.speed_mm_s * dt + 1e-6
    assert profile.at(profile.target_reached_s)[0] == pytest.approx(target, abs=1e-6)


@given(POSITIONS, SPEEDS, POSITIONS, st.floats(1, 300))
def test_a_move_is_cut_exactly_where_it_meets_a_hard_stop(start, velocity, target, limit):
    start = min(max(start, -limit), limit)
    profile = plan_drive_to(0.0, start, velocity, target, AxisDrive()).cut_at(-limit, limit)
    assert all(abs(profile.at(i * profile.end_s / 100)[0]) <= limit + 1e-6 for i in range(101))
    assert abs(profile.at(profile.end_s - 1e-9)[0] - profile.end) < 1e-3
    assert abs(profile.end) <= limit


def test_an_axis_runs_out_at_a_steady_rate():
    profile = plan_coasting(5.0, 100.0, -3.2, AxisDrive(speed_mm_s=3.2, run_out_s=0.5))
    assert profile.end_s == 5.5
    assert profile.end == pytest.approx(99.2)
