"""SCPI as an instrument understands it: header spellings, path memory, parameters, the error queue."""

import re
from collections import deque
from collections.abc import Callable, Mapping
from itertools import product
from typing import Any, NamedTuple

MESSAGES: Mapping[int, str] = {
    0: "No error",
    -103: "Invalid separator",
    -104: "Data type error",
    -108: "Parameter not allowed",
    -109: "Missing parameter",
    -113: "Undefined header",
    -213: "Init ignored",
    -221: "Settings conflict",
    -222: "Parameter data out of range",
    -224: "Illegal parameter value",
    -230: "Data corrupt or stale",
    -241: "Hardware missing",
    -350: "Queue overflow",
    -363: "Input buffer over-run",
}
_NODE = re.compile(r"(\[?):?([A-Z*][A-Z0-9*]*)([a-z]*)((?:\[1\])?)(\]?)")
_UNIT = re.compile(r"\s*([:*]?[A-Za-z*][A-Za-z0-9:]*)(\??)(?:\s+(.*\S))?\s*")
_OUTSIDE_QUOTES = r"(?=(?:[^\"']|\"[^\"]*\"|'[^']*')*$)"
_SEMICOLON = re.compile(";" + _OUTSIDE_QUOTES)
_COMMA = re.compile("," + _OUTSIDE_QUOTES)


class ScpiError(Exception):
    """A command was not understood or cannot be done now; `code` is the number of the error."""

    def __init__(self, code: int) -> None:
        super().__init__(MESSAGES[code])
        self.code = code


class ScpiCommand(NamedTuple):
    """One command of a line: its full header in upper case, whether it asks, and its parameters."""

    header: str
    query: bool
    parameters: tuple[str, ...]


def spellings(pattern: str) -> list[str]:
    """Return every header, in upper case, that a pattern such as ``[:SENSe[1]]:VOLTage[:DC]:RANGe`` stands for."""
    choices: list[tuple[str, ...]] = []
    for optional, short, rest, numbered, _ in _NODE.findall(pattern):
        forms = (short,) if not rest else (short, short + rest.upper())
        suffixes = ("", "1") if numbered else ("",)
        names = tuple(f":{form}{suffix}" for form in forms for suffix in suffixes)
        choices.append((*names, "") if optional else names)
    return sorted({"".join(parts).removeprefix(":") for parts in product(*choices)})


def split_commands(line: str) -> tuple[list[ScpiCommand], int]:
    """Cut a line into its commands; return them with the error code that ended the line, 0 if none did."""
    found: list[ScpiCommand] = []
    path = ""
    for text in _SEMICOLON.split(line):
        if not text.strip():
            continue
        match = _UNIT.fullmatch(text)
        if not match:
            return found, -113
        header, question, parameters = match[1].upper(), match[2], match[3]
        if header[0] == "*":
            full = header
        else:
            full = header[1:] if header[0] == ":" else path + header
            path = full[: full.rfind(":") + 1]
        split = tuple(part.strip() for part in _COMMA.split(parameters)) if parameters else ()
        found.append(ScpiCommand(full, bool(question), split))
    return found, 0


class ErrorQueue:
    """Ten errors, first in first out; the last place tells that some were lost."""

    SIZE = 10

    def __init__(self) -> None:
        self._codes: deque[int] = deque()

    def __len__(self) -> int:
        return len(self._codes)

    def push(self, code: int) -> None:
        """Add an error."""
        if len(self._codes) < self.SIZE:
            self._codes.append(code)
        else:
            self._codes[-1] = -350

    def pop(self) -> str:
        """Take out the oldest error, as text."""
        code = self._codes.popleft() if self._codes else 0
        return f'{code},"{MESSAGES[code]}"'

    def clear(self) -> None:
        """Forget all errors."""
        self._codes.clear()


class ScpiStatus:
    """The error queue, the standard event register and the status byte made of them, as after power-up."""

    _POWER_ON, _COMMAND, _EXECUTION, _DEVICE, _COMPLETE = 128, 32, 16, 8, 1

    def __init__(self) -> None:
        self.errors = ErrorQueue()
        self._events = self._POWER_ON

    def fail(self, code: int) -> None:
        """Note an error."""
        self.errors.push(code)
        self._events |= {1: self._COMMAND, 2: self._EXECUTION}.get(-code // 100, self._DEVICE)

    def complete(self) -> None:
        """Mark an operation as complete."""
        self._events |= self._COMPLETE

    def take_events(self) -> int:
        """Return the standard event register and clear it."""
        events, self._events = self._events, 0
        return events

    def clear(self) -> None:
        """Forget errors and events."""
        self.errors.clear()
        self._events = 0

    def byte(self, event_enable: int, request_enable: int) -> int:
        """Return the status byte under two masks."""
        byte = 4 * bool(self.errors) | 32 * bool(self._events & event_enable)
        return byte | 64 * bool(byte & request_enable)


Parser = Callable[[str], Any]


def number(low: float, high: float, default: float) -> Parser:
    """Return a parser of a number within bounds, or MIN, MAX, DEF."""
    named = {"MIN": low, "MINIMUM": low, "MAX": high, "MAXIMUM": high, "DEF": default, "DEFAULT": default}

    def parse(text: str) -> float:
        if text.upper() in named:
            return named[text.upper()]
        try:
            value = float(text)
        except ValueError:
            raise ScpiError(-104) from None
        if not (low <= value <= high):
            raise ScpiError(-222)
        return value

    return parse


def integer(low: int, high: int, default: int) -> Parser:
    """Return a parser of a whole number within bounds; a fraction is rounded."""
    parse_number = number(low, high, default)
    return lambda text: round(parse_number(text))


def boolean(text: str) -> bool:
    """Read ON, OFF, 1 or 0."""
    try:
        return {"ON": True, "OFF": False, "1": True, "0": False}[text.upper()]
    except KeyError:
        raise ScpiError(-224) from None


def choice(*patterns: str) -> Parser:
    """Return a parser of one of several names, given as patterns; the result is the name's short form."""
    short = {text: min(spellings(pattern), key=len) for pattern in patterns for text in spellings(pattern)}

    def parse(text: str) -> str:
        try:
            return short[text.upper()]
        except KeyError:
            raise ScpiError(-224) from None

    return parse
