"""What waits to be sent: bounded, the oldest goes first when there is no room."""

import asyncio
from collections import deque
from dataclasses import dataclass

_MOST_URGENT = 64


@dataclass(frozen=True, slots=True)
class Message:
    """One message to the broker.

    Attributes
    ----------
    qos
        0: at most once; 1: sent again after a loss of the connection until the broker has confirmed it.
    """

    topic: str
    payload: bytes
    qos: int = 0
    retain: bool = False


class Outbox:
    """Two queues: a short urgent one that is emptied first, and that of the telemetry.

    Parameters
    ----------
    most
        Room for telemetry; a message too many costs the oldest, which is counted.
    """

    def __init__(self, most: int) -> None:
        self._urgent: deque[Message] = deque()
        self._others: deque[Message] = deque()
        self._most = most
        self._filled = asyncio.Event()
        self.dropped = 0

    @property
    def waiting(self) -> int:
        """How many messages wait."""
        return len(self._urgent) + len(self._others)

    def put(self, message: Message, *, urgent: bool = False) -> None:
        """Append a message; never waits."""
        queue, most = (self._urgent, _MOST_URGENT) if urgent else (self._others, self._most)
        queue.append(message)
        if len(queue) > most:
            queue.popleft()
            self.dropped += 1
        self._filled.set()

    def put_back(self, message: Message) -> None:
        """Return a message whose sending failed to the front; it is dropped if there is no room any more."""
        if len(self._others) < self._most:
            self._others.appendleft(message)
            self._filled.set()
        else:
            self.dropped += 1

    def forget_urgent(self) -> None:
        """Throw away what was only worth sending at once."""
        self._urgent.clear()

    async def take(self) -> Message:
        """Wait for a message and take it out."""
        while not (self._urgent or self._others):
            self._filled.clear()
            await self._filled.wait()
        return (self._urgent or self._others).popleft()
