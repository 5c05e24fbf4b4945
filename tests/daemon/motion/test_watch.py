"""What telemetry says about motion that no order explains."""

import pytest

from daemon.motion.watch import AxisWatch, jitter
from drivers.interfaces import Telemetry
from drivers.settings import PositionerSettings


def look(time_s, b, to_b):
    return Telemetry(time_s, 0.0, b / 3, 50.0, b, 50.0, to_b)


def test_a_distance_that_an_axis_makes_up_after_arrival_is_no_part_of_its_next_move():
    watch = AxisWatch(PositionerSettings(position_unit="mm"))
    watch.note_rest(look(0, 280.0, 280.0))
    watch.expect(look(1, 280.0, 282.0))
    watch.note_arrival(look(2, 280.9, 282.0))
    for time_s, position in ((3, 281.5), (4, 282.1), (5, 282.1)):
        assert watch.update(look(time_s, position, 282.0)) is None
    watch.expect(look(6, 282.1, 10.0))
    assert watch.update(look(6.5, 282.1, 10.0)) is None
    assert watch.update(look(7, 281.0, 10.0)) is None
    assert "moves away" in watch.update(look(8, 284.0, 10.0)).text


def at(time_s, a=50.0, b=280.0, to_a=None, to_b=None):
    """Return a look; 10 mm of the drive are a degree."""
    return Telemetry(time_s, a / 10, b / 10, a, b, a if to_a is None else to_a, b if to_b is None else to_b)


def resting(look=None, **settings):
    watch = AxisWatch(PositionerSettings(position_unit="mm", **settings))
    watch.note_rest(look or at(0.0))
    return watch


def test_a_standstill_is_shown_by_a_second_look_a_quarter_of_a_second_later():
    watch = AxisWatch(PositionerSettings(position_unit="mm"))
    shown = []
    for time_s in (10.0, 10.2, 10.25, 11.0):
        watch.update(at(time_s))
        shown.append(watch.stands_since_s)
    assert shown == [None, None, 10.0, 10.0]


@pytest.mark.parametrize("axis", ["a", "b"])
@pytest.mark.parametrize(("way", "stands"), [(0.14, True), (-0.14, True), (0.16, False), (-0.16, False)])
def test_an_axis_that_shakes_by_less_than_its_jitter_stands_and_one_that_goes_further_does_not(axis, way, stands):
    watch, start = resting(), {"a": 50.0, "b": 280.0}[axis]
    watch.update(at(5.0, **{axis: start + way}))
    assert (watch.stands_since_s == 0.0) == stands
    watch.update(at(6.0, **{axis: start + way}))
    assert watch.stands_since_s == (0.0 if stands else 5.0)
    one, other = at(7.0), at(8.0, **{axis: start + way})
    assert watch.same_place(one, other) == stands


def test_rest_at_the_same_place_counts_from_its_beginning_and_at_another_place_anew():
    watch = resting(at(5.0))
    watch.note_rest(at(7.0, b=280.1))
    assert watch.stands_since_s == 5.0
    watch.note_rest(at(9.0, b=280.2))
    assert watch.stands_since_s == 9.0
    watch.note_rest(at(11.0, a=50.2, b=280.2))
    assert watch.stands_since_s == 11.0


@pytest.mark.parametrize("axis", ["a", "b"])
@pytest.mark.parametrize("way", [0.39, -0.39, 0.41, -0.41])
def test_an_axis_that_leaves_its_place_of_rest_is_reported_however_slowly_it_goes(axis, way):
    start = {"a": 50.0, "b": 280.0}[axis]
    at_once, slowly = resting(), resting()
    anomaly = at_once.update(at(4.0, **{axis: start + way}))
    strays = [slowly.update(at(float(step), **{axis: start + way * step / 10})) for step in range(1, 11)]
    assert strays[:-1] == [None] * 9
    assert (anomaly is None) == (strays[-1] is None) == (abs(way) < 0.4)
    if anomaly is not None:
        assert (anomaly.seen_s, anomaly.is_count_jump) == (4.0, False)
        assert anomaly.text == f"{axis.upper()} moved from {start / 10:+.1f} to {(start + way) / 10:+.1f} deg"


def test_a_move_is_judged_from_the_place_of_rest_and_not_from_where_the_wind_shook_the_axis():
    watch = resting()
    assert watch.update(at(1.0, b=280.3)) is None
    watch.expect(at(2.0, b=280.3, to_b=100.0))
    assert watch.update(at(3.0, b=280.39, to_b=100.0)) is None
    assert watch.update(at(4.0, b=280.5, to_b=100.0)).text.startswith("B moves away from where it was sent")


def test_no_motion_is_reported_before_the_axes_have_rested():
    watch = AxisWatch(PositionerSettings(position_unit="mm"))
    assert watch.update(at(0.0)) is None
    assert watch.update(at(1.0, b=290.0)) is None
    assert not watch.settled
    watch.note_rest(at(2.0))
    watch.suspend_judging()
    assert watch.update(at(3.0, b=290.0)) is None
    watch.note_rest(at(4.0))
    watch.forget()
    assert watch.stands_since_s is None
    assert watch.update(at(5.0, b=290.0)) is None


@pytest.mark.parametrize("axis", ["a", "b"])
@pytest.mark.parametrize(("after_s", "way_deg", "jump"), [
    (0.1, 4.9, False), (0.1, 5.1, True), (0.1, -5.1, True), (1.0, 9.9, False), (1.0, 10.1, True),
])  # fmt: skip
def test_a_count_that_changes_faster_than_an_axis_turns_is_a_jump_and_no_motion(axis, after_s, way_deg, jump):
    watch, start = resting(), {"a": 50.0, "b": 280.0}[axis]
    there = {axis: start + 10.0 * way_deg}
    anomaly = watch.update(at(after_s, **there))
    assert (anomaly.is_count_jump, anomaly.seen_s) == (jump, after_s)
    if jump:
        assert anomaly.text.startswith("the count jumped from A +5.0, B 28.0 to A ")
        assert watch.update(at(after_s + 1.0, **there)) is None, "it rests where the count now says"


def test_a_drive_that_counts_no_angles_is_judged_by_its_count():
    class Plain(PositionerSettings):
        axes_are_angles = False
        axis_names = ("azimuth", "elevation")

        def resolution(self):
            return 0.5

    watch = AxisWatch(Plain(position_unit="deg"))
    watch.note_rest(at(0.0))
    assert watch.update(at(1.0, b=281.2)) is None
    assert watch.update(at(2.0, b=281.3)).text == "elevation moved from +280.0 to +281.3 deg"
    assert not watch.same_place(at(3.0), at(4.0, b=280.61))
    assert watch.same_place(at(3.0), at(4.0, b=280.59))
    assert watch.update(at(2.5, a=55.1)).is_count_jump


@pytest.mark.parametrize(("unit", "most"), [("mm", 0.15), ("deg", 0.035), ("impulse", 2.0)])
def test_each_position_unit_has_its_own_jitter(unit, most):
    assert jitter(PositionerSettings(position_unit=unit)) == most


def under_way():
    watch = resting()
    watch.expect(at(1.0, to_b=290.0))
    return watch


def test_an_expected_move_may_go_where_it_was_sent_and_stop_on_its_way():
    watch = under_way()
    assert watch.is_motion_expected
    assert not watch.settled
    ways = [at(2.0, b=279.7, to_b=290.0), at(3.0, b=283.0, to_b=289.1), at(4.0, b=286.0, to_b=286.9), at(5.0, b=286.0)]
    assert [watch.update(look) for look in ways] == [None] * 4
    assert watch.update(at(6.0, b=292.0, to_b=290.0)) is None, "past it: the move's own judge sees that"


@pytest.mark.parametrize(("look", "told"), [
    (at(2.0, b=280.0, to_b=287.0), "B heads for position 287, but was sent to 290"),
    (at(2.0, b=280.0, to_b=291.1), "B heads for position 291.1, but was sent to 290"),
    (at(2.0, to_b=290.0, to_a=51.1), "A heads for position 51.1, but was sent to 50"),
    (at(2.0, b=279.5, to_b=290.0), "B moves away from where it was sent, B moved from +28.0 to +27.9 deg"),
    (at(2.0, a=49.0, to_a=50.0, to_b=290.0), "A moves away from where it was sent, A moved from +5.0 to +4.9 deg"),
])  # fmt: skip
def test_a_move_to_elsewhere_or_the_wrong_way_is_reported(look, told):
    anomaly = under_way().update(look)
    assert (anomaly.text, anomaly.is_count_jump) == (told, False)


def test_a_move_that_turns_back_is_reported():
    watch = under_way()
    assert watch.update(at(2.0, b=284.0, to_b=290.0)) is None
    assert watch.update(at(3.0, b=283.7, to_b=290.0)) is None
    assert "moves away" in watch.update(at(4.0, b=283.5, to_b=290.0)).text


def test_an_axis_may_make_up_the_rest_of_its_move_for_ten_seconds_after_arrival():
    watch = under_way()
    watch.update(at(2.0, b=289.0, to_b=290.0))
    watch.note_arrival(at(3.0, b=289.0, to_b=290.0))
    assert not watch.is_motion_expected
    assert watch.update(at(4.0, b=290.3, to_b=290.0)) is None
    assert watch.update(at(5.0, b=288.7, to_b=290.0)) is None
    assert watch.update(at(6.0, b=290.5, to_b=290.0)) is not None
    assert watch.update(at(7.0, b=288.5, to_b=290.0)) is not None
    assert watch.update(at(13.0, b=290.0)) is None
    assert not watch.settled
    assert watch.update(at(13.3, b=290.0)) is None
    assert watch.settled
    assert watch.update(at(14.0, b=289.5)) is not None


def test_the_axis_that_is_homed_may_go_anywhere_and_the_other_nowhere():
    watch = resting()
    watch.expect_homing("a", at(1.0))
    assert (watch.settled, watch.is_motion_expected, watch.stands_since_s) == (False, True, None)
    assert watch.update(at(2.0, a=400.0)) is None
    assert watch.update(at(3.0, a=-400.0)) is None
    assert watch.update(at(4.0, a=-400.0, b=280.5)).text == "B moved from +28.0 to +28.1 deg"
    watch.note_rest(at(5.0, a=-400.0))
    assert (watch.settled, watch.is_motion_expected) == (True, False)
    other = resting()
    other.expect_homing("b", at(1.0))
    assert other.update(at(2.0, b=0.0)) is None
    assert other.update(at(3.0, a=51.0, b=0.0)) is not None


def test_an_axis_that_overshoots_its_target_is_not_reported_as_moving_away():
    watch = under_way()
    assert watch.update(at(2.0, b=289.9, to_b=290.0)) is None
    assert watch.update(at(3.0, b=292.0, to_b=290.0)) is None


def test_after_a_jump_on_the_way_a_move_is_judged_from_where_the_count_now_says():
    watch = under_way()
    assert watch.update(at(1.1, b=200.0, to_b=290.0)).is_count_jump, "8 deg within 0.1 s of the confirmed target"
    assert watch.update(at(2.0, b=201.0, to_b=290.0)) is None
    assert "moves away" in watch.update(at(3.0, b=200.5, to_b=290.0)).text


def test_an_axis_that_stands_in_its_reference_run_has_not_settled():
    watch = resting()
    watch.expect_homing("a", at(1.0))
    for time_s in (2.0, 3.0):
        assert watch.update(at(time_s)) is None
    assert watch.stands_since_s is not None
    assert not watch.settled
