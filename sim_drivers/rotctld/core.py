"""A rotator as rotctld shows it: two axes that turn at one speed, and commands as Hamlib 4.5.4's own server takes them.

A test asks this simulation and the real rotctld the same questions and compares the bytes.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass

ROTATOR_FAULTS = ("gone", "deaf", "stopless")
"""Unplugged from rotctld, which answers with an error; switched off, which rotctld does not notice; without a stop."""

_INVALID_PARAMETER, _NO_CONNECTION, _NOT_AVAILABLE = -1, -6, -11
_PREFIX = "+"


@dataclass(frozen=True, slots=True)
class RotatorRange:
    """The range of a rotator [deg], ends included, and its speed [deg/s]."""

    azimuth_min_deg: float = -180.0
    azimuth_max_deg: float = 450.0
    elevation_min_deg: float = 0.0
    elevation_max_deg: float = 90.0
    speed_deg_per_s: float = 6.0


class RotatorCore:
    """A rotator.

    Parameters
    ----------
    now_s
        Monotonic time at which it begins.
    turns
        Range and speed.
    start
        Azimuth and elevation [deg] where it stands.

    Attributes
    ----------
    info, model
        Who rotctld says that it is.
    step_deg
        What its positions are rounded to.
    faults
        Those of `ROTATOR_FAULTS` that are present.
    received
        How often each command has come.
    """

    def __init__(
        self, now_s: float, turns: RotatorRange | None = None, start: tuple[float, float] = (0.0, 0.0)
    ) -> None:
        self.rotator_range = turns or RotatorRange()
        self.info, self.model = "Simulated rotator", 1
        self.step_deg = 0.01
        self.faults: set[str] = set()
        self.received: dict[str, int] = {}
        self._from, self._to, self._began_s = start, start, now_s

    def position(self, now_s: float) -> tuple[float, float]:
        """Return azimuth and elevation [deg] where it truly stands."""
        way_deg = self.rotator_range.speed_deg_per_s * max(0.0, now_s - self._began_s)
        azimuth_deg, elevation_deg = (
            begin + max(-way_deg, min(way_deg, end - begin)) for begin, end in zip(self._from, self._to, strict=True)
        )
        return azimuth_deg, elevation_deg

    def destination(self) -> tuple[float, float]:
        """Return azimuth and elevation [deg] where it is sent."""
        return self._to

    def turn(self, azimuth_deg: float, elevation_deg: float, now_s: float) -> None:
        """Go there, whoever orders it: a hand at the controller has no limits but the rotator's."""
        self._from, self._to, self._began_s = self.position(now_s), (azimuth_deg, elevation_deg), now_s

    def restart(self, now_s: float) -> None:
        """Start rotctld anew: the rotator stays where it is."""
        self.turn(*self.position(now_s), now_s)

    def set_target(self, azimuth_deg: float, elevation_deg: float, now_s: float) -> int:
        """Take a target; return rotctld's error number."""
        turns = self.rotator_range
        if not (
            turns.azimuth_min_deg <= azimuth_deg <= turns.azimuth_max_deg
            and turns.elevation_min_deg <= elevation_deg <= turns.elevation_max_deg
        ):
            return _INVALID_PARAMETER
        if "deaf" not in self.faults:
            self.turn(azimuth_deg, elevation_deg, now_s)
        return 0

    def stop(self, now_s: float) -> int:
        """Stop; return rotctld's error number."""
        if "stopless" in self.faults:
            return _NOT_AVAILABLE
        if "deaf" not in self.faults:
            self.turn(*self.position(now_s), now_s)
        return 0


class RotctldSession:
    """One client's connection.

    Parameters
    ----------
    core
        The rotator that all clients share.
    """

    def __init__(self, core: RotatorCore) -> None:
        self._core = core
        self._unparsed = ""
        self.closed = False

    def feed(self, data: bytes, now_s: float) -> bytes:
        """Take in bytes and return the answers; an argument that a command lacks is taken from the next line."""
        self._unparsed += data.decode("latin-1")
        answers = []
        while not self.closed and (words := self._next_command()):
            answers.append(self._answer(words, now_s))
        return "".join(answers).encode("latin-1")

    def _next_command(self) -> list[str]:
        """Take the next complete command from what has come; an empty list if there is none."""
        text = self._unparsed.lstrip()
        complete = text.split() if text[-1:].isspace() else text.split()[:-1]
        if not complete:
            return []
        name = _long_name(complete[0])
        count = 1 + len(_ARGUMENTS.get(name, ()))
        if len(complete) < count:
            return []
        words = complete[:count]
        for word in words:
            text = text.lstrip()[len(word) :]
        self._unparsed = text
        return words

    def _answer(self, words: list[str], now_s: float) -> str:
        name, arguments = _long_name(words[0]), words[1:]
        self.closed = name == "quit"
        if name not in _ANSWERS:
            return ""
        core = self._core
        core.received[name] = core.received.get(name, 0) + 1
        lines: _Lines
        if "gone" in core.faults and name not in ("get_info", "dump_state"):
            # A command to a rotator that is unplugged does nothing.
            lines, error = [], _NO_CONNECTION
        else:
            lines, error = _ANSWERS[name](core, arguments, now_s)
        extended = words[0].startswith(_PREFIX)
        if extended:
            head = " ".join((f"{name}:", *arguments))
            return "".join(f"{line}\n" for line in (head, *(label + value for label, value in lines), f"RPRT {error}"))
        end = [] if lines and not error else [f"RPRT {error}"]
        return "".join(f"{line}\n" for line in (*(_plain_line(label, value) for label, value in lines), *end))


_Lines = list[tuple[str, str]]
_ARGUMENTS = {"set_pos": ("azimuth", "elevation"), "reset": ("what",)}
_SHORT_COMMANDS = {"p": "get_pos", "P": "set_pos", "S": "stop", "K": "park", "R": "reset", "_": "get_info", "q": "quit"}
_PLAIN_LABELS = {
    "Minimum Azimuth: ": "min_az=",
    "Maximum Azimuth: ": "max_az=",
    "Minimum Elevation: ": "min_el=",
    "Maximum Elevation: ": "max_el=",
    "South Zero: ": "south_zero=",
    "rot_type=": "rot_type=",
}


def _long_name(word: str) -> str:
    name = word.removeprefix(_PREFIX)
    return name[1:] if name.startswith("\\") else _SHORT_COMMANDS.get(name, name)


def _plain_line(label: str, value: str) -> str:
    return _PLAIN_LABELS.get(label, "") + value


def _get_position(core: RotatorCore, _arguments: list[str], now_s: float) -> tuple[_Lines, int]:
    azimuth_deg, elevation_deg = (round(each / core.step_deg) * core.step_deg for each in core.position(now_s))
    return [("Azimuth: ", f"{azimuth_deg:.2f}"), ("Elevation: ", f"{elevation_deg:.2f}")], 0


def _set_position(core: RotatorCore, arguments: list[str], now_s: float) -> tuple[_Lines, int]:
    try:
        azimuth_deg, elevation_deg = map(float, arguments)
    except ValueError:
        return [], _INVALID_PARAMETER
    if not (math.isfinite(azimuth_deg) and math.isfinite(elevation_deg)):
        # rotctld accepts such numbers; where a real rotator goes then is not known.
        return [], 0
    return [], core.set_target(azimuth_deg, elevation_deg, now_s)


def _stop(core: RotatorCore, _arguments: list[str], now_s: float) -> tuple[_Lines, int]:
    return [], core.stop(now_s)


def _park(core: RotatorCore, _arguments: list[str], now_s: float) -> tuple[_Lines, int]:
    return [], core.set_target(0.0, 0.0, now_s)


def _reset(_core: RotatorCore, _arguments: list[str], _now_s: float) -> tuple[_Lines, int]:
    return [], 0


def _get_info(core: RotatorCore, _arguments: list[str], _now_s: float) -> tuple[_Lines, int]:
    return [("Info: ", core.info)], 0


def _dump_state(core: RotatorCore, _arguments: list[str], _now_s: float) -> tuple[_Lines, int]:
    turns = core.rotator_range
    return [
        ("rotctld Protocol Ver: ", "1"),
        ("Rotor Model: ", str(core.model)),
        ("Minimum Azimuth: ", f"{turns.azimuth_min_deg:.6f}"),
        ("Maximum Azimuth: ", f"{turns.azimuth_max_deg:.6f}"),
        ("Minimum Elevation: ", f"{turns.elevation_min_deg:.6f}"),
        ("Maximum Elevation: ", f"{turns.elevation_max_deg:.6f}"),
        ("South Zero: ", "0"),
        ("rot_type=", "AzEl"),
        ("", "done"),
    ], 0


_ANSWERS: dict[str, Callable[[RotatorCore, list[str], float], tuple[_Lines, int]]] = {
    "get_pos": _get_position,
    "set_pos": _set_position,
    "stop": _stop,
    "park": _park,
    "reset": _reset,
    "get_info": _get_info,
    "dump_state": _dump_state,
}
