"""One connection to an electronic load of any make: identified, configured, held at a voltage, measured."""

import contextlib
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import NamedTuple, Protocol

from drivers.errors import ConnectError, DeadlineError, DeviceError, IdentityError, ProtocolError

DEVICE = "load"
OVERFLOW = 9.9e37
_NUMBER = re.compile(r"[+-]?\d+(?:\.\d*)?(?:E[+-]?\d+)?", re.ASCII | re.IGNORECASE)
_ERRORS = 4 | 8 | 16 | 32
_QUIET_S = 0.1
_MOST_STALE_LINES = 20
_OFF = ("0", "OFF")


class Line(Protocol):
    """The load's line; blocking, for use in one thread. Raises `drivers.errors.DeviceError` and nothing else."""

    def send(self, text: str) -> None:
        """Send one line; its end is added."""

    def receive(self, within_s: float) -> str:
        """Return the next line without its end; `DeadlineError` if none is complete in time."""

    def interrupt(self) -> None:
        """Make the load drop what it has to say."""

    def drain(self, quiet_s: float) -> None:
        """Throw away what comes until nothing has come for a time [s]."""

    def close(self) -> None:
        """Release the line; never raises."""


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
        What is asked then, and what the answer begins with.
    identify_channel
        Asks for the module's identity; empty where there is only one.
    on, off, is_on
        Switch the input; ask whether it is on.
    mode, mode_proof
        Set constant voltage; what is asked then, and the answer, in upper case.
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
    is_on: str
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

    def knows(self, identity: str) -> bool:
        """Tell whether an answer to ``*IDN?`` is that of such a load."""
        fields = [field.strip().upper() for field in identity.split(",")]
        return len(fields) > 1 and fields[0].startswith(self.maker) and fields[1].startswith(self.models)


class Measured(NamedTuple):
    """Voltage and current, None where one of them is beyond the range, and the names of tripped protections."""

    point: tuple[float, float] | None
    tripped: str


class LoadSession:
    """One connection to the load; blocking, for use in one thread.

    A reply that does not come, or is none, leaves it open to which question the next one belongs: the session is in
    doubt then and must not be used again but to close it.

    Parameters
    ----------
    line
        Owned from here on.
    dialect
        The make of the load.
    deadline_s
        How long one answer may take.
    """

    def __init__(self, line: Line, dialect: Dialect, deadline_s: float) -> None:
        self._line = line
        self._dialect = dialect
        self._deadline_s = deadline_s
        self._number = 0
        self._known = False
        self._in_one_line = True
        self.in_doubt = True
        try:
            self.identity = self._identify()
            self._known = True
            self._synchronise()
            self._configure()
        except DeadlineError as error:
            self.close()
            raise ConnectError(DEVICE, f"{error.message}; is it on, and set to this interface?") from error
        except BaseException:
            self.close()
            raise
        self.in_doubt = False

    def prepare(self) -> tuple[float, str]:
        """Put the load where a sweep begins; return the open-circuit voltage and what keeps protections latched."""
        with self._doubting():
            dialect = self._dialect
            self._select()
            self._tell(dialect.off)
            if self._protection():
                self._tell(dialect.clear_protection)
            for command in (dialect.mode, *dialect.settings):
                self._tell(command)
            query, expected = dialect.mode_proof
            mode = self._ask(query).strip('"').upper()
            if mode != expected:
                raise ProtocolError(DEVICE, f"answers {mode[:80]!r} to {query}, not {expected}")
            self._prove_no_errors("its settings for a sweep")
            measured = self._measure()
            open_circuit_v = float("nan") if measured.point is None else measured.point[0]
            return open_circuit_v, measured.tripped

    def hold(self, voltage_v: float, *, switch_on: bool) -> None:
        """Hold the module at a voltage; nothing is answered."""
        with self._doubting():
            self._tell(self._dialect.level.format(voltage_v))
            if switch_on:
                self._tell(self._dialect.on)

    def measure(self) -> Measured:
        """Return voltage [V] and current [A], one straight after the other."""
        with self._doubting():
            return self._measure()

    def switch_off(self) -> None:
        """Switch the input off and ask whether it is."""
        with self._doubting():
            self._tell(self._dialect.off)
            state = self._ask(self._dialect.is_on).upper()
            if state not in _OFF:
                raise ProtocolError(
                    DEVICE, f"answers {state[:80]!r} to {self._dialect.is_on} after {self._dialect.off}"
                )

    def leave(self) -> None:
        """Switch the input off after a sweep; nothing is said in a session that is in doubt, which has to be closed."""
        if not self.in_doubt:
            self.switch_off()

    def close(self) -> None:
        """Switch the input of a load that is known to be one off, whatever it answers, and release the line."""
        if self._known:
            with contextlib.suppress(DeviceError):
                if self.in_doubt:
                    self._line.interrupt()
                self._tell(self._dialect.off)
                # A line that is closed too soon may not have sent it yet.
                self._ask(self._dialect.is_on)
        self._line.close()

    @contextlib.contextmanager
    def _doubting(self) -> Iterator[None]:
        # Until all answers are in, every way out leaves a doubt.
        self.in_doubt = True
        yield
        self.in_doubt = False

    def _tell(self, command: str) -> None:
        self._line.send(command)

    def _ask(self, query: str) -> str:
        self._line.send(query)
        try:
            return self._line.receive(self._deadline_s).strip()
        except DeadlineError:
            raise DeadlineError(DEVICE, f"did not answer {query} within {self._deadline_s:g} s") from None

    def _identify(self) -> str:
        self._line.interrupt()
        self._line.drain(_QUIET_S)
        identity = self._ask("*IDN?")
        if not self._dialect.knows(identity):
            raise IdentityError(DEVICE, f"answers {identity[:80]!r}, which is not a {self._dialect.name}")
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
        raise ProtocolError(DEVICE, f"keeps answering {answer[:80]!r} to *ESE?")

    def _configure(self) -> None:
        self._tell("*CLS")
        self._select()
        if self._dialect.identify_channel:
            self.identity += f" with {self._ask(self._dialect.identify_channel)}"
        self.switch_off()
        self._tell(self._dialect.clear_protection)
        self._prove_no_errors("its first commands")
        self._in_one_line = len(self._numbers(self._ask(self._dialect.measure))) == len(
            self._dialect.measure_one_by_one
        )
        if not self._in_one_line:
            self._tell("*CLS")

    def _select(self) -> None:
        proof = self._dialect.select_proof
        if proof is None:
            return
        self._tell(self._dialect.select)
        answer = self._ask(proof[0])
        if answer != proof[1]:
            raise ConnectError(
                DEVICE, f"has no channel {proof[1]}: after {self._dialect.select} it is at {answer[:80]}"
            )

    def _prove_no_errors(self, what: str) -> None:
        events = self._ask("*ESR?")
        if not events.isdecimal() or int(events) & _ERRORS:
            raise ProtocolError(DEVICE, f"did not take {what}: *ESR? is {events[:80]}")

    def _protection(self) -> str:
        answer = self._ask(self._dialect.protection)
        return self._tripped(self._whole(answer))

    def _measure(self) -> Measured:
        if self._in_one_line:
            numbers = self._numbers(self._ask(self._dialect.measure))
        else:
            numbers = [
                number for query in self._dialect.measure_one_by_one for number in self._numbers(self._ask(query))
            ]
        if len(numbers) != len(self._dialect.measure_one_by_one):
            raise ProtocolError(DEVICE, "answered no voltage, current and protection where they were asked for")
        voltage_v, current_a, bits = numbers
        beyond = not (abs(voltage_v) < OVERFLOW and abs(current_a) < OVERFLOW)
        return Measured(None if beyond else (voltage_v, current_a), self._tripped(int(bits)))

    def _numbers(self, reply: str) -> list[float]:
        """Return the numbers of a reply; none at all where one of its parts is not a number."""
        parts = [part.strip() for part in reply.split(";")]
        return [float(part) for part in parts] if all(_NUMBER.fullmatch(part) for part in parts) else []

    def _whole(self, answer: str) -> int:
        if not answer.isdecimal():
            raise ProtocolError(DEVICE, f"answered {answer[:80]!r} where its protections were asked for")
        return int(answer)

    def _tripped(self, bits: int) -> str:
        return ", ".join(name for bit, name in self._dialect.protections.items() if bits & bit)
