"""What the makes of scanning meters are asked and answer, as their makers' manuals and public programs have it.

Each scan is one line and one reply: pairs of a reading and the channel that it is of. Nobody has tried these on
hardware.
"""

import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Literal

Make = Literal["keithley2000-scan", "dmm6500", "daq6510", "agilent34970a"]
_Commands = Callable[[str, float, float], tuple[str, ...]]
_Proofs = Callable[[str, float, float], tuple[tuple[str, str | float], ...]]


@dataclass(frozen=True, slots=True)
class ScanDialect:
    """One make.

    Attributes
    ----------
    name
        As people call it.
    identity
        What its answer to ``*IDN?`` contains.
    channels
        The usual channels of east, south, west and zenith.
    card
        Question for the card in the slot of a channel, and what its answer has to match; None where the meter says by
        an error that it has none.
    commands, proofs
        Return, for a channel list, range [V] and integration time [mains periods], what configures the meter, and the
        questions that prove it; numbers are answered once for each channel.
    scan
        The line that triggers one scan and asks for it.
    """

    name: str
    identity: re.Pattern[str]
    channels: tuple[int, int, int, int]
    card: tuple[Callable[[int], str], re.Pattern[str]] | None
    commands: _Commands
    proofs: _Proofs
    scan: str


def channel_list(channels: Sequence[int]) -> str:
    """Return channels as SCPI lists them: ``(@101,102,103,104)``."""
    return f"(@{','.join(str(channel) for channel in channels)})"


def slot_of(channel: int) -> int:
    """Return the number of a channel's slot, 1 for 101 and for the only slot of a meter that counts from 1."""
    return max(channel // 100, 1)


def _keithley2000_commands(channels: str, range_v: float, nplc: float) -> tuple[str, ...]:
    return (
        "*CLS",
        "*RST",
        "*ESE 0",
        ":INIT:CONT OFF;:ABOR",
        ":SENS:FUNC 'VOLT:DC'",
        f":SENS:VOLT:DC:RANG {range_v:g};NPLC {nplc:g};AVER:STAT OFF",
        ":SYST:AZER:STAT ON;:SYST:BEEP:STAT OFF",
        ":CALC1:STAT OFF",
        ":FORM:DATA ASC;:FORM:ELEM READ,CHAN",
        f":ROUT:SCAN {channels}",
        ":TRIG:SOUR IMM;:TRIG:COUN 1;:SAMP:COUN 4",
        ":ROUT:SCAN:LSEL INT",
    )


def _keithley2000_proofs(channels: str, range_v: float, nplc: float) -> tuple[tuple[str, str | float], ...]:
    return (
        (":INIT:CONT?", "0"),
        (":SENS:FUNC?", "VOLT:DC"),
        (":SENS:VOLT:DC:RANG?", range_v),
        (":SENS:VOLT:DC:NPLC?", nplc),
        (":SENS:VOLT:DC:AVER:STAT?", "0"),
        (":SENS:VOLT:DC:REF:STAT?", "0"),
        (":CALC1:STAT?", "0"),
        (":ROUT:SCAN?", channels),
        (":ROUT:SCAN:LSEL?", "INT"),
        (":TRIG:SOUR?", "IMM"),
        (":SAMP:COUN?", "4"),
        (":FORM:ELEM?", "READ,CHAN"),
    )


def _tsp_commands(channels: str, range_v: float, nplc: float) -> tuple[str, ...]:
    return (
        "*CLS",
        "*RST",
        "*ESE 0",
        f":SENS:FUNC 'VOLT:DC',{channels}",
        f":SENS:VOLT:DC:RANG {range_v:g},{channels}",
        f":SENS:VOLT:DC:NPLC {nplc:g},{channels}",
        f":SENS:VOLT:DC:AZER ON,{channels}",
        ':ROUT:SCAN:BUFF "defbuffer1"',
        f":ROUT:SCAN:CRE {channels}",
        ":ROUT:SCAN:COUN:SCAN 1",
    )


def _tsp_proofs(channels: str, range_v: float, nplc: float) -> tuple[tuple[str, str | float], ...]:
    return (
        (f":SENS:VOLT:DC:RANG? {channels}", range_v),
        (f":SENS:VOLT:DC:NPLC? {channels}", nplc),
        (":ROUT:SCAN:COUN:SCAN?", "1"),
    )


def _agilent_commands(channels: str, range_v: float, nplc: float) -> tuple[str, ...]:
    return (
        "*CLS",
        "*RST",
        "*ESE 0",
        # This sets the scan list, and resets the format of readings, which is therefore set after it.
        f":CONF:VOLT:DC {range_v:g},DEF,{channels}",
        f":SENS:VOLT:DC:NPLC {nplc:g},{channels}",
        ":FORM:READ:UNIT OFF;:FORM:READ:TIME OFF;:FORM:READ:ALAR OFF;:FORM:READ:CHAN ON",
        ":TRIG:SOUR IMM;:TRIG:COUN 1",
    )


def _agilent_proofs(channels: str, range_v: float, nplc: float) -> tuple[tuple[str, str | float], ...]:
    return (
        (f":SENS:VOLT:DC:RANG? {channels}", range_v),
        (f":SENS:VOLT:DC:NPLC? {channels}", nplc),
        (f":CALC:SCAL:STAT? {channels}", 0.0),
        (":ROUT:SCAN?", channels),
        (":TRIG:SOUR?", "IMM"),
        (":FORM:READ:CHAN?", "1"),
    )


def _tsp_card(channel: int) -> str:
    return f":SYST:CARD{slot_of(channel)}:IDN?"


# The cards that switch DC voltages to the meter itself.
_KEITHLEY_CARDS = re.compile(r"(2000|2001|7700|7701|7702|7703|7706|7707|7708|7709|7710)\b.*", re.ASCII)
_AGILENT_CARDS = re.compile(r".*\b(34901A|34902A|34908A|DAQM900A|DAQM901A|DAQM902A|DAQM908A)\b.*", re.ASCII)
_TSP_SCAN = ':TRAC:CLE "defbuffer1";:INIT;*WAI;:TRAC:DATA? 1,4,"defbuffer1",READ,CHAN'

DIALECTS: dict[Make, ScanDialect] = {
    "keithley2000-scan": ScanDialect(
        name="Keithley 2000 (or a DMM6500 that speaks SCPI2000) with a scanner card",
        identity=re.compile(r"MODEL (2000|DMM6500)\b"),
        channels=(1, 2, 3, 4),
        card=None,
        commands=_keithley2000_commands,
        proofs=_keithley2000_proofs,
        scan=":READ?",
    ),
    "dmm6500": ScanDialect(
        name="Keithley DMM6500",
        identity=re.compile(r"MODEL DMM6500\b"),
        channels=(1, 2, 3, 4),
        card=(_tsp_card, _KEITHLEY_CARDS),
        commands=_tsp_commands,
        proofs=_tsp_proofs,
        scan=_TSP_SCAN,
    ),
    "daq6510": ScanDialect(
        name="Keithley DAQ6510",
        identity=re.compile(r"MODEL DAQ6510\b"),
        channels=(101, 102, 103, 104),
        card=(_tsp_card, _KEITHLEY_CARDS),
        commands=_tsp_commands,
        proofs=_tsp_proofs,
        scan=_TSP_SCAN,
    ),
    "agilent34970a": ScanDialect(
        name="Agilent 34970A, 34972A or DAQ970A",
        identity=re.compile(r"\b(34970A|34972A|DAQ970A|DAQ973A)\b"),
        channels=(101, 102, 103, 104),
        card=(lambda channel: f":SYST:CTYP? {100 * slot_of(channel)}", _AGILENT_CARDS),
        commands=_agilent_commands,
        proofs=_agilent_proofs,
        scan=":READ?",
    ),
}
