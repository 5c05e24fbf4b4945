from itertools import pairwise

import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.positioners.pozsol import wire
from drivers.positioners.pozsol.wire import Field, TokenStream, encode_command, parse_status
from sim_drivers.pozsol.core import FAULTS, PositionerCore
from sim_drivers.pozsol.profile import coast, drive_to
from sim_drivers.pozsol.screens import SLOW_SCREENS
from sim_drivers.pozsol.setup import A_ACTUATOR, B_ACTUATOR, Actuator, AxisDrive, Setup
from solar.frames import Angles

STOP = encode_command(Field.ACTION, wire.STOP)
CLEAR = encode_command(Field.STATUS, wire.CLEAR)
HOME_A = encode_command(Field.ACTION, wire.HOME_A)
HOME_B = encode_command(Field.ACTION, wire.HOME_B)
TRACKING_OFF = encode_command(Field.MODE, wire.TRACKING_OFF)


def fields(core, now):
    return dict(TokenStream().feed(core.screens(now) + b"$"))


def number(core, field, now):
    return float(fields(core, now)[field])


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
    assert A_ACTUATOR.position_mm(core.truth(60.0).a_deg) == pytest.approx(expected, abs=0.2)
    assert core.truth(60.0).a_deg < 20.0
    assert core.truth(60.0).b_deg == pytest.approx(90.0)


@given(st.floats(-50, 50), st.floats(15, 90))
def test_the_whole_working_range_is_reached_to_within_one_millimetre(a_deg, b_deg):
    core = PositionerCore()
    end = core.truth(point(core, 0.0, a_deg, b_deg) + 300.0)
    assert -0.2 <= A_ACTUATOR.position_mm(a_deg) - A_ACTUATOR.position_mm(end.a_deg) < 1.2
    assert -0.2 <= B_ACTUATOR.position_mm(b_deg) - B_ACTUATOR.position_mm(end.b_deg) < 1.2


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
SPEEDS = st.floats(-3.13, 3.13)


@given(POSITIONS, SPEEDS, POSITIONS)
def test_a_move_is_continuous_keeps_to_its_speed_and_ends_a_little_beyond_its_target(start, velocity, target):
    drive = AxisDrive()
    profile = drive_to(10.0, start, velocity, target, drive)
    assert abs(profile.end - target) <= drive.overshoot_mm + 1e-9
    assert profile.at(10.0) == pytest.approx((start, velocity), abs=1e-6)
    assert profile.at(profile.end_s) == (profile.end, 0.0)
    steps = 200
    dt = (profile.end_s - 10.0) / steps
    states = [profile.at(10.0 + i * dt) for i in range(steps + 1)]
    for (x0, _), (x1, v1) in pairwise(states):
        assert abs(v1) <= drive.speed_mm_s + 1e-9
        assert abs(x1 - x0) <= drive.speed_mm_s * dt + 1e-6
    assert profile.at(profile.crosses_s)[0] == pytest.approx(target, abs=1e-6)


@given(POSITIONS, SPEEDS, POSITIONS, st.floats(1, 300))
def test_a_move_is_cut_exactly_where_it_meets_a_hard_stop(start, velocity, target, limit):
    start = min(max(start, -limit), limit)
    profile = drive_to(0.0, start, velocity, target, AxisDrive()).cut_at(-limit, limit)
    assert all(abs(profile.at(i * profile.end_s / 100)[0]) <= limit + 1e-6 for i in range(101))
    assert abs(profile.at(profile.end_s - 1e-9)[0] - profile.end) < 1e-3
    assert abs(profile.end) <= limit


def test_an_axis_runs_out_at_a_steady_rate():
    profile = coast(5.0, 100.0, -3.2, AxisDrive(speed_mm_s=3.2, run_out_s=0.5))
    assert profile.end_s == 5.5
    assert profile.end == pytest.approx(99.2)


def test_a_move_takes_the_time_of_its_speed_and_ramps_and_counts_as_one_for_another_four_tenths_of_a_second():
    core = PositionerCore()
    start = number(core, Field.A_POSITION, 0.0)
    core.feed(encode_command(Field.A_DESTINATION, int(start) + 65), 0.001)
    drive = AxisDrive()
    way = int(start) + 65 - start
    arrival_s = 0.02 + way / drive.speed_mm_s + 0.5 * drive.speed_mm_s / drive.acceleration_mm_s2
    assert status(core, arrival_s - 0.1).a_moving
    assert number(core, Field.A_POSITION, arrival_s + 0.3) == pytest.approx(int(start) + 65 + 0.14, abs=0.03)
    assert number(core, Field.A_DESTINATION, arrival_s + 0.3) == int(start) + 65
    assert number(core, Field.A_DESTINATION, arrival_s + 0.5) == number(core, Field.A_POSITION, arrival_s + 0.5)


def test_what_it_is_told_while_it_brakes_at_its_target_is_lost():
    core = PositionerCore()
    core.feed(encode_command(Field.A_DESTINATION, 239), 0.001)
    crosses_s = next(i / 100 for i in range(1, 1000) if number(core, Field.A_POSITION, i / 100) >= 239)
    core.feed(encode_command(Field.A_DESTINATION, 200), crosses_s + 0.1)
    assert number(core, Field.A_DESTINATION, crosses_s + 0.15) == 200
    assert number(core, Field.A_DESTINATION, crosses_s + 0.5) == pytest.approx(239.1, abs=0.1)
    assert number(core, Field.A_POSITION, 60.0) == pytest.approx(239.1, abs=0.1)


def test_b_waits_until_a_has_stopped():
    core = PositionerCore()
    now = point(core, 0.0, a_deg=10.0, b_deg=60.0)
    assert number(core, Field.B_DESTINATION, now) == int(B_ACTUATOR.position_mm(60.0))
    assert status(core, now + 2.0).a_moving
    assert not status(core, now + 2.0).b_moving
    assert core.truth(now + 2.0).b_deg == pytest.approx(90.0)
    assert core.truth(now + 200.0).b_deg == pytest.approx(60.0, abs=0.4)


def test_a_synchronous_unit_says_so_and_takes_turns_all_the_same():
    core = PositionerCore(setup=Setup(synchronous=True))
    now = point(core, 0.0, a_deg=10.0, b_deg=60.0)
    assert not status(core, now + 2.0).b_moving
    assert fields(core, now + 2.0)[Field.SERVICE].startswith(b"Run:synch")


def test_a_move_smaller_than_the_dead_band_waits_until_it_is_the_axis_turn():
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


def test_after_a_stop_the_destination_is_the_position_and_no_bit_tells_that_the_axis_runs_out():
    core = PositionerCore()
    now = point(core, 0.0, a_deg=40.0, b_deg=30.0)
    core.feed(STOP, 10.0)
    before = number(core, Field.A_POSITION, 10.02)
    shown = status(core, 10.03)
    assert not shown.a_moving
    assert number(core, Field.A_POSITION, 10.1) > before
    assert number(core, Field.A_DESTINATION, 10.1) == number(core, Field.A_POSITION, 10.1)
    after = number(core, Field.A_POSITION, 11.0)
    assert after - before == pytest.approx(0.39, abs=0.02)
    assert number(core, Field.A_DESTINATION, 11.0) == after
    assert number(core, Field.B_DESTINATION, 11.0) == number(core, Field.B_POSITION, 11.0)
    assert number(core, Field.A_POSITION, now + 500.0) == after
    assert core.truth(now + 500.0).b_deg == pytest.approx(90.0)


def test_on_a_reversal_it_drives_the_old_way_for_another_second():
    core = PositionerCore()
    point(core, 0.0, a_deg=40.0)
    turn = number(core, Field.A_POSITION, 10.0)
    point(core, 10.0, a_deg=-40.0)
    assert status(core, 10.5).a_moving
    assert number(core, Field.A_POSITION, 11.0) == pytest.approx(turn + 3.1, abs=0.1)
    assert number(core, Field.A_POSITION, 11.5) == pytest.approx(turn + 3.55, abs=0.1)
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


@pytest.mark.parametrize("text", [b"-5", b"-1", b"99999999999", b"-99999999999"])
def test_a_negative_destination_becomes_the_largest_one(text):
    core = PositionerCore()
    core.feed(b"$." + text + b"\r", 0.0)
    assert number(core, Field.A_DESTINATION, 0.1) == int(A_ACTUATOR.travel_mm)


@pytest.mark.parametrize(
    ("text", "angle_deg"),
    [(b"1e1", 10.0), (b"0x10", 16.0), (b"0x1.8p3", 12.0), (b"\t5", 5.0), (b"\n5.", 5.0), (b".5e1x", 5.0), (b"", 0.0)],
)
def test_numbers_are_read_as_the_c_library_reads_them(text, angle_deg):
    core = PositionerCore()
    core.feed(b"$," + text + b"\r", 0.0)
    assert number(core, Field.A_DESTINATION, 0.1) == int(A_ACTUATOR.position_mm(angle_deg))


@pytest.mark.parametrize("text", [b"nan", b"inf", b"-INF", b"nan(5)", b"1e400", b"0x1p5000", b"-120"])
def test_an_angle_without_a_triangle_is_the_low_end(text):
    core = PositionerCore()
    core.feed(b"$," + text + b"\r", 0.0)
    assert number(core, Field.A_DESTINATION, 0.1) == 0.0


def test_the_input_is_looked_at_every_20_ms_and_a_second_packet_overwrites_the_first():
    core = PositionerCore()
    core.feed(encode_command(Field.A_ANGLE, 10.0), 1.001)
    core.feed(encode_command(Field.B_ANGLE, 60.0), 1.019)
    assert number(core, Field.A_DESTINATION, 1.1) == pytest.approx(A_ACTUATOR.position_mm(0.0), abs=0.02)
    assert number(core, Field.B_DESTINATION, 1.1) == int(B_ACTUATOR.position_mm(60.0))


def test_only_the_first_of_two_commands_in_one_packet_is_acted_on():
    core = PositionerCore()
    core.feed(encode_command(Field.A_ANGLE, 10.0) + encode_command(Field.B_ANGLE, 60.0), 1.0)
    assert number(core, Field.A_DESTINATION, 1.1) == int(A_ACTUATOR.position_mm(10.0))
    assert number(core, Field.B_DESTINATION, 1.1) == pytest.approx(B_ACTUATOR.position_mm(90.0), abs=0.02)


def test_a_packet_longer_than_64_bytes_is_overwritten_by_its_own_end():
    core = PositionerCore()
    core.feed(encode_command(Field.A_ANGLE, 10.0).ljust(64, b" ") + encode_command(Field.B_ANGLE, 60.0), 1.0)
    assert number(core, Field.A_DESTINATION, 1.1) == pytest.approx(A_ACTUATOR.position_mm(0.0), abs=0.02)
    assert number(core, Field.B_DESTINATION, 1.1) == int(B_ACTUATOR.position_mm(60.0))


def test_digits_of_an_earlier_command_stay_behind_a_shorter_one_that_is_not_closed():
    core = PositionerCore()
    core.feed(b"$.205.5", 1.0)
    core.feed(b"$.30", 2.0)
    assert number(core, Field.A_DESTINATION, 2.1) == 305.0
    core.feed(encode_command(Field.A_DESTINATION, 30), 3.0)
    assert number(core, Field.A_DESTINATION, 3.1) == 30.0


def test_only_a_dollar_at_the_very_beginning_makes_a_command():
    core = PositionerCore()
    core.feed(b"AT+GCAP\r", 1.0)
    assert core.truth(50.0).a_deg == pytest.approx(0.0)
    core.feed(b"\r$.100\r", 60.0)
    assert number(core, Field.A_DESTINATION, 61.0) == number(core, Field.A_POSITION, 61.0)
    core.feed(b"$.100\r", 62.0)
    assert number(core, Field.A_DESTINATION, 63.0) == 100.0


def test_a_lone_dollar_carries_out_what_is_left_of_the_command_before():
    core = PositionerCore()
    core.feed(b"$.100\r", 1.0)
    core.feed(STOP, 2.0)
    core.feed(b"$.200\r", 3.0)
    core.feed(b"xxxxxxxxx", 4.0)
    assert number(core, Field.A_DESTINATION, 5.0) == 200.0
    core.feed(b"$", 6.0)
    assert number(core, Field.A_DESTINATION, 7.0) == 200.0


def test_the_first_packet_after_each_connection_of_the_cable_is_lost():
    core = PositionerCore()
    point(core, 0.0, a_deg=40.0)
    core.enumerate_usb(5.0)
    core.feed(STOP, 5.0)
    assert status(core, 5.5).a_moving
    core.feed(STOP, 5.5)
    assert core.truth(6.5) == core.truth(100.0)


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
    assert again == [*firsts, SLOW_SCREENS[0][0]]


def test_the_screens_identify_the_unit_and_print_the_documented_decimals():
    text = fields(PositionerCore(), 0.0)
    assert text[Field.BOARD] == b"36A1"
    assert text[Field.VERSION].endswith(b"(B1.100)")
    assert [len(group) for group in text[Field.SERIAL].split(b"-")] == [8, 8, 8, 8]
    assert text[Field.STATUS] == b"0000"
    assert text[Field.MODE] == b"tracker ok"
    assert text[Field.SUPPLY] == b"24.00"


def test_geometry_is_printed_as_the_firmware_understands_it():
    lowers = Actuator(300.0, 280.0, 60.0, 40.0, -30.0, holder_mm=39.6, raises=False, zero_offset_mm=1.5)
    text = fields(PositionerCore(setup=Setup(b_actuator=lowers, start=Angles(0.0, 0.0))), 0.0)
    assert [text[code] for code in range(70, 81)] == (
        [b"195.3", b"300.0", b"300.0", b"0.0", b"0.0", b"1.0", b"-90.0", b"0.0", b"75.0", b"376", b"2"]
    )
    stator = f"{lowers.stator_mm:.1f}".encode()
    assert [text[code] for code in range(96, 104)] == (
        [stator, b"300.0", b"280.0", b"0.0", b"39.6", b"0.0", b"120.0", b"0.0"]
    )
    assert (text[192], text[193]) == (b"0.00", b"1.50")
    assert {text[code] for code in (108, 109, 122, 123, 126, 127)} == {b"off"}


def test_a_holder_and_a_zero_offset_change_where_an_angle_lies():
    held = Actuator(300.0, 300.0, 90.0, -52.0, 52.0, holder_mm=39.6)
    assert abs(held.position_mm(20.0) - A_ACTUATOR.position_mm(20.0)) > 1.0
    assert held.angle_deg(held.position_mm(20.0)) == pytest.approx(20.0)
    offset = Actuator(300.0, 300.0, 90.0, -52.0, 52.0, zero_offset_mm=2.0)
    core = PositionerCore(setup=Setup(a_actuator=offset))
    point(core, 0.0, a_deg=20.0)
    assert number(core, Field.A_DESTINATION, 0.1) == int(A_ACTUATOR.position_mm(20.0)) + 2


def test_an_actuator_on_the_other_side_lowers_the_angle_by_extension():
    lowers = Actuator(300.0, 300.0, 60.0, 40.0, -30.0, raises=False)
    assert lowers.position_mm(10.0) > lowers.position_mm(30.0) > 0
    assert lowers.angle_deg(lowers.position_mm(10.0)) == pytest.approx(10.0)


def test_the_live_screens_say_the_same_as_all_screens():
    core = PositionerCore()
    point(core, 0.0, a_deg=40.0)
    every = fields(core, 3.0)
    live = dict(TokenStream().feed(core.live_screens(3.0) + b"$"))
    assert {Field.A_POSITION, Field.B_DESTINATION, Field.SUPPLY, Field.MODE, Field.STATUS} <= set(live)
    assert all(every[code] == value for code, value in live.items())


def test_homing_runs_past_the_low_switch_and_starts_the_count_anew_there():
    core = PositionerCore()
    core.feed(HOME_A, 0.0)
    assert not status(core, 0.03).homing
    assert status(core, 0.2).homing
    assert number(core, Field.A_DESTINATION, 5.0) == pytest.approx(number(core, Field.A_POSITION, 5.0) - 10.0)
    assert not status(core, 200.0).homing
    assert number(core, Field.A_POSITION, 200.0) == pytest.approx(-0.4, abs=0.03)
    assert number(core, Field.A_DESTINATION, 200.0) == number(core, Field.A_POSITION, 200.0)
    assert number(core, Field.A_REMAIN, 200.0) == pytest.approx(0.0, abs=0.02)
    assert "a_low" in status(core, 200.0).end_switches
    assert core.truth(200.0).a_deg == pytest.approx(-52.0, abs=0.2)


def test_homing_b_while_a_moves_leaves_a_without_control():
    core = PositionerCore(setup=Setup(start=Angles(0.0, 20.0)))
    point(core, 0.0, a_deg=40.0)
    counted = number(core, Field.A_POSITION, 10.0)
    core.feed(HOME_B, 10.0)
    assert status(core, 11.0).homing
    # It goes on to be driven until B is, and none of it is counted.
    gone_mm = A_ACTUATOR.position_mm(core.truth(13.0).a_deg) - counted
    assert gone_mm == pytest.approx(1.7, abs=0.2)
    assert number(core, Field.A_POSITION, 13.0) == pytest.approx(counted, abs=0.1)
    assert status(core, 13.5).faults == ("a_hall_fault",)


def test_homing_an_axis_that_moves_outwards_is_lost():
    core = PositionerCore()
    point(core, 0.0, a_deg=40.0)
    before = number(core, Field.A_POSITION, 3.0)
    core.feed(HOME_A, 3.0)
    assert status(core, 3.5).homing
    assert not status(core, 10.0).homing
    assert number(core, Field.A_POSITION, 100.0) == pytest.approx(before + 3.1 - 10.0, abs=0.3)


def test_during_homing_targets_of_that_axis_are_refused_and_those_of_the_other_are_taken_and_lost_at_its_end():
    core = PositionerCore()
    core.feed(HOME_A, 0.0)
    point(core, 1.0, a_deg=20.0, b_deg=50.0)
    assert number(core, Field.A_DESTINATION, 2.0) < number(core, Field.A_POSITION, 2.0)
    assert number(core, Field.B_DESTINATION, 2.0) == int(B_ACTUATOR.position_mm(50.0))
    assert core.truth(200.0).a_deg == pytest.approx(-52.0, abs=0.2)
    assert core.truth(200.0).b_deg == pytest.approx(90.0)
    point(core, 200.0, a_deg=20.0)
    assert core.truth(400.0).a_deg == pytest.approx(20.0, abs=0.4)


def test_a_supply_dip_breaks_homing_off_without_a_word():
    core = PositionerCore()
    core.feed(HOME_A, 0.0)
    core.inject("undervoltage", 5.0)
    core.repair("undervoltage", 5.8)
    broken_off = core.truth(6.5)
    shown = status(core, 10.0)
    assert not shown.homing
    assert shown.faults == ()
    assert not shown.was_reset
    assert core.truth(100.0) == broken_off


def test_stop_ends_a_homing_run():
    core = PositionerCore()
    core.feed(HOME_A, 0.0)
    core.feed(STOP, 5.0)
    assert not status(core, 5.1).homing
    assert core.truth(6.0) == core.truth(700.0)


def test_homing_gives_up_after_600_s():
    core = PositionerCore(setup=Setup(drive=AxisDrive(speed_mm_s=0.2)))
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
    assert number(core, Field.A_REMAIN, 200.0) == pytest.approx(-A_ACTUATOR.position_mm(0.0), abs=0.03)


JOG_A_OUT = b"$92\r"


def test_a_jog_ends_280_ms_after_its_last_repetition():
    core = PositionerCore()
    for i in range(10):
        core.feed(JOG_A_OUT, i * 0.2)
    assert status(core, 1.82 + 0.27).a_moving
    assert not status(core, 1.82 + 0.29).a_moving
    end = core.truth(1.82 + 0.28 + 0.6)
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
    assert B_ACTUATOR.position_mm(core.truth(300.0).b_deg) == pytest.approx(int(shorter.travel_mm), abs=0.2)


def test_an_unknown_action_ends_a_move_as_a_jog_that_is_not_repeated():
    core = PositionerCore()
    point(core, 0.0, a_deg=40.0)
    core.feed(b"$9x\r", 5.0)
    assert status(core, 5.25).a_moving
    assert core.truth(6.0) == core.truth(100.0)


def test_overcurrent_forgets_the_axis_target_and_the_other_axis_pending_move_begins():
    core = PositionerCore()
    point(core, 0.0, a_deg=40.0, b_deg=50.0)
    core.inject("a_overcurrent", 5.0)
    assert number(core, Field.A_DESTINATION, 6.0) == number(core, Field.A_POSITION, 6.0)
    stopped = core.truth(6.0).a_deg
    assert status(core, 20.0).faults == ("a_overcurrent",)
    core.feed(CLEAR, 20.0)
    assert status(core, 20.1).faults == ()
    assert core.truth(200.0).a_deg == stopped
    assert core.truth(200.0).b_deg == pytest.approx(50.0, abs=0.4)


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


def test_a_latched_fault_clears_itself_once_15_minutes_after_power_up():
    core = PositionerCore()
    core.inject("a_overcurrent", 855.0)
    assert status(core, 899.9).faults
    assert not status(core, 900.1).faults
    core.inject("a_overcurrent", 905.0)
    assert status(core, 90_000.0).faults


def test_a_target_that_was_given_up_shows_until_it_is_cleared():
    core = PositionerCore()
    core.inject("a_destination", 0.0)
    core.inject("b_destination", 0.0)
    word = int(fields(core, 1.0)[Field.STATUS])
    assert word < 0
    assert word & 0xFFFF_FFFF == 1 << 28 | 1 << 31
    core.feed(CLEAR, 2.0)
    assert fields(core, 3.0)[Field.STATUS] == b"0000"


def test_a_lost_hall_signal_latches_after_two_seconds_of_driving_blind():
    core = PositionerCore()
    point(core, 0.0, a_deg=40.0)
    core.inject("a_hall_loss", 10.0)
    counted = number(core, Field.A_POSITION, 10.0)
    assert not status(core, 10.5).a_moving
    assert status(core, 11.9).faults == ()
    assert status(core, 12.1).faults == ("a_hall_fault",)
    assert number(core, Field.A_POSITION, 12.1) == counted
    assert number(core, Field.A_DESTINATION, 12.1) == counted
    blind_mm = A_ACTUATOR.position_mm(core.truth(13.0).a_deg) - counted
    assert blind_mm == pytest.approx(2.125 * 235 / 75, abs=0.05)
    core.repair("a_hall_loss", 13.0)
    core.feed(CLEAR, 13.0)
    point(core, 14.0, a_deg=40.0)
    assert number(core, Field.A_POSITION, 200.0) == pytest.approx(int(A_ACTUATOR.position_mm(40.0)), abs=0.2)
    assert core.truth(200.0).a_deg > 41.0


def test_a_hall_signal_lost_at_rest_shows_at_the_next_move():
    core = PositionerCore()
    core.inject("b_hall_loss", 0.0)
    assert status(core, 100.0).faults == ()
    point(core, 100.0, b_deg=50.0)
    assert status(core, 103.0).faults == ("b_hall_fault",)


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
    assert status(core, 200.0).faults == ("a_hall_fault",)
    assert A_ACTUATOR.position_mm(core.truth(200.0).a_deg) == pytest.approx(-1.0)
    assert not status(core, 200.0).homing


def test_a_move_that_meets_its_high_end_switch_ends_there_unless_the_build_has_none():
    for has_one in (True, False):
        core = PositionerCore(setup=Setup(high_switches=has_one))
        core.inject("reset_position_lost", 0.0)
        core.feed(CLEAR, 0.5)
        core.feed(encode_command(Field.A_DESTINATION, 372), 1.0)
        beyond_mm = A_ACTUATOR.position_mm(core.truth(300.0).a_deg) - A_ACTUATOR.travel_mm
        assert beyond_mm == pytest.approx(0.39 if has_one else 1.0, abs=0.03)
        assert ("a_high" in status(core, 300.0).end_switches) is has_one
        assert number(core, Field.A_DESTINATION, 300.0) == number(core, Field.A_POSITION, 300.0)


def test_undervoltage_cuts_a_move_off_and_refuses_targets_until_five_seconds_after_it():
    core = PositionerCore()
    point(core, 0.0, a_deg=40.0)
    core.inject("undervoltage", 10.0)
    stopped = core.truth(10.5)
    point(core, 11.0, a_deg=20.0)
    core.feed(HOME_A, 12.0)
    assert number(core, Field.SUPPLY, 13.0) == 15.0
    assert not status(core, 13.0).homing
    core.repair("undervoltage", 60.0)
    point(core, 64.5, a_deg=20.0)
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
    assert status(core, 501.0).was_reset, "it has enumerated anew, so the first packet is lost"
    core.feed(CLEAR, 502.0)
    assert not status(core, 503.0).was_reset


def test_a_fresh_unit_has_no_reset_mark():
    assert not status(PositionerCore(), 0.0).was_reset


def test_a_button_that_is_held_drives_an_axis_and_shows_for_as_long():
    core = PositionerCore()
    core.inject("button", 10.0)
    assert status(core, 10.1).button_pressed
    assert core.truth(10.3).a_deg == pytest.approx(0.0)
    assert core.truth(12.0).a_deg > 0.5
    core.repair("button", 12.0)
    assert not status(core, 12.1).button_pressed
    assert core.truth(13.0) == core.truth(100.0)


def test_a_short_press_of_a_button_stops_nothing():
    core = PositionerCore()
    point(core, 0.0, a_deg=40.0)
    core.inject("button_in", 10.0)
    core.repair("button_in", 10.2)
    assert core.truth(100.0).a_deg == pytest.approx(40.0, abs=0.4)


def test_both_buttons_choose_the_other_axis():
    core = PositionerCore()
    core.inject("buttons_both", 0.0)
    core.repair("buttons_both", 0.5)
    core.inject("button_in", 1.0)
    core.repair("button_in", 5.0)
    assert core.truth(10.0).a_deg == pytest.approx(0.0)
    assert core.truth(10.0).b_deg < 89.0


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


def test_a_slave_that_is_led_takes_targets_and_off_puts_it_on_standby():
    core = PositionerCore(setup=own())
    core.inject("slave_mode", 0.0)
    assert fields(core, 1.0)[Field.MODE] == b"sigma tracking"
    assert status(core, 1.0).own_tracking
    point(core, 1.0, a_deg=40.0)
    assert number(core, Field.A_DESTINATION, 2.0) == int(A_ACTUATOR.position_mm(40.0))
    for now in (3.0, 5.0):
        core.feed(TRACKING_OFF, now)
        assert fields(core, now + 1.0)[Field.MODE] == b"sigma standby"
        assert not status(core, now + 1.0).own_tracking
    core.repair("slave_mode", 7.0)
    assert fields(core, 8.0)[Field.MODE] == b"tracker ok"


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


def test_a_re_reference_homes_b_unasked_and_a_not_even_if_it_is_due_as_well():
    core = PositionerCore()
    core.inject("re_reference", 0.0)
    assert status(core, 5.0).homing
    assert core.truth(400.0) == pytest.approx((0.0, 13.0), abs=0.2)


def test_an_axis_may_ignore_its_targets_and_a_count_may_slip():
    core = PositionerCore()
    core.inject("a_ignores_targets", 0.0)
    before = number(core, Field.A_DESTINATION, 0.0)
    point(core, 1.0, a_deg=20.0, b_deg=50.0)
    assert number(core, Field.A_DESTINATION, 2.0) == before
    assert core.truth(200.0).b_deg == pytest.approx(50.0, abs=0.4)
    counted = number(core, Field.B_POSITION, 200.0)
    core.inject("b_slip", 200.0)
    assert number(core, Field.B_POSITION, 200.0) == pytest.approx(counted + 5.0)
    core.feed(HOME_B, 201.0)
    assert number(core, Field.B_REMAIN, 400.0) == pytest.approx(5.0, abs=0.03)


def test_b_shows_its_motion_where_the_layout_of_its_build_has_it():
    core = PositionerCore(setup=Setup(b_out_bit=16))
    core.feed(HOME_B, 0.0)
    word = int(fields(core, 1.0)[Field.STATUS])
    assert word == 1 << 17 | 1 << 18


def test_what_it_cannot_do_is_refused_by_name():
    core = PositionerCore()
    with pytest.raises(ValueError, match=r"no fault 'melt'.*a_overcurrent"):
        core.inject("melt", 0.0)
    with pytest.raises(ValueError, match="nothing to end"):
        core.repair("a_overcurrent", 0.0)
    with pytest.raises(ValueError, match="nothing to end"):
        core.repair("re_reference", 0.0)
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
            assert low_mm - 1e-6 <= position <= actuator.travel_mm - low_mm + 1e-6


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
