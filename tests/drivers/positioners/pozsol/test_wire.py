import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.positioners.pozsol import wire
from drivers.positioners.pozsol.wire import Field, TokenStream, encode_command, own_moves, parse_number, parse_status

ALLOWED = {44, 46, 48, 50, 56, 57, 136}


def test_an_angle_command_is_a_dollar_a_code_a_number_and_a_carriage_return():
    assert encode_command(Field.A_ANGLE, -45.5) == b"$,-45.5000\r"
    assert encode_command(Field.B_ANGLE, 90) == b"$090.0000\r"


def test_a_destination_command_is_a_whole_number():
    assert encode_command(Field.A_DESTINATION, 120) == b"$.120\r"
    assert encode_command(Field.A_DESTINATION, -0.0) == b"$.0\r"
    with pytest.raises(ValueError, match="whole"):
        encode_command(Field.B_DESTINATION, 12.5)


@pytest.mark.parametrize("field", [Field.A_DESTINATION, Field.B_DESTINATION])
def test_a_negative_destination_is_refused_by_encode_command_and_by_require_allowed(field):
    with pytest.raises(ValueError, match="from 0 on"):
        encode_command(field, -1)
    with pytest.raises(ValueError, match="is not a command"):
        wire.require_allowed(b"$%c-1\r" % field)


def test_stop_homing_clear_and_tracking_off_are_encoded_as_their_fixed_bytes():
    assert encode_command(Field.MODE, wire.TRACKING_OFF) == b"$8N\r"
    assert encode_command(Field.ACTION, wire.STOP) == b"$9s\r"
    assert encode_command(Field.ACTION, wire.HOME_A) == b"$95\r"
    assert encode_command(Field.ACTION, wire.HOME_B) == b"$96\r"
    assert encode_command(Field.STATUS, wire.CLEAR) == b"$\x880\r"


def test_no_command_code_outside_the_allow_list_can_be_encoded():
    for code in set(range(-1, 300)) - ALLOWED:
        for value in (1.0, "N", "s", "0"):
            with pytest.raises(ValueError, match="not allowed"):
                encode_command(code, value)


@pytest.mark.parametrize(("code", "value"), [(56, "Y"), (56, "n"), (57, "1"), (57, "4"), (57, ""), (57, 5), (136, "1")])
def test_own_tracking_jogs_and_other_values_that_are_not_allowed_cannot_be_encoded(code, value):
    with pytest.raises(ValueError, match="may only carry"):
        encode_command(code, value)


@pytest.mark.parametrize("code", [44, 46, 48, 50])
@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf, 1e6, "12"])
def test_encode_command_refuses_nan_infinity_too_large_numbers_and_text(code, value):
    with pytest.raises(ValueError, match=str(code)):
        encode_command(code, value)


@given(st.floats(-180, 180))
def test_every_angle_command_fits_one_packet_and_reads_back_to_the_fourth_decimal(angle_deg):
    packet = encode_command(Field.A_ANGLE, angle_deg)
    assert len(packet) <= wire.MAXIMUM_PACKET
    assert packet.count(b"$") == 1
    assert float(packet[2:-1]) == pytest.approx(angle_deg, abs=5.1e-5)


def test_the_token_stream_returns_a_token_once_the_next_one_has_begun():
    stream = TokenStream()
    assert stream.feed(b"$,12.3$-45.6000$\xb2") == [(44, b"12.3"), (45, b"45.6000")]
    assert stream.feed(b"22$%36A1$") == [(178, b"22"), (37, b"36A1")]


def test_the_token_stream_drops_bytes_before_the_first_separator():
    assert TokenStream().feed(b"5.6000$,12.3$") == [(44, b"12.3")]


def test_the_token_stream_copes_with_merged_screens_empty_tokens_and_odd_bytes():
    stream = TokenStream()
    assert stream.feed(b"$$$,1.0$\xe2\xf8 C$$\x00$") == [(44, b"1.0"), (226, b"\xf8 C"), (0, b"")]


def test_an_endless_token_is_dropped_and_the_next_one_understood():
    stream = TokenStream()
    for _ in range(1000):
        assert stream.feed(b"$," + b"7" * 100) in ([], [(44, b"7" * 100)])
        stream.feed(b"7" * 1000)
        assert len(stream._pending) <= 1 + wire.MAXIMUM_VALUE
    assert stream.feed(b"$,1.0$") == [(44, b"1.0")]
    assert stream.feed(b"," + b"7" * 1000 + b"$,2.0$") == [(44, b"2.0")]


TOKENS = st.lists(
    st.tuples(
        st.integers(1, 255).filter(lambda code: code != 0x24),
        st.binary(max_size=20).filter(lambda value: b"$" not in value),
    ),
    max_size=30,
)


@given(TOKENS, st.lists(st.integers(0, 400), max_size=20))
def test_the_token_stream_returns_the_same_tokens_however_its_bytes_are_cut(tokens, cuts):
    data = b"".join(b"$" + bytes([code]) + value for code, value in tokens) + b"$"
    stream, found, start = TokenStream(), [], 0
    for end in [*sorted(cuts), len(data)]:
        found += stream.feed(data[start:end])
        start = max(start, end)
    assert found == tokens


@given(st.binary(max_size=2000))
def test_random_bytes_never_break_the_token_stream_or_overfill_its_buffer(data):
    stream = TokenStream()
    assert all(0 <= code <= 255 and b"$" not in value for code, value in stream.feed(data))
    assert len(stream._pending) <= 1 + wire.MAXIMUM_VALUE


@pytest.mark.parametrize(("value", "number"), [
    (b"24.00", 24.0), (b"24.0", 24.0), (b"24", 24.0), (b"24.", 24.0), (b" 24.000 ", 24.0), (b"+.5", 0.5), (b"-0.0", 0),
])  # fmt: skip
def test_a_number_is_read_in_whatever_width_it_is_printed(value, number):
    assert parse_number(Field.SUPPLY, value) == number


@pytest.mark.parametrize("field", wire.DECIMALS)
def test_a_field_value_that_is_not_a_number_or_beyond_its_range_is_refused(field):
    assert parse_number(field, b"12.3456") == 12.3456
    for value in (
        b"",
        b".",
        b"nan",
        b"inf",
        b"1e1",
        b"0x10",
        b"12.3-4.5",
        b"--1",
        b"1 2",
        b"1,5",
        b"100000",
        b"-100000",
    ):
        with pytest.raises(ValueError, match="should be a number from"):
            parse_number(field, value)


@pytest.mark.parametrize("field", wire.DECIMALS)
def test_each_numeric_field_accepts_the_ends_of_its_range_and_refuses_values_beyond_them(field):
    name = field.name.removeprefix("A_").removeprefix("B_")
    low, high = {"ANGLE": (-360, 360), "CURRENT": (-50, 50), "SUPPLY": (-1, 100)}.get(name, (-99_999, 99_999))
    assert [parse_number(field, f"{edge}".encode()) for edge in (low, high)] == [low, high]
    for beyond in (f"{low}.01", f"{high}.01"):
        with pytest.raises(ValueError, match="should be a number from"):
            parse_number(field, beyond.encode())


def test_a_zero_status_shows_no_faults_no_end_switches_and_no_own_mode():
    status = parse_status("0000")
    assert status.faults == ()
    assert status.end_switches == ()
    assert status.word == 0
    assert not status.autonomous


# As the maker's manual numbers them, written out once more: a slip in the table shows only against a second copy.
FAULTS_BY_BIT = {
    0: "a_overcurrent", 1: "a_hall_fault", 2: "a_homing_too_long", 3: "a_cable",
    4: "b_overcurrent", 5: "b_hall_fault", 6: "b_homing_too_long", 7: "b_cable",
    23: "a_pulse_loss", 24: "b_pulse_loss", 28: "a_destination_error", 31: "b_destination_error",
}  # fmt: skip


def test_every_fault_bit_has_its_name_and_no_other_bit_has_one():
    named = {bit: parse_status(str(1 << bit)).faults for bit in range(32)}
    assert {bit: names for bit, names in named.items() if names} == {
        bit: (name,) for bit, name in FAULTS_BY_BIT.items()
    }


def test_the_status_bits_of_axis_b_and_of_memory_faults_match_both_board_generations():
    assert (wire.B_OUT_BIT_STM, wire.B_OUT_BIT_LPC, wire.B_HIGH_BIT_STM) == (15, 16, 22)
    for bit in (14, 30):
        assert parse_status(str(1 << bit)).memory_fault


def test_status_marks_end_switches_and_modes_are_read_from_their_bits():
    assert parse_status(str(1 << 8)).was_reset
    assert parse_status(str(1 << 9)).button_pressed
    assert parse_status(str(1 << 13)).homing
    assert parse_status(str(1 << 14)).memory_fault
    assert parse_status(str(0b111 << 19)).end_switches == ("a_low", "a_high", "b_low")
    for bit, name in ((25, "own_tracking"), (26, "snow"), (27, "wind")):
        status = parse_status(str(1 << bit))
        assert getattr(status, name)
        assert status.autonomous


@pytest.mark.parametrize("bit", [15, 16, 17, 18, 22])
def test_bits_on_which_the_generations_disagree_are_not_interpreted(bit):
    status = parse_status(str(1 << bit))
    assert status.b_homing is None
    assert status.faults == ()
    assert status.end_switches == ()
    assert not status.homing


@pytest.mark.parametrize("start", [wire.B_OUT_BIT_STM, wire.B_OUT_BIT_LPC])
def test_homing_and_high_end_switch_of_axis_b_are_read_when_the_board_generation_is_known(start):
    assert not parse_status(str(0b11 << start), start).homing
    assert parse_status(str(1 << start + 2), start).homing
    assert parse_status(str(1 << 22), wire.B_OUT_BIT_STM).end_switches == ("b_high",)


@given(st.integers(0, 2**32 - 1))
def test_a_status_printed_as_a_signed_number_keeps_its_32_bits(word):
    signed = word - (1 << 32) if word >> 31 else word
    assert parse_status(f"{signed:04d}").word == word


@pytest.mark.parametrize("text", ["", "12x", "4294967296", "-2147483649", "1.5", "0x10", "٣"])
def test_a_status_that_is_no_32_bit_number_is_refused(text):
    with pytest.raises(ValueError, match="32 bits"):
        parse_status(text)


@pytest.mark.parametrize(
    ("fields", "told"),
    [
        ({}, ()),
        ({108: "off", 109: "OFF", 117: "off", 118: "Off", 126: "off", 127: "off"}, ()),
        ({108: "1000", 109: "1000.0", 117: "0", 118: "0.0", 126: "1000", 127: ""}, ()),
        ({108: "-50", 109: "off"}, ("a night position (108=-50, 109=off)",)),
        ({109: "0"}, ("a night position (109=0)",)),
        ({117: "0", 118: "7"}, ("a reference run every few days (117=0, 118=7)",)),
        ({126: "0.0", 127: "1000"}, ("a snow position (126=0.0, 127=1000)",)),
        ({108: "1", 118: "1000"}, ("a night position (108=1)", "a reference run every few days (118=1000)")),
    ],
)
def test_own_moves_of_the_unit_are_switched_off_by_1000_for_a_position_and_by_0_for_days(fields, told):
    assert own_moves(fields) == told
