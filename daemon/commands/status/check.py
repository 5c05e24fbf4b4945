"""The problems of a running service, for scripts: a line for each, and an exit code."""

from collections.abc import Iterator
from typing import Any

from daemon.base.alarms.kinds import with_tracker_option
from daemon.base.errors import ExitCode
from daemon.commands.status.times import local_and_utc_time, localise_times

_HELD = {"stop": "STOPPED by a person", "buttons": "a button was pressed at the unit"}


def troubles(state: dict[str, Any], health: dict[str, Any]) -> list[str]:
    """Return a sentence for each problem, the most urgent first, none twice.

    Parameters
    ----------
    state, health
        The JSON of /api/state and of /healthz.
    """
    alarms = [
        f"{_prefix(alarm['tracker'], state)}{alarm['name']} ({_state(alarm)}): {alarm['text']}; {_remedy(alarm, state)}"
        for alarm in state["alarms"]
    ]
    cube = f"{_last_scan(state)}; check supply, cables and adapters of the cube, and the link from its process"
    down = [
        f"{text}{cube if text.startswith('cube: ') else ''}"
        for text in health["down"]
        if not text.startswith(tuple(_explained_prefixes(state)))
    ]
    return list(dict.fromkeys([*health["troubles"], *_faults(state), *alarms, *down]))


def _faults(state: dict[str, Any]) -> Iterator[str]:
    """Yield the faults whose reason is not part of an alarm's text."""
    for name, own in _trackers(state).items():
        why = own["mode"]["why"]
        told = any(why in alarm["text"] for alarm in state["alarms"] if alarm["tracker"] == name)
        if own["mode"]["name"] == "fault" and not told:
            yield f"{_prefix(name, state)}fault: {why}"


def _explained_prefixes(state: dict[str, Any]) -> Iterator[str]:
    """Yield the beginnings of sentences of /healthz that a fault or an alarm explains as well."""
    for name, own in _trackers(state).items():
        if own["mode"]["name"] == "fault":
            yield f"positioner of {name}: " if len(_trackers(state)) > 1 else "positioner: "
    for alarm in state["alarms"]:
        if alarm["name"] in ("store-down", "bridge-down"):
            yield f"{alarm['name'].removesuffix('-down')}: "


def verdict(state: dict[str, Any], health: dict[str, Any]) -> tuple[list[str], ExitCode]:
    """Return the lines of the answer, the first of which sums them up, and the exit code."""
    found = troubles(localise_times(state), localise_times(health))
    modes = [f"{_prefix(name, state)}{mode_words(own)}" for name, own in _trackers(state).items()]
    doing = ", ".join(modes) or "reads the cube"
    simulated = "SIMULATED, " if state["simulated"] else ""
    if not found:
        return [f"works: {simulated}{doing}"], ExitCode.GOOD
    return [f"works, but {len(found)} to look at: {simulated}{doing}", *found], ExitCode.ALARMS


def page(state: dict[str, Any], health: dict[str, Any]) -> dict[str, Any]:
    """Return the problems as JSON."""
    found, (_, code) = troubles(state, health), verdict(state, health)
    return {
        "exit_code": int(code),
        "simulated": state["simulated"],
        "modes": {name: own["mode"] for name, own in _trackers(state).items()},
        "alarms": [alarm["name"] for alarm in state["alarms"]],
        "troubles": found,
    }


def mode_words(own: dict[str, Any]) -> str:
    """Return the mode from a tracker's part of the state, and whether a person keeps the tracker still."""
    name: str = own["mode"]["name"]
    held = next((words for wish, words in _HELD.items() if own["wishes"][wish]), None)
    return name if held is None else f"{name}, {held}"


def _last_scan(state: dict[str, Any]) -> str:
    scan = state["scan"]
    return "" if scan is None else f"; the last scan is of {local_and_utc_time(scan['time'])}"


def _state(alarm: dict[str, Any]) -> str:
    if alarm["state"] == "cleared":
        return f"raised {local_and_utc_time(alarm['since'])}, over since {local_and_utc_time(alarm['cleared_at'])}"
    return f"{alarm['state']}, since {local_and_utc_time(alarm['since'])}"


def _remedy(alarm: dict[str, Any], state: dict[str, Any]) -> str:
    remedy: str = alarm["remedy"]
    if alarm["state"] != "cleared":
        return remedy
    whose = alarm["tracker"] if len(_trackers(state)) > 1 else None
    return with_tracker_option(f"see what it was, then `heliocube alarms ack {alarm['name']}`", whose)


def _trackers(state: dict[str, Any]) -> dict[str, dict[str, Any]]:
    found: dict[str, dict[str, Any]] = state["trackers"]
    return found


def _prefix(tracker: str | None, state: dict[str, Any]) -> str:
    return f"{tracker}: " if tracker and len(_trackers(state)) > 1 else ""
