"""The command sets of the simulated electronic loads: what each line means, worked out once per different line."""

import math
from collections.abc import Callable, Mapping
from typing import Any

from sim_drivers.load.dialects import DialectName
from sim_drivers.load.instrument import LoadInstrument
from sim_drivers.scpi import Parser, ScpiCommand, ScpiError, boolean, choice, integer, number, spellings, split_commands

Step = Callable[[LoadInstrument, float], str | None]
Program = tuple[Step, ...]
"""What a line does, step by step, each at a time [s]."""
_Command = Callable[[LoadInstrument, tuple[str, ...], float], str | None]
_MOST_V, _MOST_A = 240.0, 80.0
_CHROMA_MODES = ("CVL", "CVM", "CVH", "CCL", "CCM", "CCH", "CRL", "CRM", "CRH")
_CHROMA_MODULE = "CHROMA,63640-80-80,636400004321,1.05"


def compile_line(line: str, make: DialectName) -> Program:
    """Return the steps of a line; the step of a command that is not understood raises `ScpiError`."""
    found, code = split_commands(line)
    steps: list[Step] = []
    for message in found:
        step = _step(message, make)
        steps.append(step)
    if code:
        steps.append(_failing(code))
    return tuple(steps)


def _step(message: ScpiCommand, make: DialectName) -> Step:
    command = _COMMANDS[make].get((message.header, message.query))
    if command is None:
        return _failing(-113)
    return lambda load, now: command(load, message.parameters, now)


def _failing(code: int) -> Step:
    def fail(_load: LoadInstrument, _now: float) -> str | None:
        raise ScpiError(code)

    return fail


def _question(answer: Callable[[LoadInstrument, float], str]) -> _Command:
    def command(load: LoadInstrument, parameters: tuple[str, ...], now: float) -> str | None:
        if parameters:
            raise ScpiError(-108)
        return answer(load, now)

    return command


def _action(do: Callable[[LoadInstrument, float], Any]) -> _Command:
    def command(load: LoadInstrument, parameters: tuple[str, ...], now: float) -> str | None:
        if parameters:
            raise ScpiError(-108)
        do(load, now)
        return None

    return command


def _setter(parse: Parser, do: Callable[[LoadInstrument, Any, float], Any]) -> _Command:
    def command(load: LoadInstrument, parameters: tuple[str, ...], now: float) -> str | None:
        if len(parameters) != 1:
            raise ScpiError(-108 if parameters else -109)
        do(load, parse(parameters[0]), now)
        return None

    return command


def _of_channel(command: _Command, *, asks: bool) -> _Command:
    """Let a command of a channel reach the source only on the channel that has it; the others are empty."""

    def routed(load: LoadInstrument, parameters: tuple[str, ...], now: float) -> str | None:
        if load.selected == load.channel:
            return command(load, parameters, now)
        return "0" if asks else None

    return routed


def _written(load: LoadInstrument, value: float) -> str:
    if value >= 9.9e37:
        return "9.9E+37"
    return f"{value:.4f}" if load.make == "chroma63600" else f"{value:+.5E}"


def _store_as(name: str) -> Callable[[LoadInstrument, Any, float], None]:
    return lambda load, value, _now: setattr(load, name, value)


def _select(load: LoadInstrument, channel: int, _now: float) -> None:
    if channel not in load.dialect.channels:
        raise ScpiError(-222)
    load.selected = channel


def _protections(load: LoadInstrument, now: float) -> str:
    return str(load.status(now))


def _clear_protections(load: LoadInstrument, _now: float) -> None:
    load.latched.clear()


def _by_spelling(commands: Mapping[str, _Command], *, of_channel: bool = False) -> dict[tuple[str, bool], _Command]:
    found = {}
    for pattern, command in commands.items():
        asks = pattern.endswith("?")
        for header in spellings(pattern.removesuffix("?")):
            found[header, asks] = _of_channel(command, asks=asks) if of_channel else command
    return found


_COMMON = _by_spelling(
    {
        "*IDN?": _question(lambda load, _now: load.identity),
        "*CLS": _action(lambda load, _now: load.scpi.clear()),
        "*RST": _action(lambda load, now: load.reset(now)),
        "*ESR?": _question(lambda load, _now: str(load.scpi.take_events())),
        "*ESE": _setter(integer(0, 255, 0), _store_as("event_enable")),
        "*ESE?": _question(lambda load, _now: str(load.event_enable)),
        "*OPC?": _question(lambda _load, _now: "1"),
    }
)
_READINGS: dict[str, _Command] = {
    "VOLTage[:DC]?": _question(lambda load, now: _written(load, load.read(now)[0])),
    "CURRent[:DC]?": _question(lambda load, now: _written(load, load.read(now)[1])),
    "POWer[:DC]?": _question(lambda load, now: _written(load, math.prod(load.read(now)))),
}
_MEASURE = {f"MEASure:{name}": command for name, command in _READINGS.items()}
_FETCH = {f"FETCh:{name}": command for name, command in _READINGS.items()}
_level = _setter(number(0.0, _MOST_V, 0.0), lambda load, level_v, now: load.set_level(level_v, now))
_switch = _setter(boolean, lambda load, on, now: load.switch(now, on=on))

_CHROMA = _by_spelling(
    {
        "CHANnel[:LOAD]": _setter(integer(1, 10, 1), _select),
        "CHANnel[:LOAD]?": _question(lambda load, _now: str(load.selected)),
        "CHANnel:ID?": _question(lambda _load, _now: _CHROMA_MODULE),
    }
) | _by_spelling(
    {
        "LOAD[:STATe]": _switch,
        "LOAD[:STATe]?": _question(lambda load, _now: "ON" if load.on else "OFF"),
        "LOAD:PROTection?": _question(_protections),
        "LOAD:PROTection:CLEar": _action(_clear_protections),
        "MODE": _setter(choice(*_CHROMA_MODES), lambda load, mode, now: load.set_mode(mode, now)),
        "MODE?": _question(lambda load, _now: load.mode),
        "CONFigure:VOLTage:RANGe": _setter(choice("HIGH", "MIDDLE", "LOW", "H", "M", "L"), _store_as("voltage_range")),
        "CONFigure:VOLTage:RANGe?": _question(lambda load, _now: load.voltage_range),
        "VOLTage:STATic:L1": _level,
        "VOLTage:STATic:L1?": _question(lambda load, _now: _written(load, load.level_v)),
        "VOLTage:STATic:ILIMit": _setter(number(0.0, _MOST_A, _MOST_A), _store_as("limit_a")),
        "VOLTage:STATic:ILIMit?": _question(lambda load, _now: _written(load, load.limit_a)),
        **_MEASURE,
        **_FETCH,
    },
    of_channel=True,
)
_AGILENT = _by_spelling(
    {
        "INPut[:STATe]": _switch,
        "INPut[:STATe]?": _question(lambda load, _now: str(int(load.on))),
        "INPut:PROTection:CLEar": _action(_clear_protections),
        "INPut:SHORt": _setter(boolean, lambda _load, _on, _now: None),
        "MODE:CURRent[:DC]": _action(lambda load, now: load.set_mode("CURR", now)),
        "MODE:RESistance": _action(lambda load, now: load.set_mode("RES", now)),
        "MODE:VOLTage[:DC]": _action(lambda load, now: load.set_mode("VOLT", now)),
        "MODE?": _question(lambda load, _now: load.mode),
        "VOLTage[:LEVel][:IMMediate]": _level,
        # This answers what was set, not what is measured.
        "VOLTage[:LEVel][:IMMediate]?": _question(lambda load, _now: _written(load, load.level_v)),
        "CURRent:RANGe": _setter(number(0.0, 10.0, 10.0), lambda _load, _range_a, _now: None),
        "TRANsient[:STATe]": _setter(boolean, lambda _load, _on, _now: None),
        "STATus:CHANnel:CONDition?": _question(_protections),
        "SYSTem:ERRor?": _question(lambda load, _now: load.scpi.errors.pop()),
        **_MEASURE,
    }
)
_COMMANDS: dict[DialectName, dict[tuple[str, bool], _Command]] = {
    "chroma63600": _COMMON | _CHROMA,
    "agilent6063b": _COMMON | _AGILENT,
}
