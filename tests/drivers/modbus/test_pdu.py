"""Numbers in registers."""

import math

import pytest

from drivers.modbus.pdu import decode_number, encode_number, exception_text, register_count, reply_matches


@pytest.mark.parametrize(("kind", "value", "words"), [
    ("int16", -1.0, (0xFFFF,)),
    ("int16", 40_000.0, (0x7FFF,)),
    ("int16", -40_000.0, (0x8000,)),
    ("uint16", 70_000.0, (0xFFFF,)),
    ("uint16", -1.0, (0,)),
    ("int32", -2.0, (0xFFFF, 0xFFFE)),
    ("int32", 3e9, (0x7FFF, 0xFFFF)),
    ("int32", -3e9, (0x8000, 0)),
    ("uint32", 65_538.4, (1, 2)),
    ("uint32", 5e9, (0xFFFF, 0xFFFF)),
    ("uint32", -5.0, (0, 0)),
    ("float32", 1.5, (0x3FC0, 0)),
])  # fmt: skip
def test_a_number_is_encoded_or_clamped_to_the_nearest_value_of_its_register_type(kind, value, words):
    assert encode_number(value, kind) == words
    assert encode_number(value, kind, "low-first") == tuple(reversed(words))
    assert encode_number(decode_number(words, kind), kind) == words
    assert encode_number(decode_number(words[::-1], kind, "low-first"), kind) == words


@pytest.mark.parametrize("words", [(0x7FC0, 0), (0x7F80, 0), (0xFF80, 0)])
def test_nan_and_infinity_in_float_registers_are_read_as_nan(words):
    assert math.isnan(decode_number(words, "float32"))


@pytest.mark.parametrize(("request_", "reply", "its_own"), [
    ("01 0000 0008", "01 01 FF", True),
    ("01 0000 0009", "01 02 FF 01", True),
    ("01 0000 0010", "01 02 FF FF", True),
    ("01 0000 0009", "01 01 FF", False),
    ("02 0000 0011", "02 03 FF FF 01", True),
    ("02 0000 0011", "01 03 FF FF 01", False),
    ("03 0000 0002", "03 04 0001 0002", True),
    ("04 0000 0002", "04 04 0001 0002", True),
    ("03 0000 0002", "03 02 0001", False),
    ("03 0000 0002", "03 02 0001 0002", False),
    ("03 0000 0002", "83 02", True),
    ("03 0000 0002", "84 02", False),
    ("03 0000 0002", "", False),
    ("05 0001 FF00", "05 0001 FF00", True),
    ("06 0003 1234", "06 0003 1235", False),
    ("0F 0000 000A 02 0502", "0F 0000 000A", True),
    ("10 0000 0002 04 000A 000B", "10 0000 0002", True),
    ("10 0000 0002 04 000A 000B", "10 0000 0003", False),
    ("2B 0E 01 00", "2B 0E 01 00", False),
])  # fmt: skip
def test_a_reply_is_matched_to_its_question_by_function_length_and_echoed_fields(request_, reply, its_own):
    assert reply_matches(bytes.fromhex(request_), bytes.fromhex(reply)) == its_own


@pytest.mark.parametrize(("reply", "text"), [
    ("83 01", "does not know the function (exception 1)"),
    ("84 02", "has no such register (exception 2)"),
    ("86 03", "does not take the value or the count (exception 3)"),
    ("83 04", "has failed (exception 4)"),
    ("83 05", "needs longer (exception 5)"),
    ("83 06", "is busy (exception 6)"),
    ("83 07", "refuses (exception 7)"),
    ("83 0A", "cannot be reached through the gateway (exception 10)"),
    ("83 0B", "does not answer the gateway (exception 11)"),
    ("03 02 0001", ""),
])  # fmt: skip
def test_a_modbus_exception_is_described_in_words(reply, text):
    assert exception_text(bytes.fromhex(reply)) == text


def test_a_number_takes_one_register_if_it_has_16_bits_and_two_if_it_has_32():
    kinds = ("int16", "uint16", "int32", "uint32", "float32")
    assert [register_count(kind) for kind in kinds] == [1, 1, 2, 2, 2]
