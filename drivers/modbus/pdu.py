"""What Modbus carries, without frames: requests, replies, and numbers in registers.

Source: Modbus application protocol V1.1b3. Registers and coils are counted from 0, as they are on the line.
"""

import math
import struct
from collections.abc import Sequence
from typing import Literal, NamedTuple

READ_COILS, READ_DISCRETE_INPUTS, READ_HOLDING, READ_INPUT_REGISTERS = 1, 2, 3, 4
WRITE_COIL, WRITE_REGISTER, WRITE_COILS, WRITE_REGISTERS = 5, 6, 15, 16
WRITE_FUNCTIONS = (WRITE_COIL, WRITE_REGISTER, WRITE_COILS, WRITE_REGISTERS)
EXCEPTION_FLAG = 0x80
MOST_REGISTERS = 125
MOST_REGISTERS_WRITTEN = 123
MOST_BITS = 2000
MOST_BITS_WRITTEN = 1968

ILLEGAL_FUNCTION, ILLEGAL_ADDRESS, ILLEGAL_VALUE, DEVICE_FAILURE = 1, 2, 3, 4
_EXCEPTIONS = {
    ILLEGAL_FUNCTION: "does not know the function",
    ILLEGAL_ADDRESS: "has no such register",
    ILLEGAL_VALUE: "does not take the value or the count",
    DEVICE_FAILURE: "has failed",
    5: "needs longer",
    6: "is busy",
    10: "cannot be reached through the gateway",
    11: "does not answer the gateway",
}

NumberType = Literal["int16", "uint16", "int32", "uint32", "float32"]
WordOrder = Literal["high-first", "low-first"]
_FORMATS: dict[NumberType, str] = {"int16": "h", "uint16": "H", "int32": "i", "uint32": "I", "float32": "f"}


class ModbusRequest(NamedTuple):
    """What a device is asked.

    Attributes
    ----------
    unit
        Its address, 0 to 255.
    pdu
        Function and what belongs to it.
    """

    unit: int
    pdu: bytes


def read_registers(unit: int, function: int, register: int, count: int) -> ModbusRequest:
    """Return the request for holding (function 3) or input (4) registers."""
    return ModbusRequest(unit, struct.pack(">BHH", function, register, count))


def write_register(unit: int, register: int, value: int) -> ModbusRequest:
    """Return the request that writes one holding register."""
    return ModbusRequest(unit, struct.pack(">BHH", WRITE_REGISTER, register, value))


def write_coil(unit: int, coil: int, *, on: bool) -> ModbusRequest:
    """Return the request that writes one coil."""
    return ModbusRequest(unit, struct.pack(">BHH", WRITE_COIL, coil, 0xFF00 if on else 0))


def write_registers(unit: int, register: int, values: Sequence[int]) -> ModbusRequest:
    """Return the request that writes several holding registers."""
    head = struct.pack(">BHHB", WRITE_REGISTERS, register, len(values), 2 * len(values))
    return ModbusRequest(unit, head + struct.pack(f">{len(values)}H", *values))


def reply_length(request: bytes) -> int:
    """Return the length of the reply to a request, exceptions apart; 0 for a function that is not known here."""
    function = request[0]
    count = int.from_bytes(request[3:5], "big")
    if function in (READ_COILS, READ_DISCRETE_INPUTS):
        return 2 + (count + 7) // 8
    if function in (READ_HOLDING, READ_INPUT_REGISTERS):
        return 2 + 2 * count
    return 5 if function in WRITE_FUNCTIONS else 0


def reply_matches(request: bytes, reply: bytes) -> bool:
    """Tell whether a reply can belong to a request, by its function, its length, or what it echoes."""
    if len(reply) == 2 and reply[0] == request[0] | EXCEPTION_FLAG:
        return True
    if not reply or reply[0] != request[0] or len(reply) != reply_length(request):
        return False
    if request[0] <= READ_INPUT_REGISTERS:
        return reply[1] == len(reply) - 2
    return reply == request[:5]


def exception_text(reply: bytes) -> str:
    """Return in words why a device did not do what it was asked; empty for a reply that is none of that kind."""
    if not reply[0] & EXCEPTION_FLAG:
        return ""
    return f"{_EXCEPTIONS.get(reply[1], 'refuses')} (exception {reply[1]})"


def registers_of(reply: bytes) -> tuple[int, ...]:
    """Return the registers in the reply to a read."""
    return struct.unpack(f">{(len(reply) - 2) // 2}H", reply[2:])


def register_count(kind: NumberType) -> int:
    """Return how many registers a number of a type takes."""
    return struct.calcsize(f">{_FORMATS[kind]}") // 2


def decode_number(words: Sequence[int], kind: NumberType, order: WordOrder = "high-first") -> float:
    """Return the number in registers; NaN for a float that is infinite or none.

    Parameters
    ----------
    words
        As many as the type takes.
    kind
        How they are to be understood.
    order
        Which of two words comes first.
    """
    ordered = words if order == "high-first" else tuple(reversed(words))
    (value,) = struct.unpack(f">{_FORMATS[kind]}", struct.pack(f">{len(ordered)}H", *ordered))
    return float(value) if math.isfinite(value) else math.nan


def encode_number(value: float, kind: NumberType, order: WordOrder = "high-first") -> tuple[int, ...]:
    """Return the registers of a number; one that the type cannot hold becomes its nearest end."""
    form = _FORMATS[kind]
    if kind == "float32":
        data = struct.pack(">f", value)
    else:
        bits = 8 * struct.calcsize(f">{form}")
        low, high = (-(1 << bits - 1), (1 << bits - 1) - 1) if form.islower() else (0, (1 << bits) - 1)
        data = struct.pack(f">{form}", min(max(round(value), low), high))
    words: tuple[int, ...] = struct.unpack(f">{len(data) // 2}H", data)
    return words if order == "high-first" else tuple(reversed(words))
