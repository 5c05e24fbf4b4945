"""What is the matter with a running service, for scripts: in a line each, and as an exit code."""

from typing import Any

from daemon.base.errors import ExitCode


def troubles(state: dict[str, Any], health: dict[str, Any]) -> list[str]:
    """Return a sentence for each thing that is the matter, none twice.

    Parameters
    ----------
    state, health
        The JSON of /api/state and of /healthz.
    """
    found = [*health["troubles"], *health["down"]]
    for name, own in _trackers(state).items():
        if own["mode"]["name"] == "fault":
            found.append(f"{_of(name, state)}fault: {own['mode']['why']}")
    for alarm in state["alarms"]:
        of = _of(alarm["tracker"], state)
        found.append(f"{of}{alarm['name']} ({_state(alarm)}): {alarm['text']}; {alarm['remedy']}")
    return list(dict.fromkeys(found))


def verdict(state: dict[str, Any], health: dict[str, Any]) -> tuple[list[str], ExitCode]:
    """Return the lines of the answer, the first of them the sum, and what the program ends with."""
    found = troubles(state, health)
    modes = [f"{_of(name, state)}{mode_words(own['mode'])}" for name, own in _trackers(state).items()]
    doing = ", ".join(modes) or "reads the cube"
    simulated = "SIMULATED, " if state["simulated"] else ""
    if not found:
        return [f"works: {simulated}{doing}"], ExitCode.GOOD
    return [f"works, but {len(found)} to look at: {simulated}{doing}", *found], ExitCode.ALARMS


def page(state: dict[str, Any], health: dict[str, Any]) -> dict[str, Any]:
    """Return the same as JSON."""
    found, (_, code) = troubles(state, health), verdict(state, health)
    return {
        "exit_code": int(code),
        "simulated": state["simulated"],
        "modes": {name: own["mode"] for name, own in _trackers(state).items()},
        "alarms": [alarm["name"] for alarm in state["alarms"]],
        "troubles": found,
    }


def mode_words(mode: dict[str, Any]) -> str:
    """Return a mode's name, and for one that persons hold which it is: a stop is more than a hold."""
    asked = mode.get("asked")
    held = {"stop": "STOPPED by a person", "buttons": "a button was pressed at the unit"}.get(asked or "")
    return mode["name"] if held is None else f"{mode['name']}, {held}"


def _state(alarm: dict[str, Any]) -> str:
    since = "raised" if alarm["state"] == "cleared" else "since"
    return f"{alarm['state']}, {since} {alarm['since'][:19].replace('T', ' ')} UTC"


def _trackers(state: dict[str, Any]) -> dict[str, dict[str, Any]]:
    found: dict[str, dict[str, Any]] = state["trackers"]
    return found


def _of(tracker: str | None, state: dict[str, Any]) -> str:
    return f"{tracker}: " if tracker and len(_trackers(state)) > 1 else ""
