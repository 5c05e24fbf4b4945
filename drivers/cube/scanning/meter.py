"""A scanning meter as a cube: identified with its card, configured, and asked for one scan after the other."""

import asyncio
import math
import re
from typing import TYPE_CHECKING

from drivers.cube.scanning.dialects import ScanDialect, channel_list, slot_of
from drivers.errors import (
    ConnectError,
    DeadlineError,
    IdentityError,
    LinkLostError,
    ProtocolError,
)
from drivers.interfaces import CubeReading, FaceFlaw, FaceSample
from drivers.scpi import POWER_ON, ScpiLine, ScpiSession, opening
from drivers.settings import CubeSurroundings

if TYPE_CHECKING:
    from collections.abc import Sequence

DEVICE = "scanning meter"
_READING = re.compile(r"\s*([+-]?\d+(?:\.\d+)?(?:E[+-]?\d+)?)\s*(?:VDC)?\s*", re.ASCII | re.IGNORECASE)
_CHANNEL = re.compile(r"\s*\+?0*(\d{1,3})\s*", re.ASCII)
_NUMBER = re.compile(r"\d{1,3}", re.ASCII)
_BLOCK = re.compile(r"#(\d)")
# These meters measure to 120 % of their range.
_BEYOND_RANGE = 1.21
_FACES = 4


class ScanningMeterCube:
    """Four faces at the channels of a meter, in volts.

    Parameters
    ----------
    line
        Opened at each `open`.
    dialect
        The make.
    channels
        Of east, south, west and zenith.
    range_v, nplc
        The fixed range [V] and the integration time [mains periods] of each channel.
    surroundings
        Time, and how long one reading may take; a scan may take four times that.
    """

    def __init__(
        self,
        line: ScpiLine,
        dialect: ScanDialect,
        channels: tuple[int, int, int, int],
        *,
        range_v: float,
        nplc: float,
        surroundings: CubeSurroundings,
    ) -> None:
        self._line = line
        self._dialect = dialect
        self._channels = channels
        self._range_v = range_v
        self._nplc = nplc
        self._around = surroundings
        self._turn = asyncio.Lock()
        self._session: _ScanSession | None = None

    async def open(self) -> str:
        """Connect, identify meter and card, configure, and read the configuration back."""
        await self.close()
        session = _ScanSession(
            self._line, self._dialect, self._channels, self._range_v, self._nplc, _FACES * self._around.deadline_s
        )
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

    async def read(self) -> CubeReading:
        """Trigger one scan and return it; the faces are stamped as evenly as they were measured between both ends."""
        async with self._turn:
            session = self._session
            if session is None:
                raise LinkLostError(DEVICE, "has to be opened first")
            begin_utc_s, begin_s = self._around.utc_s(), self._around.monotonic_s()
            flaw: FaceFlaw = "missing"
            pairs: Sequence[tuple[int, str]] = ()
            end_s: float | None = None
            try:
                pairs = await session.scan()
                end_s = self._around.monotonic_s()
                await session.look()
            except (LinkLostError, ConnectError):
                await self.close()
                raise
            except DeadlineError:
                flaw = "late"
            except ProtocolError:
                flaw = "missing"
            took_s = (self._around.monotonic_s() if end_s is None else end_s) - begin_s
        order = [channel for channel, _ in pairs] or list(self._channels)
        texts = dict(pairs)
        samples = []
        for channel in self._channels:
            middle_s = took_s * (order.index(channel) + 0.5) / _FACES
            value, own_flaw = _voltage(texts[channel], self._range_v) if texts else (math.nan, flaw)
            samples.append(FaceSample(value, begin_utc_s + middle_s, begin_s + middle_s, own_flaw))
        east, south, west, zenith = samples
        return CubeReading(east=east, south=south, west=west, zenith=zenith, unit="V")


class _ScanSession(ScpiSession):
    """One connection to the meter."""

    def __init__(
        self,
        line: ScpiLine,
        dialect: ScanDialect,
        channels: tuple[int, int, int, int],
        range_v: float,
        nplc: float,
        deadline_s: float,
    ) -> None:
        super().__init__(line, DEVICE, deadline_s)
        self._dialect = dialect
        self._channels = channels
        self._commands = dialect.commands(channel_list(channels), range_v, nplc)
        self._proofs = dialect.proofs(channel_list(channels), range_v, nplc)
        self._identity: str
        self._looks = 0

    async def start(self) -> str:
        """Identify, configure, and return the meter's identity."""
        with opening(DEVICE, "this interface and speed"):
            await self.quieten()
            self._identity = await self.ask("*IDN?")
            if not self._dialect.identity.search(self._identity):
                raise IdentityError(DEVICE, f"answers {self._identity[:80]!r}, which is no {self._dialect.name}")
            await self.synchronise()
            cards = await self._cards()
            for command in self._commands:
                await self._configure(command)
            changed = await self._changed()
        if changed:
            raise ProtocolError(DEVICE, f"did not keep its configuration: {changed}")
        return "; ".join((self._identity, *cards))

    async def scan(self) -> list[tuple[int, str]]:
        """Return channel and reading, as text, in the order of the scan."""
        if self.in_doubt:
            await self._resynchronise()
        with self.doubting():
            reply = await self.ask(self._dialect.scan)
            parts = reply.split(",")
            found = [_CHANNEL.fullmatch(part) for part in parts[1::2]]
            channels = [int(match[1]) for match in found if match]
            if len(parts) != 2 * _FACES or sorted(channels) != sorted(self._channels):
                raise ProtocolError(DEVICE, f"answered {reply[:80]!r} where four readings and channels were expected")
        return list(zip(channels, parts[::2], strict=True))

    async def look(self) -> None:
        """Read one setting back, another one each time: a filter of the front panel mixes the faces unnoticed."""
        self._looks += 1
        with self.doubting():
            why = await self._differs(*self._proofs[self._looks % len(self._proofs)])
        if why:
            raise LinkLostError(DEVICE, why)

    async def _cards(self) -> list[str]:
        if self._dialect.card is None:
            return []
        question, right = self._dialect.card
        answers = []
        for channel in {slot_of(channel): channel for channel in self._channels}.values():
            answer = (await self.ask(question(channel))).strip("\"'")
            if not right.fullmatch(answer):
                said = f"answers {answer[:80]!r} for" if answer else "has no card in"
                raise IdentityError(
                    DEVICE,
                    f"{said} slot {slot_of(channel)}, where instruments.cube.channels has channel {channel}: a"
                    " multiplexer card that switches DC voltages is needed there",
                )
            answers.append(f"slot {slot_of(channel)} {answer}")
        return answers

    async def _configure(self, command: str) -> None:
        try:
            await self.command(command)
        except ProtocolError as error:
            if ":ROUT:SCAN" in command:
                raise IdentityError(
                    DEVICE, f"{error.message}; is there a scanner card in it, and has it these channels?"
                ) from error
            raise

    async def _changed(self) -> str:
        """Return the first setting that is not as it was set, or an empty text."""
        for query, expected in self._proofs:
            if why := await self._differs(query, expected):
                return why
        return ""

    async def _differs(self, query: str, expected: str | float) -> str:
        answer = await self.ask(query)
        return "" if _same(answer, expected) else f"{query} is answered by {answer[:80]}, not {expected}"

    async def _resynchronise(self) -> None:
        try:
            await self.quieten()
            await self.synchronise()
            restarted = bool(await self.events() & POWER_ON) or await self.ask("*IDN?") != self._identity
            why = "it has restarted and lost its configuration" if restarted else await self._changed()
        except (DeadlineError, ProtocolError) as error:
            raise LinkLostError(DEVICE, f"has gone silent: {error.message}") from error
        if why:
            raise LinkLostError(DEVICE, why)
        await self.write("*CLS")


def _same(answer: str, expected: str | float) -> bool:
    text = _unblocked(answer.strip()).strip("\"'")
    if isinstance(expected, str):
        if expected.startswith("(@"):
            return _listed(text) == _listed(expected)
        return text.lstrip("+") == expected
    try:
        numbers = [float(part) for part in text.split(",")]
    except ValueError:
        return False
    return all(abs(number - expected) <= 1e-6 * expected for number in numbers)


def _unblocked(text: str) -> str:
    """Return what stands in a block of definite length, ``#214(@101,102,103)``, or the text as it is."""
    head = _BLOCK.match(text)
    return text if head is None else text[2 + int(head[1]) :]


def _listed(text: str) -> list[int] | None:
    """Return the channels of ``(@1:3,5)``, sorted; None for what is no list."""
    if not (text.startswith("(@") and text.endswith(")")):
        return None
    channels: list[int] = []
    for part in text[2:-1].split(","):
        first, _, last = part.strip().partition(":")
        if not (_NUMBER.fullmatch(first) and _NUMBER.fullmatch(last or first)):
            return None
        channels += range(int(first), int(last or first) + 1)
    return sorted(channels)


def _voltage(text: str, range_v: float) -> tuple[float, FaceFlaw | None]:
    match = _READING.fullmatch(text)
    if match is None:
        return math.nan, "missing"
    value_v = float(match[1])
    if not abs(value_v) <= _BEYOND_RANGE * range_v:
        return math.nan, "over-range"
    return value_v, None
