"""The part of the self-check that asks the running service, which has the instruments; it gives no commands."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

from daemon.api.client import NoServiceError, find_without_token
from daemon.base.installation import release
from daemon.base.records import Quality
from daemon.commands.status.check import mode_words
from daemon.commands.status.times import local_and_utc_time, localise_times
from daemon.commands.upgrade.finding import Finding
from daemon.config.settings import Settings
from daemon.service.rig import Role
from daemon.store.release_kept import CUBE_FILE_NAME, FILE_NAME, last_started

_ALARMS_TOLD_ELSEWHERE = ("no-wind-source", "nothing-kept", "stow-source-silent")


def query_service(settings: Settings, config: Path | None) -> list[Finding] | None:
    """Return what the service of these settings, read from `config`, says; None if no service listens."""
    if not settings.api.enabled:
        return None
    client = find_without_token(config, None, {})
    try:
        state = client.state()
        return [
            *check_running_release(settings, state["role"]),
            *service_findings(localise_times(state), localise_times(client.health())),
        ]
    except NoServiceError as error:
        if isinstance(error.__context__, ConnectionRefusedError):
            return None
        return [Finding("service", str(error), "see what listens there: 'ss -tlnp'")]


def check_running_release(settings: Settings, role: str) -> Iterator[Finding]:
    """Yield which heliocube the running service is, if it is another release than this."""
    started = last_started(settings.store.directory, CUBE_FILE_NAME if role == Role.CUBE else FILE_NAME)
    if started is not None and started != release():
        yield Finding("service", f"still runs heliocube {started}", "restart it, so that it runs the installed release")


def service_findings(state: dict[str, Any], health: dict[str, Any]) -> Iterator[Finding]:
    """Yield what the service says of its work, its instruments, the wind and the clock, and each alarm.

    `state` and `health` are the JSON of /api/state and of /healthz.
    """
    modes = ", ".join(f"{_tracker_prefix(name, state)}{mode_words(own)}" for name, own in state["trackers"].items())
    simulated = "SIMULATED, " if state["simulated"] else ""
    remedy = f"{'; '.join(health['troubles'])}: restart it" if health["troubles"] else ""
    yield Finding("service", f"runs as {state['role']}: {simulated}{modes or 'reads the cube'}", remedy)
    yield _cube(state)
    for name, own in state["trackers"].items():
        yield _positioner(own, _subject("positioner", name, state))
        if own["load"] is not None:
            yield _load(own["load"], _subject("load", name, state))
        yield _wind(own, _subject("wind source", name, state), _remedy("no-wind-source", name, state))
    for alarm in state["alarms"]:
        if alarm["name"] in _ALARMS_TOLD_ELSEWHERE:
            continue
        subject = f"alarm {_tracker_prefix(alarm['tracker'], state)}{alarm['name']}"
        yield Finding(
            subject, f"{alarm['state']} since {local_and_utc_time(alarm['since'])}: {alarm['text']}", alarm["remedy"]
        )
    if state["store"] is not None and state["store"]["down_why"]:
        yield Finding("store", state["store"]["down_why"], "disk full, rights")


def _cube(state: dict[str, Any]) -> Finding:
    scan = state["scan"]
    if state["cube_down_why"]:
        return Finding(
            "cube", state["cube_down_why"], "cable, supply, adapter; 'heliocube status' shows when it is back"
        )
    if state["bridge"] is not None and state["bridge"].get("down_why"):
        return Finding("bridge", state["bridge"]["down_why"], "its network, cable and DHCP; or correct the address")
    if scan is None or scan["stale"]:
        text = "no reading yet" if scan is None else f"the latest reading is {_age(scan['age_s'])} old"
        return Finding("cube", text, "see the cube's service, the network, and the key of both machines")
    bad = [f"{name}: {face['quality']}" for name, face in scan["faces"].items() if face["quality"] != Quality.OK]
    text = f"{scan['source']}, the latest reading is {_age(scan['age_s'])} old"
    return Finding("cube", ", ".join([text, *bad]), "check these sensors" if bad else "")


def _positioner(own: dict[str, Any], subject: str) -> Finding:
    seen = own["tracker"]
    if not seen["connected"]:
        why = (seen["down_why"] or "is not connected").removeprefix("positioner: ")
        return Finding(subject, why, "cable, supply, adapter")
    identity, pose = seen["identity"], seen["pose"]
    text = "connected" if identity is None else f"{identity['board']} {identity['firmware']}"
    if pose is not None:
        text = f"{text} at A {pose['a_deg']:+z.1f}, B {pose['b_deg']:.1f} deg"
    wrong = seen["blocked_why"] or seen["doubt_why"] or seen["unexplained_why"]
    return Finding(subject, f"{text}; {wrong}" if wrong else text, "see 'heliocube status'" if wrong else "")


def _load(load: dict[str, Any], subject: str) -> Finding:
    if not load["connected"]:
        return Finding(subject, load["down_why"] or "is not connected", "cable, supply, adapter")
    return Finding(subject, load["identity"])


def _wind(own: dict[str, Any], subject: str, missing: str | None) -> Finding:
    if missing is not None:
        return Finding(subject, "none", missing)
    sources = own["wind"]
    text = "; ".join(_source(source) for source in sources) or "none, and that is accepted"
    silent = any(source["age_s"] is None or source["silent"] for source in sources)
    return Finding(subject, text, "see the sensor, the broker and mqtt.wind.topic" if silent else "")


def _source(source: dict[str, Any]) -> str:
    if source["age_s"] is None:
        return f"{source['name']}: not heard"
    speed = "" if source["speed_m_s"] is None else f"{source['speed_m_s']:.1f} m/s, "
    return f"{source['name']}: {speed}{_age(source['age_s'])} ago{', it is silent' if source['silent'] else ''}"


def _remedy(alarm: str, tracker: str, state: dict[str, Any]) -> str | None:
    """Return the remedy of a tracker's alarm, or None if it is not raised."""
    found = (each["remedy"] for each in state["alarms"] if each["name"] == alarm and each["tracker"] == tracker)
    return next(found, None)


def _age(age_s: float | None) -> str:
    return "unknown" if age_s is None else f"{age_s:.0f} s"


def _subject(what: str, tracker: str, state: dict[str, Any]) -> str:
    return f"{what} of {tracker}" if len(state["trackers"]) > 1 else what


def _tracker_prefix(tracker: str | None, state: dict[str, Any]) -> str:
    return f"{tracker}: " if tracker and len(state["trackers"]) > 1 else ""
