"""One connection to an electronic load of any make: identified, configured, held at a voltage, measured."""

import contextlib
import re
from collections.abc import Mapping
from dataclasses import dataclass
from typing import NamedTuple

from drivers.errors import ConnectError, DeviceError, IdentityError, ProtocolError
from drivers.scpi import ERROR_BITS, ScpiLine, ScpiSession, silence_as_connect_error

DEVICE = "load"
OVERFLOW = 9.9e37
_MOST_BITS = 2.0**32
_NUMBER = re.compile(r"[+-]?\d+(?:\.\d*)?(?:E[+-]?\d+)?", re.ASCII | re.IGNORECASE)
_OFF = ("0", "OFF")


@dataclass(frozen=True, slots=True)
class Dialect:
    """How one make of load is spoken to.

    Attributes
    ----------
    maker, models
        The first two fields of its answer to ``*IDN?``, in upper case; a model may go on after what stands here.
    select
        Chooses the channel, before anything that belongs to one; empty where there is only one.
    select_proof
        The question that proves the choice, and its answer.
    identify_channel
        Asks for the module's identity; empty where there is only one.
    on, off, on_query
        Switch the input; ask whether it is on.
    mode, mode_proof
        Set constant voltage; the question that proves it, and its answer in upper case.
    settings
        Made once per sweep, with the input off.
    level
        Sets the voltage; a format of one number.
    measure
        Asks for voltage, current and protection in one line.
    measure_one_by_one
        The same as three questions.
    protection
        Asks for the latched protections alone.
    clear_protection
        Ends them.
    protections
        Names of the bits that end a sweep, by value.
    """

    maker: str
    models: tuple[str, ...]
    select: str
    select_proof: tuple[str, str] | None
    identify_channel: str
    on: str
    off: str
    on_query: str
    mode: str
    mode_proof: tuple[str, str]
    settings: tuple[str, ...]
    level: str
    measure: str
    measure_one_by_one: tuple[str, str, str]
    protection: str
    clear_protection: str
    protections: Mapping[int, str]

    @property
    def name(self) -> str:
        """Maker and first model, for messages."""
        return f"{self.maker} {self.models[0]}".strip()

    def matches_identity(self, identity: str) -> bool:
        """Tell whether an answer to ``*IDN?`` is that of such a load."""
        fields = [field.strip().upper() for field in identity.split(",")]
        return len(fields) > 1 and fields[0].startswith(self.maker) and fields[1].startswith(self.models)


class LoadMeasurement(NamedTuple):
    """Voltage and current, None where one of them is beyond the range, and the names of tripped protections."""

    point: tuple[float, float] | None
    tripped: str


class LoadSession(ScpiSession):
    """One connection to the load.

    A session that is in doubt must not be used again, except to close it.

    Parameters
    ----------
    line
        Already open; closed by `close`.
    dialect
        The make of the load.
    deadline_s
        How long one answer may take.
    """

    def __init__(self, line: ScpiLine, dialect: Dialect, deadline_s: float) -> None:
        super().__init__(line, DEVICE, deadline_s)
        self._dialect = dialect
        self._is_identified = False
        self._answers_in_one_line = True

    async def start(self) -> str:
        """Identify the load, switch its input off, configure it; return its identity."""
        with silence_as_connect_error(DEVICE, "this interface"), self.doubtful_exchange():
            await self.discard_pending_output()
            identity = await self.ask("*IDN?")
            if not self._dialect.matches_identity(identity):
                raise IdentityError(DEVICE, f"answers {identity[:80]!r}, which is not a {self._dialect.name}")
            self._is_identified = True
            await self.synchronise()
            return identity + await self._configure()

    async def prepare(self) -> tuple[float, str]:
        """Put the load where a sweep begins; return the open-circuit voltage and the protections still latched."""
        with self.doubtful_exchange():
            dialect = self._dialect
            await self._select()
            await self.write(dialect.off)
            if await self._protection():
                await self.write(dialect.clear_protection)
            for command in (dialect.mode, *dialect.settings):
                await self.write(command)
            query, expected = dialect.mode_proof
            mode = (await self.ask(query)).strip('"').upper()
            if mode != expected:
                raise ProtocolError(DEVICE, f"answers {mode[:80]!r} to {query}, not {expected}")
            await self._prove_no_errors("its settings for a sweep")
            measured = await self._measure()
            open_circuit_v = float("nan") if measured.point is None else measured.point[0]
            return open_circuit_v, measured.tripped

    async def hold(self, voltage_v: float, *, switch_on: bool) -> None:
        """Hold the module at a voltage, and return when the load says that it has taken it."""
        with self.doubtful_exchange():
            await self.write(self._dialect.level.format(voltage_v))
            if switch_on:
                await self.write(self._dialect.on)
            # What was sent may lie in a buffer for longer than a voltage takes to settle.
            answer = await self.ask("*OPC?")
            if self.parse_integer("*OPC?", answer) != 1:
                raise ProtocolError(DEVICE, f"answers {answer[:80]!r} to *OPC?, not 1")

    async def measure(self) -> LoadMeasurement:
        """Return voltage [V] and current [A], one straight after the other."""
        with self.doubtful_exchange():
            return await self._measure()

    async def switch_off(self) -> None:
        """Switch the input off and ask whether it is."""
        with self.doubtful_exchange():
            await self.write(self._dialect.off)
            state = (await self.ask(self._dialect.on_query)).upper()
            if state not in _OFF:
                raise ProtocolError(
                    DEVICE, f"answers {state[:80]!r} to {self._dialect.on_query} after {self._dialect.off}"
                )

    async def close(self) -> None:
        """Switch the input off, whatever the load answers, unless it was never identified; release the line."""
        if self._is_identified:
            with contextlib.suppress(DeviceError):
                if self.in_doubt:
                    await self._line.interrupt()
                await self.write(self._dialect.off)
                # A line that is closed too soon may not have sent it yet.
                await self.ask(self._dialect.on_query)
        await self._line.close()

    async def _configure(self) -> str:
        """Return what the channel adds to the identity."""
        await self.write("*CLS")
        await self._select()
        module = ""
        if self._dialect.identify_channel:
            module = f" with {await self.ask(self._dialect.identify_channel)}"
        await self.switch_off()
        await self.write(self._dialect.clear_protection)
        await self._prove_no_errors("its first commands")
        numbers = self._numbers(await self.ask(self._dialect.measure))
        self._answers_in_one_line = len(numbers) == len(self._dialect.measure_one_by_one)
        if not self._answers_in_one_line:
            await self.write("*CLS")
        return module

    async def _select(self) -> None:
        proof = self._dialect.select_proof
        if proof is None:
            return
        await self.write(self._dialect.select)
        answer = await self.ask(proof[0])
        if answer != proof[1]:
            raise ConnectError(
                DEVICE, f"has no channel {proof[1]}: after {self._dialect.select} it is at {answer[:80]}"
            )

    async def _prove_no_errors(self, what: str) -> None:
        events = await self.events()
        if events & ERROR_BITS:
            raise ProtocolError(DEVICE, f"did not take {what}: *ESR? is {events}")

    async def _protection(self) -> str:
        query = self._dialect.protection
        return self._tripped(self.parse_integer(query, await self.ask(query)))

    async def _measure(self) -> LoadMeasurement:
        if self._answers_in_one_line:
            numbers = self._numbers(await self.ask(self._dialect.measure))
        else:
            numbers = [
                number for query in self._dialect.measure_one_by_one for number in self._numbers(await self.ask(query))
            ]
        if len(numbers) != len(self._dialect.measure_one_by_one):
            raise ProtocolError(DEVICE, "did not answer with voltage, current and protections when asked for them")
        voltage_v, current_a, bits = numbers
        if not 0.0 <= bits < _MOST_BITS:
            raise ProtocolError(DEVICE, f"answered {bits:g} where its protections were asked for")
        beyond = not (abs(voltage_v) < OVERFLOW and abs(current_a) < OVERFLOW)
        return LoadMeasurement(None if beyond else (voltage_v, current_a), self._tripped(int(bits)))

    def _numbers(self, reply: str) -> list[float]:
        """Return the numbers of a reply; none at all where one of its parts is not a number."""
        parts = [part.strip() for part in reply.split(";")]
        return [float(part) for part in parts] if all(_NUMBER.fullmatch(part) for part in parts) else []

    def _tripped(self, bits: int) -> str:
        return ", ".join(name for bit, name in self._dialect.protections.items() if bits & bit)
