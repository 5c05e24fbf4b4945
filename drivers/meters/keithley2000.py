"""The Keithley 2000 voltmeter: identified, configured, read, and put right again after a doubtful exchange.

The commands are those that public drivers of this model use; the front panel stays usable, so the settings are read
back after every doubt, and one of them now and then.
"""

import asyncio
import contextlib
import re

from drivers.errors import (
    ConnectError,
    DeadlineError,
    IdentityError,
    LinkLostError,
    OverRangeError,
    ProtocolError,
)
from drivers.scpi import POWER_ON, ScpiLine, ScpiSession, opening

_DEVICE = "voltmeter"
_READING = re.compile(r"([+-]?\d+(?:\.\d+)?(?:E[+-]?\d+)?)(?:VDC)?", re.ASCII)
# The meter measures to 120 % of its range, and answers 9.9E37 beyond.
_BEYOND_RANGE = 1.21
_READINGS_BETWEEN_LOOKS = 10


class Keithley2000:
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
        self._line = line
        self._settings = _Settings(range_v, nplc)
        self._deadline_s = deadline_s
        self._turn = asyncio.Lock()
        self._session: _Session | None = None

    async def open(self) -> str:
        """Connect, identify, configure and read the configuration back."""
        await self.close()
        session = _Session(self._line, self._settings, self._deadline_s)
        try:
            await self._line.open()
            identity = await session.start()
        except BaseException:
            await self._line.close()
            raise
        self._session = session
        return identity

    async def close(self) -> None:
        """Release the line; the meter keeps its settings."""
        self._session = None
        await self._line.close()

    async def read_voltage(self) -> float:
        """Return a fresh conversion [V]."""
        async with self._turn:
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
        self.expected: dict[str, str | float] = {
            ":INIT:CONT?": "0",
            ":SENS:FUNC?": "VOLT:DC",
            ":SENS:VOLT:DC:RANG?": range_v,
            ":SENS:VOLT:DC:NPLC?": nplc,
            ":SENS:VOLT:DC:AVER:STAT?": "0",
            ":SENS:VOLT:DC:REF:STAT?": "0",
            ":CALC1:STAT?": "0",
            ":FORM:ELEM?": "READ",
            ":TRIG:SOUR?": "IMM",
        }


class _Session(ScpiSession):
    """One connection to the meter."""

    def __init__(self, line: ScpiLine, settings: _Settings, deadline_s: float) -> None:
        super().__init__(line, _DEVICE, deadline_s)
        self._settings = settings
        self._identity = ""
        self._readings = 0

    async def start(self) -> str:
        """Identify, configure, and return the meter's identity."""
        with opening(_DEVICE, "this interface and speed"):
            await self.quieten()
            self._identity = await self.ask("*IDN?")
            require_model(self._identity)
            await self.synchronise()
            for command in self._settings.commands:
                await self.command(command)
            changed = await self._changed()
        if changed:
            raise ProtocolError(_DEVICE, f"did not keep its configuration: {changed}")
        return self._identity

    async def read(self) -> float:
        """Return a fresh conversion [V]."""
        if self.in_doubt:
            await self._resynchronise()
        # As `doubting` does, at a tenth of its cost: a simulated day has 70,000 readings.
        self.in_doubt = True
        reply = await self.ask(":READ?")
        match = _READING.fullmatch(reply)
        if match is None:
            raise ProtocolError(_DEVICE, f"answered {reply!r} where a reading was expected")
        self._readings += 1
        if self._readings % _READINGS_BETWEEN_LOOKS == 0:
            await self._look()
        self.in_doubt = False
        voltage_v, range_v = float(match[1]), self._settings.range_v
        if not abs(voltage_v) <= _BEYOND_RANGE * range_v:
            raise OverRangeError(_DEVICE, f"the voltage is beyond the {range_v:g} V range")
        return voltage_v

    async def _changed(self) -> str:
        """Return the first setting that is not as it was set, or an empty text."""
        for query in self._settings.expected:
            if why := await self._differs(query):
                return why
        return ""

    async def _differs(self, query: str) -> str:
        expected = self._settings.expected[query]
        answer = (await self.ask(query)).strip("\"'")
        if isinstance(expected, str):
            same = answer == expected
        else:
            same = False
            with contextlib.suppress(ValueError):
                same = abs(float(answer) - expected) <= 1e-6 * expected
        return "" if same else f"{query} is answered by {answer[:80]}, not {expected}"

    async def _look(self) -> None:
        """Read one setting back, another one each time: a filter of the front panel mixes the faces unnoticed."""
        queries = tuple(self._settings.expected)
        if why := await self._differs(queries[self._readings // _READINGS_BETWEEN_LOOKS % len(queries)]):
            raise LinkLostError(_DEVICE, why)

    async def _resynchronise(self) -> None:
        try:
            await self.quieten()
            await self.synchronise()
            restarted = bool(await self.events() & POWER_ON) or await self.ask("*IDN?") != self._identity
            why = "it has restarted and lost its configuration" if restarted else await self._changed()
        except (DeadlineError, ProtocolError) as error:
            raise LinkLostError(_DEVICE, f"has gone silent: {error.message}") from error
        if why:
            raise LinkLostError(_DEVICE, why)
        await self.write("*CLS")
