"""What waits to be sent: bounded, the oldest goes first when there is no room."""

import asyncio
from collections import deque
from dataclasses import dataclass
from enum import Enum, auto
from itertools import count


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


class Lane(Enum):
    """The queue that a message waits in: a full one costs the others nothing."""

    URGENT = auto()
    TELEMETRY = auto()
    ANSWERS = auto()


_DEFAULT_MOST = {Lane.URGENT: 64, Lane.ANSWERS: 256}


class Outbox:
    """Three queues: a short urgent one that is emptied first, and telemetry and answers in the order that they came in.

    Parameters
    ----------
    most
        Room for telemetry. If a lane has a message too many, its oldest is dropped and counted.
    """

    def __init__(self, most: int) -> None:
        self._most_by_lane = {**_DEFAULT_MOST, Lane.TELEMETRY: most}
        self._lanes: dict[Lane, deque[tuple[int, Message]]] = {lane: deque() for lane in Lane}
        self._numbers = count()
        self._last_taken = Lane.TELEMETRY, 0
        self._filled = asyncio.Event()
        self.dropped = 0

    @property
    def waiting(self) -> int:
        """How many messages wait."""
        return sum(map(len, self._lanes.values()))

    def __contains__(self, message: Message) -> bool:
        return any(message is waiting for lane in self._lanes.values() for _, waiting in lane)

    def put(self, message: Message, lane: Lane = Lane.TELEMETRY) -> None:
        """Append a message; never waits."""
        queue = self._lanes[lane]
        queue.append((next(self._numbers), message))
        if len(queue) > self._most_by_lane[lane]:
            queue.popleft()
            self.dropped += 1
        self._filled.set()

    def put_back(self, message: Message) -> None:
        """Return the message that was taken last to its place; it is dropped if there is no room any more."""
        lane, number = self._last_taken
        if len(self._lanes[lane]) < self._most_by_lane[lane]:
            self._lanes[lane].appendleft((number, message))
            self._filled.set()
        else:
            self.dropped += 1

    def forget_urgent(self) -> None:
        """Throw away the messages that were only worth sending at once."""
        self._lanes[Lane.URGENT].clear()

    async def take(self) -> Message:
        """Wait for a message and take it out."""
        while not self.waiting:
            self._filled.clear()
            await self._filled.wait()
        lane = Lane.URGENT
        if not self._lanes[lane]:
            lane = min((one for one in Lane if self._lanes[one]), key=lambda one: self._lanes[one][0][0])
        number, message = self._lanes[lane].popleft()
        self._last_taken = lane, number
        return message
