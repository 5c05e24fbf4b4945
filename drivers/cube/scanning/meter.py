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
from drivers.scpi import ScpiLine
from drivers.scpi_meter import MeterSession, ScpiMeter
from drivers.settings import CubeSurroundings

if TYPE_CHECKING:
    from collections.abc import Sequence

DEVICE = "scanning meter"
_READING = re.compile(r"\s*([+-]?\d+(?:\.\d+)?(?:E[+-]?\d+)?)\s*(?:VDC)?\s*", re.ASCII | re.IGNORECASE)
_CHANNEL = re.compile(r"\s*\+?0*(\d{1,3})\s*", re.ASCII)
# These meters measure to 120 % of their range.
_OVER_RANGE_FACTOR = 1.21
_FACES = 4


class ScanningMeterCube(ScpiMeter["_ScanSession"]):
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
        deadline_s = _FACES * surroundings.deadline_s
        super().__init__(line, lambda: _ScanSession(line, dialect, channels, range_v, nplc, deadline_s))
        self._channels = channels
        self._range_v = range_v
        self._around = surroundings
        self._scan_lock = asyncio.Lock()

    async def read(self) -> CubeReading:
        """Trigger one scan and return it; the faces' times are spread evenly between its begin and its end."""
        async with self._scan_lock:
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
                with session.doubtful_exchange():
                    await session.check_next_setting()
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


class _ScanSession(MeterSession):
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
        super().__init__(line, DEVICE, dialect.proofs(channel_list(channels), range_v, nplc), deadline_s)
        self._dialect = dialect
        self._channels = channels
        self._commands = dialect.commands(channel_list(channels), range_v, nplc)
        self._cards: list[str] = []

    def require_identity(self, identity: str) -> None:
        """Raise `IdentityError` unless it is of the dialect's make."""
        if not self._dialect.identity.search(identity):
            raise IdentityError(DEVICE, f"answers {identity[:80]!r}, which is no {self._dialect.name}")

    async def configure(self) -> None:
        """Check that its cards switch voltages, and set it to scan the faces."""
        self._cards = await self._identified_cards()
        for command in self._commands:
            await self._configure(command)

    async def start(self) -> str:
        """Open as any meter, and return the identities of meter and cards."""
        return "; ".join((await super().start(), *self._cards))

    async def scan(self) -> list[tuple[int, str]]:
        """Return channel and reading, as text, in the order of the scan."""
        await self.ensure_synchronised()
        with self.doubtful_exchange():
            reply = await self.ask(self._dialect.scan)
            parts = reply.split(",")
            found = [_CHANNEL.fullmatch(part) for part in parts[1::2]]
            channels = [int(match[1]) for match in found if match]
            if len(parts) != 2 * _FACES or sorted(channels) != sorted(self._channels):
                raise ProtocolError(DEVICE, f"answered {reply[:80]!r} where four readings and channels were expected")
        return list(zip(channels, parts[::2], strict=True))

    async def _identified_cards(self) -> list[str]:
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
                    DEVICE, f"{error.message}; does it have a scanner card with these channels?"
                ) from error
            raise


def _voltage(text: str, range_v: float) -> tuple[float, FaceFlaw | None]:
    match = _READING.fullmatch(text)
    if match is None:
        return math.nan, "missing"
    value_v = float(match[1])
    if not abs(value_v) <= _OVER_RANGE_FACTOR * range_v:
        return math.nan, "over-range"
    return value_v, None
