from itertools import pairwise

import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers import pozsol_wire as wire
from drivers.pozsol_wire import Field, TokenStream, encode_command, parse_number, parse_status
from sim_drivers.positioner_core import FAULTS, PositionerCore
from sim_drivers.positioner_motion import brake, travel
from sim_drivers.positioner_screens import SLOW_SCREENS
from sim_drivers.positioner_setup import A_ACTUATOR, B_ACTUATOR, Actuator, Drive, Setup
from solar.frames import Angles

STOP = encode_command(Field.ACTION, wire.STOP)
CLEAR = encode_command(Field.STATUS, wire.CLEAR)
HOME_A = encode_command(Field.ACTION, wire.HOME_A)
HOME_B = encode_command(Field.ACTION, wire.HOME_B)
TRACKING_OFF = encode_command(Field.MODE, wire.TRACKING_OFF)


def fields(core, now):
    return dict(TokenStream().feed(core.screens(now) + b"$"))


def number(core, field, now):
    return parse_number(field, fields(core, now)[field])


def status(core, now):
    return parse_status(fields(core, now)[Field.STATUS].decode(), wire.B_OUT_BIT_STM)


def point(core, now, a_deg=None, b_deg=None):
    if a_deg is not None:
        core.feed(encode_command(Field.A_ANGLE, a_deg), now)
    if b_deg is not None:
        core.feed(encode_command(Field.B_ANGLE, b_deg), now + 0.06)
    return now + 0.12


def test_an_angle_command_moves_the_axis_there_cut_to_whole_millimetres():
    core = PositionerCore()
    point(core, 1.0, a_deg=20.0)
    expected = int(A_ACTUATOR.position_mm(20.0))
    assert number(core, Field.A_DESTINATION, 1.1) == expected
    assert core.truth(60.0).a_deg == pytest.approx(A_ACTUATOR.angle_deg(expected))
    assert core.truth(60.0).a_deg < 20.0
    assert core.truth(60.0).b_deg == pytest.approx(90.0)


@given(st.floats(-50, 50), st.floats(15, 90))
def test_the_whole_working_range_is_reached_to_within_one_millimetre(a_deg, b_deg):
    core = PositionerCore()
    end = core.truth(point(core, 0.0, a_deg, b_deg) + 300.0)
    assert 0 <= A_ACTUATOR.position_mm(a_deg) - A_ACTUATOR.position_mm(end.a_deg) < 1.06
    assert 0 <= B_ACTUATOR.position_mm(b_deg) - B_ACTUATOR.position_mm(end.b_deg) < 1.06


@given(st.floats(-52, 52))
def test_the_triangle_turns_angles_into_positions_and_back(angle_deg):
    assert A_ACTUATOR.angle_deg(A_ACTUATOR.position_mm(angle_deg)) == pytest.approx(angle_deg, abs=1e-9)


def test_near_mid_travel_one_millimetre_is_about_a_quarter_of_a_degree():
    assert A_ACTUATOR.angle_deg(A_ACTUATOR.position_mm(0.0) + 1.0) == pytest.approx(0.27, abs=0.01)


@pytest.mark.parametrize(("low", "high"), [(-95.0, 52.0), (-52.0, 95.0), (10.0, -10.0)])
def test_a_triangle_that_cannot_be_built_is_refused(low, high):
    with pytest.raises(ValueError, match=r"triangle|low end"):
        Actuator(300.0, 300.0, 90.0, low, high)


POSITIONS = st.floats(-300, 300)


@given(POSITIONS, st.floats(-3.2, 3.2), POSITIONS)
def test_a_move_is_continuous_keeps_to_speed_and_ramp_and_ends_on_its_target(start, velocity, target):
    drive = Drive()
    profile = travel(10.0, start, velocity, target, drive)
    assert profile.end == target
    assert profile.at(10.0) == pytest.approx((start, velocity), abs=1e-6)
    assert profile.at(profile.end_s) == (target, 0.0)
    steps = 200
    dt = (profile.end_s - 10.0) / steps
    states = [profile.at(10.0 + i * dt) for i in range(steps + 1)]
    for (x0, v0), (x1, v1) in pairwise(states):
        assert abs(v1) <= drive.speed_mm_s + 1e-9
        assert abs(v1 - v0) <= drive.acceleration_mm_s2 * dt + 1e-6
        assert abs(x1 - x0) <= drive.speed_mm_s * dt + 1e-6


@given(POSITIONS, st.floats(-3.2, 3.2), POSITIONS, st.floats(0, 300))
def test_a_move_is_cut_exactly_where_it_meets_an_end_switch(start, velocity, target, limit):
    profile = travel(0.0, start, velocity, target, Drive()).cut_at(-limit, limit)
    furthest = max(limit, abs(start)) + 1e-6
    assert all(abs(profile.at(i * profile.end_s / 100)[0]) <= furthest for i in range(101))
    assert abs(profile.at(profile.end_s - 1e-9)[0] - profile.end) < 1e-3
    if not profile.cut:
        assert profile.end == target


def test_braking_takes_the_ramp():
    profile = brake(5.0, 100.0, -3.2, Drive(speed_mm_s=3.2, acceleration_mm_s2=6.4))
    assert profile.end_s == 5.5
    assert profile.end == pytest.approx(99.2)


def test_a_move_takes_the_time_of_speed_and_ramps():
    core = PositionerCore()
    start = number(core, Field.A_POSITION, 0.0)
    core.feed(encode_command(Field.A_DESTINATION, int(start) + 65), 0.001)
    way = int(start) + 65 - start
    arrival_s = 0.02 + way / 3.2 + 0.5
    assert status(core, arrival_s - 0.01).a_moving
    assert not status(core, arrival_s + 0.01).a_moving
    assert number(core, Field.A_POSITION, arrival_s + 0.01) == int(start) + 65


def test_b_waits_until_a_has_stopped():
    core = PositionerCore()
    now = point(core, 0.0, a_deg=10.0, b_deg=60.0)
    assert number(core, Field.B_DESTINATION, now) == int(B_ACTUATOR.position_mm(60.0))
    assert status(core, now + 2.0).a_moving
    assert not status(core, now + 2.0).b_moving
    assert core.truth(now + 2.0).b_deg == pytest.approx(90.0)
    assert core.truth(now + 200.0).b_deg == pytest.approx(60.0, abs=0.4)


def test_a_synchronous_unit_moves_both_axes_at_once():
    core = PositionerCore(setup=Setup(synchronous=True))
    now = point(core, 0.0, a_deg=10.0, b_deg=60.0)
    assert status(core, now + 2.0).a_moving
    assert status(core, now + 2.0).b_moving
    assert fields(core, now + 2.0)[Field.SERVICE] == b"Run:synch"


def test_a_move_smaller_than_the_dead_band_is_not_started():
    core = PositionerCore(setup=Setup(drive=Drive(dead_band_mm=1.0)))
    before = number(core, Field.A_POSITION, 0.0)
    core.feed(encode_command(Field.A_DESTINATION, round(before)), 0.0)
    assert number(core, Field.A_DESTINATION, 1.0) == round(before)
    assert number(core, Field.A_POSITION, 30.0) == before


def test_overshoot_leaves_the_axis_beyond_its_target_in_the_direction_of_the_move():
    core = PositionerCore(setup=Setup(drive=Drive(overshoot_mm=0.7)))
    core.feed(encode_command(Field.A_DESTINATION, 250), 0.0)
    assert number(core, Field.A_POSITION, 100.0) == pytest.approx(250.7)
    core.feed(encode_command(Field.A_DESTINATION, 200), 100.0)
    assert number(core, Field.A_POSITION, 200.0) == pytest.approx(199.3)
    assert core.next_event(200.0) == 900.0


def test_stop_runs_out_on_the_ramp_and_takes_the_position_for_the_destination():
    core = PositionerCore()
    now = point(core, 0.0, a_deg=40.0, b_deg=30.0)
    core.feed(STOP, 10.0)
    before = number(core, Field.A_POSITION, 10.02)
    after = number(core, Field.A_POSITION, 11.0)
    assert after - before == pytest.approx(0.8, abs=0.01)
    assert number(core, Field.A_DESTINATION, 11.0) == after
    assert number(core, Field.B_DESTINATION, 11.0) == number(core, Field.B_POSITION, 11.0)
    assert number(core, Field.A_POSITION, now + 500.0) == after
    assert core.truth(now + 500.0).b_deg == pytest.approx(90.0)


def test_a_reversal_stops_first():
    core = PositionerCore()
    point(core, 0.0, a_deg=40.0)
    turn = number(core, Field.A_POSITION, 10.0)
    point(core, 10.0, a_deg=-40.0)
    assert number(core, Field.A_POSITION, 10.4) > turn
    assert number(core, Field.A_POSITION, 20.0) < turn
    assert core.truth(200.0).a_deg == pytest.approx(-40.0, abs=0.4)


@pytest.mark.parametrize(("angle_deg", "end_mm"), [(80.0, int(A_ACTUATOR.travel_mm)), (-85.0, 0)])
def test_angles_beyond_the_range_are_silently_held_in_it(angle_deg, end_mm):
    core = PositionerCore()
    point(core, 0.0, a_deg=angle_deg)
    assert number(core, Field.A_DESTINATION, 0.1) == end_mm


def test_a_destination_beyond_the_range_is_silently_held_in_it():
    core = PositionerCore()
    core.feed(encode_command(Field.B_DESTINATION, 9999), 0.0)
    assert number(core, Field.B_DESTINATION, 0.1) == int(B_ACTUATOR.travel_mm)


def test_a_negative_destination_becomes_the_lowest_one():
    core = PositionerCore()
    core.feed(encode_command(Field.A_DESTINATION, -5), 0.0)
    assert number(core, Field.A_DESTINATION, 0.1) == 0.0


def test_the_input_is_looked_at_every_20_ms_and_a_second_packet_overwrites_the_first():
    core = PositionerCore()
    core.feed(encode_command(Field.A_ANGLE, 10.0), 1.001)
    core.feed(encode_command(Field.B_ANGLE, 60.0), 1.019)
    assert number(core, Field.A_DESTINATION, 1.1) == pytest.approx(A_ACTUATOR.position_mm(0.0), abs=1e-4)
    assert number(core, Field.B_DESTINATION, 1.1) == int(B_ACTUATOR.position_mm(60.0))


def test_only_the_first_of_two_commands_in_one_packet_is_acted_on():
    core = PositionerCore()
    core.feed(encode_command(Field.A_ANGLE, 10.0) + encode_command(Field.B_ANGLE, 60.0), 1.0)
    assert number(core, Field.A_DESTINATION, 1.1) == int(A_ACTUATOR.position_mm(10.0))
    assert number(core, Field.B_DESTINATION, 1.1) == pytest.approx(B_ACTUATOR.position_mm(90.0), abs=1e-4)


def test_a_packet_longer_than_64_bytes_is_overwritten_by_its_own_end():
    core = PositionerCore()
    core.feed(encode_command(Field.A_ANGLE, 10.0).ljust(64, b" ") + encode_command(Field.B_ANGLE, 60.0), 1.0)
    assert number(core, Field.A_DESTINATION, 1.1) == pytest.approx(A_ACTUATOR.position_mm(0.0), abs=1e-4)
    assert number(core, Field.B_DESTINATION, 1.1) == int(B_ACTUATOR.position_mm(60.0))


def test_digits_of_an_earlier_command_stay_behind_a_shorter_one_that_is_not_closed():
    core = PositionerCore()
    core.feed(b"$.205.5", 1.0)
    core.feed(b"$.30", 2.0)
    assert number(core, Field.A_DESTINATION, 2.1) == 305.0
    core.feed(encode_command(Field.A_DESTINATION, 30), 3.0)
    assert number(core, Field.A_DESTINATION, 3.1) == 30.0


def test_text_without_a_dollar_does_nothing_until_it_uncovers_an_old_one():
    core = PositionerCore()
    core.feed(b"AT+GCAP\r", 1.0)
    assert core.truth(50.0).a_deg == pytest.approx(0.0)
    core.feed(b"$.100\r$.200\r", 60.0)
    core.feed(b"AT\r", 61.0)
    assert number(core, Field.A_DESTINATION, 61.1) == 200.0


def test_its_own_telemetry_echoed_back_cancels_a_move():
    core = PositionerCore()
    point(core, 0.0, a_deg=40.0)
    echo = core.next_screen(10.0), core.next_screen(10.0)
    assert echo[1].startswith(b"$,")
    core.feed(echo[1], 10.0)
    assert core.truth(300.0).a_deg < 15.0


def test_its_own_slow_screens_echoed_back_change_parameters():
    core = PositionerCore()
    core.feed(b"$F299.9$G299.9", 0.0)
    assert fields(core, 0.1)[70] == b"299.9"


def test_screens_come_in_six_slots_with_27_slow_ones_in_turn():
    core = PositionerCore()
    screens = [core.next_screen(i * 0.02) for i in range(6 * 27)]
    firsts = [screen[1] for screen in screens[:5]]
    assert firsts == [Field.CLOCK_HOUR, Field.A_ANGLE, Field.B_ANGLE, Field.GMT_SECOND, Field.GMT_MONTH]
    slow = screens[5::6]
    assert [screen[1] for screen in slow] == [group[0] for group in SLOW_SCREENS]
    assert len(set(slow)) == 27
    assert all(len(screen) <= 255 and screen.startswith(b"$") for screen in screens)
    again = [core.next_screen(10.0)[1] for _ in range(6)]
    assert again == [*firsts, Field.BOARD]


def test_the_screens_identify_the_unit_and_print_the_documented_decimals():
    text = fields(PositionerCore(), 0.0)
    assert text[Field.BOARD] == b"36A1"
    assert text[Field.VERSION].endswith(b"(B1.100)")
    assert [len(group) for group in text[Field.SERIAL].split()] == [8, 8, 8, 8]
    assert text[Field.STATUS] == b"0000"
    assert text[Field.MODE] == b"tracking disabled"
    for field in wire.DECIMALS:
        parse_number(field, text[field])


def test_the_live_screens_say_the_same_as_all_screens():
    core = PositionerCore()
    point(core, 0.0, a_deg=40.0)
    every = fields(core, 3.0)
    live = dict(TokenStream().feed(core.live_screens(3.0) + b"$"))
    assert {Field.A_POSITION, Field.B_DESTINATION, Field.SUPPLY, Field.MODE, Field.STATUS} <= set(live)
    assert all(every[code] == value for code, value in live.items())


def test_homing_runs_to_the_low_switch_and_starts_the_count_anew():
    core = PositionerCore()
    core.feed(HOME_A, 0.0)
    assert status(core, 5.0).homing
    assert not status(core, 200.0).homing
    assert number(core, Field.A_POSITION, 200.0) == 0.0
    assert number(core, Field.A_DESTINATION, 200.0) == 0.0
    assert number(core, Field.A_REMAIN, 200.0) == pytest.approx(0.0, abs=1e-4)
    assert "a_low" in status(core, 200.0).end_switches
    assert core.truth(200.0).a_deg == pytest.approx(-52.0)


def test_homing_of_b_shows_in_its_own_bits_and_waits_for_a():
    core = PositionerCore()
    core.feed(HOME_A, 0.0)
    core.feed(HOME_B, 0.06)
    assert core.truth(10.0).b_deg == pytest.approx(90.0)
    assert core.truth(400.0).b_deg == pytest.approx(13.0)


def test_targets_are_refused_while_homing_and_taken_afterwards():
    core = PositionerCore()
    core.feed(HOME_A, 0.0)
    destination = number(core, Field.B_DESTINATION, 1.0)
    point(core, 1.0, a_deg=20.0, b_deg=50.0)
    assert number(core, Field.B_DESTINATION, 2.0) == destination
    assert core.truth(200.0).a_deg == pytest.approx(-52.0)
    point(core, 200.0, a_deg=20.0)
    assert core.truth(400.0).a_deg == pytest.approx(20.0, abs=0.4)


def test_stop_ends_a_homing_run():
    core = PositionerCore()
    core.feed(HOME_A, 0.0)
    core.feed(STOP, 5.0)
    assert not status(core, 5.1).homing
    assert core.truth(6.0) == core.truth(700.0)


def test_homing_gives_up_after_600_s():
    core = PositionerCore(setup=Setup(drive=Drive(speed_mm_s=0.2)))
    core.feed(HOME_A, 0.0)
    assert status(core, 600.0).homing
    late = status(core, 600.1)
    assert not late.homing
    assert late.faults == ("a_homing_too_long",)
    assert core.truth(601.0) == core.truth(800.0)


def test_remain_tells_how_far_the_count_had_slipped():
    core = PositionerCore()
    core.inject("reset_position_lost", 0.0)
    assert number(core, Field.A_POSITION, 0.1) == 0.0
    core.feed(HOME_A, 1.0)
    assert number(core, Field.A_REMAIN, 200.0) == pytest.approx(-A_ACTUATOR.position_mm(0.0), abs=1e-4)


JOG_A_OUT = b"$92\r"


def test_a_jog_ends_260_ms_after_its_last_repetition():
    core = PositionerCore()
    for i in range(10):
        core.feed(JOG_A_OUT, i * 0.2)
    assert status(core, 1.82 + 0.25).a_moving
    end = core.truth(1.82 + 0.26 + 0.6)
    assert end.a_deg > 0.5
    assert core.truth(100.0) == end


def test_an_angle_command_takes_over_from_a_jog():
    core = PositionerCore()
    core.feed(JOG_A_OUT, 0.0)
    point(core, 0.1, a_deg=20.0)
    assert core.truth(60.0).a_deg == pytest.approx(20.0, abs=0.4)


def test_a_jog_of_b_ends_where_a_would():
    shorter = Actuator(300.0, 300.0, 90.0, -52.0, 10.0)
    core = PositionerCore(setup=Setup(start=Angles(0.0, 20.0), a_actuator=shorter))
    for i in range(1000):
        core.feed(b"$91\r", i * 0.2)
    assert B_ACTUATOR.position_mm(core.truth(300.0).b_deg) == pytest.approx(int(shorter.travel_mm))


def test_overcurrent_stops_the_axis_and_what_was_pending_goes_on_once_cleared():
    core = PositionerCore()
    point(core, 0.0, a_deg=40.0)
    core.inject("a_overcurrent", 10.0)
    stopped = core.truth(10.0)
    assert status(core, 20.0).faults == ("a_overcurrent",)
    assert core.truth(20.0) == stopped
    core.feed(CLEAR, 20.0)
    assert status(core, 20.1).faults == ()
    assert core.truth(200.0).a_deg == pytest.approx(40.0, abs=0.6)


def test_a_stop_before_the_clearing_leaves_nothing_pending():
    core = PositionerCore()
    point(core, 0.0, a_deg=40.0)
    core.inject("a_overcurrent", 10.0)
    core.feed(STOP, 20.0)
    core.feed(CLEAR, 20.06)
    assert core.truth(200.0).a_deg < 15.0


def test_a_faulted_axis_refuses_targets_and_the_other_one_takes_them():
    core = PositionerCore()
    core.inject("a_overcurrent", 0.0)
    before = number(core, Field.A_DESTINATION, 0.0)
    point(core, 1.0, a_deg=20.0, b_deg=50.0)
    assert number(core, Field.A_DESTINATION, 2.0) == before
    assert core.truth(200.0).b_deg == pytest.approx(50.0, abs=0.4)


def test_a_latched_fault_clears_itself_15_minutes_after_power_up_and_the_move_goes_on():
    core = PositionerCore()
    point(core, 850.0, a_deg=40.0)
    core.inject("a_overcurrent", 855.0)
    stopped = core.truth(899.9)
    assert status(core, 899.9).faults
    assert not status(core, 900.1).faults
    assert core.truth(905.0).a_deg > stopped.a_deg
    core.inject("a_overcurrent", 905.0)
    assert status(core, 90_000.0).faults


def test_a_lost_hall_signal_latches_after_two_seconds_of_driving_blind():
    core = PositionerCore()
    point(core, 0.0, a_deg=40.0)
    core.inject("a_hall_loss", 10.0)
    counted = number(core, Field.A_POSITION, 10.0)
    assert status(core, 11.9).faults == ()
    assert status(core, 12.1).faults == ("a_hall_fault", "a_pulse_loss")
    assert number(core, Field.A_POSITION, 12.1) == counted
    assert A_ACTUATOR.position_mm(core.truth(12.1).a_deg) == pytest.approx(counted + 6.4, abs=0.01)
    core.repair("a_hall_loss", 13.0)
    core.feed(CLEAR, 13.0)
    assert number(core, Field.A_POSITION, 200.0) == int(A_ACTUATOR.position_mm(40.0))
    assert core.truth(200.0).a_deg > 41.0


def test_a_hall_signal_lost_at_rest_shows_at_the_next_move():
    core = PositionerCore()
    core.inject("b_hall_loss", 0.0)
    assert status(core, 100.0).faults == ()
    point(core, 100.0, b_deg=50.0)
    assert status(core, 103.0).faults == ("b_hall_fault", "b_pulse_loss")


def test_a_broken_cable_latches_again_however_often_it_is_cleared():
    core = PositionerCore()
    core.inject("b_cable", 0.0)
    core.feed(CLEAR, 1.0)
    assert status(core, 2.0).faults == ("b_cable",)
    core.repair("b_cable", 3.0)
    assert status(core, 4.0).faults == ("b_cable",)
    core.feed(CLEAR, 5.0)
    assert status(core, 6.0).faults == ()


def test_a_switch_stuck_closed_stops_inward_moves_and_fakes_a_home():
    core = PositionerCore()
    core.inject("a_switch_closed", 0.0)
    here = core.truth(0.0).a_deg
    point(core, 1.0, a_deg=-20.0)
    assert core.truth(60.0).a_deg == pytest.approx(here)
    assert number(core, Field.A_DESTINATION, 60.0) == number(core, Field.A_POSITION, 60.0)
    point(core, 60.0, a_deg=20.0)
    assert core.truth(120.0).a_deg == pytest.approx(20.0, abs=0.4)
    core.feed(HOME_A, 120.0)
    assert number(core, Field.A_POSITION, 121.0) == 0.0
    assert core.truth(121.0).a_deg == pytest.approx(20.0, abs=0.4)


def test_a_switch_that_does_not_close_lets_homing_run_into_the_hard_stop():
    core = PositionerCore()
    core.inject("a_switch_open", 0.0)
    core.feed(HOME_A, 1.0)
    assert status(core, 200.0).faults == ("a_hall_fault", "a_pulse_loss")
    assert A_ACTUATOR.position_mm(core.truth(200.0).a_deg) == pytest.approx(-1.0)
    assert not status(core, 200.0).homing


def test_a_move_that_meets_an_end_switch_ends_there():
    core = PositionerCore()
    core.inject("reset_position_lost", 0.0)
    core.feed(encode_command(Field.A_DESTINATION, 372), 1.0)
    assert core.truth(300.0).a_deg == pytest.approx(52.0)
    assert "a_high" in status(core, 300.0).end_switches
    assert number(core, Field.A_DESTINATION, 300.0) == number(core, Field.A_POSITION, 300.0)


def test_undervoltage_cuts_a_move_off_and_refuses_the_next_one():
    core = PositionerCore()
    point(core, 0.0, a_deg=40.0)
    core.inject("undervoltage", 10.0)
    stopped = core.truth(10.0)
    point(core, 11.0, a_deg=20.0)
    core.feed(HOME_A, 12.0)
    assert number(core, Field.SUPPLY, 13.0) == 15.0
    assert not status(core, 13.0).homing
    assert core.truth(60.0) == stopped
    core.repair("undervoltage", 60.0)
    assert core.truth(120.0) == stopped
    point(core, 120.0, a_deg=20.0)
    assert core.truth(180.0).a_deg == pytest.approx(20.0, abs=0.4)


def test_a_power_cycle_stops_everything_sets_the_reset_mark_and_keeps_the_count():
    core = PositionerCore()
    point(core, 0.0, a_deg=40.0, b_deg=50.0)
    core.inject("b_overcurrent", 5.0)
    position = number(core, Field.A_POSITION, 10.0)
    core.power_cycle(10.0)
    assert status(core, 10.0).was_reset
    assert status(core, 10.0).faults == ()
    assert number(core, Field.A_POSITION, 500.0) == position
    assert number(core, Field.A_DESTINATION, 500.0) == position
    core.feed(CLEAR, 500.0)
    assert not status(core, 501.0).was_reset


def test_a_fresh_unit_has_no_reset_mark():
    assert not status(PositionerCore(), 0.0).was_reset


def test_a_button_stops_the_axes_and_leaves_its_mark():
    core = PositionerCore()
    point(core, 0.0, a_deg=40.0)
    core.inject("button", 10.0)
    assert status(core, 10.1).button_pressed
    assert core.truth(11.0) == core.truth(100.0)


def test_a_deaf_unit_shows_telemetry_and_takes_no_command():
    core = PositionerCore()
    core.inject("deaf", 0.0)
    point(core, 1.0, a_deg=40.0)
    assert core.truth(60.0).a_deg == pytest.approx(0.0)
    core.repair("deaf", 60.0)
    point(core, 60.0, a_deg=40.0)
    assert core.truth(120.0).a_deg > 39.0


def own(**changes):
    return Setup(own_target=lambda now: Angles(-30.0 + now / 100.0, 60.0), **changes)


def test_its_own_tracking_moves_by_itself_and_ignores_the_host_until_switched_off():
    core = PositionerCore(setup=own())
    core.inject("own_tracking", 0.0)
    assert status(core, 0.1).own_tracking
    assert fields(core, 0.1)[Field.MODE] == b"Micro tracking"
    point(core, 100.0, a_deg=40.0)
    assert core.truth(200.0).a_deg == pytest.approx(-30.0, abs=0.4)
    assert core.truth(1000.0).a_deg == pytest.approx(-21.0, abs=0.4)
    core.feed(STOP, 1000.0)
    assert core.truth(1400.0).a_deg == pytest.approx(-18.0, abs=0.4)
    core.feed(TRACKING_OFF, 1400.0)
    assert not status(core, 1401.0).own_tracking
    point(core, 1401.0, a_deg=40.0)
    assert core.truth(3000.0).a_deg == pytest.approx(40.0, abs=0.6)


def test_switching_its_tracking_off_does_not_stop_a_running_motor():
    core = PositionerCore(setup=own())
    core.inject("own_tracking", 0.0)
    core.feed(TRACKING_OFF, 5.0)
    assert core.truth(100.0).a_deg == pytest.approx(-30.0, abs=0.4)


def test_a_slave_takes_tracking_off_for_the_other_way_round():
    core = PositionerCore()
    core.inject("slave_mode", 0.0)
    core.feed(TRACKING_OFF, 1.0)
    assert fields(core, 2.0)[Field.MODE] == b"sigma standby"
    core.feed(TRACKING_OFF, 3.0)
    assert fields(core, 4.0)[Field.MODE] == b"sigma tracking"
    assert status(core, 4.0).own_tracking


def test_wind_stows_after_half_a_second_and_is_left_after_its_hold():
    core = PositionerCore(setup=own(wind_stow=Angles(0.0, 90.0), wind_hold_s=120.0))
    core.inject("own_tracking", 0.0)
    core.inject("wind", 200.0)
    assert not status(core, 200.4).wind
    assert status(core, 200.6).wind
    assert fields(core, 201.0)[Field.MODE] == b"wind mode"
    assert core.truth(300.0) == pytest.approx((0.0, 90.0), abs=0.5)
    core.repair("wind", 300.0)
    assert status(core, 419.0).wind
    assert not status(core, 421.0).wind
    assert core.truth(599.0).b_deg == pytest.approx(60.0, abs=0.5)


def test_a_gust_shorter_than_half_a_second_and_wind_without_a_stow_position_do_nothing():
    core = PositionerCore(setup=own(wind_stow=Angles(0.0, 90.0)))
    core.inject("own_tracking", 0.0)
    core.inject("wind", 200.0)
    core.repair("wind", 200.3)
    assert not status(core, 299.0).wind
    bare = PositionerCore(setup=own())
    bare.inject("own_tracking", 0.0)
    bare.inject("wind", 200.0)
    assert not status(bare, 299.0).wind


def test_snow_stows_after_ten_seconds_and_only_with_its_own_tracking_on():
    core = PositionerCore(setup=own(snow_stow=Angles(0.0, 20.0)))
    core.inject("snow", 0.0)
    assert core.truth(100.0).b_deg == pytest.approx(90.0)
    assert not status(core, 100.0).autonomous
    core.inject("own_tracking", 100.0)
    assert status(core, 101.0).snow
    assert core.truth(300.0).b_deg == pytest.approx(20.0, abs=0.5)


def test_a_re_reference_homes_both_axes_unasked():
    core = PositionerCore()
    core.inject("re_reference", 0.0)
    assert core.truth(400.0) == pytest.approx((-52.0, 13.0))


def test_what_it_cannot_do_is_refused_by_name():
    core = PositionerCore()
    with pytest.raises(ValueError, match=r"no fault 'melt'.*a_overcurrent"):
        core.inject("melt", 0.0)
    with pytest.raises(ValueError, match="nothing to end"):
        core.repair("a_overcurrent", 0.0)
    with pytest.raises(ValueError, match="nothing to end"):
        core.repair("button", 0.0)
    with pytest.raises(ValueError, match="cannot go back"):
        core.advance(-1.0)
    with pytest.raises(ValueError, match="cannot go back"):
        core.advance(float("nan"))


def test_an_idle_unit_has_one_event_left_and_then_none():
    core = PositionerCore()
    assert core.next_event(0.0) == 900.0
    assert core.next_event(86_400.0) is None


COMMANDS = st.one_of(
    st.floats(-60, 60).map(lambda a: encode_command(Field.A_ANGLE, a)),
    st.floats(10, 95).map(lambda b: encode_command(Field.B_ANGLE, b)),
    st.sampled_from([STOP, CLEAR, HOME_A, HOME_B, TRACKING_OFF, JOG_A_OUT, b"$93\r", b"$8Y\r", b"$7\r"]),
    st.binary(max_size=80),
)
FAULT = st.sampled_from(FAULTS)
STEPS = st.lists(st.tuples(st.floats(0, 50), st.one_of(COMMANDS, FAULT)), max_size=12)
ENDS = ((A_ACTUATOR, -1.0), (B_ACTUATOR, -1.0))


@given(STEPS)
def test_whatever_happens_the_axes_stay_on_their_tracks_and_the_screens_stay_readable(steps):
    core, now = PositionerCore(setup=own(wind_stow=Angles(0.0, 90.0))), 0.0
    for wait, step in steps:
        now += wait
        if isinstance(step, bytes):
            core.feed(step, now)
        else:
            core.inject(step, now)
        status(core, now)
        for (actuator, low_mm), angle_deg in zip(ENDS, core.truth(now), strict=True):
            position = actuator.position_mm(angle_deg)
            assert low_mm - 1e-6 <= position <= actuator.travel_mm + 1e-6


@given(STEPS, st.integers(1, 40))
def test_how_often_it_is_looked_at_changes_nothing(steps, looks):
    seldom, often, now = PositionerCore(setup=own()), PositionerCore(setup=own()), 0.0
    for wait, step in steps:
        for i in range(1, looks):
            often.advance(now + wait * i / looks)
        now += wait
        for core in (seldom, often):
            if isinstance(step, bytes):
                core.feed(step, now)
            else:
                core.inject(step, now)
    assert seldom.screens(now + 30.0) == often.screens(now + 30.0)
    assert seldom.truth(now + 30.0) == often.truth(now + 30.0)
