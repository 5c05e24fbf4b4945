"""The Keithley 2000 voltmeter, with the commands that public drivers of this model use."""

import asyncio
import re

from drivers.errors import (
    ConnectError,
    IdentityError,
    LinkLostError,
    OverRangeError,
    ProtocolError,
)
from drivers.scpi import ScpiLine
from drivers.scpi_meter import MeterSession, Proof, ScpiMeter

_DEVICE = "voltmeter"
# The exponent, which every reading has, is required: answers about settings and registers are numbers too.
_READING = re.compile(r"([+-]?\d+(?:\.\d+)?E[+-]?\d{2,})(?:VDC)?", re.ASCII)
# The meter measures to 120 % of its range, and answers 9.9E37 beyond.
_OVER_RANGE_FACTOR = 1.21
_READINGS_BETWEEN_LOOKS = 10


class Keithley2000(ScpiMeter["_Session"]):
    """DC voltage, one conversion at a time.

    Parameters
    ----------
    line
        Opened at each `open`.
    range_v, nplc
        The fixed range [V] and the integration time [power line cycles].
    deadline_s
        How long one answer may take.
    """

    def __init__(self, line: ScpiLine, *, range_v: float = 1.0, nplc: float = 1.0, deadline_s: float = 2.0) -> None:
        settings = _Settings(range_v, nplc)
        super().__init__(line, lambda: _Session(line, settings, deadline_s))
        self._conversion_lock = asyncio.Lock()

    async def read_voltage(self) -> float:
        """Return a fresh conversion [V]."""
        async with self._conversion_lock:
            session = self._session
            if session is None:
                raise LinkLostError(_DEVICE, "has to be opened first")
            try:
                return await session.read()
            except (LinkLostError, ConnectError):
                await self.close()
                raise


def require_model(identity: str) -> None:
    """Raise `IdentityError` unless an answer to ``*IDN?`` is that of a Keithley 2000."""
    fields = identity.split(",")
    if len(fields) < 2 or fields[1].strip() != "MODEL 2000":
        raise IdentityError(_DEVICE, f"answers {identity[:80]!r}, which is not a Keithley MODEL 2000")


class _Settings:
    """What the meter is set to, as commands and as the answers that prove it."""

    def __init__(self, range_v: float, nplc: float) -> None:
        self.range_v = range_v
        self.commands = (
            "*CLS",
            "*RST",
            "*ESE 0",
            ":INIT:CONT OFF;:ABOR",
            ":SENS:FUNC 'VOLT:DC'",
            f":SENS:VOLT:DC:RANG {range_v:g};NPLC {nplc:g};AVER:STAT OFF",
            ":SYST:AZER:STAT ON;:SYST:BEEP:STAT OFF",
            ":CALC1:STAT OFF",
            ":FORM:DATA ASC;:FORM:ELEM READ",
            ":TRIG:SOUR IMM;:TRIG:COUN 1;:SAMP:COUN 1",
        )
        self.proofs: tuple[Proof, ...] = (
            (":INIT:CONT?", "0"),
            (":SENS:FUNC?", "VOLT:DC"),
            (":SENS:VOLT:DC:RANG?", range_v),
            (":SENS:VOLT:DC:NPLC?", nplc),
            (":SENS:VOLT:DC:AVER:STAT?", "0"),
            (":SENS:VOLT:DC:REF:STAT?", "0"),
            (":CALC1:STAT?", "0"),
            (":FORM:ELEM?", "READ"),
            (":TRIG:SOUR?", "IMM"),
        )


class _Session(MeterSession):
    """One connection to the meter."""

    def __init__(self, line: ScpiLine, settings: _Settings, deadline_s: float) -> None:
        super().__init__(line, _DEVICE, settings.proofs, deadline_s)
        self._settings = settings
        self._readings = 0

    def require_identity(self, identity: str) -> None:
        """Raise `IdentityError` unless it is that of a Keithley 2000."""
        require_model(identity)

    async def configure(self) -> None:
        """Set it to take one conversion each time."""
        for command in self._settings.commands:
            await self.command(command)

    async def read(self) -> float:
        """Return a fresh conversion [V]."""
        await self.ensure_synchronised()
        # As `doubtful_exchange` does, at a tenth of its cost: a simulated day has 70,000 readings.
        self.in_doubt = True
        reply = await self.ask(":READ?")
        match = _READING.fullmatch(reply)
        if match is None:
            raise ProtocolError(_DEVICE, f"answered {reply!r} where a reading was expected")
        self._readings += 1
        if self._readings % _READINGS_BETWEEN_LOOKS == 0:
            await self.check_next_setting()
        self.in_doubt = False
        voltage_v, range_v = float(match[1]), self._settings.range_v
        if not abs(voltage_v) <= _OVER_RANGE_FACTOR * range_v:
            raise OverRangeError(_DEVICE, f"the voltage is beyond the {range_v:g} V range")
        return voltage_v
