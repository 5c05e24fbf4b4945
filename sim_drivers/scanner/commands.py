"""What the simulated scanning meters understand beside what they share with the simulated Keithley 2000."""

from collections.abc import Callable
from typing import cast

from sim_drivers.scanner.instrument import ScannerInstrument
from sim_drivers.scpi import Parser, ScpiError, boolean, integer, number, spellings
from sim_drivers.voltmeter.commands import TABLE, Build, CommandTable, MeterCommand, Step
from sim_drivers.voltmeter.instrument import VoltmeterInstrument
from sim_drivers.voltmeter.settings import RANGES_V, RESET

ScannerStep = Callable[[ScannerInstrument, float], str | None]
# What every make has in common with the 2000.
_SHARED_HEADERS = ("*", "SYSTEM:ERROR", "SYST:ERR", "ABOR", "INIT", "READ")


def _meter_step(step: ScannerStep) -> Step:
    def on_meter(meter: VoltmeterInstrument, cursor_s: float) -> str | None:
        return step(cast("ScannerInstrument", meter), cursor_s)

    return on_meter


def _without_parameters(step: ScannerStep) -> Build:
    def build(parameters: tuple[str, ...]) -> Step:
        if parameters:
            raise ScpiError(-108)
        return _meter_step(step)

    return build


def _with_parameters(count: int, step: Callable[..., str | None]) -> Build:
    """Return the builder of a command that takes `count` parameters, whatever they are."""

    def build(parameters: tuple[str, ...]) -> Step:
        if len(parameters) != count:
            raise ScpiError(-109 if len(parameters) < count else -108)
        return _meter_step(lambda meter, _cursor_s: step(meter, *parameters))

    return build


def _define(table: CommandTable, pattern: str, act: Build | None = None, ask: Build | None = None) -> None:
    for spelling in spellings(pattern):
        before = table.get(spelling, MeterCommand())
        table[spelling] = MeterCommand(act or before.act, ask or before.ask)


def _format_channels(channels: tuple[int, ...]) -> str:
    return f"(@{','.join(map(str, channels))})"


def _set_list(meter: ScannerInstrument, text: str) -> None:
    meter.scan_list = meter.channels(text)


def _reset(meter: ScannerInstrument, _cursor_s: float) -> None:
    meter.reset(RESET)
    meter.forget_scan()


def _keithley2000() -> CommandTable:
    table = dict(TABLE)
    _define(table, "*RST", act=_without_parameters(_reset))
    _define(
        table,
        "ROUTe:SCAN[:INTernal]",
        act=_with_channel_list(_set_list),
        ask=_without_parameters(lambda meter, _: _format_channels(meter.scan_list)),
    )

    def select(meter: ScannerInstrument, text: str) -> None:
        if text.upper() not in ("INT", "INTERNAL", "NONE"):
            raise ScpiError(-224)
        if not meter.card:
            raise ScpiError(-241)
        meter.scanning = text.upper() != "NONE"

    chosen = _without_parameters(lambda meter, _: "INT" if meter.scanning else "NONE")
    _define(table, "ROUTe:SCAN:LSELect", act=_with_parameters(1, select), ask=chosen)
    return table


def _with_channel_list(act: Callable[[ScannerInstrument, str], None]) -> Build:
    """Return the builder of a command that takes a channel list, whose commas are no separators."""

    def build(parameters: tuple[str, ...]) -> Step:
        if not parameters:
            raise ScpiError(-109)
        return _meter_step(lambda meter, _cursor_s: act(meter, ",".join(parameters)))

    return build


def _shared_commands() -> CommandTable:
    return {
        spelling: command
        for spelling, command in TABLE.items()
        if spelling.startswith(_SHARED_HEADERS) and not spelling.startswith("INITIATE:CONT")
    }


def _setting_for_channels(table: CommandTable, pattern: str, name: str, parse: Parser) -> None:
    def split(parameters: tuple[str, ...]) -> tuple[str, str]:
        at = next((index for index, text in enumerate(parameters) if text.startswith("(@")), None)
        if at is None:
            raise ScpiError(-109)
        return ",".join(parameters[:at]), ",".join(parameters[at:])

    def act(parameters: tuple[str, ...]) -> Step:
        value, channels = split(parameters)
        parsed = parse(value)

        def step(meter: ScannerInstrument, cursor_s: float) -> None:
            meter.channels(channels)
            more = {"autorange": False} if name == "range_v" else {}
            meter.change(cursor_s, **{name: parsed}, **more)

        return _meter_step(step)

    def ask(parameters: tuple[str, ...]) -> Step:
        _, channels = split(parameters)
        return _meter_step(
            lambda meter, _: ",".join(_format_value(getattr(meter.settings, name)) for _ in meter.channels(channels))
        )

    _define(table, pattern, act=act, ask=ask)


def _format_value(value: float | str) -> str:
    return f'"{value}"' if isinstance(value, str) else f"{value:+.8E}"


_place = integer(1, 1_000_000, 1)
_level = number(0.0, 1010.0, 1000.0)


def _range(text: str) -> float:
    level_v = _level(text)
    return next(range_v for range_v in RANGES_V if level_v <= 1.01 * range_v)


def _function(text: str) -> str:
    if text.strip("\"'").upper() not in ("VOLT", "VOLT:DC", "VOLTAGE", "VOLTAGE:DC"):
        raise ScpiError(-224)
    return "VOLT:DC"


def _tsp() -> CommandTable:
    """Return the commands of DMM6500 and DAQ6510 in their own SCPI."""
    table = _shared_commands()
    volt = "[:SENSe[1]]:VOLTage[:DC]"
    _setting_for_channels(table, "[:SENSe[1]]:FUNCtion", "function", _function)
    _setting_for_channels(table, f"{volt}:RANGe[:UPPer]", "range_v", _range)
    _setting_for_channels(table, f"{volt}:NPLCycles", "nplc", number(0.0005, 15.0, 1.0))
    _setting_for_channels(table, f"{volt}:AZERo[:STATe]", "autozero", boolean)

    def buffer_named(_meter: ScannerInstrument, name: str) -> None:
        if name.strip("\"'") != "defbuffer1":
            raise ScpiError(-224)

    def set_scans(meter: ScannerInstrument, text: str) -> None:
        meter.scans = integer(0, 1_000_000, 1)(text)

    def clear(meter: ScannerInstrument, name: str) -> None:
        buffer_named(meter, name)
        meter.clear_buffer()

    def wait(meter: ScannerInstrument, _cursor_s: float) -> None:
        meter.wait()

    def completed(meter: ScannerInstrument, _cursor_s: float) -> str:
        meter.wait()
        return "1"

    def data(meter: ScannerInstrument, first: str, last: str, name: str, *elements: str) -> str:
        buffer_named(meter, name)
        pairs = meter.buffered(_place(first), _place(last))
        chosen = [element.upper() for element in elements] or ["READ"]
        if not set(chosen) <= {"READ", "CHAN"}:
            raise ScpiError(-224)
        parts = ({"READ": text, "CHAN": str(channel)}[name] for text, channel in pairs for name in chosen)
        return ",".join(parts)

    def data_build(parameters: tuple[str, ...]) -> Step:
        if not 3 <= len(parameters) <= 5:
            raise ScpiError(-109)
        return _meter_step(lambda meter, _: data(meter, *parameters))

    _define(table, "*RST", act=_without_parameters(_reset))
    _define(table, "ROUTe:SCAN:BUFFer", act=_with_parameters(1, buffer_named))
    _define(
        table,
        "ROUTe:SCAN[:CREate]",
        act=_with_channel_list(_set_list),
        ask=_without_parameters(lambda meter, _: _format_channels(meter.scan_list)),
    )
    scans = _without_parameters(lambda meter, _: str(meter.scans))
    _define(table, "ROUTe:SCAN:COUNt:SCAN", act=_with_parameters(1, set_scans), ask=scans)
    _define(table, "TRACe:CLEar", act=_with_parameters(1, clear))
    _define(table, "INITiate[:IMMediate]", act=_without_parameters(ScannerInstrument.begin_scan))
    _define(table, "*WAI", act=_without_parameters(wait))
    _define(table, "*OPC", ask=_without_parameters(completed))
    _define(table, "TRACe:DATA", ask=data_build)
    _define(table, "SYSTem:CARD1:IDN", ask=_without_parameters(lambda meter, _: meter.card if 1 in meter.slots else ""))
    _define(table, "SYSTem:CARD2:IDN", ask=_without_parameters(lambda meter, _: meter.card if 2 in meter.slots else ""))
    return table


def _agilent() -> CommandTable:
    table = _shared_commands()
    volt = "[:SENSe]:VOLTage[:DC]"
    _setting_for_channels(table, f"{volt}:RANGe[:UPPer]", "range_v", _range)
    _setting_for_channels(table, f"{volt}:NPLCycles", "nplc", number(0.02, 200.0, 1.0))
    _setting_for_channels(table, "CALCulate:SCALe:STATe", "math_on", boolean)

    def configure(parameters: tuple[str, ...]) -> Step:
        at = next((index for index, text in enumerate(parameters) if text.startswith("(@")), None)
        if at not in (1, 2):
            raise ScpiError(-109)
        range_v, channels = _range(parameters[0]), ",".join(parameters[at:])

        def step(meter: ScannerInstrument, cursor_s: float) -> None:
            meter.scan_list = meter.channels(channels)
            meter.with_channels = False
            meter.change(
                cursor_s,
                function="VOLT:DC",
                range_v=range_v,
                autorange=False,
                continuous=False,
                filter_on=False,
                math_on=False,
                trigger_source="IMM",
            )

        return _meter_step(step)

    def with_channels(meter: ScannerInstrument, text: str) -> None:
        meter.with_channels = boolean(text)

    def other_element(_meter: ScannerInstrument, text: str) -> None:
        if boolean(text):
            raise ScpiError(-224)

    def block(meter: ScannerInstrument, _cursor_s: float) -> str:
        text = _format_channels(tuple(sorted(meter.scan_list)))
        return f"#{len(str(len(text)))}{len(text)}{text}"

    def read(meter: ScannerInstrument, cursor_s: float) -> str | None:
        if meter.settings.trigger_source != "IMM":
            return None
        pairs = meter.scan(cursor_s)
        parts = [part for text, channel in pairs for part in ((text, str(channel)) if meter.with_channels else (text,))]
        return ",".join(parts)

    def card(meter: ScannerInstrument, slot: str) -> str:
        if slot not in ("100", "200", "300"):
            raise ScpiError(-222)
        return meter.card if int(slot) // 100 in meter.slots and meter.card else "HEWLETT-PACKARD,0,0,0"

    def once(_meter: ScannerInstrument, text: str) -> None:
        if text != "1":
            raise ScpiError(-224)

    _define(table, "*RST", act=_without_parameters(_reset))
    _define(table, "CONFigure:VOLTage[:DC]", act=configure)
    _define(
        table,
        "FORMat:READing:CHANnel",
        act=_with_parameters(1, with_channels),
        ask=_without_parameters(lambda meter, _: str(int(meter.with_channels))),
    )
    for name in ("UNIT", "TIME", "ALARm"):
        _define(table, f"FORMat:READing:{name}", act=_with_parameters(1, other_element))
    table |= {spelling: TABLE[spelling] for spelling in spellings("TRIGger:SOURce")}
    _define(table, "TRIGger:COUNt", act=_with_parameters(1, once))
    _define(table, "ROUTe:SCAN", ask=_without_parameters(block))
    _define(table, "SYSTem:CTYPe", ask=_with_parameters(1, card))
    _define(table, "READ", ask=_without_parameters(read))
    return table


TABLES: dict[str, CommandTable] = {
    "keithley2000-scan": _keithley2000(),
    "dmm6500": _tsp(),
    "daq6510": _tsp(),
    "agilent34970a": _agilent(),
}
"""The commands of each make, by every spelling of a header."""
