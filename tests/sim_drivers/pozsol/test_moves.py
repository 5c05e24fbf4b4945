"""Moves to an angle or a position: where they end, when, which axis comes first, and what a stop leaves."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.positioners.pozsol.wire import Field, encode_command
from sim_drivers.pozsol.core import PositionerCore
from sim_drivers.pozsol.setup import A_ACTUATOR, B_ACTUATOR, AxisDrive, Setup
from tests.sim_drivers.pozsol.exchange import STOP, fields, moves, number, point


def test_an_angle_command_moves_the_axis_there_cut_to_whole_millimetres():
    core = PositionerCore()
    point(core, 1.0, a_deg=20.0)
    expected = int(A_ACTUATOR.position_mm(20.0))
    assert number(core, Field.A_DESTINATION, 1.1) == expected
    assert A_ACTUATOR.position_mm(core.truth(60.0).a_deg) == pytest.approx(expected, abs=0.2)
    assert core.truth(60.0).a_deg < 20.0
    assert core.truth(60.0).b_deg == pytest.approx(90.0)


@given(st.floats(-50, 50), st.floats(15, 90))
def test_the_whole_working_range_is_reached_to_within_one_millimetre(a_deg, b_deg):
    core = PositionerCore()
    end = core.truth(point(core, 0.0, a_deg, b_deg) + 300.0)
    assert -0.2 <= A_ACTUATOR.position_mm(a_deg) - A_ACTUATOR.position_mm(end.a_deg) < 1.2
    assert -0.2 <= B_ACTUATOR.position_mm(b_deg) - B_ACTUATOR.position_mm(end.b_deg) < 1.2


def test_a_move_takes_the_time_of_speed_and_ramps_and_shows_its_target_for_another_0_4_s():
    core = PositionerCore()
    start = number(core, Field.A_POSITION, 0.0)
    core.feed(encode_command(Field.A_DESTINATION, int(start) + 65), 0.001)
    drive = AxisDrive()
    way = int(start) + 65 - start
    arrival_s = 0.02 + way / drive.speed_mm_s + 0.5 * drive.speed_mm_s / drive.acceleration_mm_s2
    assert moves(core, arrival_s - 0.1)
    assert number(core, Field.A_POSITION, arrival_s + 0.3) == pytest.approx(int(start) + 65 + 0.14, abs=0.03)
    assert number(core, Field.A_DESTINATION, arrival_s + 0.3) == int(start) + 65
    assert number(core, Field.A_DESTINATION, arrival_s + 0.5) == number(core, Field.A_POSITION, arrival_s + 0.5)


def test_a_target_sent_while_the_axis_brakes_at_its_old_target_is_lost():
    core = PositionerCore()
    core.feed(encode_command(Field.A_DESTINATION, 239), 0.001)
    crosses_s = next(i / 100 for i in range(1, 1000) if number(core, Field.A_POSITION, i / 100) >= 239)
    core.feed(encode_command(Field.A_DESTINATION, 200), crosses_s + 0.1)
    assert number(core, Field.A_DESTINATION, crosses_s + 0.15) == 200
    assert number(core, Field.A_DESTINATION, crosses_s + 0.5) == pytest.approx(239.1, abs=0.1)
    assert number(core, Field.A_POSITION, 60.0) == pytest.approx(239.1, abs=0.1)


def test_axis_b_begins_its_move_only_after_axis_a_has_stopped():
    core = PositionerCore()
    now = point(core, 0.0, a_deg=10.0, b_deg=60.0)
    assert number(core, Field.B_DESTINATION, now) == int(B_ACTUATOR.position_mm(60.0))
    assert moves(core, now + 2.0)
    assert not moves(core, now + 2.0, "b")
    assert core.truth(now + 2.0).b_deg == pytest.approx(90.0)
    assert core.truth(now + 200.0).b_deg == pytest.approx(60.0, abs=0.4)


def test_a_synchronous_unit_says_so_but_still_moves_one_axis_after_the_other():
    core = PositionerCore(setup=Setup(synchronous=True))
    now = point(core, 0.0, a_deg=10.0, b_deg=60.0)
    assert not moves(core, now + 2.0, "b")
    assert fields(core, now + 2.0)[Field.SERVICE].startswith(b"Run:synch")


def test_a_move_smaller_than_the_dead_band_keeps_its_target_but_does_not_begin():
    core = PositionerCore(setup=Setup(drive=AxisDrive(dead_band_mm=1.0)))
    before = number(core, Field.B_POSITION, 0.0)
    core.feed(encode_command(Field.B_DESTINATION, int(before)), 0.0)
    assert number(core, Field.B_DESTINATION, 1.0) == int(before)
    assert number(core, Field.B_POSITION, 30.0) == before


def test_overshoot_leaves_the_axis_beyond_its_target_in_the_direction_of_the_move():
    core = PositionerCore(setup=Setup(drive=AxisDrive(overshoot_mm=0.7)))
    core.feed(encode_command(Field.A_DESTINATION, 250), 0.0)
    assert number(core, Field.A_POSITION, 100.0) == pytest.approx(250.7, abs=0.05)
    core.feed(encode_command(Field.A_DESTINATION, 200), 100.0)
    assert number(core, Field.A_POSITION, 200.0) == pytest.approx(199.3, abs=0.05)
    assert core.next_event(200.0) == 900.0


def test_after_a_stop_the_destination_is_the_position_and_the_run_out_shows_in_no_status_bit():
    core = PositionerCore()
    now = point(core, 0.0, a_deg=40.0, b_deg=30.0)
    core.feed(STOP, 10.0)
    before = number(core, Field.A_POSITION, 10.02)
    assert not moves(core, 10.03)
    assert number(core, Field.A_POSITION, 10.1) > before
    assert number(core, Field.A_DESTINATION, 10.1) == number(core, Field.A_POSITION, 10.1)
    after = number(core, Field.A_POSITION, 11.0)
    assert after - before == pytest.approx(0.39, abs=0.02)
    assert number(core, Field.A_DESTINATION, 11.0) == after
    assert number(core, Field.B_DESTINATION, 11.0) == number(core, Field.B_POSITION, 11.0)
    assert number(core, Field.A_POSITION, now + 500.0) == after
    assert core.truth(now + 500.0).b_deg == pytest.approx(90.0)


def test_on_a_reversal_the_axis_drives_the_old_way_for_another_second():
    core = PositionerCore()
    point(core, 0.0, a_deg=40.0)
    turn = number(core, Field.A_POSITION, 10.0)
    point(core, 10.0, a_deg=-40.0)
    assert moves(core, 10.5)
    assert number(core, Field.A_POSITION, 11.0) == pytest.approx(turn + 3.1, abs=0.1)
    assert number(core, Field.A_POSITION, 11.5) == pytest.approx(turn + 3.55, abs=0.1)
    assert number(core, Field.A_POSITION, 20.0) < turn
    assert core.truth(200.0).a_deg == pytest.approx(-40.0, abs=0.4)


@pytest.mark.parametrize(("angle_deg", "end_mm"), [(80.0, int(A_ACTUATOR.travel_mm)), (-85.0, 0)])
def test_angles_beyond_the_range_are_silently_limited_to_it(angle_deg, end_mm):
    core = PositionerCore()
    point(core, 0.0, a_deg=angle_deg)
    assert number(core, Field.A_DESTINATION, 0.1) == end_mm


def test_a_destination_beyond_the_range_is_silently_limited_to_it():
    core = PositionerCore()
    core.feed(encode_command(Field.B_DESTINATION, 9999), 0.0)
    assert number(core, Field.B_DESTINATION, 0.1) == int(B_ACTUATOR.travel_mm)
