"""rotctld's protocol with extended responses, without a line: commands to bytes, and bytes to replies.

A command is a `+`, a long name and its arguments; its reply repeats the name, has a line for each value and ends with
`RPRT` and an error number: so every command is answered, and every answer names its command. Measured with rotctld of
Hamlib 4.5.4; `rotctl(1)` describes it.
"""

import math
import re
from typing import NamedTuple

from drivers.numbers import read_number

GET_POSITION, SET_POSITION, STOP = "get_pos", "set_pos", "stop"
GET_INFO, DUMP_STATE = "get_info", "dump_state"
AZIMUTH, ELEVATION, INFO = "Azimuth", "Elevation", "Info"

NOT_IMPLEMENTED, NOT_AVAILABLE = 4, 11
REFUSALS = (1, 9, 21)
"""The errors of a command that has reached its receiver and is not carried out."""
_ERRORS = {
    1: "invalid parameter",
    NOT_IMPLEMENTED: "not implemented",
    5: "time-out of the rotator",
    6: "no connection to the rotator",
    8: "protocol error of the rotator",
    9: "rejected by the rotator",
    NOT_AVAILABLE: "not available",
    21: "limit exceeded",
}
_END = re.compile(r"RPRT -?(\d+)")
_HEAD = re.compile(r"([a-z_]+):(?: .*)?")
# For a line without blanks at its ends. No text matches it in two ways: when one did, a line of blanks took hours.
_VALUE = re.compile(r"([A-Za-z_ ]+)[:=](.*)")
_MOST_BYTES = 16384


class RotctldReply(NamedTuple):
    """One answer.

    Attributes
    ----------
    command
        What is answered, by its long name; empty where the answer does not say.
    values
        Its lines by their label.
    error
        Hamlib's error number, 0 where there is none.
    """

    command: str
    values: dict[str, str]
    error: int

    def number(self, label: str) -> float:
        """Return a value as a finite number; `ValueError` where it is none."""
        text = self.values.get(label)
        if text is None:
            raise ValueError(f"{label} is missing")
        try:
            number = read_number(text)
        except ValueError:
            number = math.nan
        if not math.isfinite(number):
            raise ValueError(f"{label} is {text!r}, not a number")
        return number


class RotatorState(NamedTuple):
    """What rotctld says of its rotator.

    Attributes
    ----------
    model
        Hamlib's number of it; 1 is the dummy.
    azimuth_deg, elevation_deg
        Lowest and highest. With rotctld's offsets (-o, -O) these are not what it accepts.
    kind
        Such as ``AzEl``; empty where an older rotctld does not say.
    """

    model: int
    azimuth_deg: tuple[float, float]
    elevation_deg: tuple[float, float]
    kind: str


def command(name: str, *arguments: float) -> bytes:
    """Return the bytes of one command, complete; `ValueError` for an argument that is not a finite number."""
    # rotctld accepts "nan", and takes a missing argument from the next command.
    if not all(math.isfinite(argument) for argument in arguments):
        raise ValueError(f"{name} takes finite numbers, not {arguments}")
    return " ".join((f"+\\{name}", *(f"{argument:.2f}" for argument in arguments))).encode("ascii") + b"\n"


def error_text(error: int) -> str:
    """Return an error in words, with its number."""
    return f"{_ERRORS.get(error, 'an error of Hamlib')} (RPRT -{error})"


def parse_state(reply: RotctldReply) -> RotatorState:
    """Read the answer to `DUMP_STATE`; `ValueError` where something is missing or no number."""
    return RotatorState(
        model=int(reply.number("Rotor Model")),
        azimuth_deg=(reply.number("Minimum Azimuth"), reply.number("Maximum Azimuth")),
        elevation_deg=(reply.number("Minimum Elevation"), reply.number("Maximum Elevation")),
        kind=reply.values.get("rot_type", ""),
    )


class ReplyStream:
    """Cuts what comes from rotctld into replies."""

    def __init__(self) -> None:
        self._incomplete_line = b""
        self._lines: list[str] = []

    def feed(self, data: bytes) -> list[RotctldReply]:
        """Take in bytes and return the replies that they complete; `ValueError` for what never becomes one."""
        *complete, self._incomplete_line = (self._incomplete_line + data).split(b"\n")
        replies = []
        for line in complete:
            text = line.decode("latin-1").strip()
            end = _END.fullmatch(text)
            if end is None:
                self._lines.append(text)
            else:
                replies.append(_reply(self._lines, int(end[1])))
                self._lines = []
        if len(self._incomplete_line) + sum(map(len, self._lines)) > _MOST_BYTES:
            raise ValueError("it sends without end, but never a whole reply")
        return replies


def _reply(lines: list[str], error: int) -> RotctldReply:
    head = _HEAD.fullmatch(lines[0]) if lines else None
    found = (_VALUE.fullmatch(line.strip()) for line in lines[1:])
    values = {one[1].strip(): one[2].strip() for one in found if one is not None}
    return RotctldReply(head[1] if head else "", values, error)
