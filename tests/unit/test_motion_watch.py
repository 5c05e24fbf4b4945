"""Telling motion from rest, and explained motion from any other."""

import math

import pytest

from daemon.motion_watch import Watch
from drivers.interfaces import Telemetry


def look(time_s, a=100.0, b=200.0, to=(100.0, 200.0)):
    """Positions in mm, at a quarter of a degree to the mm."""
    return Telemetry(
        time_monotonic_s=time_s,
        a_deg=a / 4 - 25,
        b_deg=b / 4,
        position_a=a,
        position_b=b,
        destination_a=to[0],
        destination_b=to[1],
        supply_v=24.0,
    )


def resting(unit="mm"):
    watch = Watch(unit)
    watch.rest(look(0.0))
    return watch


def test_a_count_or_two_and_a_shake_of_the_wind_are_rest():
    watch = resting()
    for step in range(1, 1000):
        assert watch.look(look(0.5 * step, a=100.0 + 0.12 * (step % 3 - 1), b=200.0 + 0.1 * math.sin(step))) is None
    assert watch.settled


@pytest.mark.parametrize("side", [1, -1])
@pytest.mark.parametrize("axis", ["a", "b"])
def test_creeping_is_found_however_slow_it_is(axis, side):
    watch = resting()
    found = None
    for step in range(1, 2000):
        place = {"a": 100.0, "b": 200.0}
        place[axis] += side * 0.001 * step
        found = watch.look(look(0.5 * step, **place))
        if found:
            break
    assert step == pytest.approx(401, abs=1)
    assert found.text.startswith(f"{axis.upper()} moved from ")
    assert not found.jump


@pytest.mark.parametrize(("unit", "far"), [("mm", 0.5), ("deg", 0.12), ("impulse", 7.0)])
def test_what_counts_as_motion_depends_on_the_units_own_unit(unit, far):
    assert resting(unit).look(look(1.0, a=100.0 + far)) is not None
    assert resting(unit).look(look(1.0, a=100.0 + 0.7 * far)) is None


def test_a_position_that_is_no_number_is_not_rest():
    watch = resting()
    assert watch.look(look(1.0, a=math.nan)) is not None
    assert watch.stands_since_s is None


def test_standing_is_said_of_two_looks_and_from_the_first_of_them():
    watch = Watch("mm")
    watch.look(look(10.0))
    assert watch.stands_since_s is None
    watch.look(look(10.1))
    assert watch.stands_since_s is None, "a look so soon after may be of the same telemetry"
    watch.look(look(10.5))
    assert watch.stands_since_s == 10.0
    watch.look(look(11.0, a=101.0))
    assert watch.stands_since_s is None
    watch.forget()
    assert watch.stands_since_s is None


def test_a_confirmed_move_may_go_to_its_target_and_a_little_past_it():
    watch = resting()
    watch.expect(look(1.0, a=100.5, to=(110.0, 190.0)))
    for step in range(22):
        assert watch.look(look(1.5 + step, a=100.5 + 0.5 * step, to=(110.0, 190.0))) is None


@pytest.mark.parametrize("place", [{"a": 98.0}, {"b": 201.0}])
def test_a_confirmed_move_may_not_go_the_other_way(place):
    watch = resting()
    watch.expect(look(1.0, to=(110.0, 190.0)))
    found = watch.look(look(1.5, **place, to=(110.0, 190.0)))
    assert "moves away from where it was sent" in found.text


def test_a_confirmed_move_may_not_turn_back_half_way():
    watch = resting()
    watch.expect(look(1.0, to=(110.0, 200.0)))
    assert watch.look(look(3.0, a=105.0, to=(110.0, 200.0))) is None
    assert watch.look(look(3.5, a=104.8, to=(110.0, 200.0))) is None
    assert "moves away" in watch.look(look(4.0, a=104.5, to=(110.0, 200.0))).text


def test_a_destination_that_is_not_ours_is_found_before_the_axis_turns():
    watch = resting()
    watch.expect(look(1.0, to=(110.0, 200.0)))
    assert "A heads for position 150 and was sent to 110" in watch.look(look(1.5, to=(150.0, 200.0))).text
    assert watch.look(look(2.0, a=105.0, to=(105.0, 200.0))) is None, "after a stop the destination is the position"


def test_after_the_arrival_the_rest_of_the_way_is_explained_for_some_seconds():
    watch = resting()
    watch.expect(look(1.0, to=(102.0, 198.0)))
    watch.arrived(look(2.0, to=(102.0, 198.0)))
    assert watch.look(look(5.0, a=101.0, b=199.0, to=(102.0, 198.0))) is None
    assert not watch.settled
    assert "B moved" in watch.look(look(6.0, a=102.0, b=197.0, to=(102.0, 198.0))).text
    assert watch.look(look(13.0, a=102.0, b=198.0)) is None
    assert watch.look(look(13.5, a=102.0, b=198.0)) is None
    assert watch.settled
    assert "A moved" in watch.look(look(14.0, a=101.0, b=198.0)).text


def test_a_count_that_changes_faster_than_an_axis_turns_is_a_jump():
    watch = resting()
    found = watch.look(look(0.5, a=0.0))
    assert found.jump
    assert "the count jumped from A +0.0, B 50.0 to A -25.0, B 50.0 deg" in found.text
    assert watch.look(look(1.0, a=0.0)) is None, "it is told once"


def test_during_a_reference_run_the_other_axis_stands():
    watch = resting()
    watch.expect_homing("a", look(1.0))
    assert watch.look(look(2.0, a=20.0)) is None
    assert watch.look(look(2.5, a=0.0)) is None
    assert "B moved" in watch.look(look(3.0, a=0.0, b=199.0)).text


def test_after_a_pardon_nothing_is_judged_before_the_next_rest():
    watch = resting()
    watch.pardon()
    assert watch.look(look(1.0, b=195.0)) is None
    watch.rest(look(2.0, b=190.0))
    assert watch.look(look(2.5, b=190.0)) is None
    assert watch.look(look(3.0, b=189.0)) is not None
