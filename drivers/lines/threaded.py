"""A line of blocking calls, run in a thread of its own: what VISA and its like offer, as `drivers.scpi.ScpiLine`."""

from collections.abc import Callable
from typing import Protocol, TypeVar

from drivers.errors import LinkLostError
from drivers.lines.threads import DeviceThread

T = TypeVar("T")

_OPEN_S = 15.0
_SEND_S = 1.0
_DRAIN_S = 10.0
_CLOSE_S = 1.0
# A call that has not returned so long after its own deadline never will.
_HUNG_S = 2.0


class BlockingLine(Protocol):
    """An open line; blocking, for use in one thread. Raises `drivers.errors.DeviceError` and nothing else.

    Attributes
    ----------
    transfer_s
        The longest time that a question and its answer take on the way, which comes on top of every deadline.
    """

    transfer_s: float

    def send(self, text: str) -> None:
        """Send one line; its end is added."""

    def receive(self, within_s: float) -> str:
        """Return the next line without its end; `DeadlineError` if none is complete in time."""

    def interrupt(self) -> None:
        """Make the instrument drop what it is doing and what it has to say."""

    def drain(self, quiet_s: float) -> None:
        """Throw away what comes until nothing has come for a time [s]."""

    def discard_unsolicited(self) -> bool:
        """Throw away what has come and was not read; return whether it was more than the end of a line."""

    def close(self) -> None:
        """Release the line; never raises."""


class ThreadedLine:
    """A blocking line; each exchange is one call in the instrument's thread.

    Parameters
    ----------
    device
        Role of the instrument, for errors.
    connect
        Opens the line; called in the thread at each `open`.
    """

    def __init__(self, device: str, connect: Callable[[], BlockingLine]) -> None:
        self._device = device
        self._connect = connect
        self._thread = DeviceThread(device)
        self._line: BlockingLine | None = None

    async def open(self) -> None:
        """Connect."""
        self._line = await self._thread.call(self._connect, _OPEN_S, lambda late: late.close())

    async def close(self) -> None:
        """Release the line; never raises."""
        line, self._line = self._line, None
        await self._thread.finish(None if line is None else line.close, _CLOSE_S)

    async def send(self, text: str) -> None:
        """Send one line."""
        await self._call(lambda line: line.send(text), _SEND_S)

    async def ask(self, text: str, within_s: float) -> str:
        """Send one line and return the next one that comes."""

        def exchange(line: BlockingLine) -> str:
            line.send(text)
            return line.receive(within_s)

        return await self._call(exchange, _SEND_S + within_s)

    async def receive(self, within_s: float) -> str:
        """Return the next line."""
        return await self._call(lambda line: line.receive(within_s), within_s)

    async def interrupt(self) -> None:
        """Make the instrument drop what it has to say."""
        await self._call(lambda line: line.interrupt(), _SEND_S)

    async def drain(self, quiet_s: float) -> None:
        """Throw away what comes."""
        await self._call(lambda line: line.drain(quiet_s), _DRAIN_S)

    async def discard_unsolicited(self) -> bool:
        """Throw away what has come and was not read."""
        return await self._call(lambda line: line.discard_unsolicited(), _SEND_S)

    async def _call(self, exchange: Callable[[BlockingLine], T], within_s: float) -> T:
        line = self._line
        if line is None:
            raise LinkLostError(self._device, "has to be opened first")
        return await self._thread.call(lambda: exchange(line), within_s + 2 * line.transfer_s + _HUNG_S)
