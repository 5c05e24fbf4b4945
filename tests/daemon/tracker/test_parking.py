"""The tracker goes to a fixed position at once, and is sent again every minute while it is not there."""

from math import nan
from types import SimpleNamespace

import pytest

from daemon.base.records import Pose, Target
from daemon.tracker.parking import Parking

NIGHT = Target(0.0, 90.0, "night")


def at(a_deg, b_deg):
    return Pose(0.0, 0.0, a_deg, b_deg, moving=False)


def ordered(times_s, pose=None, target=None, homing=False, after=lambda _parking: None, taken=True):
    """Return the times, out of these, at which a move is ordered."""
    found = []
    motion = SimpleNamespace(pose=pose or at(20.0, 60.0), target=target, heading=target, homing=homing)

    def order(place):
        found.append(place)
        return taken

    parking = Parking(motion, 0.8, order)
    orders = []
    for now_s in times_s:
        before = len(found)
        parking.park(NIGHT, now_s)
        orders += [now_s] * (len(found) - before)
        after(parking)
    assert set(found) <= {NIGHT}
    return orders


def test_the_first_order_goes_out_at_once_and_the_next_after_a_minute():
    assert ordered([0.0, 5.0, 59.0, 60.0, 119.0, 120.0]) == [0.0, 60.0, 120.0]
    assert ordered([0.0, 5.0], after=Parking.forget) == [0.0, 5.0]


def test_an_order_that_was_refused_is_given_again_the_next_time():
    assert ordered([0.0, 5.0, 10.0], taken=False) == [0.0, 5.0, 10.0]


@pytest.mark.parametrize(("a_deg", "b_deg", "there"), [
    (0.0, 90.0, True), (0.8, 89.2, True), (-0.8, 90.0, True), (0.9, 90.0, False), (0.0, 89.1, False),
    (nan, 90.0, False), (0.1, nan, False),
])  # fmt: skip
def test_a_tracker_at_the_position_within_the_tolerance_is_not_sent_there(a_deg, b_deg, there):
    assert ordered([0.0], pose=at(a_deg, b_deg)) == ([] if there else [0.0])


def test_a_position_away_from_zero_is_recognised_and_an_unknown_pose_is_never_taken_as_at_it():
    stow = Target(-30.0, 80.0, "stow")
    for pose, orders in ((at(-30.0, 80.0), []), (at(30.0, 80.0), [stow]), (at(-40.0, 80.0), [stow]), (None, [stow])):
        found = []
        Parking(SimpleNamespace(pose=pose, target=None, heading=None, homing=False), 0.8, found.append).park(stow, 0.0)
        assert found == orders


def test_a_tracker_on_its_way_to_the_position_is_not_sent_again_and_one_going_elsewhere_is():
    assert ordered([0.0, 100.0], target=Target(0.0, 90.0, "stow")) == []
    assert ordered([0.0], target=Target(0.0, 89.0, "law")) == [0.0]
    assert ordered([0.0], pose=at(0.0, 90.0), target=Target(20.0, 60.0, "law")) == [0.0]


def test_a_tracker_whose_move_to_the_position_is_being_ended_is_sent_there_again():
    found = []
    motion = SimpleNamespace(pose=at(0.0, 90.0), target=NIGHT, heading=None, homing=False)
    Parking(motion, 0.8, found.append).park(NIGHT, 0.0)
    assert found == [NIGHT]


def test_a_tracker_at_the_position_during_a_reference_run_is_sent_there():
    assert ordered([0.0], pose=at(0.0, 90.0), homing=True) == [0.0]
