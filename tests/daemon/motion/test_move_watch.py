"""Judging a move from telemetry."""

import math

import pytest

from daemon.base.records import Pose, Target
from daemon.config.sections import MotionSettings
from daemon.motion.move_watch import MoveWatch, Progress
from drivers.interfaces import Telemetry
from drivers.settings import PositionerSettings
from solar.frames import Limits


def look(a, b, faults=(), pending=0.0, **more):
    return Telemetry(
        time_monotonic_s=0.0,
        a_deg=a,
        b_deg=b,
        position_a=a * 3.7 + 200,
        position_b=b * 3.7,
        destination_a=a * 3.7 + 200 + pending,
        destination_b=b * 3.7,
        faults=faults,
        **more,
    )


def follow(a=20.0, b=60.0, start=(0.0, 90.0)):
    return MoveWatch(
        Target(a, b, "test"),
        Pose(0.0, 0.0, *start, moving=False),
        Limits(),
        MotionSettings(tolerance_deg=0.8),
        PositionerSettings(slowest_deg_per_s=0.5, position_unit="mm"),
        now_s=0.0,
    )


def test_a_move_has_arrived_once_both_axes_stand_still_at_the_target():
    move = follow()
    assert move.judge(look(10, 90), 1)[0] is Progress.GOING
    assert move.judge(look(20.3, 60.2), 2)[0] is Progress.GOING, "there, but perhaps still moving"
    assert move.judge(look(20.3, 60.2), 3)[0] is Progress.ARRIVED


@pytest.mark.parametrize("pending", [2.0, 0.85, -0.45, math.nan])
def test_a_move_near_its_target_has_not_arrived_while_the_unit_may_yet_drive_on_to_its_destination(pending):
    move = follow()
    assert move.judge(look(20.3, 60.2, pending=pending), 1)[0] is Progress.GOING
    assert move.judge(look(20.3, 60.2, pending=pending), 3)[0] is Progress.GOING
    assert move.judge(look(20.3, 60.2, pending=pending), 5)[0] is Progress.ARRIVED, "it never does"


def test_an_axis_that_rests_a_little_beside_its_destination_is_not_waited_for():
    move = follow()
    move.judge(look(20.3, 60.2, pending=0.35), 1)
    assert move.judge(look(20.3, 60.2, pending=0.35), 2)[0] is Progress.ARRIVED


def test_standing_still_short_of_the_target_is_a_stall():
    move = follow()
    move.judge(look(5, 90), 1)
    assert move.judge(look(5, 90), 6)[0] is Progress.GOING
    assert move.judge(look(5, 90), 8) == (Progress.STALLED, "no movement for 7 s at A 5.0, B 90.0 deg")


def test_the_reason_of_a_stall_includes_the_supply_and_details_that_the_positioner_reports():
    move = follow()
    move.judge(look(5, 90), 1)
    why = move.judge(look(5, 90, supply_v=23.96, details={"mode": "tracker ok"}), 8)[1]
    assert why == "no movement for 7 s at A 5.0, B 90.0 deg; supply 24.0 V, mode tracker ok"


def test_a_move_that_goes_past_its_target_has_overshot():
    move = follow()
    assert move.judge(look(21.5, 90), 1)[0] is Progress.GOING
    assert move.judge(look(21.7, 90), 2)[0] is Progress.OVERSHOT


def test_a_move_that_leaves_the_limits_has_overshot_even_short_of_its_target():
    move = follow(a=50, b=90)
    assert move.judge(look(30, 92), 1)[0] is Progress.OVERSHOT


@pytest.mark.parametrize("side", [1, -1])
def test_an_axis_that_starts_outside_the_limits_may_come_back_in(side):
    move = follow(a=40 * side, b=60, start=(55.0 * side, 60.0))
    assert move.judge(look(54 * side, 60), 1)[0] is Progress.GOING
    assert move.judge(look(57 * side, 60), 2)[0] is Progress.OVERSHOT


def test_angles_that_are_no_numbers_end_the_move():
    assert follow().judge(look(math.nan, 90), 1)[0] is Progress.OVERSHOT


def test_a_fault_ends_the_move_and_is_named():
    assert follow().judge(look(5, 90, ("a_overcurrent",)), 1) == (
        Progress.STALLED,
        "the positioner reports a_overcurrent",
    )


def test_a_move_slower_than_the_slowest_configured_speed_times_out():
    move = follow(a=20, b=90)
    verdicts = [move.judge(look(now * 0.1, 90), now)[0] for now in range(1, 70)]
    assert verdicts[-1] is Progress.TIMED_OUT
    assert verdicts.index(Progress.TIMED_OUT) == 60, "40 s for 20 degrees at 0.5 deg/s, and 20 s to spare"


def test_an_axis_that_hunts_around_its_target_runs_out_of_time_as_well():
    move = follow(a=20, b=90)
    verdicts = [move.judge(look(20.0 + 0.2 * (now % 2), 90), now) for now in range(1, 70)]
    assert verdicts.index((Progress.TIMED_OUT, "not at rest after 61 s, at A 20.2, B 90.0 deg")) == 60


class WholeDegrees(PositionerSettings):
    def resolution(self):
        return 1.0


def creep(deg_per_s, start_deg, target_deg):
    """Return the verdicts, second by second, on a rotator of whole degrees that goes on at this speed."""
    move = MoveWatch(
        Target(target_deg, 60.0, "test"),
        Pose(0.0, 0.0, start_deg, 60.0, moving=False),
        Limits(),
        MotionSettings(tolerance_deg=1.5),
        WholeDegrees(slowest_deg_per_s=0.3),
        now_s=0.0,
    )
    for second in range(1, 100):
        a_deg = float(round(min(start_deg + deg_per_s * second, target_deg)))
        yield move.judge(Telemetry(0.0, a_deg, 60.0, a_deg, 60.0, target_deg, 60.0), second)[0]


def test_a_rotator_of_whole_degrees_has_arrived_when_its_slowest_motion_would_have_shown():
    verdicts = list(creep(0.31, 0.0, 20.0))
    assert Progress.STALLED not in verdicts, "two steps take seven seconds"
    # Within the tolerance since 58 s, and at its end after 64.5 s.
    assert verdicts.index(Progress.ARRIVED) + 1 >= 65
