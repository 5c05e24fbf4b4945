"""The Keithley 2000 voltmeter: identified, configured, read, and put right again after a doubtful exchange.

A query that the meter does not understand is answered by silence, and a reply that comes too late would be taken for
the answer to the next question. So whatever does not answer as it should leaves a doubt, and nothing is measured before
the meter has given back a number that was never sent before. The commands are those that public drivers of this model
use; the front panel stays usable, so the settings are read back after every doubt.
"""

import contextlib
import re
from collections.abc import Callable
from typing import Protocol

from drivers.errors import (
    ConnectError,
    DeadlineError,
    IdentityError,
    LinkLostError,
    OverRangeError,
    ProtocolError,
)
from drivers.lines.threads import DeviceThread

_DEVICE = "voltmeter"
_READING = re.compile(r"([+-]?\d+(?:\.\d+)?(?:E[+-]?\d+)?)(?:VDC)?", re.ASCII)
_OVERFLOW = 9.9e37
# The meter measures to 120 % of its range.
_BEYOND_RANGE = 1.21
_POWER_ON = 128
_QUIET_S = 0.1
_MOST_STALE_LINES = 20
_CLOSE_S = 1.0


class VoltmeterLine(Protocol):
    """The meter's line; blocking, for use in one thread. Raises `drivers.errors.DeviceError` and nothing else."""

    def send(self, text: str) -> None:
        """Send one line; its end is added."""

    def receive(self, within_s: float) -> str:
        """Return the next line without its end; `DeadlineError` if none is complete in time."""

    def interrupt(self) -> None:
        """Make the meter drop what it is doing and what it has to say."""

    def drain(self, quiet_s: float) -> None:
        """Throw away what comes until nothing has come for a time [s]."""

    def close(self) -> None:
        """Release the line; never raises."""


class Keithley2000:
    """DC voltage, one conversion at a time.

    Parameters
    ----------
    connect
        Opens the line; called in the instrument's thread at each `open`.
    range_v, nplc
        The fixed range [V] and the integration time [power line cycles].
    deadline_s
        How long one answer may take.
    """

    def __init__(
        self, connect: Callable[[], VoltmeterLine], *, range_v: float = 1.0, nplc: float = 1.0, deadline_s: float = 2.0
    ) -> None:
        self._connect = connect
        self._settings = _Settings(range_v, nplc)
        self._deadline_s = deadline_s
        self._thread = DeviceThread(_DEVICE)
        self._session: _Session | None = None

    async def open(self) -> str:
        """Connect, identify, configure and read the configuration back."""
        await self.close()

        def start() -> _Session:
            return _Session(self._connect(), self._settings, self._deadline_s)

        answers = 2 * len(self._settings.commands) + len(self._settings.expected)
        try:
            self._session = await self._thread.call(start, answers * self._deadline_s + 5.0, _Session.close)
        except BaseException:
            await self.close()
            raise
        return self._session.identity

    async def close(self) -> None:
        """Release the line; the meter keeps its settings."""
        session, self._session = self._session, None
        await self._thread.finish(None if session is None else session.close, _CLOSE_S)

    async def read_voltage(self) -> float:
        """Return a fresh conversion [V]."""
        session = self._session
        if session is None:
            raise LinkLostError(_DEVICE, "has to be opened first")
        try:
            return await self._thread.call(session.read, (_MOST_STALE_LINES + 5) * self._deadline_s + 5.0)
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
            ":FORM:DATA ASC;:FORM:ELEM READ",
        )
        self.expected: dict[str, str | float] = {
            ":INIT:CONT?": "0",
            ":SENS:FUNC?": "VOLT:DC",
            ":SENS:VOLT:DC:RANG?": range_v,
            ":SENS:VOLT:DC:NPLC?": nplc,
            ":SENS:VOLT:DC:AVER:STAT?": "0",
            ":FORM:ELEM?": "READ",
        }


class _Session:
    """One connection to the meter; blocking, for use in one thread."""

    def __init__(self, line: VoltmeterLine, settings: _Settings, deadline_s: float) -> None:
        self._line = line
        self._settings = settings
        self._deadline_s = deadline_s
        self._in_doubt = False
        self._number = 0
        try:
            self.identity = self._identify()
            self._synchronise()
            self._configure()
        except DeadlineError as error:
            self.close()
            raise ConnectError(_DEVICE, f"{error.message}; is it on, and set to this interface and speed?") from error
        except BaseException:
            self.close()
            raise

    def read(self) -> float:
        """Return a fresh conversion [V]."""
        if self._in_doubt:
            self._resynchronise()
        # Until a reading is in, every way out of here leaves a doubt.
        self._in_doubt = True
        reply = self._ask(":READ?")
        match = _READING.fullmatch(reply)
        if match is None:
            raise ProtocolError(_DEVICE, f"answered {reply!r} where a reading was expected")
        self._in_doubt = False
        voltage_v, largest_v = float(match[1]), _BEYOND_RANGE * self._settings.range_v
        if abs(voltage_v) >= _OVERFLOW or not abs(voltage_v) <= largest_v:
            raise OverRangeError(_DEVICE, f"the voltage is beyond the {self._settings.range_v:g} V range")
        return voltage_v

    def close(self) -> None:
        """Release the line."""
        self._line.close()

    def _ask(self, query: str) -> str:
        self._line.send(query)
        try:
            return self._line.receive(self._deadline_s).strip()
        except DeadlineError:
            raise DeadlineError(_DEVICE, f"did not answer {query} within {self._deadline_s:g} s") from None

    def _quieten(self) -> None:
        self._line.interrupt()
        self._line.drain(_QUIET_S)

    def _identify(self) -> str:
        self._quieten()
        identity = self._ask("*IDN?")
        require_model(identity)
        return identity

    def _synchronise(self) -> None:
        """Prove that the next answer belongs to the next question, whatever was still under way."""
        self._number = self._number % 127 + 1
        self._line.send(f"*ESE {self._number}")
        answer = self._ask("*ESE?")
        for _ in range(_MOST_STALE_LINES):
            if answer.isdecimal() and int(answer) == self._number:
                return
            answer = self._line.receive(self._deadline_s).strip()
        raise ProtocolError(_DEVICE, f"keeps answering {answer[:80]!r} to *ESE?")

    def _configure(self) -> None:
        for command in self._settings.commands:
            self._line.send(command)
            error = self._ask(":SYST:ERR?")
            if not re.match(r"[+-]?0+,", error):
                raise ProtocolError(_DEVICE, f"did not take {command}: {error[:80]}")
        changed = self._changed()
        if changed:
            raise ProtocolError(_DEVICE, f"did not keep its configuration: {changed}")

    def _changed(self) -> str:
        """Return the first setting that is not as it was set, or an empty text."""
        for query, expected in self._settings.expected.items():
            answer = self._ask(query).strip("\"'")
            if isinstance(expected, str):
                same = answer == expected
            else:
                same = False
                with contextlib.suppress(ValueError):
                    same = abs(float(answer) - expected) <= 1e-6 * expected
            if not same:
                return f"{query} is answered by {answer[:80]}, not {expected}"
        return ""

    def _resynchronise(self) -> None:
        try:
            self._quieten()
            self._synchronise()
            events = self._ask("*ESR?")
            identity = self._ask("*IDN?")
            restarted = not events.isdecimal() or bool(int(events) & _POWER_ON) or identity != self.identity
            why = "it has restarted and lost its configuration" if restarted else self._changed()
        except (DeadlineError, ProtocolError) as error:
            raise LinkLostError(_DEVICE, f"has gone silent: {error.message}") from error
        if why:
            raise LinkLostError(_DEVICE, why)
        self._line.send("*CLS")
