"""The line in memory to a simulated rotctld."""

import asyncio
from collections.abc import Callable

from drivers.errors import DeadlineError
from drivers.positioners.rotctld.protocol import ReplyStream, RotctldReply
from sim_drivers.rotctld.core import RotatorCore, RotctldSession
from sim_drivers.transports.cable import Cabled


class InMemoryRotctld(Cabled):
    """A `drivers.positioners.rotctld.link.RotctldLine` whose bytes take no time.

    Parameters
    ----------
    core
        The simulated rotator.
    now
        The event loop's time [s].

    Attributes
    ----------
    frozen
        Whether rotctld hangs: it answers nothing.
    """

    simulated = True

    def __init__(self, core: RotatorCore, now: Callable[[], float]) -> None:
        super().__init__("positioner")
        self._core = core
        self._now = now
        self._session = RotctldSession(core)
        self._replies = ReplyStream()
        self.frozen = False

    async def open(self) -> None:
        """Connect, as a new client."""
        self._connect()
        self._session, self._replies = RotctldSession(self._core), ReplyStream()

    async def close(self) -> None:
        """Release the connection; a move goes on."""
        self._disconnect()

    async def ask(self, command: bytes, within_s: float) -> RotctldReply:
        """Send one command and return its reply."""
        self._require_open()
        replies = [] if self.frozen else self._replies.feed(self._session.feed(command, self._now()))
        if not replies:
            await asyncio.sleep(within_s)
            self._require_open()
            raise DeadlineError(self._device, f"did not answer within {within_s:g} s")
        return replies[0]
