"""Questions and answers in SCPI over a line, in turn and proven to belong together.

An instrument answers a query that it does not understand by silence, and a reply that comes too late would be taken for
the answer to the next question. So an instrument that does not answer as it should is in doubt, and nothing that it
says is believed before it has given back a number that was never sent before.
"""

import contextlib
import re
from collections.abc import Iterator
from typing import Protocol

from drivers.errors import ConnectError, DeadlineError, ProtocolError

POWER_ON_BIT = 128
"""Event bit of an instrument that has restarted."""
ERROR_BITS = 4 | 8 | 16 | 32
"""Event bits of commands that were not carried out."""

# No register has more digits, and Python refuses to make a number of thousands of them.
_WHOLE = re.compile(r"\+?[0-9]{1,10}")
_NO_ERROR = re.compile(r"[+-]?0+,")
_QUIET_S = 0.1
_MOST_STALE_LINES = 20


class ScpiLine(Protocol):
    """An instrument's line, whatever carries it. Raises `drivers.errors.DeviceError` and nothing else."""

    async def open(self) -> None:
        """Connect."""

    async def close(self) -> None:
        """Release the line; never raises."""

    async def send(self, text: str) -> None:
        """Send one line; its end is added."""

    async def ask(self, text: str, within_s: float) -> str:
        """Send one line and return the next one that comes, as `receive` does."""

    async def receive(self, within_s: float) -> str:
        """Return the next line without its end; `DeadlineError` if none is complete in time."""

    async def interrupt(self) -> None:
        """Make the instrument drop what it is doing and what it has to say."""

    async def drain(self, quiet_s: float) -> None:
        """Throw away what comes until nothing has come for a time [s]."""

    async def discard_unsolicited(self) -> bool:
        """Throw away what has come and nobody has read, and return whether it was more than the end of a line."""


class ScpiSession:
    """One connection to an instrument.

    Parameters
    ----------
    line
        Already open.
    device
        Role of the instrument, for errors.
    deadline_s
        How long one answer may take.

    Attributes
    ----------
    in_doubt
        Whether it is unclear to which question the next answer belongs.
    """

    def __init__(self, line: ScpiLine, device: str, deadline_s: float) -> None:
        self.in_doubt = False
        self._line = line
        self._device = device
        self._deadline_s = deadline_s
        self._number = 0

    @contextlib.contextmanager
    def doubtful_exchange(self) -> Iterator[None]:
        """Be in doubt until the block has come to its end: an error or a cancellation before that leaves the doubt."""
        self.in_doubt = True
        yield
        self.in_doubt = False

    async def write(self, command: str) -> None:
        """Send a command that is not answered."""
        await self._line.send(command)

    async def ask(self, query: str) -> str:
        """Return the answer to a question; `DeadlineError` if it does not come in time."""
        try:
            return (await self._line.ask(query, self._deadline_s)).strip()
        except DeadlineError:
            raise DeadlineError(self._device, f"did not answer {query} within {self._deadline_s:g} s") from None

    async def discard_pending_output(self) -> None:
        """Make the instrument drop what it still had to say, and throw away what is under way already."""
        await self._line.interrupt()
        await self._line.drain(_QUIET_S)

    async def synchronise(self) -> None:
        """Prove that the next answer belongs to the next question, whatever was still under way."""
        self._number = self._number % 127 + 1
        await self._line.send(f"*ESE {self._number}")
        answer = await self.ask("*ESE?")
        for _ in range(_MOST_STALE_LINES):
            if _WHOLE.fullmatch(answer) and int(answer) == self._number:
                return
            answer = (await self._line.receive(self._deadline_s)).strip()
        raise ProtocolError(self._device, f"keeps answering {answer[:80]!r} to *ESE?")

    async def events(self) -> int:
        """Return the standard event register, which reading clears; `ProtocolError` if the answer is no number."""
        return self.parse_integer("*ESR?", await self.ask("*ESR?"))

    def parse_integer(self, query: str, answer: str) -> int:
        """Return the whole number that answers a question; `ProtocolError` if it has not one to ten digits."""
        if not _WHOLE.fullmatch(answer):
            raise ProtocolError(self._device, f"answers {answer[:80]!r} to {query}")
        return int(answer)

    async def command(self, command: str) -> None:
        """Send a command and read the error queue; `ProtocolError` if that holds an error."""
        await self._line.send(command)
        error = await self.ask(":SYST:ERR?")
        if not _NO_ERROR.match(error):
            raise ProtocolError(self._device, f"did not take {command}: {error[:80]}")


@contextlib.contextmanager
def silence_as_connect_error(device: str, settings: str) -> Iterator[None]:
    """Turn silence while an instrument is opened into a `ConnectError` that says what to check.

    Parameters
    ----------
    device
        Role of the instrument.
    settings
        What has to be set at it, such as ``this interface and speed``.
    """
    try:
        yield
    except DeadlineError as error:
        raise ConnectError(device, f"{error.message}; is it on, and set to {settings}?") from error
