"""How records get from where they are made to whoever keeps, shows or sends them."""

from collections.abc import Callable

from daemon.base.records import Record

Subscriber = Callable[[Record], None]


class Bus:
    """Hands every record to every subscriber, at once and in order; subscribers must not block."""

    def __init__(self) -> None:
        self._subscribers: list[Subscriber] = []

    def subscribe(self, subscriber: Subscriber) -> None:
        """Add a subscriber for all records from now on."""
        self._subscribers.append(subscriber)

    def publish(self, record: Record) -> None:
        """Hand one record on."""
        for subscriber in self._subscribers:
            subscriber(record)
