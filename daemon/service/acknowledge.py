"""Acknowledging alarms: a person has seen them. It moves nothing, and releases nothing."""

from collections.abc import Mapping

from daemon.base.alarms.alarm import Alarm
from daemon.base.alarms.alarms import Alarms
from daemon.base.alarms.kinds import KINDS
from daemon.base.clock import minute_utc
from daemon.service.operator import Answer, CommandError, Effect


def acknowledge(alarms: Mapping[str, Alarms], tracker: str | None, name: str | None, by: str, why: str) -> Answer:
    """Note that a person has seen one alarm, or all that are shown; say so if it was acknowledged before.

    Parameters
    ----------
    alarms
        The alarms of each tracker by its name, and of the cube by the empty name.
    tracker, name
        Whose alarms, and which one; None for all.
    by, why
        Who, and a reason for the records.

    Raises
    ------
    CommandError
        There is no such tracker, or no such alarm on show.
    """
    if tracker is not None and tracker not in alarms:
        known = ", ".join(filter(None, alarms)) or "none"
        raise CommandError(f"there is no tracker {ascii(tracker)[:40]}; the trackers are {known}", wrong=True)
    chosen = alarms if tracker is None else {tracker: alarms[tracker]}
    before = {owner: {alarm.name: alarm for alarm in own.shown} for owner, own in chosen.items()}
    shown = {each for own in before.values() for each in own}
    seen = (
        [] if name is None else [(owner, alarm) for owner, own in chosen.items() if (alarm := own.acknowledged(name))]
    )
    if name is not None and name not in shown and not seen:
        raise CommandError(_not_shown_text(name, sorted(shown)), wrong=name not in KINDS)
    of = {owner: f"{owner}: " if owner and len(alarms) > 2 else "" for owner in chosen}
    sentences = []
    for owner, own in chosen.items():
        acknowledged = own.acknowledge(by, name, why)
        sentences += [f"{of[owner]}{_outcome(before[owner][each])}" for each in acknowledged]
    if sentences:
        return Answer(Effect.DONE, f"acknowledged: {'; '.join(sentences)}")
    told = "; ".join(f"{of[owner]}{_acknowledged_before_text(alarm)}" for owner, alarm in seen)
    return Answer(Effect.DONE, told or "there is nothing to acknowledge")


def _outcome(alarm: Alarm) -> str:
    remedy = alarm.kind.remedy.replace("`", "'")
    return f"{alarm.name} (over)" if not alarm.on else f"{alarm.name} is still on: {remedy}"


def _acknowledged_before_text(alarm: Alarm) -> str:
    when = "" if alarm.acknowledged_utc_s is None else f" at {minute_utc(alarm.acknowledged_utc_s)}"
    return f"{alarm.name} was acknowledged before, by {alarm.acknowledged_by}{when}"


def _not_shown_text(name: str, shown: list[str]) -> str:
    which = f"shown are {', '.join(shown)}" if shown else "none is shown"
    said = f"the alarm {name} is not on" if name in KINDS else f"there is no alarm {ascii(name)[:40]}"
    return f"{said}: {which}"
