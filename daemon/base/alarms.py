"""What a person has to know: an alarm is raised once, lasts till its cause ends, and is shown everywhere."""

import logging
from collections.abc import Callable
from dataclasses import dataclass

from daemon.base.clock import Clock
from daemon.base.records import Event, Record

log = logging.getLogger("heliocube.alarm")


@dataclass(frozen=True, slots=True)
class Alarm:
    """One alarm that is on.

    Attributes
    ----------
    name
        Of its kind, such as ``unexplained-motion``; at most one of a kind is on.
    text
        What is wrong and what to do, in a sentence.
    since_utc_s
        When it was raised.
    """

    name: str
    text: str
    since_utc_s: float


class Alarms:
    """The alarms that are on.

    Parameters
    ----------
    clock
        The service's time.
    publish
        Called with an event when an alarm is raised and when it ends.
    changed
        Called when they are muted or shown again.
    """

    def __init__(
        self, clock: Clock, publish: Callable[[Record], None], changed: Callable[[], None] = lambda: None
    ) -> None:
        self._clock = clock
        self._changed = changed
        self._publish = publish
        self._on: dict[str, Alarm] = {}
        self._held: dict[str, str] = {}
        self._muted = False

    @property
    def active(self) -> tuple[Alarm, ...]:
        """The alarms that are on, oldest first; none while they are muted."""
        return () if self._muted else tuple(self._on.values())

    @property
    def muted(self) -> bool:
        """Whether they are kept silent."""
        return self._muted

    def set(self, name: str, text: str | None) -> None:
        """Raise the alarm `name`, or end it with None. A new text for one that is on replaces the old one silently."""
        if self._muted:
            if text is None:
                self._held.pop(name, None)
            else:
                self._held[name] = text
            return
        before = self._on.get(name)
        if text is None:
            if before is not None:
                del self._on[name]
                log.info("alarm %s is over", name)
                self._report(f"over: {before.text}")
        elif before is None:
            self._on[name] = Alarm(name, text, self._clock.utc())
            log.warning("%s", text, extra={"fields": {"alarm": name}})
            self._report(text)
        elif before.text != text:
            self._on[name] = Alarm(name, text, before.since_utc_s)

    def mute(self, *, muted: bool) -> None:
        """Keep all alarms to itself, as in maintenance, or show again what is still on."""
        if muted is self._muted:
            return
        self._muted = muted
        if muted:
            self._held, self._on = {alarm.name: alarm.text for alarm in self._on.values()}, {}
        else:
            held, self._held = self._held, {}
            for name, text in held.items():
                self.set(name, text)
        self._changed()

    def _report(self, text: str) -> None:
        self._publish(Event(self._clock.utc(), self._clock.monotonic(), "alarm", text))
