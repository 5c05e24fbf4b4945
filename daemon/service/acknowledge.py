"""Acknowledging alarms: a person has seen them. It moves nothing, and releases nothing."""

from collections.abc import Mapping

from daemon.base.alarms.alarm import Alarm
from daemon.base.alarms.alarms import Alarms
from daemon.base.alarms.kinds import KINDS
from daemon.service.operator import Answer, CommandError, Seen


def acknowledge(alarms: Mapping[str, Alarms], tracker: str | None, name: str | None, by: str, why: str) -> Answer:
    """Note that a person has seen one alarm, or all that are shown.

    Parameters
    ----------
    alarms
        Of each tracker by its name, and of the cube by the empty one.
    tracker, name
        Whose, and which; None for all.
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
    if name is not None and name not in shown:
        raise CommandError(_unknown(name, sorted(shown)), wrong=name not in KINDS)
    sentences = []
    for owner, own in chosen.items():
        of = f"{owner}: " if owner and len(alarms) > 2 else ""
        acknowledged = own.acknowledge(by, name, why)
        sentences += [f"{of}{_outcome(before[owner][each])}" for each in acknowledged]
    if sentences:
        return Answer(Seen.DONE, f"acknowledged: {'; '.join(sentences)}")
    return Answer(Seen.DONE, f"{name} was acknowledged before" if name else "there is nothing to acknowledge")


def _outcome(alarm: Alarm) -> str:
    remedy = alarm.kind.remedy.replace("`", "'")
    return f"{alarm.name} (over)" if not alarm.on else f"{alarm.name} is still on: {remedy}"


def _unknown(name: str, shown: list[str]) -> str:
    which = f"shown are {', '.join(shown)}" if shown else "none is shown"
    said = f"the alarm {name} is not on" if name in KINDS else f"there is no alarm {ascii(name)[:40]}"
    return f"{said}: {which}"
