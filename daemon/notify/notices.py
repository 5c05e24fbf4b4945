"""Puts into words what people are told: the changes of alarms from one look at a service to the next."""

import math
from collections.abc import Collection, Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from datetime import datetime
from typing import Any

from daemon.base.alarms.kinds import with_tracker_option
from daemon.base.clock import local_time
from daemon.notify.notification_state import NotificationState, NotifiedAlarm

# Alarms by tracker (empty for the cube's) and name.
_Shown = dict[tuple[str, str], dict[str, Any]]

SEVERITIES = ("notice", "warning", "critical")
_NOTHING = NotificationState()
# systemd's unit by the role of a service.
_UNITS = {"cube": "heliocube-cube", "tracker": "heliocube-tracker", "both": "heliocube-tracker"}
# Pushover takes 1024 letters; other services take more.
_LONGEST_WHOLE = 900


@dataclass(frozen=True, slots=True)
class Notice:
    """One thing to tell.

    Attributes
    ----------
    title, body
        A line, and some more.
    severity
        One of `SEVERITIES`.
    is_recovery
        Whether it is the end of something.
    since
        Since when the alarm is or was on, in words; empty if that is not known.
    brief
        What is the matter and what to do, in one line, for a message that has several notices.
    """

    title: str
    body: str
    severity: str
    is_recovery: bool = False
    since: str = ""
    brief: str = ""

    @property
    def urgent(self) -> bool:
        """Whether it is told in quiet hours too."""
        return self.severity == "critical"


class ServiceWatch:
    """Compares a service with its state at the look before, and returns the notices.

    The first look tells every alarm that is on and acknowledged by nobody: one that was told before a restart is told
    once more, rather than never. An alarm that was told before and has ended since is told as over. A latched alarm
    that has begun and ended between two looks is told in one notice.

    Parameters
    ----------
    address
        Of the service, as people know it.
    silent_after_s
        The time without an answer after which that is told.
    at_least
        The least severity that is told.
    link
        Where to look, or None.
    now_s
        Monotonic time, from which silence counts.
    before
        What was told before a restart.
    """

    def __init__(
        self,
        address: str,
        silent_after_s: float,
        at_least: str,
        link: str | None,
        now_s: float,
        before: NotificationState = _NOTHING,
    ) -> None:
        self._address = address
        self._silent_after_s = silent_after_s
        self._least_severity_index = SEVERITIES.index(at_least)
        self._link = link
        self._heard_s = now_s
        self._name = address
        self._unit = "heliocube-tracker heliocube-cube"
        self._has_answered = self._silent = self._has_several_trackers = False
        self._was_silent = before.silent
        self._known: _Shown = {(alarm.tracker or "", alarm.name): alarm.as_api_alarm() for alarm in before.alarms}
        self._told = before

    @property
    def notification_state(self) -> NotificationState:
        """What has been told, or is about to be, for a restart."""
        return self._told.model_copy(update={"silent": self._silent or self._was_silent})

    def note_answer(self, state: Mapping[str, Any], now_s: float) -> list[Notice]:
        """Take in the JSON of /api/state; anything else raises an error such as `KeyError`, and counts as silence."""
        before, self._name = self._name, f"{state['site']['name']}{' SIMULATED' if state['simulated'] else ''}"
        try:
            self._has_several_trackers = len(state["trackers"]) > 1
            shown = {(alarm["tracker"] or "", alarm["name"]): alarm for alarm in state["alarms"]}
            shown |= self._hidden(_muted_trackers(state), shown)
            changes = list(self._changes(shown))
            on = [alarm for alarm in shown.values() if self._is_severe_enough(alarm) and alarm["state"] != "cleared"]
            told = NotificationState(alarms=[NotifiedAlarm.model_validate(alarm) for alarm in on])
        except Exception:
            self._name = before
            raise
        notices = [self._back_notice(), *changes] if self._silent or self._was_silent else changes
        self._heard_s, self._silent, self._was_silent, self._known, self._told = now_s, False, False, shown, told
        self._has_answered = True
        self._unit = _UNITS.get(str(state.get("role")), self._unit)
        return notices

    def note_failure(self, why: str, now_s: float) -> list[Notice]:
        """Take in that the service did not answer."""
        silent_s = now_s - self._heard_s
        if self._silent or not silent_s >= self._silent_after_s:
            return []
        self._silent = True
        body = f"The service at {self._address} has not answered for {math.floor(silent_s)} s: {why}."
        remedy = f"Remedy: look at its machine, its network and 'systemctl status {self._unit}'."
        return [self._notice("does not answer", "critical", (body, remedy))]

    def _back_notice(self) -> Notice:
        return self._notice("answers again", "critical", (f"The service at {self._address} answers.",), good=True)

    def _hidden(self, muted: Collection[str], shown: _Shown) -> _Shown:
        """Return the alarms that maintenance hides: nobody knows before its end whether they are still on."""
        known = self._known.items()
        return {key: alarm | {"hidden": True} for key, alarm in known if key[0] in muted and key not in shown}

    def _changes(self, shown: _Shown) -> Iterator[Notice]:
        for key, alarm in shown.items():
            if self._is_severe_enough(alarm):
                yield from self._change(alarm, self._known.get(key))
        for key, alarm in self._known.items():
            if key not in shown and self._is_severe_enough(alarm) and alarm["state"] != "cleared":
                yield self._over_notice(alarm)

    def _change(self, alarm: Mapping[str, Any], before: Mapping[str, Any] | None) -> Iterator[Notice]:
        if alarm["state"] == "cleared":
            if before is not None and before["state"] != "cleared":
                yield self._over_notice(alarm)
            elif self._has_answered and (before is None or before["cleared_at"] != alarm["cleared_at"]):
                yield self._over_already_notice(alarm)
            return
        # An alarm that lasts through maintenance is raised anew at its end, at another time.
        same = "text" if before is not None and "hidden" in before else "raised_at"
        known = before is not None and before["state"] != "cleared" and before[same] == alarm[same]
        if not known and alarm["state"] == "raised":
            yield self._raised_notice(alarm)

    def _is_severe_enough(self, alarm: Mapping[str, Any]) -> bool:
        return SEVERITIES.index(alarm["severity"]) >= self._least_severity_index

    def _raised_notice(self, alarm: Mapping[str, Any]) -> Notice:
        since = _local_time_text(alarm["raised_at"])
        lines = (f"{alarm['text']}.", f"Effect: {alarm['effect']}.", f"Remedy: {alarm['remedy']}.", f"Since {since}.")
        found = self._notice(f"{_tracker_prefix(alarm)}{alarm['name']}", alarm["severity"], lines)
        brief = f"{alarm['text']}. Remedy: {alarm['remedy']}".replace("`", "'")
        return replace(found, since=f"since {since}", brief=brief)

    def _over_already_notice(self, alarm: Mapping[str, Any]) -> Notice:
        since = f"was on since {_local_time_text(alarm['raised_at'])}"
        lines = (
            f"{alarm['text']}.",
            f"Remedy: {alarm['remedy']}.",
            f"It {since}.",
            _stays_shown_text(alarm, several=self._has_several_trackers),
        )
        found = self._notice(f"{_tracker_prefix(alarm)}{alarm['name']}, over already", alarm["severity"], lines)
        brief = f"{alarm['text']}. Remedy: {alarm['remedy']}".replace("`", "'")
        return replace(found, since=f"it {since}", brief=brief)

    def _over_notice(self, alarm: Mapping[str, Any]) -> Notice:
        since = f"was on since {_local_time_text(alarm['raised_at'])}" if alarm["raised_at"] else ""
        lines = [f"Was: {alarm['text']}.", *([f"It {since}."] if since else [])]
        if alarm["latched"] and not alarm["acknowledged_at"]:
            lines.append(_stays_shown_text(alarm, several=self._has_several_trackers))
        found = self._notice(f"over: {_tracker_prefix(alarm)}{alarm['name']}", alarm["severity"], lines, good=True)
        return replace(found, since=f"it {since}" if since else "", brief=alarm["text"].replace("`", "'"))

    def _notice(self, what: str, severity: str, lines: Iterable[str], *, good: bool = False) -> Notice:
        urgency = "" if good else f"{severity.upper()} "
        whole = [*lines, *([] if self._link is None else [self._link])]
        return Notice(f"heliocube {self._name}: {urgency}{what}", "\n".join(whole).replace("`", "'"), severity, good)


def _muted_trackers(state: Mapping[str, Any]) -> set[str]:
    """Return the trackers in maintenance; if all are, the cube counts too, under an empty name."""
    trackers = state["trackers"]
    muted = {name for name, tracker in trackers.items() if tracker["mode"]["name"] == "maintenance"}
    return muted | {""} if muted and len(muted) == len(trackers) else muted


def _tracker_prefix(alarm: Mapping[str, Any]) -> str:
    return f"{alarm['tracker']} " if alarm["tracker"] not in (None, "tracker") else ""


def _stays_shown_text(alarm: Mapping[str, Any], *, several: bool) -> str:
    command = with_tracker_option(f"heliocube alarms ack {alarm['name']}", alarm["tracker"] if several else None)
    return f"It stays shown until somebody acknowledges it: '{command}'."


def _local_time_text(iso_utc: str) -> str:
    """Return an instant in this machine's local time, and how far that is from UTC."""
    there = local_time(datetime.fromisoformat(iso_utc).timestamp())
    offset = there.strftime("%z")
    zone = f"(UTC{offset[:3]}:{offset[3:5]})" if there.utcoffset() else "UTC"
    return f"{there:%Y-%m-%d %H:%M:%S} {zone}"


def combine_notices(notices: list[Notice], *, short: bool = False) -> Notice:
    """Return several notices as one: the worst severity, and a line each with name and time.

    The line says what is the matter as far as there is room; with `short` it never does.
    """
    if len(notices) == 1:
        return notices[0]
    worst = max(notices, key=lambda notice: SEVERITIES.index(notice.severity))
    names = [", ".join(filter(None, (notice.title.removeprefix("heliocube "), notice.since))) for notice in notices]
    room = 0 if short else _LONGEST_WHOLE - sum(map(len, names))
    lines = []
    for name, notice in zip(names, notices, strict=True):
        fits = 0 < len(notice.brief) <= room
        room -= len(notice.brief) if fits else 0
        lines.append(f"{name}: {notice.brief}" if fits else name)
    last = [line for line in notices[-1].body.splitlines()[-1:] if line.startswith("http")]
    good = all(notice.is_recovery for notice in notices)
    return Notice(f"heliocube: {len(notices)} changes of alarms", "\n".join([*lines, *last]), worst.severity, good)
