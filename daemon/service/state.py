"""The state of the service as JSON: every value with its age and what it is worth."""

import math
from dataclasses import asdict, replace
from importlib.metadata import version
from operator import attrgetter
from typing import Any

from daemon.base.alarms import Alarm
from daemon.base.clock import iso_utc
from daemon.base.records import FACES, Pose, Quality, Record, Scan
from daemon.cube.calibration import CubeCalibration
from daemon.motion.motion import Motion
from daemon.service.recent import Recent
from daemon.service.service import Service
from daemon.service.status import LinkStatus
from daemon.store.store import StoreStatus
from daemon.store.tables import COLUMNS, with_irradiances
from daemon.tracker.budget import DayBudget
from daemon.tracker.curves import IvAcquisition
from daemon.tracker.stow_watch import StowWatch
from daemon.tracker.wishes import Wish

# Telemetry comes every 10 s at rest and more often on the way.
POSE_STALE_S = 30.0

_NAMES = {kind: name.removesuffix("s") for kind, (name, _) in COLUMNS.items()}


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
            found[column.name] = iso_utc(value) if column.holds == "time" else number(value)
    return found


def number(value: Any) -> Any:
    """Return None for a float that is not finite, and anything else as it is."""
    return None if isinstance(value, float) and not math.isfinite(value) else value


def state(
    service: Service, recent: Recent, speed: float, store: StoreStatus | None, mqtt: LinkStatus | None = None
) -> dict[str, Any]:
    """Return everything there is to see of the service now.

    A face's quality is ``stale`` where its reading has become too old to be used, whatever it was before.
    """
    clock, settings = service.clock, service.settings
    now_s, utc_s = clock.monotonic(), clock.utc()
    site, acquisition, control = settings.site, service.acquisition, service.control
    found: dict[str, Any] = {
        "version": version("heliocube"),
        "simulated": service.rig.simulated,
        "speed": speed,
        "role": service.role.value,
        "time": iso_utc(utc_s),
        "site": {
            "name": site.name,
            "latitude_deg": site.latitude_deg,
            "longitude_deg": site.longitude_deg,
            "altitude_m": site.altitude_m,
        },
        "sun_elevation_deg": number(service.sun_elevation_deg(utc_s)),
        "sky": None if service.rig.sky_text is None else service.rig.sky_text(),
        "scan": None if recent.scan is None else _scan(recent.scan, now_s, settings.safety.scan_stale_s),
        "calibration": None if service.calibration is None else _calibration(service.calibration, utc_s),
        "cube_down_why": acquisition.outage.reason if acquisition and acquisition.outage.is_down else None,
        "wind": None if service.stow_watch is None else _wind(service.stow_watch, now_s),
        "alarms": [_alarm(alarm) for alarm in service.alarms.active],
        "mode": None,
        "wishes": None,
        "today": None,
        "irradiances": None,
        "decision": None,
        "law": None,
        "next_decision_s": None,
        "tracker": None,
        "load": None,
        "bridge": None,
        "store": None if store is None else _store(store),
        "mqtt": None if mqtt is None else _mqtt(mqtt),
        "news": [{"time": iso_utc(item.time_utc_s), "text": item.text} for item in recent.news],
    }
    if control is not None and service.motion is not None:
        seen = control.state
        found["mode"] = {"name": seen.mode.value, "why": seen.why, "since": iso_utc(seen.since_utc_s)}
        if seen.irradiances is not None:
            names = [*(f"{face}_w_m2" for face in FACES), "coverage"]
            found["irradiances"] = {name: number(getattr(seen.irradiances, name)) for name in names}
        if seen.decision is not None:
            found["decision"] = record_json(seen.decision) | {
                "age_s": number(round(now_s - seen.decision.time_monotonic_s, 3))
            }
        found["next_decision_s"] = number(seen.next_decision_s)
        found["law"] = {"name": settings.law.name} | control.pointing.law.shown()
        found["wishes"] = {name: _wish(wish) for name, wish in control.wishes}
        found["today"] = _today(control.budget)
        found["tracker"] = _tracker(service.motion, now_s)
        limits = settings.limits.limits()
        found["tracker"]["limits"] = {
            "a_min_deg": limits.a_min_deg,
            "a_max_deg": limits.a_max_deg,
            "b_min_deg": limits.b_min_deg,
            "b_max_deg": limits.b_max_deg,
        }
    if service.curves is not None:
        found["load"] = _load(service.curves, now_s)
    if service.receiver is not None:
        counts = service.receiver.statistics
        found["bridge"] = {"accepted": counts.accepted, "lost": counts.lost, "refused": counts.refused}
    return found


def _wind(watch: StowWatch, now_s: float) -> list[dict[str, Any]]:
    return [{name: number(value) for name, value in asdict(status).items()} for status in watch.statuses(now_s)]


def _calibration(calibration: CubeCalibration, utc_s: float) -> dict[str, Any]:
    return {
        "identifier": calibration.identifier,
        "method": calibration.method,
        "calibrated": iso_utc(calibration.calibrated_utc.timestamp()),
        "expires": iso_utc(calibration.expires_utc.timestamp()),
        "validity": calibration.validity(utc_s),
    }


def _alarm(alarm: Alarm) -> dict[str, Any]:
    return {"name": alarm.name, "text": alarm.text, "since": iso_utc(alarm.since_utc_s)}


def _wish(wish: Wish | None) -> dict[str, Any] | None:
    if wish is None:
        return None
    since = None if wish.since_utc_s is None else iso_utc(wish.since_utc_s)
    return {"why": wish.why, "by": wish.by, "since": since}


def _today(budget: DayBudget) -> dict[str, Any]:
    """Return what the laws have moved on this solar day and may still move."""
    return {
        "travelled_deg": budget.used.travelled_deg,
        "moves": budget.used.moves,
        "left": {"travel_deg": budget.travel_left_deg, "moves": budget.moves_left},
    }


def _scan(scan: Scan, now_s: float, stale_s: float) -> dict[str, Any]:
    age_s = now_s - scan.time_monotonic_s
    stale = not (age_s <= stale_s)
    return {
        "source": scan.source,
        "session": scan.session,
        "sequence": scan.sequence,
        "time": iso_utc(scan.time_utc_s),
        "age_s": number(round(age_s, 3)),
        "stale": stale,
        "simulated": scan.simulated,
        "calibration": scan.calibration or None,
        "faces": {
            name: {
                "irradiance_w_m2": number(face.irradiance_w_m2),
                "quality": (Quality.STALE if stale and face.quality is Quality.OK else face.quality).value,
                "age_s": number(round(now_s - face.time_monotonic_s, 3)),
            }
            for name, face in zip(FACES, scan.faces, strict=True)
        },
    }


def _load(curves: IvAcquisition, now_s: float) -> dict[str, Any]:
    last = curves.last
    return {
        "connected": curves.identity is not None,
        "down_why": curves.outage.reason if curves.outage.is_down else None,
        "identity": curves.identity,
        "curve": None
        if last is None
        else record_json(replace(last, curve="")) | {"age_s": number(round(now_s - last.time_monotonic_s, 3))},
    }


def _tracker(motion: Motion, now_s: float) -> dict[str, Any]:
    telemetry, identity, target, last = motion.telemetry, motion.identity, motion.target, motion.last_move
    return {
        "connected": motion.connected,
        "down_why": motion.outage.reason if motion.outage.is_down else None,
        "identity": None
        if identity is None
        else {"board": identity.board, "firmware": identity.firmware, "serial": identity.serial},
        "pose": None if motion.pose is None else _pose(motion.pose, now_s, connected=motion.connected),
        "moving": motion.target is not None,
        "homing": motion.homing,
        "target": None if target is None else {"a_deg": target.a_deg, "b_deg": target.b_deg, "why": target.why},
        "blocked_why": motion.blocked,
        "doubt_why": motion.doubt,
        "faults": [] if telemetry is None else list(telemetry.faults),
        "concerns": list(motion.concerns),
        "unexplained_why": motion.unexplained,
        "button_pressed": None if telemetry is None else telemetry.button_pressed,
        "motor_current_a": {
            "a": None if telemetry is None else number(telemetry.a_motor_current_a),
            "b": None if telemetry is None else number(telemetry.b_motor_current_a),
        },
        "supply_v": None if telemetry is None else number(telemetry.supply_v),
        "last_move": None if last is None else record_json(last),
    }


def _pose(pose: Pose, now_s: float, *, connected: bool) -> dict[str, Any]:
    age_s = now_s - pose.time_monotonic_s
    return {
        "a_deg": number(pose.a_deg),
        "b_deg": number(pose.b_deg),
        "time": iso_utc(pose.time_utc_s),
        "age_s": number(round(age_s, 3)),
        "stale": not (connected and age_s <= POSE_STALE_S),
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
