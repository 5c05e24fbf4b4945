"""The cube's simulated instruments in this process: multiplexer and voltmeter."""

import asyncio
import re
from collections import deque
from collections.abc import Callable

from drivers.errors import (
    ConnectError,
    DeadlineError,
    IdentityError,
    LinkLostError,
    OverRangeError,
    ProtocolError,
    RefusedError,
)
from sim_drivers.multiplexer import ENABLE_LINE, DaqWriteError, MultiplexerCore
from sim_drivers.transports.link import Cabled
from sim_drivers.voltmeter.core import VoltmeterCore

_INPUTS = 8
_READING = re.compile(rb"([+-]?\d+(?:\.\d+)?(?:E[+-]?\d+)?)(?:VDC)?\s*")
_OVERFLOW = 9.9e37
_POWER_ON = 128


class InMemoryMultiplexer(Cabled):
    """The multiplexer over its simulated port.

    Parameters
    ----------
    core
        The simulated switch.
    now
        The event loop's time [s].
    enable_high
        The level of the enable line that this side believes to be on.
    """

    def __init__(self, core: MultiplexerCore, now: Callable[[], float], *, enable_high: bool = True) -> None:
        super().__init__("multiplexer")
        self._core = core
        self._now = now
        self._enable = enable_high << ENABLE_LINE

    async def open(self) -> str:
        """Connect; the selection is left alone."""
        self._connect()
        return f"simulated digital port with a multiplexer of {_INPUTS} inputs"

    async def close(self) -> None:
        """Release the port."""
        self._disconnect()

    async def select(self, channel: int) -> None:
        """Write the address in one value and wait until it is on the lines."""
        if not 0 <= channel < _INPUTS:
            raise RefusedError("multiplexer", f"has the inputs 0 to {_INPUTS - 1}, not {channel}")
        self._require_open()
        try:
            self._core.write(channel | self._enable, self._now())
        except DaqWriteError as error:
            self._disconnect()
            raise LinkLostError("multiplexer", f"the port did not take the address: {error}") from error
        if self._core.latency_s:
            await asyncio.sleep(self._core.latency_s)
            self._require_open()

    def _pulled(self) -> None:
        # Without USB the lines go high, which selects the last input.
        self._core.power_cycle(self._now())


class InMemoryVoltmeter(Cabled):
    """The voltmeter over its simulated line.

    Parameters
    ----------
    core
        The simulated instrument.
    now
        The event loop's time [s].
    range_v, nplc
        The fixed range and the integration time [power line cycles] to measure with.
    deadline_s
        How long one exchange may take.
    """

    def __init__(
        self,
        core: VoltmeterCore,
        now: Callable[[], float],
        *,
        range_v: float = 1.0,
        nplc: float = 1.0,
        deadline_s: float = 2.0,
    ) -> None:
        super().__init__("voltmeter")
        self._core = core
        self._now = now
        self._range_v = range_v
        self._nplc = nplc
        self._deadline_s = deadline_s
        self._turn = asyncio.Lock()
        self._arriving: deque[tuple[float, bytes]] = deque()
        self._in_doubt = False
        self._identity = ""

    async def open(self) -> str:
        """Connect, identify, configure and read the configuration back."""
        async with self._turn:
            self._connect()
            try:
                await self._identify()
                await self._configure()
            except DeadlineError as error:
                self._disconnect()
                raise ConnectError("voltmeter", "does not answer") from error
            except (IdentityError, ProtocolError):
                self._disconnect()
                raise
            return self._identity

    async def close(self) -> None:
        """Release the line; the instrument keeps its settings."""
        self._disconnect()

    async def read_voltage(self) -> float:
        """Return a fresh conversion [V]."""
        async with self._turn:
            self._require_open()
            if self._in_doubt:
                await self._resynchronise()
            reply = await self._ask(b":READ?\n")
            match = _READING.fullmatch(reply)
            if match is None:
                self._in_doubt = True
                raise ProtocolError("voltmeter", f"answered {reply!r} where a reading was expected")
            voltage_v = float(match[1])
            if abs(voltage_v) >= _OVERFLOW:
                raise OverRangeError("voltmeter", f"the voltage is beyond the {self._range_v:g} V range")
            return voltage_v

    async def _ask(self, query: bytes) -> bytes:
        # Until its answer is in, every way out of here (deadline, cancellation, a pulled cable) leaves a doubt.
        self._in_doubt = True
        now = self._now()
        aborts = self._core.aborts
        self._arriving.extend(self._core.feed(query, now))
        due_s = self._arriving[0][0] if self._arriving else now + self._deadline_s
        if not self._arriving or due_s - now > self._deadline_s:
            await self._miss(query, now)
        if due_s > now:
            await asyncio.sleep(due_s - now)
            self._require_open()
            if self._core.aborts != aborts:
                self._arriving.clear()
                await self._miss(query, now)
        self._in_doubt = False
        return self._arriving.popleft()[1]

    async def _miss(self, query: bytes, asked_s: float) -> None:
        await asyncio.sleep(max(asked_s + self._deadline_s - self._now(), 0.0))
        self._require_open()
        text = query.decode("ascii").strip()
        raise DeadlineError("voltmeter", f"did not answer {text} within {self._deadline_s:g} s")

    async def _ask_text(self, query: str) -> str:
        return (await self._ask(query.encode("ascii") + b"\n")).decode("latin-1").strip()

    def _tell(self, line: str) -> None:
        self._arriving.extend(self._core.feed(line.encode("ascii") + b"\n", self._now()))

    def _quieten(self) -> None:
        """Make the meter drop what it still had to say, and forget what of it is under way."""
        self._core.feed(b"\x03", self._now())
        self._arriving.clear()

    async def _identify(self) -> None:
        self._quieten()
        self._identity = await self._ask_text("*IDN?")
        fields = self._identity.split(",")
        if len(fields) < 2 or fields[1].strip() != "MODEL 2000":
            raise IdentityError("voltmeter", f"answers {self._identity!r}, which is not a Keithley MODEL 2000")

    async def _configure(self) -> None:
        self._tell("*RST;*CLS")
        self._tell(":INIT:CONT OFF;:ABOR")
        self._tell(":SENS:FUNC 'VOLT:DC'")
        self._tell(f":SENS:VOLT:DC:RANG {self._range_v:g};NPLC {self._nplc:g};AVER:STAT OFF")
        self._tell(":SYST:AZER:STAT ON;:SYST:BEEP:STAT OFF")
        self._tell(":FORM:DATA ASC;:FORM:ELEM READ")
        error = await self._ask_text(":SYST:ERR?")
        if not error.startswith("0,"):
            raise ProtocolError("voltmeter", f"did not take its configuration: {error}")
        expected = {
            ":INIT:CONT?": "0",
            ":SENS:FUNC?": '"VOLT:DC"',
            ":SENS:VOLT:DC:RANG?": f"{self._range_v:g}",
            ":SENS:VOLT:DC:NPLC?": f"{self._nplc:g}",
            ":SENS:VOLT:DC:AVER:STAT?": "0",
            ":FORM:ELEM?": "READ",
        }
        for query, value in expected.items():
            answer = await self._ask_text(query)
            if answer != value:
                raise ProtocolError("voltmeter", f"answers {answer} to {query} after it was set to {value}")

    async def _resynchronise(self) -> None:
        """Prove after a doubtful exchange that the next answer belongs to the next question."""
        self._quieten()
        try:
            events = await self._ask_text("*ESR?")
            restarted = not events.isdecimal() or bool(int(events) & _POWER_ON)
            same = await self._ask_text("*IDN?") == self._identity
        except DeadlineError as error:
            self._disconnect()
            raise LinkLostError("voltmeter", "has gone silent") from error
        if restarted or not same:
            self._disconnect()
            raise LinkLostError("voltmeter", "has restarted and lost its configuration")
        self._tell("*CLS")
