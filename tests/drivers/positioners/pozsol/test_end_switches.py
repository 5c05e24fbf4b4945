"""When B counts as moving, and when a switch cannot be closed, look by look and at the bounds."""

import math

import pytest

from drivers.positioners.pozsol.end_switches import AxisBBitDetector, SwitchCheck, leave_switch_position
from drivers.positioners.pozsol.geometry import AxisSetup, Proportional, Triangle
from drivers.positioners.pozsol.wire import B_OUT_BIT_LPC, B_OUT_BIT_STM, parse_status

A = AxisSetup(Triangle(300.0, 300.0, 90.0, -52.0), -50.0, 50.0)
FIRST, SECOND, THIRD = (1 << B_OUT_BIT_STM + place for place in range(3))
OPEN, LOW = parse_status("0"), parse_status(str(1 << 19))


def found(*looks, word=FIRST, late_s=0.0):
    """Return where B's bits are after looks, each with a time [s] and a position; the status is `late_s` older."""
    layout = AxisBBitDetector(None)
    for time_s, position in looks:
        layout.update(position, time_s, word, time_s - late_s)
    return layout.bit


OUT, IN = ((5.0, 10.0), (5.2, 11.0), (5.4, 12.0)), ((5.0, 12.0), (5.2, 11.0), (5.4, 10.0))


@pytest.mark.parametrize(("looks", "word", "bit"), [
    (OUT, FIRST, B_OUT_BIT_STM),
    (OUT, FIRST | THIRD, B_OUT_BIT_STM),
    (OUT, SECOND, B_OUT_BIT_LPC),
    (OUT, FIRST | SECOND, None),
    (OUT, THIRD, None),
    (IN, SECOND, B_OUT_BIT_STM),
    (IN, SECOND | THIRD, B_OUT_BIT_STM),
    (IN, THIRD, B_OUT_BIT_LPC),
    (IN, FIRST | SECOND, None),
    (IN, FIRST | THIRD, None),
    (IN, 0, None),
])  # fmt: skip
def test_each_direction_of_axis_b_reveals_the_place_of_its_status_bits_by_its_own_bit(looks, word, bit):
    assert found(*looks, word=word) == bit


@pytest.mark.parametrize(("looks", "told"), [
    (OUT[:2], False),
    (((5.0, 10.0), (5.2, 11.0), (5.4, 10.0)), False),
    (((5.0, 10.0), (5.2, 11.0), (5.4, 10.0), (5.6, 9.0)), True),
    (((0.0, 0.0), (0.5, 0.1), (1.0, 0.2)), False),
    (((0.0, 0.0), (0.5, 0.15), (1.0, 0.3)), True),
    # A slow axis counts from the last position at which it was seen to have moved.
    (((0.0, 0.0), (0.5, 0.06), (0.9, 0.12), (1.4, 0.24)), True),
    (((5.0, 0.0), (5.5, 0.06), (5.9, 0.12), (6.4, 0.24)), True),
    (((1.0, 10.0), (2.0, 11.0), (3.0, 12.0)), True),
    # After a pause the count of steps begins anew.
    (((1.0, 10.0), (2.5, 11.0), (2.6, 12.0), (2.8, 13.0)), True),
    (((1.0, 10.0), (1.2, 10.0), (1.4, 10.0)), False),
    (((1.0, 10.0), (2.1, 11.0), (3.2, 12.0)), False),
    (((1.0, 10.0), (2.1, 11.0), (2.3, 12.0)), False),
    (((5.0, 10.0), (5.2, 11.0), (5.2, 12.0)), False),
    (((5.0, 10.0), (5.2, 11.0), (5.1, 12.0)), False),
])  # fmt: skip
def test_axis_b_counts_as_moving_after_two_steps_in_one_direction_within_a_second_each(looks, told):
    word = FIRST if looks[-1][1] > looks[0][1] else SECOND
    assert (found(*looks, word=word) is not None) == told


@pytest.mark.parametrize(("late_s", "told"), [(0.69, True), (0.71, False), (-0.69, True), (-0.71, False)])
def test_a_status_over_0_7_s_from_the_position_reveals_nothing_about_the_bits_of_axis_b(late_s, told):
    assert (found(*OUT, late_s=late_s) is not None) == told


def test_a_preset_place_of_the_bits_of_axis_b_stays_while_b_does_not_move():
    layout = AxisBBitDetector(B_OUT_BIT_LPC)
    layout.update(1.0, 1.0, FIRST, 1.0)
    assert layout.bit == B_OUT_BIT_LPC


FAR = A.units(4.0)


def texts(*looks):
    check = SwitchCheck("a", A)
    return [bool(check.update(position, status, status_s)) for position, status, status_s in looks]


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_a_closed_end_switch_contradicts_a_count_more_than_four_degrees_away_from_it(side):
    near, far = side * 0.99 * FAR, side * 1.01 * FAR
    assert texts((near, LOW, 1.0), (near, LOW, 2.0), (near, LOW, 3.0)) == [False] * 3
    assert texts((far, LOW, 1.0), (far, LOW, 2.0), (far, LOW, 3.0)) == [False, True, True]


def test_a_wrongly_closed_end_switch_is_reported_only_after_two_consecutive_statuses():
    far = 2 * FAR
    assert texts((far, LOW, 1.0), (far, LOW, 1.0), (far, LOW, 0.9)) == [False] * 3
    assert texts((far, LOW, 1.0), (far, OPEN, 2.0), (far, LOW, 3.0), (far, LOW, 4.0)) == [False, False, False, True]
    assert texts((far, LOW, 1.0), (0.0, LOW, 2.0), (far, LOW, 3.0)) == [False] * 3


def test_an_end_switch_is_suspected_from_a_first_contradicting_status_until_the_next_one():
    check, seen = SwitchCheck("a", A), []
    for status, status_s in ((OPEN, 1.0), (LOW, 2.0), (LOW, 2.0), (OPEN, 3.0)):
        check.update(2 * FAR, status, status_s)
        seen.append(check.is_pending)
    assert seen == [False, True, True, False]


def test_an_axis_in_doubt_is_sent_five_degrees_off_its_switch_unless_it_might_pass_its_limits():
    slew = AxisSetup(Proportional(10.0, 0.0), 2.0, 90.0)
    assert leave_switch_position(slew, 0.0, None) is None, "nothing is in doubt"
    assert leave_switch_position(slew, 0.0, 300.0) == 50
    assert leave_switch_position(slew, 25.0, 300.0) == 50
    assert leave_switch_position(slew, 25.1, 300.0) is None, "it is off its switch"
    assert leave_switch_position(slew, 0.0, 849.0) == 50
    assert leave_switch_position(slew, 0.0, 849.1) is None, "it may stand at its other end"
    assert leave_switch_position(slew, 0.0, math.nan) is None
    narrow = AxisSetup(Proportional(10.0, 0.0), 2.0, 5.0)
    assert leave_switch_position(narrow, 0.0, -20.0) is None
    offset = AxisSetup(Proportional(10.0, 0.0), 2.0, 90.0, zero_offset=7.5)
    assert leave_switch_position(offset, 0.0, 300.0) == 43
    far = AxisSetup(Proportional(10.0, 0.0), 2.0, 90.0, zero_offset=400.0)
    assert leave_switch_position(far, 0.0, 300.0) == 0, "its offset alone takes it off"
    assert leave_switch_position(far, 0.0, 500.0) is None, "and so far that it may pass its other end"
    downwards = AxisSetup(Proportional(-10.0, 90.0), 0.0, 88.0)
    assert leave_switch_position(downwards, 0.0, 300.0) == 50
