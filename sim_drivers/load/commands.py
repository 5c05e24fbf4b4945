"""The command sets of the simulated electronic loads: what each line means, worked out once per different line."""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal

from sim_drivers.scpi import Message, Parser, ScpiError, boolean, choice, integer, messages, number, spellings

if TYPE_CHECKING:
    from sim_drivers.load.core import LoadCore

DialectName = Literal["chroma63600", "agilent6063b"]
Step = Callable[["LoadCore", float], str | None]
Program = tuple[Step, ...]
"""What a line does, step by step, each at a time [s]."""
_Command = Callable[["LoadCore", tuple[str, ...], float], str | None]
_MOST_V, _MOST_A = 240.0, 80.0
_CHROMA_MODES = ("CVL", "CVM", "CVH", "CCL", "CCM", "CCH", "CRL", "CRM", "CRH")


@dataclass(frozen=True, slots=True)
class DialectFacts:
    """What one make does in its own way.

    Attributes
    ----------
    identity
        Its answer to ``*IDN?``.
    mode, constant_voltage
        The mode after ``*RST``, and the one for sweeps.
    channels
        Those that there are: modules with one input take every other number.
    bits
        Its status bits by protection.
    shutdown_bit, unregulated_bit
        Set with some protections, and while the set voltage is not met; 0 where there is none. The manual of the
        6063B's family says that the latter does not come in constant voltage; it does here, so that nothing is built
        on its absence.
    end
        What ends a reply.
    """

    identity: str
    mode: str
    constant_voltage: str
    channels: tuple[int, ...]
    bits: Mapping[str, int]
    shutdown_bit: int
    unregulated_bit: int
    end: bytes


DIALECTS: dict[DialectName, DialectFacts] = {
    "chroma63600": DialectFacts(
        "CHROMA,63600-5,636000001234,1.20",
        "CCH",
        "CVH",
        (1, 3, 5, 7, 9),
        {"over-temperature": 1, "over-voltage": 2, "over-current": 4, "over-power": 8, "reverse-voltage": 16},
        0,
        0,
        b"\n",
    ),
    "agilent6063b": DialectFacts(
        "HEWLETT-PACKARD,6063B,0,A.02.01",
        "CURR",
        "VOLT",
        (1,),
        {
            "over-temperature": 16,
            "over-voltage": 4096 | 1,
            "over-current": 2,
            "over-power": 8,
            "reverse-voltage": 2048 | 1,
        },
        8192,
        1024,
        b"\r\n",
    ),
}
_CHROMA_MODULE = "CHROMA,63640-80-80,636400004321,1.05"


def compile_line(line: str, make: DialectName) -> Program:
    """Return what a line does; from the first command on that is not understood it raises `ScpiError`."""
    found, code = messages(line)
    steps: list[Step] = []
    for message in found:
        step = _step(message, make)
        steps.append(step)
    if code:
        steps.append(_failing(code))
    return tuple(steps)


def _step(message: Message, make: DialectName) -> Step:
    command = _COMMANDS[make].get((message.header, message.query))
    if command is None:
        return _failing(-113)
    return lambda core, now: command(core, message.parameters, now)


def _failing(code: int) -> Step:
    def fail(_core: "LoadCore", _now: float) -> str | None:
        raise ScpiError(code)

    return fail


def _ask(answer: Callable[["LoadCore", float], str]) -> _Command:
    def command(core: "LoadCore", parameters: tuple[str, ...], now: float) -> str | None:
        if parameters:
            raise ScpiError(-108)
        return answer(core, now)

    return command


def _act(do: Callable[["LoadCore", float], Any]) -> _Command:
    def command(core: "LoadCore", parameters: tuple[str, ...], now: float) -> str | None:
        if parameters:
            raise ScpiError(-108)
        do(core, now)
        return None

    return command


def _set(parse: Parser, do: Callable[["LoadCore", Any, float], Any]) -> _Command:
    def command(core: "LoadCore", parameters: tuple[str, ...], now: float) -> str | None:
        if len(parameters) != 1:
            raise ScpiError(-108 if parameters else -109)
        do(core, parse(parameters[0]), now)
        return None

    return command


def _of_channel(command: _Command, *, asks: bool) -> _Command:
    """Let a command of a channel reach the source only on the channel that has it; the others are empty."""

    def routed(core: "LoadCore", parameters: tuple[str, ...], now: float) -> str | None:
        if core.selected == core.channel:
            return command(core, parameters, now)
        return "0" if asks else None

    return routed


def _written(core: "LoadCore", value: float) -> str:
    if value >= 9.9e37:
        return "9.9E+37"
    return f"{value:.4f}" if core.make == "chroma63600" else f"{value:+.5E}"


def _keep(name: str) -> Callable[["LoadCore", Any, float], None]:
    return lambda core, value, _now: setattr(core, name, value)


def _select(core: "LoadCore", channel: int, _now: float) -> None:
    if channel not in core.dialect.channels:
        raise ScpiError(-222)
    core.selected = channel


def _protections(core: "LoadCore", now: float) -> str:
    return str(core.status(now))


def _clear_protections(core: "LoadCore", _now: float) -> None:
    core.latched.clear()


def _spelt(commands: Mapping[str, _Command], *, of_channel: bool = False) -> dict[tuple[str, bool], _Command]:
    found = {}
    for pattern, command in commands.items():
        asks = pattern.endswith("?")
        for header in spellings(pattern.removesuffix("?")):
            found[header, asks] = _of_channel(command, asks=asks) if of_channel else command
    return found


_COMMON = _spelt(
    {
        "*IDN?": _ask(lambda core, _now: core.identity),
        "*CLS": _act(lambda core, _now: core.scpi.clear()),
        "*RST": _act(lambda core, now: core.reset(now)),
        "*ESR?": _ask(lambda core, _now: str(core.scpi.take_events())),
        "*ESE": _set(integer(0, 255, 0), _keep("event_enable")),
        "*ESE?": _ask(lambda core, _now: str(core.event_enable)),
        "*OPC?": _ask(lambda _core, _now: "1"),
    }
)
_READINGS: dict[str, _Command] = {
    "VOLTage[:DC]?": _ask(lambda core, now: _written(core, core.read(now)[0])),
    "CURRent[:DC]?": _ask(lambda core, now: _written(core, core.read(now)[1])),
    "POWer[:DC]?": _ask(lambda core, now: _written(core, math.prod(core.read(now)))),
}
_MEASURE = {f"MEASure:{name}": command for name, command in _READINGS.items()}
_FETCH = {f"FETCh:{name}": command for name, command in _READINGS.items()}
_level = _set(number(0.0, _MOST_V, 0.0), lambda core, level_v, now: core.set_level(level_v, now))
_switch = _set(boolean, lambda core, on, now: core.switch(now, on=on))

_CHROMA = _spelt(
    {
        "CHANnel[:LOAD]": _set(integer(1, 10, 1), _select),
        "CHANnel[:LOAD]?": _ask(lambda core, _now: str(core.selected)),
        "CHANnel:ID?": _ask(lambda _core, _now: _CHROMA_MODULE),
    }
) | _spelt(
    {
        "LOAD[:STATe]": _switch,
        "LOAD[:STATe]?": _ask(lambda core, _now: "ON" if core.on else "OFF"),
        "LOAD:PROTection?": _ask(_protections),
        "LOAD:PROTection:CLEar": _act(_clear_protections),
        "MODE": _set(choice(*_CHROMA_MODES), lambda core, mode, now: core.set_mode(mode, now)),
        "MODE?": _ask(lambda core, _now: core.mode),
        "CONFigure:VOLTage:RANGe": _set(choice("HIGH", "MIDDLE", "LOW", "H", "M", "L"), _keep("voltage_range")),
        "CONFigure:VOLTage:RANGe?": _ask(lambda core, _now: core.voltage_range),
        "VOLTage:STATic:L1": _level,
        "VOLTage:STATic:L1?": _ask(lambda core, _now: _written(core, core.level_v)),
        "VOLTage:STATic:ILIMit": _set(number(0.0, _MOST_A, _MOST_A), _keep("limit_a")),
        "VOLTage:STATic:ILIMit?": _ask(lambda core, _now: _written(core, core.limit_a)),
        **_MEASURE,
        **_FETCH,
    },
    of_channel=True,
)
_AGILENT = _spelt(
    {
        "INPut[:STATe]": _switch,
        "INPut[:STATe]?": _ask(lambda core, _now: str(int(core.on))),
        "INPut:PROTection:CLEar": _act(_clear_protections),
        "INPut:SHORt": _set(boolean, lambda _core, _on, _now: None),
        "MODE:CURRent[:DC]": _act(lambda core, now: core.set_mode("CURR", now)),
        "MODE:RESistance": _act(lambda core, now: core.set_mode("RES", now)),
        "MODE:VOLTage[:DC]": _act(lambda core, now: core.set_mode("VOLT", now)),
        "MODE?": _ask(lambda core, _now: core.mode),
        "VOLTage[:LEVel][:IMMediate]": _level,
        # What was set, and not what is there.
        "VOLTage[:LEVel][:IMMediate]?": _ask(lambda core, _now: _written(core, core.level_v)),
        "CURRent:RANGe": _set(number(0.0, 10.0, 10.0), lambda _core, _range_a, _now: None),
        "TRANsient[:STATe]": _set(boolean, lambda _core, _on, _now: None),
        "STATus:CHANnel:CONDition?": _ask(_protections),
        "SYSTem:ERRor?": _ask(lambda core, _now: core.scpi.errors.pop()),
        **_MEASURE,
    }
)
_COMMANDS: dict[DialectName, dict[tuple[str, bool], _Command]] = {
    "chroma63600": _COMMON | _CHROMA,
    "agilent6063b": _COMMON | _AGILENT,
}
