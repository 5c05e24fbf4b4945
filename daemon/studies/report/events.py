"""The events that the service recorded in words: alarms with their times, and all others."""

import re
from dataclasses import dataclass, replace

from daemon.studies.report.material import Material

_ALARM = "alarm"
_CHANGE = re.compile(r"(raised|cleared) ([\w-]+): (.*)\Z", re.DOTALL)
_ACKNOWLEDGED = re.compile(r"acknowledged ([\w-]+) by (.*)\Z", re.DOTALL)
# Older services recorded an alarm as its text alone, and its end with this before the text.
_OVER_PREFIX = "over: "


@dataclass(frozen=True, slots=True)
class AlarmSpan:
    """An alarm from its raising to its clearing [s UTC].

    Attributes
    ----------
    name, text
        Its kind, empty in older records, and what was wrong.
    start_utc_s, end_utc_s
        None for a start before the first known record, and for an alarm that is still on at the end of the span.
    acknowledged
        By whom, with the reason if there was one; empty if nobody did.
    """

    name: str
    text: str
    start_utc_s: float | None
    end_utc_s: float | None
    acknowledged: str = ""


@dataclass(frozen=True, slots=True)
class Note:
    """One event: when [s UTC], who said it, and what."""

    utc_s: float
    subject: str
    text: str


def alarms_of(material: Material) -> list[AlarmSpan]:
    """Return the alarms of a span, also those that were on when it began, in the order in which they were raised."""
    latest: dict[str, AlarmSpan] = {}
    over: list[AlarmSpan] = []
    before_it = [Note(at, _ALARM, text) for at, _, text in material.before.alarms]
    for note in (*before_it, *_notes(material)):
        if note.subject != _ALARM:
            continue
        acknowledged = _ACKNOWLEDGED.match(note.text)
        if acknowledged is not None:
            name, by = acknowledged.groups()
            if name in latest:
                latest[name] = replace(latest[name], acknowledged=by)
            continue
        what, name, text = _change(note.text)
        before = latest.get(name or text)
        if what == "raised":
            if before is not None and before.end_utc_s is not None:
                over.append(before)
            if before is None or before.end_utc_s is not None:
                latest[name or text] = AlarmSpan(name, text, note.utc_s, None)
            elif before.text != text:
                # It was raised anew with another text, which whoever acknowledged it has not seen.
                latest[name or text] = replace(before, text=text, acknowledged="")
        elif before is None:
            latest[name or text] = AlarmSpan(name, text, None, note.utc_s)
        else:
            latest[name or text] = replace(before, end_utc_s=note.utc_s)
    begins_s = material.span.start_utc_s
    inside = [each for each in (*over, *latest.values()) if each.end_utc_s is None or each.end_utc_s >= begins_s]
    return sorted(inside, key=lambda alarm: alarm.start_utc_s or 0.0)


def notes_of(material: Material) -> list[Note]:
    """Return the events that are no alarms, in their order."""
    return [note for note in _notes(material) if note.subject != _ALARM]


def _change(said: str) -> tuple[str, str, str]:
    """Return what happened to an alarm, its name and its text."""
    found = _CHANGE.match(said)
    if found is not None:
        what, name, text = found.groups()
        return what, name, text
    return ("cleared", "", said.removeprefix(_OVER_PREFIX)) if said.startswith(_OVER_PREFIX) else ("raised", "", said)


def _notes(material: Material) -> list[Note]:
    events = material.tables["events"]
    if not len(events):
        return []
    columns = (material.times_of("events").tolist(), events["subject"], events["text"])
    return [Note(at, str(subject), str(text)) for at, subject, text in zip(*columns, strict=True)]
