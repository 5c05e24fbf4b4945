"""Publishes every record as it comes over the bus, and the whole state at intervals."""

import asyncio
import json
from collections.abc import Callable
from typing import Any

from daemon.base.records import Event, ModeChange, Record, is_relevant_to
from daemon.base.timeloop import wait_at_most
from daemon.mqtt.link import Link
from daemon.mqtt.outbox import Message
from daemon.mqtt.topics import Topics
from daemon.service.snapshot import Snapshot
from daemon.service.state import finite_or_none, kind_of, record_json, state_json, tracker_state_json

# By the record's name: quality of service, and whether the broker keeps the last one.
_MANNERS = {
    "scan": (0, False),
    "pose": (0, True),
    "decision": (1, True),
    "mode": (1, True),
    "move": (1, False),
    "event": (1, False),
    "curve": (0, False),
}


class TelemetryPublisher:
    """Sends records and state.

    Parameters
    ----------
    link, topics
        The way out, and under which names.
    see
        Takes a snapshot of the service.
    every_s
        Time from one state to the next, on the loop's clock.
    tracker
        The tracker whose state and records are sent, with records of no tracker; empty in the cube's process.
    simulated
        Whether every message is marked as simulated.
    """

    def __init__(
        self,
        link: Link,
        topics: Topics,
        see: Callable[[], Snapshot],
        every_s: float,
        tracker: str,
        *,
        simulated: bool,
    ) -> None:
        self._link = link
        self._topics = topics
        self._take_snapshot = see
        self._tracker = tracker
        self._every_s = every_s
        self._simulated = simulated
        self._wake = asyncio.Event()
        self._retained_messages: dict[str, Message] = {}
        link.at_birth(self._birth_messages)

    def note(self, record: Record) -> None:
        """Queue one record; a change of mode and an alarm bring the state at once."""
        if not is_relevant_to(record, self._tracker):
            return
        kind = kind_of(record)
        qos, retain = _MANNERS[kind]
        payload = encoded({**record_json(record), "simulated": self._simulated})
        # Commands that a person or a program gives in a loop must not push out measurements.
        asked = isinstance(record, Event) and record.subject == "operator"
        message = Message(self._topics.of(kind), payload, qos, retain)
        if retain:
            self._retained_messages[kind] = message
        self._link.send(message, answer=asked)
        if isinstance(record, ModeChange) or (isinstance(record, Event) and record.subject == "alarm"):
            self._wake.set()

    async def run(self) -> None:
        """Send the state at intervals until cancelled; without a connection it is not sent."""
        while True:
            await wait_at_most(self._wake, self._every_s)
            self._link.send_now(self._state_message())

    def _birth_messages(self) -> list[Message]:
        """Return the state and the last of all retained messages: a broker may have lost them, or the queue been full.

        A message that still waits is left out: it comes in its turn, behind older ones.
        """
        return [
            self._state_message(),
            *(each for each in self._retained_messages.values() if not self._link.is_waiting(each)),
        ]

    def _state_message(self) -> Message:
        seen = self._take_snapshot()
        state = tracker_state_json(seen, self._tracker) if self._tracker else state_json(seen)
        return Message(self._topics.state, encoded(state), 0, retain=True)


def encoded(found: dict[str, Any]) -> bytes:
    """Return one JSON object as the bytes of a message."""
    return json.dumps(found, default=finite_or_none, separators=(",", ":"), allow_nan=False).encode()
