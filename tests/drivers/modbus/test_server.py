"""The answering end: correct questions, and every wrong one."""

import struct

import pytest

from drivers.modbus.pdu import ILLEGAL_ADDRESS, ILLEGAL_FUNCTION, ILLEGAL_VALUE
from drivers.modbus.server import NoBits, RefusedRequestError, SilentError, answer


class Table:
    """Ten registers and ten coils."""

    def __init__(self):
        self.words = list(range(10))
        self.bits = [False] * 10

    def read(self, function, register, count):
        if register == 9:
            raise SilentError
        if register + count > 10:
            raise RefusedRequestError(ILLEGAL_ADDRESS)
        return tuple(self.words[register : register + count])

    def write(self, function, register, values):
        self.written_by = function
        self.words[register : register + len(values)] = values

    def read_bits(self, function, first, count):
        return tuple(self.bits[first : first + count])

    def write_bits(self, function, first, values):
        self.written_by = function
        self.bits[first : first + len(values)] = values


RIGHT = {
    "03 0001 0002": "03 04 0001 0002",
    "04 0000 0001": "04 02 0000",
    "06 0003 1234": "06 0003 1234",
    "10 0000 0002 04 000A 000B": "10 0000 0002",
    "05 0001 FF00": "05 0001 FF00",
    "0F 0000 000A 02 0502": "0F 0000 000A",
    "01 0000 000A": "01 02 0000",
}
WRONG = {
    "03 0008 0004": ILLEGAL_ADDRESS,
    "03 0000 0000": ILLEGAL_VALUE,
    "03 0000 007E": ILLEGAL_VALUE,
    "03 0000": ILLEGAL_VALUE,
    "05 0000 1234": ILLEGAL_VALUE,
    "10 0000 0002 04 000A": ILLEGAL_VALUE,
    "10 0000 0002 02 000A 000B": ILLEGAL_VALUE,
    "10 0000": ILLEGAL_VALUE,
    "2B 0E 01 00": ILLEGAL_FUNCTION,
    "08 0000 1234": ILLEGAL_FUNCTION,
}


def test_valid_questions_are_answered():
    answers = {question: answer(Table(), bytes.fromhex(question)) for question in RIGHT}
    assert answers == {question: bytes.fromhex(reply) for question, reply in RIGHT.items()}


@pytest.mark.parametrize("question", ["05 0001 FF00", "06 0001 0007", "0F 0000 000A 02 0502", "10 0001 0001 02 0001"])
def test_a_table_is_told_by_which_function_it_is_written(question):
    table, asked = Table(), bytes.fromhex(question)
    answer(table, asked)
    assert table.written_by == asked[0]


def test_written_registers_and_coils_are_stored():
    table = Table()
    answer(table, bytes.fromhex("10 0000 0002 04 000A 000B"))
    answer(table, bytes.fromhex("0F 0000 000A 02 0502"))
    assert table.words[:3] == [10, 11, 2]
    assert answer(table, bytes.fromhex("01 0000 000A")) == bytes.fromhex("01 02 05 02")


@pytest.mark.parametrize(("count", "data"), [(1, "01"), (7, "55"), (8, "AA"), (9, "55 01"), (10, "FF 02")])
def test_coils_are_written_bit_by_bit(count, data):
    table = Table()
    sent = bytes.fromhex(data)
    answer(table, bytes((0x0F, 0, 0, 0, count, len(sent))) + sent)
    bits = int.from_bytes(sent, "little")
    assert table.bits == [index < count and bool(bits >> index & 1) for index in range(10)]
    assert answer(table, bytes((1, 0, 0, 0, count))) == bytes((1, len(sent))) + sent
    assert answer(table, bytes((0x0F, 0, 0, 0, count, len(sent) + 1)) + sent + b"\0") == bytes((0x8F, ILLEGAL_VALUE))


def test_invalid_questions_are_answered_with_the_right_exception():
    answers = {question: answer(Table(), bytes.fromhex(question)) for question in WRONG}
    assert answers == {question: bytes((bytes.fromhex(question)[0] | 0x80, code)) for question, code in WRONG.items()}


def test_a_question_that_the_table_leaves_unanswered_gets_no_reply():
    assert answer(Table(), bytes.fromhex("03 0009 0001")) is None


class Wide:
    """Registers and coils of any number; keeps those that were written last."""

    def __init__(self):
        self.written = None

    def read(self, function, register, count):
        return (0,) * count

    def write(self, function, register, values):
        self.written = function, register, values

    def read_bits(self, function, first, count):
        return (False,) * count

    write_bits = write


@pytest.mark.parametrize(("question", "written"), [
    ("06 0003 1234", (6, 3, (0x1234,))),
    ("06 0003 0000", (6, 3, (0,))),
    ("06 0003 FFFF", (6, 3, (0xFFFF,))),
    ("05 0004 FF00", (5, 4, (True,))),
    ("05 0004 0000", (5, 4, (False,))),
])  # fmt: skip
def test_functions_5_and_6_write_a_single_coil_or_register(question, written):
    table = Wide()
    assert answer(table, bytes.fromhex(question)) == bytes.fromhex(question)
    assert table.written == written


@pytest.mark.parametrize(("function", "most"), [(1, 2000), (2, 2000), (3, 125), (4, 125), (15, 1968), (16, 123)])
def test_counts_up_to_the_limit_of_the_standard_are_accepted_and_one_more_is_refused(function, most):
    def asked(count):
        question = struct.pack(">BHH", function, 0, count)
        if function < 15:
            return question
        length = 2 * count if function == 16 else (count + 7) // 8
        return question + bytes((length,)) + bytes(length)

    assert answer(Wide(), asked(most))[0] == function
    assert answer(Wide(), asked(most + 1)) == bytes((function | 0x80, ILLEGAL_VALUE))


@pytest.mark.parametrize("question", ["01 0000 0001", "0F 0000 0001 01 01", "05 0000 FF00"])
def test_a_table_without_coils_refuses_them(question):
    function = bytes.fromhex(question)[0]
    assert answer(NoBits(), bytes.fromhex(question)) == bytes((function | 0x80, ILLEGAL_FUNCTION))
