"""How the unit reads bytes from outside: numbers as C reads them, packets that overwrite, echoes that count."""

import pytest

from drivers.positioners.pozsol.wire import Field, encode_command
from sim_drivers.pozsol.core import PositionerCore
from sim_drivers.pozsol.setup import A_ACTUATOR, B_ACTUATOR
from tests.sim_drivers.pozsol.exchange import STOP, fields, moves, number, point


@pytest.mark.parametrize("text", [b"-5", b"-1", b"99999999999", b"-99999999999"])
def test_a_negative_or_too_large_destination_becomes_the_largest_one(text):
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
def test_an_angle_for_which_no_triangle_exists_is_taken_as_the_low_end(text):
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


def test_digits_of_an_earlier_command_remain_behind_a_shorter_one_without_a_terminator():
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


@pytest.mark.parametrize(("foreign", "is_repeated"), [(b"", True), (b"xxxxxxxxx", False)])
def test_a_lone_dollar_repeats_the_last_command_unless_foreign_bytes_have_overwritten_it(foreign, is_repeated):
    core = PositionerCore()
    core.feed(b"$.100\r", 1.0)
    # The button gives the axis another destination, and sends nothing that overwrites the command.
    core.inject("button", 2.0)
    core.repair("button", 10.0)
    core.feed(foreign, 32.0)
    assert number(core, Field.A_DESTINATION, 33.0) > 200.0
    core.feed(b"$", 34.0)
    assert (number(core, Field.A_DESTINATION, 35.0) == 100.0) is is_repeated


def test_the_first_packet_after_each_connection_of_the_cable_is_lost():
    core = PositionerCore()
    point(core, 0.0, a_deg=40.0)
    core.enumerate_usb(5.0)
    core.feed(STOP, 5.0)
    assert moves(core, 5.5)
    core.feed(STOP, 5.5)
    assert core.truth(6.5) == core.truth(100.0)


def test_telemetry_echoed_back_to_the_unit_cancels_a_move():
    core = PositionerCore()
    point(core, 0.0, a_deg=40.0)
    echo = core.next_screen(10.0), core.next_screen(10.0)
    assert echo[1].startswith(b"$,")
    core.feed(echo[1], 10.0)
    assert core.truth(300.0).a_deg < 15.0


def test_slow_screens_echoed_back_to_the_unit_change_its_parameters():
    core = PositionerCore()
    core.feed(b"$F299.9$G299.9", 0.0)
    assert fields(core, 0.1)[70] == b"299.9"
