"""The answering end of Modbus over a table of registers: it answers the right questions and refuses the others."""

import struct
from typing import Protocol

from drivers.modbus.pdu import (
    EXCEPTION_FLAG,
    ILLEGAL_FUNCTION,
    ILLEGAL_VALUE,
    MOST_BITS,
    MOST_BITS_WRITTEN,
    MOST_REGISTERS,
    MOST_REGISTERS_WRITTEN,
    READ_COILS,
    READ_DISCRETE_INPUTS,
    READ_HOLDING,
    READ_INPUT_REGISTERS,
    WRITE_COIL,
    WRITE_COILS,
    WRITE_REGISTER,
    WRITE_REGISTERS,
)


class RefusedRequestError(Exception):
    """A question that is answered by an exception of Modbus.

    Parameters
    ----------
    code
        1 function, 2 register, 3 value, 4 device.
    """

    def __init__(self, code: int) -> None:
        self.code = code


class SilentError(Exception):
    """A question that is not answered at all."""


class RegisterTable(Protocol):
    """What is behind the registers. Every method may raise `RefusedRequestError` and `SilentError`."""

    def read(self, function: int, register: int, count: int) -> tuple[int, ...]:
        """Return holding (function 3) or input (4) registers."""

    def write(self, function: int, register: int, values: tuple[int, ...]) -> None:
        """Write holding registers, one (function 6) or several (16) at once."""

    def read_bits(self, function: int, first: int, count: int) -> tuple[bool, ...]:
        """Return coils (function 1) or discrete inputs (2)."""

    def write_bits(self, function: int, first: int, values: tuple[bool, ...]) -> None:
        """Write coils, one (function 5) or several (15)."""


class NoBits:
    """A table without coils and discrete inputs."""

    def read_bits(self, function: int, first: int, count: int) -> tuple[bool, ...]:  # noqa: ARG002
        """Refuse."""
        raise RefusedRequestError(ILLEGAL_FUNCTION)

    def write_bits(self, function: int, first: int, values: tuple[bool, ...]) -> None:  # noqa: ARG002
        """Refuse."""
        raise RefusedRequestError(ILLEGAL_FUNCTION)


def answer(table: RegisterTable, pdu: bytes) -> bytes | None:
    """Return the reply to a question; None where it is not answered."""
    try:
        return _answer(table, pdu)
    except RefusedRequestError as refused:
        return bytes((pdu[0] | EXCEPTION_FLAG, refused.code))
    except SilentError:
        return None


def _answer(table: RegisterTable, pdu: bytes) -> bytes:
    function = pdu[0]
    if function in (READ_COILS, READ_DISCRETE_INPUTS):
        first, count = _start_and_count(pdu, MOST_BITS)
        return _packed(function, table.read_bits(function, first, count))
    if function in (READ_HOLDING, READ_INPUT_REGISTERS):
        first, count = _start_and_count(pdu, MOST_REGISTERS)
        values = table.read(function, first, count)
        return struct.pack(f">BB{count}H", function, 2 * count, *values)
    if function == WRITE_COIL:
        first, value = _start_and_count(pdu, 0xFFFF, least=0)
        _require(value in (0, 0xFF00))
        table.write_bits(function, first, (value != 0,))
        return pdu
    if function == WRITE_REGISTER:
        first, value = _start_and_count(pdu, 0xFFFF, least=0)
        table.write(function, first, (value,))
        return pdu
    if function in (WRITE_COILS, WRITE_REGISTERS):
        _write_several(table, pdu)
        return pdu[:5]
    raise RefusedRequestError(ILLEGAL_FUNCTION)


def _write_several(table: RegisterTable, pdu: bytes) -> None:
    bits = pdu[0] == WRITE_COILS
    first, count = _start_and_count(pdu[:5], MOST_BITS_WRITTEN if bits else MOST_REGISTERS_WRITTEN)
    length = (count + 7) // 8 if bits else 2 * count
    _require(len(pdu) == 6 + length and pdu[5] == length)
    if bits:
        values = tuple(bool(pdu[6 + index // 8] >> index % 8 & 1) for index in range(count))
        table.write_bits(pdu[0], first, values)
    else:
        table.write(pdu[0], first, struct.unpack(f">{count}H", pdu[6:]))


def _start_and_count(pdu: bytes, most: int, least: int = 1) -> tuple[int, int]:
    """Return where a question begins, and its count or value."""
    _require(len(pdu) == 5)
    first, count = struct.unpack(">HH", pdu[1:])
    _require(least <= count <= most)
    return first, count


def _require(right: bool) -> None:
    if not right:
        raise RefusedRequestError(ILLEGAL_VALUE)


def _packed(function: int, bits: tuple[bool, ...]) -> bytes:
    data = bytearray((len(bits) + 7) // 8)
    for index, bit in enumerate(bits):
        data[index // 8] |= bit << index % 8
    return bytes((function, len(data))) + bytes(data)
