"""What a person has to know: raised once, acknowledged by a person, cleared with its cause, shown everywhere."""

import logging
import re
from collections.abc import Callable, Iterable
from dataclasses import replace

from daemon.base.alarms.alarm import Alarm
from daemon.base.alarms.kept import AlarmFile, KeptAlarm
from daemon.base.clock import Clock
from daemon.base.records import Event, Record

log = logging.getLogger("heliocube.alarm")

# An alarm that is raised within this time after a start counts as the one acknowledged before it, not as a new one: it
# takes half an hour to find that a face of the cube stands still.
_SAME_AFTER_START_S = 3600.0


class Alarms:
    """The alarms of one tracker, or of the cube and its process.

    Each change is an event of the subject ``alarm``: ``raised NAME: TEXT``, ``acknowledged NAME by WHO`` with the
    reason after a colon where there is one, ``cleared NAME: TEXT``. Acknowledging moves nothing and releases nothing.

    Parameters
    ----------
    clock
        The service's time.
    publish
        Called with the events.
    changed
        Called when the alarms are muted or shown again.
    file
        Keeps over a restart what was acknowledged, and what is latched; None keeps nothing.
    """

    def __init__(
        self,
        clock: Clock,
        publish: Callable[[Record], None],
        changed: Callable[[], None] = lambda: None,
        file: AlarmFile | None = None,
    ) -> None:
        self._clock = clock
        self._changed = changed
        self._publish = publish
        self._file = file
        self._shown: dict[str, Alarm] = {}
        # By name, the alarm that was acknowledged last: a person who acknowledges it once more is told so.
        self._acknowledged: dict[str, Alarm] = {}
        self._alarms_on_while_muted: dict[str, tuple[str, Iterable[str]]] = {}
        self._muted = False
        self._started_s = clock.monotonic()
        self._acknowledged_before_start: dict[str, KeptAlarm] = {}
        self._saved: dict[str, KeptAlarm] = {}
        if file is not None:
            self._resume(file.load())

    @property
    def active(self) -> tuple[Alarm, ...]:
        """The alarms that are on, oldest first; none while they are muted."""
        return tuple(alarm for alarm in self.shown if alarm.on)

    @property
    def shown(self) -> tuple[Alarm, ...]:
        """Those that are on, and those that are over and wait for a person; none while they are muted."""
        return () if self._muted else tuple(self._shown.values())

    @property
    def muted(self) -> bool:
        """Whether they are kept silent."""
        return self._muted

    def set(self, name: str, text: str | None, *, of: Iterable[str] = (), worse: bool = False) -> None:
        """Raise the alarm `name`, or end it with None. A new text for one that is on replaces the old one silently.

        If the old text lacks any of the words or sentences `of`, or the cause has become `worse`, the new text is
        raised like a new alarm: nobody has seen what it tells.
        """
        if self._muted:
            if text is None:
                self._alarms_on_while_muted.pop(name, None)
            else:
                self._alarms_on_while_muted[name] = text, of
            return
        before = self._shown.get(name)
        if self._acknowledged_before_start:
            self._forget_old_acknowledgement(name, text, of)
        if text is None:
            if before is not None and before.on:
                self._clear(before)
        elif before is None or not before.on:
            self._raise(name, text, before)
        elif worse or not mentions_all(before.text, of):
            self._raise(name, text, None)
        elif before.text != text:
            self._shown[name] = replace(before, text=text)

    def acknowledge(self, by: str, name: str | None = None, why: str = "", *, latched: bool = False) -> tuple[str, ...]:
        """Note that a person has seen an alarm, and return the names of those that nobody had acknowledged yet.

        Parameters
        ----------
        by, why
            Who, and a reason for the records, each one line.
        name
            Of one alarm; None for all that are shown.
        latched
            Whether only those that wait for a person are meant.
        """
        chosen = [
            alarm
            for alarm in self.shown
            if name in (None, alarm.name) and alarm.acknowledged_utc_s is None and (alarm.kind.latched or not latched)
        ]
        for alarm in chosen:
            seen = replace(alarm, acknowledged_utc_s=self._clock.utc(), acknowledged_by=by)
            self._acknowledged[alarm.name] = seen
            if alarm.on:
                self._shown[alarm.name] = seen
            else:
                del self._shown[alarm.name]
            self._report(f"acknowledged {alarm.name} by {by}{f': {why}' if why else ''}")
        if chosen:
            self._save()
        return tuple(alarm.name for alarm in chosen)

    def acknowledged(self, name: str) -> Alarm | None:
        """Return the alarm of a name as it was acknowledged last, on or over by now; None where nobody has."""
        found = self._shown.get(name) or self._acknowledged.get(name)
        return None if found is None or found.acknowledged_utc_s is None else found

    def mute(self, *, muted: bool) -> None:
        """Keep all alarms silent, as in maintenance, or show again those that are still on."""
        if muted is self._muted:
            return
        self._muted = muted
        if muted:
            self._alarms_on_while_muted = {alarm.name: (alarm.text, ()) for alarm in self._shown.values() if alarm.on}
            self._shown = {alarm.name: alarm for alarm in self._shown.values() if not alarm.on}
        else:
            held, self._alarms_on_while_muted = self._alarms_on_while_muted, {}
            for name, (text, of) in held.items():
                self.set(name, text, of=of)
        self._changed()

    def _raise(self, name: str, text: str, before: Alarm | None) -> None:
        now_utc_s = self._clock.utc()
        self._acknowledged.pop(name, None)
        kept = self._acknowledged_before_start.pop(name, None)
        if kept is not None:
            self._shown[name] = kept.alarm(name, text)
        else:
            # If an alarm came back before anybody had looked, its first time counts.
            self._shown[name] = Alarm(name, text, now_utc_s if before is None else before.raised_utc_s)
        log.warning("%s", text, extra={"fields": {"alarm": name}})
        self._report(f"raised {name}: {text}")
        self._save()

    def _clear(self, before: Alarm) -> None:
        if before.kind.latched and before.acknowledged_utc_s is None:
            self._shown[before.name] = replace(before, cleared_utc_s=self._clock.utc())
        else:
            del self._shown[before.name]
        log.info("alarm %s is over", before.name)
        self._report(f"cleared {before.name}: {before.text}")
        self._save()

    def _resume(self, kept: dict[str, KeptAlarm]) -> None:
        """Show again the alarms that wait for a person; an acknowledged one stays so if it is raised again soon."""
        now_utc_s = self._clock.utc()
        for name, found in kept.items():
            if found.acknowledged_utc_s is not None:
                self._acknowledged_before_start[name] = found
            else:
                cleared_utc_s = now_utc_s if found.cleared_utc_s is None else found.cleared_utc_s
                self._shown[name] = replace(found.alarm(name, found.text), cleared_utc_s=cleared_utc_s)
        self._saved = kept

    def _forget_old_acknowledgement(self, name: str, text: str | None, of: Iterable[str]) -> None:
        """Forget an acknowledgement from before the start if its alarm is over or another; after a while forget all."""
        if self._clock.monotonic() - self._started_s > _SAME_AFTER_START_S:
            self._acknowledged_before_start = {}
        elif text is None or (
            name in self._acknowledged_before_start and not mentions_all(self._acknowledged_before_start[name].text, of)
        ):
            self._acknowledged_before_start.pop(name, None)
        self._save()

    def _save(self) -> None:
        if self._file is None:
            return
        found = {
            alarm.name: KeptAlarm.of(alarm)
            for alarm in self._shown.values()
            if alarm.kind.latched or alarm.acknowledged_utc_s is not None
        }
        whole = self._acknowledged_before_start | found
        if whole != self._saved:
            self._saved = whole
            self._file.save(whole)

    def _report(self, text: str) -> None:
        self._publish(Event(self._clock.utc(), self._clock.monotonic(), "alarm", text))


def mentions_all(text: str, of: Iterable[str]) -> bool:
    """Return whether the text of an alarm has all of these words, or sentences, each whole."""
    return all(re.search(rf"(?<!\w){re.escape(each)}(?!\w)", text) for each in of)
