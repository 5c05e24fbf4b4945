"""Numbers in registers."""

import math

import pytest

from drivers.modbus.pdu import number, words_for


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
def test_a_number_is_written_or_becomes_the_nearest_that_its_type_has(kind, value, words):
    assert words_for(value, kind) == words
    assert words_for(value, kind, "low-first") == tuple(reversed(words))
    assert words_for(number(words, kind), kind) == words
    assert words_for(number(words[::-1], kind, "low-first"), kind) == words


@pytest.mark.parametrize("words", [(0x7FC0, 0), (0x7F80, 0), (0xFF80, 0)])
def test_what_is_no_finite_number_is_none(words):
    assert math.isnan(number(words, "float32"))
