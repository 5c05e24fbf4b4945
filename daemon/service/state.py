"""A snapshot of the service as JSON: every value with its age and what it is worth."""

import math
from collections.abc import Iterable
from dataclasses import asdict, replace
from operator import attrgetter
from typing import Any

from daemon.base.alarms.alarm import Alarm
from daemon.base.alarms.kinds import with_tracker_option
from daemon.base.clock import iso_utc
from daemon.base.records import FACES, Mode, Record
from daemon.cube.calibration import CubeCalibration
from daemon.received.shadow import ShadowState
from daemon.received.today import Insolation
from daemon.service.snapshot import LoadState, PositionerState, Snapshot, TrackerState
from daemon.service.status import LinkStatus
from daemon.store.store import StoreStatus
from daemon.store.tables import COLUMNS, with_irradiances
from daemon.tracker.control import ControlState
from daemon.tracker.pointing import DecisionPreview
from daemon.tracker.wishes import Wish, Wishes
from solar.frames import Limits

_NAMES = {kind: name.removesuffix("s") for kind, (name, _) in COLUMNS.items()}
# The wishes that lead to a mode, the one that goes first in front.
_WISHES_BY_MODE = {
    Mode.MAINTENANCE: ("maintenance",),
    Mode.HOLD: ("stop", "buttons", "hold"),
    Mode.STOW: ("stow",),
    Mode.SNOW: ("snow",),
}
# The keys of one tracker. A process with one tracker has them at the top too, where scripts and dashboards know them.
_TRACKER_KEYS = (
    "mode",
    "wishes",
    "at_stow",
    "today",
    "received",
    "shadow",
    "irradiances",
    "decision",
    "law",
    "next_decision_s",
    "next_decision",
    "tracker",
    "load",
    "wind",
    "wind_m_s",
    "stow_release_in_s",
    "mqtt",
)


def kind_of(record: Record) -> str:
    """Return the name of a record's kind: that of its table without the plural, such as ``scan``."""
    return _NAMES[type(record)]


def record_json(record: Record) -> dict[str, Any]:
    """Return a record under the names of its table's columns, times as ISO 8601 and null for what is not a number."""
    whole = with_irradiances(record)
    found = {}
    for column in COLUMNS[type(record)][1]:
        value = attrgetter(column.path)(whole)
        if column.name != "time_monotonic_s":
            found[column.name] = iso_utc(value) if column.holds == "time" else finite_or_none(value)
    return found


def finite_or_none(value: Any) -> Any:
    """Return None for a float that is not finite, and anything else as it is."""
    return None if isinstance(value, float) and not math.isfinite(value) else value


def state_json(seen: Snapshot) -> dict[str, Any]:
    """Return the state of the whole process: its trackers by name, and a single one's values at the top as well."""
    only = seen.trackers[0] if len(seen.trackers) == 1 else None
    alarms: list[tuple[Alarm, TrackerState | None]] = [(alarm, None) for alarm in seen.cube_alarms]
    alarms += [(alarm, tracker) for tracker in seen.trackers for alarm in tracker.alarms]
    own = {tracker.name: _tracker_json(seen, tracker) for tracker in seen.trackers}
    return _common(seen, alarms) | _top_level_json(seen, only) | {"trackers": own}


def tracker_state_json(seen: Snapshot, name: str) -> dict[str, Any]:
    """Return the state of one tracker, with its cube's and its process' but without other trackers."""
    tracker = next(tracker for tracker in seen.trackers if tracker.name == name)
    alarms = [*((alarm, None) for alarm in seen.cube_alarms), *((alarm, tracker) for alarm in tracker.alarms)]
    return _common(seen, alarms) | _top_level_json(seen, tracker)


def _common(seen: Snapshot, alarms: Iterable[tuple[Alarm, TrackerState | None]]) -> dict[str, Any]:
    """Return the keys that do not belong to one tracker."""
    ordered = sorted(alarms, key=lambda item: item[0].sort_key)
    return {
        "version": seen.version,
        "simulated": seen.simulated,
        "speed": seen.speed,
        "role": seen.role,
        "time": iso_utc(seen.time_utc_s),
        "site": {
            "name": seen.site.name,
            "latitude_deg": seen.site.latitude_deg,
            "longitude_deg": seen.site.longitude_deg,
            "altitude_m": seen.site.altitude_m,
        },
        "sun_elevation_deg": finite_or_none(seen.sun_elevation_deg),
        "sky": seen.sky,
        "scan": _scan(seen),
        "calibration": None if seen.calibration is None else _calibration(seen.calibration, seen.time_utc_s),
        "cube_down_why": seen.cube_down_why,
        "unacknowledged": sum(alarm.acknowledged_utc_s is None for alarm, _ in ordered),
        "alarms": [
            _alarm(alarm, None) | {"tracker": None}
            if tracker is None
            else _alarm(alarm, tracker.name_in_commands) | {"tracker": tracker.name}
            for alarm, tracker in ordered
        ],
        "bridge": None
        if seen.bridge is None
        else {
            "accepted": seen.bridge.accepted,
            "lost": seen.bridge.lost,
            "refused": seen.bridge.refused,
            "down_why": seen.bridge_down_why,
        },
        "store": None if seen.store is None else _store(seen.store),
        "loop": {"late_worst_s": round(seen.loop.worst_s, 4)},
        "news": [{"time": iso_utc(item.time_utc_s), "text": item.text} for item in seen.news],
    }


def _top_level_json(seen: Snapshot, tracker: TrackerState | None) -> dict[str, Any]:
    if tracker is not None:
        return _tracker_json(seen, tracker)
    process = seen.links.get("")
    return dict.fromkeys(_TRACKER_KEYS) | {"mqtt": None if process is None else _mqtt(process)}


def _tracker_json(seen: Snapshot, tracker: TrackerState) -> dict[str, Any]:
    control = tracker.control
    link = seen.links.get(tracker.name)
    since = iso_utc(control.since_utc_s)
    return {
        "mode": {
            "name": control.mode.value,
            "why": with_tracker_option(control.why, tracker.name_in_commands),
            "since": since,
            "asked": _wish_behind_mode(control.mode, tracker.wishes),
        },
        "wishes": {name: _wish(wish, tracker.name_in_commands) for name, wish in tracker.wishes},
        "at_stow": tracker.at_stow,
        "today": {
            "travelled_deg": tracker.today.travelled_deg,
            "moves": tracker.today.moves,
            "left": {"travel_deg": tracker.today.travel_left_deg, "moves": tracker.today.moves_left},
            "modes_s": {mode.value: round(lasted_s, 3) for mode, lasted_s in tracker.modes.lasted_s.items()},
            "modes_since": iso_utc(tracker.modes.since_utc_s),
        },
        "received": _received(tracker.received),
        "shadow": None if tracker.shadow is None else _shadow(tracker.shadow, tracker.received),
        "irradiances": _irradiances(control),
        "decision": None
        if control.decision is None
        else record_json(replace(control.decision, tracker=tracker.name))
        | {"age_s": finite_or_none(round(seen.age_s(control.decision.time_monotonic_s), 3))},
        "law": {"name": tracker.law} | dict(tracker.law_shown),
        "next_decision_s": finite_or_none(control.next_decision_s),
        "next_decision": None
        if tracker.next is None
        else _next_decision_json(tracker.next, seen.time_utc_s + control.next_decision_s),
        "tracker": _positioner(tracker.positioner, tracker) | {"limits": _limits(tracker.limits)},
        "load": None if tracker.load is None else _load(tracker.load, tracker.name, seen),
        "wind": [{name: finite_or_none(value) for name, value in status._asdict().items()} for status in tracker.wind],
        "wind_m_s": finite_or_none(tracker.wind_m_s),
        "stow_release_in_s": finite_or_none(tracker.stow_release_in_s),
        "mqtt": None if link is None else _mqtt(link),
    }


def _irradiances(control: ControlState) -> dict[str, Any] | None:
    if control.irradiances is None:
        return None
    names = [*(f"{face}_w_m2" for face in FACES), "coverage"]
    return {name: finite_or_none(getattr(control.irradiances, name)) for name in names}


def _received(today: Insolation) -> dict[str, Any] | None:
    if today.since_utc_s is None:
        return None
    return {
        "since": iso_utc(today.since_utc_s),
        "known_s": round(today.known_s, 1),
        "actual_kwh_m2": round(today.actual_kwh_m2, 5),
        "chronometric_kwh_m2": round(today.chronometric_kwh_m2, 5),
        "best_kwh_m2": round(today.best_kwh_m2, 5),
        "gain": finite_or_none(round(today.gain, 5)),
    }


def _shadow(shadow: ShadowState, own: Insolation) -> dict[str, Any]:
    return {
        "law": shadow.law,
        "failed_why": shadow.failed_why,
        "received": _received(shadow.received),
        "gain": finite_or_none(round(shadow.gain_over(own), 5)),
        "travelled_deg": shadow.travel.travelled_deg,
        "moves": shadow.travel.moves,
        "active_travelled_deg": shadow.travel.active_deg,
        "active_moves": shadow.travel.active_moves,
    }


def _next_decision_json(foresight: DecisionPreview, due_utc_s: float) -> dict[str, Any]:
    target = foresight.target
    return {
        "time": iso_utc(due_utc_s),
        "law": foresight.law,
        "target_a_deg": finite_or_none(target.a_deg),
        "target_b_deg": finite_or_none(target.b_deg),
        "moves": foresight.moves,
        "why": target.why,
    }


def _limits(limits: Limits) -> dict[str, float]:
    return {
        "a_min_deg": limits.a_min_deg,
        "a_max_deg": limits.a_max_deg,
        "b_min_deg": limits.b_min_deg,
        "b_max_deg": limits.b_max_deg,
    }


def _calibration(calibration: CubeCalibration, utc_s: float) -> dict[str, Any]:
    return {
        "identifier": calibration.identifier,
        "method": calibration.method,
        "calibrated": iso_utc(calibration.calibrated_utc.timestamp()),
        "expires": iso_utc(calibration.expires_utc.timestamp()),
        "validity": calibration.validity(utc_s),
    }


def _alarm(alarm: Alarm, tracker: str | None) -> dict[str, Any]:
    kind, raised = alarm.kind, iso_utc(alarm.raised_utc_s)
    return {
        "name": alarm.name,
        "severity": kind.severity.value,
        "state": alarm.state,
        "text": with_tracker_option(alarm.text, tracker),
        "cause": kind.cause,
        "effect": kind.effect,
        "remedy": with_tracker_option(kind.remedy, tracker),
        "latched": kind.latched,
        "since": raised,
        "raised_at": raised,
        "acknowledged_at": None if alarm.acknowledged_utc_s is None else iso_utc(alarm.acknowledged_utc_s),
        "acknowledged_by": alarm.acknowledged_by or None,
        "cleared_at": None if alarm.cleared_utc_s is None else iso_utc(alarm.cleared_utc_s),
    }


def _wish_behind_mode(mode: Mode, wishes: Wishes) -> str | None:
    """Return which wish of a person leads to this mode, or None: a stop and a hold lead to the same mode."""
    return next((name for name in _WISHES_BY_MODE.get(mode, ()) if getattr(wishes, name) is not None), None)


def _wish(wish: Wish | None, name_in_commands: str | None) -> dict[str, Any] | None:
    if wish is None:
        return None
    first, *also = (
        {"why": with_tracker_option(each.why, name_in_commands), "by": each.by, "since": each.since}
        for each in wish.all_requests
    )
    return {**first, "latest": wish.latest, "also": also}


def _scan(seen: Snapshot) -> dict[str, Any] | None:
    scan = seen.scan
    if scan is None:
        return None
    return {
        "source": scan.source,
        "session": scan.session,
        "sequence": scan.sequence,
        "time": iso_utc(scan.time_utc_s),
        "age_s": finite_or_none(round(seen.age_s(scan.time_monotonic_s), 3)),
        "stale": seen.scan_is_stale,
        "simulated": scan.simulated,
        "calibration": scan.calibration or None,
        "faces": {
            name: {
                "irradiance_w_m2": finite_or_none(face.irradiance_w_m2),
                "quality": seen.face_quality(name).value,
                "age_s": finite_or_none(round(seen.age_s(face.time_monotonic_s), 3)),
            }
            for name, face in zip(FACES, scan.faces, strict=True)
        },
    }


def _load(load: LoadState, tracker: str, seen: Snapshot) -> dict[str, Any]:
    curve = load.curve
    return {
        "connected": load.identity is not None,
        "down_why": load.down_why,
        "identity": load.identity,
        "curve": None
        if curve is None
        else record_json(replace(curve, tracker=tracker))
        | {"age_s": finite_or_none(round(seen.age_s(curve.time_monotonic_s), 3))},
    }


def _positioner(seen: PositionerState, tracker: TrackerState) -> dict[str, Any]:
    telemetry, identity, target, last = seen.telemetry, seen.identity, seen.target, seen.last_move

    def typed(text: str | None) -> str | None:
        return None if text is None else with_tracker_option(text, tracker.name_in_commands)

    return {
        "name": tracker.name,
        "connected": seen.connected,
        "down_why": typed(seen.down_why),
        "identity": None
        if identity is None
        else {"board": identity.board, "firmware": identity.firmware, "serial": identity.serial},
        "pose": _pose(seen),
        "moving": seen.moving,
        "homing": seen.homing,
        "target": None if target is None else {"a_deg": target.a_deg, "b_deg": target.b_deg, "why": target.why},
        "blocked_why": typed(seen.blocked_why),
        "doubt_why": typed(seen.doubt_why),
        "faults": [] if telemetry is None else list(telemetry.faults),
        "concerns": [typed(concern) for concern in seen.concerns],
        "unexplained_why": typed(seen.unexplained_why),
        "button_pressed": None if telemetry is None else telemetry.button_pressed,
        "motor_current_a": {
            "a": None if telemetry is None else finite_or_none(telemetry.a_motor_current_a),
            "b": None if telemetry is None else finite_or_none(telemetry.b_motor_current_a),
        },
        "supply_v": None if telemetry is None else finite_or_none(telemetry.supply_v),
        "details": {}
        if telemetry is None
        else {name: finite_or_none(value) for name, value in telemetry.details.items()},
        "last_move": None
        if last is None
        else record_json(
            replace(last, tracker=tracker.name, why=with_tracker_option(last.why, tracker.name_in_commands))
        ),
    }


def _pose(seen: PositionerState) -> dict[str, Any] | None:
    pose = seen.pose
    if pose is None or seen.pose_age_s is None:
        return None
    return {
        "a_deg": finite_or_none(pose.a_deg),
        "b_deg": finite_or_none(pose.b_deg),
        "time": iso_utc(pose.time_utc_s),
        "age_s": finite_or_none(round(seen.pose_age_s, 3)),
        "stale": seen.pose_is_stale,
    }


def _mqtt(status: LinkStatus) -> dict[str, Any]:
    found = asdict(status)
    since, lost_since = found.pop("since_utc_s"), found.pop("dropped_since_utc_s")
    found["since"] = iso_utc(since)
    found["dropped_since"] = None if lost_since is None else iso_utc(lost_since)
    for item in found["inputs"]:
        item["age_s"] = None if item["age_s"] is None else round(item["age_s"], 3)
    return found


def _store(status: StoreStatus) -> dict[str, Any]:
    return {
        "path": str(status.path),
        "written": status.written,
        "waiting": status.waiting,
        "lost": status.lost,
        "down_why": status.down_why,
    }
