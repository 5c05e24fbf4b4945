"""A meter that speaks SCPI: configured when it is opened, and put right again after a doubtful exchange.

Its front panel stays usable, so its settings are read back after every doubt, and one of them now and then without one.
"""

import re
from collections.abc import Callable, Sequence
from typing import Generic, TypeVar

from drivers.errors import DeadlineError, LinkLostError, ProtocolError
from drivers.scpi import POWER_ON_BIT, ScpiLine, ScpiSession, silence_as_connect_error

Proof = tuple[str, str | float]
"""A question, and the answer that proves a setting: a text, a list of channels or a number."""

_NUMBER = re.compile(r"\d{1,3}", re.ASCII)
_BLOCK = re.compile(r"#(\d)")


class MeterSession(ScpiSession):
    """One connection to a meter.

    Parameters
    ----------
    line, device, deadline_s
        As for `ScpiSession`.
    proofs
        What the meter answers as long as it is set as it should be.
    """

    def __init__(self, line: ScpiLine, device: str, proofs: Sequence[Proof], deadline_s: float) -> None:
        super().__init__(line, device, deadline_s)
        self._proofs = proofs
        self._identity = ""
        self._looks = 0

    def require_identity(self, identity: str) -> None:
        """Raise `IdentityError` unless an answer to ``*IDN?`` is that of such a meter."""
        raise NotImplementedError

    async def configure(self) -> None:
        """Set the meter to what the proofs say."""
        raise NotImplementedError

    async def start(self) -> str:
        """Identify, configure, read the configuration back, and return the meter's identity."""
        with silence_as_connect_error(self._device, "this interface and speed"):
            await self.discard_pending_output()
            self._identity = await self.ask("*IDN?")
            self.require_identity(self._identity)
            await self.synchronise()
            await self.configure()
            changed = await self._first_changed_setting()
        if changed:
            raise ProtocolError(self._device, f"did not keep its configuration: {changed}")
        return self._identity

    async def check_next_setting(self) -> None:
        """Read one setting back, another one each time: a filter set at the front panel mixes the faces unnoticed."""
        self._looks += 1
        if why := await self._differs(*self._proofs[self._looks % len(self._proofs)]):
            raise LinkLostError(self._device, why)

    async def ensure_synchronised(self) -> None:
        """Make sure that the next answer belongs to the next question: a meter may have said more than it was asked."""
        if self.in_doubt or await self._line.discard_unsolicited():
            self.in_doubt = True
            await self.resynchronise()
            self.in_doubt = False

    async def resynchronise(self) -> None:
        """End a doubt: prove that answers belong to their questions, and that the meter is still set as it was."""
        try:
            await self.discard_pending_output()
            await self.synchronise()
            restarted = bool(await self.events() & POWER_ON_BIT) or await self.ask("*IDN?") != self._identity
            why = "it has restarted and lost its configuration" if restarted else await self._first_changed_setting()
        except (DeadlineError, ProtocolError) as error:
            raise LinkLostError(self._device, f"has gone silent: {error.message}") from error
        if why:
            raise LinkLostError(self._device, why)
        await self.write("*CLS")

    async def _first_changed_setting(self) -> str:
        """Return the first setting that is not as it was set, or an empty text."""
        for proof in self._proofs:
            if why := await self._differs(*proof):
                return why
        return ""

    async def _differs(self, query: str, expected: str | float) -> str:
        answer = await self.ask(query)
        return "" if _is_expected(answer, expected) else f"{query} is answered by {answer[:80]}, not {expected}"


Session = TypeVar("Session", bound=MeterSession)


class ScpiMeter(Generic[Session]):
    """A meter with a session from `open` to `close`.

    Parameters
    ----------
    line
        Opened at each `open`.
    begin
        Returns a new session on it.
    """

    def __init__(self, line: ScpiLine, begin: Callable[[], Session]) -> None:
        self._line = line
        self._new_session = begin
        self._session: Session | None = None

    async def open(self) -> str:
        """Connect, identify, configure and read the configuration back; return what the meter says it is."""
        await self.close()
        session = self._new_session()
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


def _is_expected(answer: str, expected: str | float) -> bool:
    text = _without_block_head(answer.strip()).strip("\"'")
    if isinstance(expected, str):
        if expected.startswith("(@"):
            return _listed(text) == _listed(expected)
        return text.lstrip("+") == expected
    try:
        numbers = [float(part) for part in text.split(",")]
    except ValueError:
        return False
    return all(abs(number - expected) <= 1e-6 * expected for number in numbers)


def _without_block_head(text: str) -> str:
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
