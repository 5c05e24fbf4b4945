"""The wire format of the POZSOL36A1 positioner over USB: a stream of telemetry out, commands in that nothing answers.

Both directions carry ``$``, one byte that names the field, and the value as text up to the next ``$``. There is no line
end, no length and no checksum. As seen in public firmware of the same product family; no protocol document is known.
"""

import math
import re
from collections.abc import Mapping
from dataclasses import dataclass
from enum import IntEnum
from functools import lru_cache

SEPARATOR = 0x24
TERMINATOR = b"\r"
MAXIMUM_PACKET = 64
MAXIMUM_VALUE = 255
_LONGEST = 1 + MAXIMUM_VALUE
COMMAND_SPACING_S = 0.06
"""The unit reads its input every 20 ms, and a second packet in that time overwrites the first."""


class Field(IntEnum):
    """Fields by code. Those that exist per axis start with the axis' letter."""

    BOARD = 37
    VERSION = 38
    SUPPLY = 39
    CLOCK_HOUR = 40
    CLOCK_MINUTE = 41
    CLOCK_SECOND = 42
    A_ANGLE = 44
    A_POSITION = 45
    A_DESTINATION = 46
    A_CURRENT = 47
    B_ANGLE = 48
    B_POSITION = 49
    B_DESTINATION = 50
    B_CURRENT = 51
    LATITUDE = 52
    LONGITUDE = 53
    TRACKING_INTERVAL = 54
    REBOOT = 55
    MODE = 56
    ACTION = 57
    SERVICE = 58
    A_REMAIN = 63
    B_REMAIN = 64
    SERIAL = 87
    LINK_COUNTER = 115
    STATUS = 136
    GMT_SECOND = 173
    GMT_MINUTE = 174
    GMT_HOUR = 175
    GMT_DAY = 176
    GMT_MONTH = 177
    GMT_YEAR = 178


DECIMALS = {
    Field.A_ANGLE: 1,
    Field.B_ANGLE: 1,
    Field.A_POSITION: 4,
    Field.B_POSITION: 4,
    Field.A_DESTINATION: 4,
    Field.B_DESTINATION: 4,
    Field.A_REMAIN: 4,
    Field.B_REMAIN: 4,
    Field.A_CURRENT: 2,
    Field.B_CURRENT: 2,
    Field.SUPPLY: 2,
}
"""How many decimals public firmware prints; older and newer units differ, so a reader takes any number of them."""

_FARTHEST = 99_999.0
_RANGES: dict[int, tuple[float, float]] = {
    Field.A_ANGLE: (-360.0, 360.0),
    Field.B_ANGLE: (-360.0, 360.0),
    Field.A_POSITION: (-_FARTHEST, _FARTHEST),
    Field.B_POSITION: (-_FARTHEST, _FARTHEST),
    Field.A_DESTINATION: (-_FARTHEST, _FARTHEST),
    Field.B_DESTINATION: (-_FARTHEST, _FARTHEST),
    Field.A_REMAIN: (-_FARTHEST, _FARTHEST),
    Field.B_REMAIN: (-_FARTHEST, _FARTHEST),
    Field.A_CURRENT: (-50.0, 50.0),
    Field.B_CURRENT: (-50.0, 50.0),
    Field.SUPPLY: (-1.0, 100.0),
}
"""What each field can say; anything beyond is garbage."""
_NUMBER = re.compile(rb" *([+-]?(?:\d{1,9}(?:\.\d{0,9})?|\.\d{1,9})) *")
_INTEGER = re.compile(r" *-?[0-9]{1,10} *")
_LETTERS = {Field.MODE: ("N",), Field.ACTION: ("s", "5", "6"), Field.STATUS: ("0",)}
_ANGLES = (Field.A_ANGLE, Field.B_ANGLE)
_DESTINATIONS = (Field.A_DESTINATION, Field.B_DESTINATION)
_LARGEST = _FARTHEST
_ALLOWED = re.compile(rb"\$(?:[,0]-?\d{1,5}\.\d{4}|[.2]\d{1,5}|8N|9[s56]|\x880)\r")
"""Codes 44 and 48 with an angle, 46 and 50 with a whole number that has no sign (the unit takes minus one for a very
large number and goes to its maximum), 56 N, 57 s, 5 or 6, and 136."""

TRACKING_OFF = "N"
STOP = "s"
HOME_A = "5"
HOME_B = "6"
CLEAR = "0"


def encode_command(field: int, value: float | str) -> bytes:
    """Return the one packet that carries a command.

    Parameters
    ----------
    field
        44 or 48 (angle [deg]), 46 or 50 (destination [whole position units]), 56 (only `TRACKING_OFF`), 57 (`STOP`,
        `HOME_A`, `HOME_B`) or 136 (`CLEAR`). Everything else could reconfigure, move or reboot the unit.
    value
        A number for 44 to 50, one of the texts above otherwise.

    Raises
    ------
    ValueError
        The field is not on that list, the value is not one it may have, or the number is NaN, infinite, too large or,
        for a destination, negative or not whole.
    """
    text = _letter(field, value) if field in _LETTERS else _number(field, value)
    # The unit keeps the end of a longer earlier command behind a shorter one, so the value needs its terminator.
    packet = bytes((SEPARATOR, int(field))) + text.encode("ascii") + TERMINATOR
    require_allowed(packet)
    return packet


def require_allowed(packet: bytes) -> None:
    """Raise `ValueError` unless these bytes are one command that `encode_command` may make.

    The last gate before the port: the unit takes whatever begins with ``$`` for a command, so nothing else may leave.
    """
    if not _ALLOWED.fullmatch(packet):
        raise ValueError(f"{bytes(packet[:16])!r} is not a command that may be sent to a positioner")


def _letter(field: int, value: float | str) -> str:
    letters = _LETTERS[Field(field)]
    for letter in letters:
        if value == letter:
            return letter
    raise ValueError(f"positioner command {field} may only carry {' or '.join(letters)}, not {value!r}")


def _number(field: int, value: float | str) -> str:
    if field not in _ANGLES and field not in _DESTINATIONS:
        raise ValueError(f"positioner command {field} is not allowed: it could reconfigure or reboot the unit")
    # A bool is a number to Python, and never an angle.
    if isinstance(value, str | bool) or not (-_LARGEST <= value <= _LARGEST):
        raise ValueError(f"positioner command {field} needs a number of at most {_LARGEST:g}, not {value!r}")
    if field in _DESTINATIONS and not (value >= 0 and math.floor(value) == value):
        raise ValueError(f"positioner command {field} takes whole position units from 0 on, not {value!r}")
    return f"{float(value):.4f}" if field in _ANGLES else f"{int(value)}"


class TokenStream:
    """Cuts the telemetry stream into fields, whatever pieces it arrives in.

    Nothing before the first ``$`` is believed, since the stream is usually joined in the middle of a token. The last
    token is given out once the ``$`` of the next one has come. What is longer than any value is dropped.
    """

    def __init__(self) -> None:
        self._pending = b""
        self._in_token = False

    def feed(self, data: bytes) -> list[tuple[int, bytes]]:
        """Take in any number of bytes and return the (field code, value) pairs that they complete."""
        return [(token[0], token[1:]) for token in self.feed_tokens(data)]

    def feed_tokens(self, data: bytes) -> list[bytes]:
        """Take in any number of bytes and return the tokens that they complete: one byte of code, and the value."""
        tokens = data.split(b"$")
        last = tokens.pop()
        if not tokens:
            if self._in_token:
                self._begin(self._pending + last)
            return []
        if self._in_token:
            tokens[0] = self._pending + tokens[0]
        else:
            del tokens[0]
        self._begin(last)
        lengths = list(map(len, tokens))
        if tokens and not (min(lengths) > 0 and max(lengths) <= _LONGEST):
            tokens = [token for token in tokens if 0 < len(token) <= _LONGEST]
        return tokens

    def _begin(self, pending: bytes) -> None:
        self._in_token = len(pending) <= _LONGEST
        self._pending = pending if self._in_token else b""


def parse_number(field: int, value: bytes) -> float:
    """Return the number of a field, printed in whatever width; `ValueError` if it is none, or an impossible one."""
    found = _NUMBER.fullmatch(value)
    low, high = _RANGES[field]
    number = float(found[1]) if found else math.nan
    if not (low <= number <= high):
        raise ValueError(f"positioner field {field} should be a number from {low:g} to {high:g}, not {value!r}")
    return number


@dataclass(frozen=True, slots=True)
class StatusWord:
    """The status word, field 136.

    Attributes
    ----------
    word
        The 32 bits, unsigned.
    faults
        Latched faults by name, such as ``a_overcurrent``; `FAULT_BITS` has them all.
    was_reset
        A mark that stays until the status is cleared, which the unit does by itself 15 minutes after power-up.
    button_pressed
        A button on the box is being pressed.
    a_homing, b_homing
        The axis is on a reference run. The unit reports that some screens late, and not while no Hall pulses come.
        `b_homing` is None where the place of B's bits is not known.
    memory_fault
        The parameter memory could not be read or written.
    end_switches
        Closed end switches by name: ``a_low``, ``a_high``, ``b_low``, and ``b_high`` if its place is known.
    own_tracking, snow, wind
        The unit's own modes.
    """

    word: int
    faults: tuple[str, ...]
    was_reset: bool
    button_pressed: bool
    a_homing: bool
    b_homing: bool | None
    memory_fault: bool
    end_switches: tuple[str, ...]
    own_tracking: bool
    snow: bool
    wind: bool

    @property
    def homing(self) -> bool:
        """Whether an axis is known to be on a reference run."""
        return self.a_homing or bool(self.b_homing)

    @property
    def autonomous(self) -> bool:
        """Whether the unit may move the axes of its own accord."""
        return self.own_tracking or self.snow or self.wind


FAULT_BITS = {
    "a_overcurrent": 0,
    "a_hall_fault": 1,
    "a_homing_too_long": 2,
    "a_cable": 3,
    "b_overcurrent": 4,
    "b_hall_fault": 5,
    "b_homing_too_long": 6,
    "b_cable": 7,
    "a_pulse_loss": 23,
    "b_pulse_loss": 24,
    "a_destination_error": 28,
    "b_destination_error": 31,
}
RESET_BIT, BUTTON_BIT = 8, 9
A_OUT_BIT, A_IN_BIT, A_HOMING_BIT = 11, 12, 13
TRACKING_BIT, SNOW_BIT, WIND_BIT = 25, 26, 27
SWITCH_BITS = {"a_low": 19, "a_high": 20, "b_low": 21}
B_OUT_BIT_STM, B_OUT_BIT_LPC = 15, 16
"""Where B's three motion bits (out, in, homing) begin, by generation of the firmware."""
B_HIGH_BIT_STM = 22
_MEMORY_BITS = (14, 30)


@lru_cache(maxsize=64)
def parse_status(text: str, b_out_bit: int | None = None) -> StatusWord:
    """Read the status word from its text, a signed decimal number of 32 bits.

    Parameters
    ----------
    text
        As the unit prints it.
    b_out_bit
        `B_OUT_BIT_STM` or `B_OUT_BIT_LPC` where the firmware's generation is known. The generations disagree, so
        nothing is said of B's reference run and high end switch without it. In the LPC layout the bit of B's homing
        may also be that of its high end switch, so homing is then reported for both.

    Raises
    ------
    ValueError
        The text is not such a number.
    """
    if not _INTEGER.fullmatch(text) or not (-(1 << 31) <= int(text) < 1 << 32):
        raise ValueError(f"positioner status should be a whole number of 32 bits, not {text!r}")
    word = int(text) & 0xFFFF_FFFF
    switches = [name for name, bit in SWITCH_BITS.items() if word >> bit & 1]
    b_homing = None
    if b_out_bit is not None:
        b_homing = bool(word >> b_out_bit + 2 & 1)
        if word >> B_HIGH_BIT_STM & 1:
            switches.append("b_high")
    return StatusWord(
        word=word,
        faults=tuple(name for name, bit in FAULT_BITS.items() if word >> bit & 1),
        was_reset=bool(word >> RESET_BIT & 1),
        button_pressed=bool(word >> BUTTON_BIT & 1),
        a_homing=bool(word >> A_HOMING_BIT & 1),
        b_homing=b_homing,
        memory_fault=any(word >> bit & 1 for bit in _MEMORY_BITS),
        end_switches=tuple(switches),
        own_tracking=bool(word >> TRACKING_BIT & 1),
        snow=bool(word >> SNOW_BIT & 1),
        wind=bool(word >> WIND_BIT & 1),
    )


# For a position only "off" (stored as 1000) means that there is none: 0 is a place to go to.
_NO_POSITION = ("", "off", "1000", "1000.0")
_NO_DAYS = ("", "off", "0", "0.0")
_OWN_MOVE_SETTINGS = {
    "a night position": ((108, 109), _NO_POSITION),
    "a reference run every few days": ((117, 118), _NO_DAYS),
    "a snow position": ((126, 127), _NO_POSITION),
}
OWN_MOVES = tuple(code for codes, _ in _OWN_MOVE_SETTINGS.values() for code in codes)
"""The fields of these settings."""


def own_moves(fields: Mapping[int, str]) -> tuple[str, ...]:
    """Name the settings that are on, with their fields, such as ``a night position (108=-50, 109=off)``."""
    found = []
    for name, (codes, off) in _OWN_MOVE_SETTINGS.items():
        if any(fields.get(code, "").lower() not in off for code in codes):
            found.append(f"{name} ({', '.join(f'{code}={fields[code]}' for code in codes if code in fields)})")
    return tuple(found)
