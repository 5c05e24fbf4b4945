"""The command set of the simulated Keithley 2000: what each line means, worked out once per different line."""

from collections.abc import Callable
from typing import Any, NamedTuple

from sim_drivers.scpi import Parser, ScpiError, boolean, choice, integer, number, spellings, split_commands
from sim_drivers.voltmeter.instrument import VoltmeterInstrument
from sim_drivers.voltmeter.settings import PRESET, RANGES_V, RESET

_HIGHEST_V = 1010.0
_RANGE_FACTOR = 1.01
_UNLIMITED = 9999
_FUNCTIONS = {
    "VOLT:DC": "VOLTage[:DC]",
    "VOLT:AC": "VOLTage:AC",
    "CURR:DC": "CURRent[:DC]",
    "CURR:AC": "CURRent:AC",
    "RES": "RESistance",
    "FRES": "FRESistance",
    "PER": "PERiod",
    "FREQ": "FREQuency",
    "TEMP": "TEMPerature",
    "DIOD": "DIODe",
    "CONT": "CONTinuity",
}
_FUNCTION_OF = {spelling: name for name, pattern in _FUNCTIONS.items() for spelling in spellings(pattern)}


Step = Callable[[VoltmeterInstrument, float], str | None]
Build = Callable[[tuple[str, ...]], Step]


class MeterCommand(NamedTuple):
    """What a header does as a command and as a question; None where it is not one."""

    act: Build | None = None
    ask: Build | None = None


CommandTable = dict[str, MeterCommand]
TABLE: CommandTable = {}
"""The Keithley 2000's commands, by every spelling of a header."""


def compile_line(line: str, table: CommandTable = TABLE) -> tuple[Step, ...]:
    """Return what a line does, step by step; where it goes wrong the last step raises `ScpiError`."""
    steps: list[Step] = []
    found, error = split_commands(line)
    for message in found:
        command = table.get(message.header, MeterCommand())
        build = (command.ask if message.query else command.act) or _undefined
        try:
            steps.append(build(message.parameters))
        except ScpiError as wrong:
            error = wrong.code
            break
    if error:
        steps.append(_raiser(error))
    return tuple(steps)


def _undefined(_parameters: tuple[str, ...]) -> Step:
    raise ScpiError(-113)


def _raiser(code: int) -> Step:
    def step(_meter: VoltmeterInstrument, _cursor_s: float) -> str | None:
        raise ScpiError(code)

    return step


def _without_parameters(step: Step) -> Build:
    def build(parameters: tuple[str, ...]) -> Step:
        if parameters:
            raise ScpiError(-108)
        return step

    return build


def _one_parameter(step_of: Callable[[str], Step]) -> Build:
    def build(parameters: tuple[str, ...]) -> Step:
        if len(parameters) != 1:
            raise ScpiError(-108 if parameters else -109)
        return step_of(parameters[0])

    return build


def _define(pattern: str, act: Build | None = None, ask: Build | None = None) -> None:
    for spelling in spellings(pattern):
        TABLE[spelling] = MeterCommand(act, ask)


def _action(pattern: str, action: Callable[[VoltmeterInstrument, float], None]) -> None:
    def step(meter: VoltmeterInstrument, cursor_s: float) -> str | None:
        action(meter, cursor_s)
        return None

    _define(pattern, act=_without_parameters(step))


def _query(pattern: str, answer: Step) -> None:
    _define(pattern, ask=_without_parameters(answer))


def _change(**settings: Any) -> Step:
    def step(meter: VoltmeterInstrument, cursor_s: float) -> str | None:
        meter.change(cursor_s, **settings)
        return None

    return step


def _text(value: object) -> str:
    if isinstance(value, bool):
        return str(int(value))
    return f"{value:.8G}" if isinstance(value, float) else str(value)


def _setting(pattern: str, name: str, parse: Parser) -> None:
    _define(
        pattern,
        act=_one_parameter(lambda text: _change(**{name: parse(text)})),
        ask=_without_parameters(lambda meter, _cursor_s: _text(getattr(meter.settings, name))),
    )


_range_number = number(0.0, _HIGHEST_V, 1000.0)


def _range_for(text: str) -> float:
    level_v = _range_number(text)
    return next(range_v for range_v in RANGES_V if level_v <= _RANGE_FACTOR * range_v)


def _set_function(text: str) -> Step:
    if len(text) < 2 or text[0] not in "\"'" or text[-1] != text[0]:
        raise ScpiError(-104)
    if text[1:-1].upper() not in _FUNCTION_OF:
        raise ScpiError(-224)
    return _change(function=_FUNCTION_OF[text[1:-1].upper()])


def _configure(parameters: tuple[str, ...]) -> Step:
    if len(parameters) > 2:
        raise ScpiError(-108)
    chosen = parameters[0].upper() if parameters else "DEF"
    settings: dict[str, Any] = {"autorange": True}
    if chosen not in ("DEF", "DEFAULT", "AUTO"):
        settings = {"autorange": False, "range_v": _range_for(chosen)}
    return _change(
        function="VOLT:DC",
        continuous=False,
        trigger_source="IMM",
        trigger_count=1,
        sample_count=1,
        filter_on=False,
        **settings,
    )


def _measure(parameters: tuple[str, ...]) -> Step:
    configure = _configure(parameters)

    def step(meter: VoltmeterInstrument, cursor_s: float) -> str | None:
        meter.abort()
        configure(meter, cursor_s)
        return meter.read(cursor_s)

    return step


_element = choice("READing", "CHANnel", "UNITs")


def _set_elements(parameters: tuple[str, ...]) -> Step:
    if not parameters:
        raise ScpiError(-109)
    chosen = {str(_element(text)) for text in parameters}
    if chosen == {"UNIT"}:
        raise ScpiError(-224)
    return _change(elements=tuple(name for name in ("READ", "CHAN", "UNIT") if name in chosen))


_parse_count = integer(1, _UNLIMITED, 1)


def _trigger_count(text: str) -> int:
    count: int = _UNLIMITED if text.upper() in ("INF", "INFINITE") else _parse_count(text)
    return count


_volt = "[:SENSe[1]]:VOLTage[:DC]"
_setting(f"{_volt}:NPLCycles", "nplc", number(0.01, 10.0, 1.0))
_setting(f"{_volt}:DIGits", "digits", integer(4, 7, 7))
_setting(f"{_volt}:AVERage:STATe", "filter_on", boolean)
_setting(f"{_volt}:AVERage:TCONtrol", "filter_kind", choice("MOVing", "REPeat"))
_setting(f"{_volt}:AVERage:COUNt", "filter_count", integer(1, 100, 10))
_setting(f"{_volt}:REFerence", "reference_v", number(-_HIGHEST_V, _HIGHEST_V, 0.0))
_setting(f"{_volt}:REFerence:STATe", "reference_on", boolean)
_setting("CALCulate[1]:KMATh:MMFactor", "math_factor", number(-1e9, 1e9, 1.0))
_setting("CALCulate[1]:STATe", "math_on", boolean)
_setting(f"{_volt}:RANGe:AUTO", "autorange", boolean)
_define(
    f"{_volt}:RANGe[:UPPer]",
    act=_one_parameter(lambda text: _change(range_v=_range_for(text), autorange=False)),
    ask=_without_parameters(lambda meter, _cursor_s: _text(meter.range_v)),
)
_define(
    "[:SENSe[1]]:FUNCtion",
    act=_one_parameter(_set_function),
    ask=_without_parameters(lambda meter, _cursor_s: f'"{meter.settings.function}"'),
)
_define("CONFigure:VOLTage[:DC]", act=_configure)
_query("CONFigure", lambda meter, _cursor_s: f'"{meter.settings.function}"')
_define("MEASure:VOLTage[:DC]", ask=_measure)
_query("READ", lambda meter, cursor_s: meter.read(cursor_s))
_query("FETCh", lambda meter, cursor_s: meter.fetch(cursor_s))
_query("[:SENSe[1]]:DATA", lambda meter, cursor_s: meter.fetch(cursor_s))
_action("INITiate[:IMMediate]", lambda meter, cursor_s: meter.initiate(cursor_s))
_setting("INITiate:CONTinuous", "continuous", boolean)
_action("ABORt", lambda meter, _cursor_s: meter.abort())
_setting("TRIGger:SOURce", "trigger_source", choice("IMMediate", "BUS", "EXTernal", "TIMer", "MANual"))
_setting("TRIGger:COUNt", "trigger_count", _trigger_count)
_setting("TRIGger:DELay", "trigger_delay_s", number(0.0, 999_999.999, 0.0))
_setting("SAMPle:COUNt", "sample_count", integer(1, 1024, 1))
_define(
    "FORMat:ELEMents",
    act=_set_elements,
    ask=_without_parameters(lambda meter, _cursor_s: ",".join(meter.settings.elements)),
)
# Over a serial line readings can only be text.
_setting("FORMat[:DATA]", "data_format", choice("ASCii"))
_setting("SYSTem:AZERo:STATe", "autozero", boolean)
_setting("SYSTem:BEEPer[:STATe]", "beeper", boolean)
_action("SYSTem:PRESet", lambda meter, _cursor_s: meter.reset(PRESET))
_action("SYSTem:REMote", lambda meter, cursor_s: meter.change(cursor_s, panel="REM"))
_action("SYSTem:LOCal", lambda meter, cursor_s: meter.change(cursor_s, panel="LOC"))
_action("SYSTem:RWLock", lambda meter, cursor_s: meter.change(cursor_s, panel="RWL"))
_query("SYSTem:VERSion", lambda _meter, _cursor_s: "1991.0")
_query("SYSTem:ERRor", lambda meter, _cursor_s: meter.status.errors.pop())
_query("STATus:QUEue[:NEXT]", lambda meter, _cursor_s: meter.status.errors.pop())
_action("STATus:QUEue:CLEar", lambda meter, _cursor_s: meter.status.errors.clear())
_action("STATus:PRESet", lambda _meter, _cursor_s: None)
_query("*IDN", lambda meter, _cursor_s: meter.identity)
_action("*RST", lambda meter, _cursor_s: meter.reset(RESET))
_action("*CLS", lambda meter, _cursor_s: meter.status.clear())
_query("*ESR", lambda meter, _cursor_s: str(meter.status.take_events()))
_query("*STB", lambda meter, _cursor_s: str(meter.status_byte()))
_setting("*ESE", "event_enable", integer(0, 255, 0))
_setting("*SRE", "request_enable", integer(0, 255, 0))
_query("*TST", lambda _meter, _cursor_s: "0")
_action("*WAI", lambda _meter, _cursor_s: None)
_action("*TRG", lambda meter, cursor_s: meter.trigger(cursor_s))
_define(
    "*OPC",
    act=_without_parameters(lambda meter, _cursor_s: meter.status.complete()),
    ask=_without_parameters(lambda _meter, _cursor_s: "1"),
)
