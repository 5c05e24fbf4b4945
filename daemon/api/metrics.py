"""A snapshot of the service as metrics for Prometheus, in a registry of its own."""

import math
from collections.abc import Iterator, Mapping, Sequence
from operator import attrgetter

from prometheus_client import CollectorRegistry, generate_latest
from prometheus_client.core import CounterMetricFamily, GaugeMetricFamily, HistogramMetricFamily, Metric
from prometheus_client.registry import Collector

from daemon.base.alarms.alarm import Alarm
from daemon.base.records import FACES, CurveQuality, Mode, MoveOutcome, Quality
from daemon.service.health import LATENESS_BOUNDS_S, LoopState
from daemon.service.snapshot import LoadState, PositionerState, Snapshot, TrackerState
from daemon.service.status import LinkStatus
from daemon.tracker.stow import StowStatus

_REFUSALS = (
    "duplicate",
    "reordered",
    "late",
    "skewed",
    "malformed",
    "forged",
    "oversized",
    "refused_sender",
    "other_source",
    "second_cube",
    "replayed",
)


class Metrics(Collector):
    """The metrics of one snapshot; a value that is stale or unknown is left out, not repeated.

    Parameters
    ----------
    seen
        The snapshot.
    refused
        What the interface itself has refused, by kind.
    """

    def __init__(self, seen: Snapshot, refused: Mapping[str, int]) -> None:
        self._seen = seen
        self._refused = refused

    def text(self) -> bytes:
        """Return all metrics in the text format of Prometheus; needs no event loop and touches nothing else."""
        registry = CollectorRegistry()
        registry.register(self)
        return generate_latest(registry)

    def collect(self) -> Iterator[Metric]:
        """Yield each metric; called by the registry."""
        seen, found = self._seen, _Families()
        about = "Always 1; the labels say which program and role this is."
        found.gauge("info", about, 1.0, version=seen.version, role=seen.role, simulated=str(seen.simulated).lower())
        found.gauge("sun_elevation_degrees", "Elevation of the sun by ephemeris.", seen.sun_elevation_deg)
        _cube(found, seen)
        for tracker in seen.trackers:
            _tracker(found, tracker)
            _alarms(found, tracker.alarms, tracker.name)
        _alarms(found, seen.cube_alarms, "")
        _bridge(found, seen)
        if seen.store is not None:
            found.gauge("store_up", "1 while the store can write.", float(seen.store.down_why is None))
            found.gauge("store_waiting", "Records that wait to be written.", seen.store.waiting)
            found.count("store_written", "Records written.", seen.store.written)
            found.count("store_lost", "Records lost for want of room.", seen.store.lost)
        for name, link in seen.links.items():
            _link(found, link, name)
        for kind, number in self._refused.items():
            found.count("api_refused", "What the local interface refused, by kind.", number, kind=kind)
        about = "How late the event loop was at most in the last minute or two."
        found.gauge("loop_late_worst_seconds", about, seen.loop.worst_s)
        yield from found
        yield _lateness(seen.loop)


class _Families:
    """Metrics by name, each with the values of all its labels."""

    def __init__(self) -> None:
        self._gauges: dict[str, GaugeMetricFamily] = {}
        self._counts: dict[str, CounterMetricFamily] = {}

    def gauge(self, name: str, about: str, value: float, /, **labels: str) -> None:
        family = self._gauges.get(name)
        if family is None:
            family = self._gauges[name] = GaugeMetricFamily(f"heliocube_{name}", about, labels=tuple(labels))
        family.add_metric(tuple(labels.values()), value)

    def count(self, name: str, about: str, value: float, /, **labels: str) -> None:
        family = self._counts.get(name)
        if family is None:
            family = self._counts[name] = CounterMetricFamily(f"heliocube_{name}", about, labels=tuple(labels))
        family.add_metric(tuple(labels.values()), value)

    def by_axis(self, name: str, about: str, a_value: float, b_value: float, **labels: str) -> None:
        for axis, value in (("a", a_value), ("b", b_value)):
            if math.isfinite(value):
                # Grafana would show -0.
                self.gauge(name, about, value + 0.0, **labels, axis=axis)

    def __iter__(self) -> Iterator[Metric]:
        yield from self._gauges.values()
        yield from self._counts.values()


def _lateness(loop: LoopState) -> HistogramMetricFamily:
    bounds = [*(f"{bound_s:g}" for bound_s in LATENESS_BOUNDS_S), "+Inf"]
    buckets = list(zip(bounds, map(float, loop.counts), strict=True))
    about = "How late the event loop ran what was due."
    return HistogramMetricFamily("heliocube_loop_late_seconds", about, buckets, loop.sum_s)


def _cube(found: _Families, seen: Snapshot) -> None:
    if seen.has_cube:
        found.gauge("cube_up", "1 while the cube's instruments answer.", float(seen.cube_down_why is None))
    if seen.calibration is not None:
        about = "When the cube's calibration expires, in seconds of UTC."
        found.gauge("calibration_expires_timestamp_seconds", about, seen.calibration.expires_utc.timestamp())
    found.count("scans", "Scans taken, or accepted from the bridge.", seen.scans)
    if seen.scan is None:
        return
    found.gauge("scan_age_seconds", "Age of the newest scan.", seen.age_s(seen.scan.time_monotonic_s))
    for name, face in zip(FACES, seen.scan.faces, strict=True):
        good = seen.face_quality(name) is Quality.OK
        found.gauge("face_ok", "1 while a face's reading is good.", float(good), face=name)
        if good:
            about = "Irradiance on a face, while it is good."
            found.gauge("irradiance_watts_per_square_meter", about, face.irradiance_w_m2, face=name)


def _tracker(found: _Families, seen: TrackerState) -> None:
    name = seen.name
    for mode in Mode:
        about = "1 for the mode the tracker is in."
        found.gauge("mode", about, float(mode is seen.control.mode), tracker=name, mode=mode.value)
    _positioner(found, seen.positioner, name)
    if seen.control.decision is not None:
        target = seen.control.decision.target
        found.by_axis("target_degrees", "Where the latest decision points.", target.a_deg, target.b_deg, tracker=name)
    travelled_deg = seen.today.travelled_deg
    about = "How far the laws have moved the tracker today, A and B added."
    found.gauge("day_travel_degrees", about, travelled_deg, tracker=name)
    found.gauge("day_moves", "Moves of the laws today.", seen.today.moves, tracker=name)
    for mode, lasted_s in seen.modes.lasted_s.items():
        about = "Time in each mode on this solar day, or since the start of the service."
        found.gauge("day_mode_seconds", about, lasted_s, tracker=name, mode=mode.value)
    for source in seen.wind:
        _stow_source(found, source, name)
    found.count("decisions", "Decisions of the pointing law.", seen.decisions, tracker=name)
    for outcome in MoveOutcome:
        ended = seen.moves.get(outcome, 0)
        found.count("moves", "Moves by how they ended.", ended, tracker=name, outcome=outcome.value)
    if seen.load is not None:
        _module(found, seen.load, name)


def _stow_source(found: _Families, source: StowStatus, name: str) -> None:
    of = {"tracker": name, "source": source.name}
    found.gauge("stow_wanted", "1 while a source wants the tracker stowed.", float(source.why is not None), **of)
    about = "1 while a source of stow has not been heard for longer than it may be silent."
    found.gauge("stow_source_silent", about, float(source.silent), **of)
    if math.isfinite(source.age_s):
        found.gauge("stow_source_age_seconds", "Time since a source of stow was last heard.", source.age_s, **of)
    if math.isfinite(source.speed_m_s):
        found.gauge("wind_meters_per_second", "Wind as a source last read it.", source.speed_m_s, **of)
    if math.isfinite(source.release_in_s):
        found.gauge(
            "stow_release_seconds",
            "How long a source must still be calm until it releases.",
            source.release_in_s,
            **of,
        )


def _positioner(found: _Families, seen: PositionerState, name: str) -> None:
    telemetry = seen.telemetry
    found.gauge("positioner_up", "1 while the positioner sends telemetry.", float(seen.connected), tracker=name)
    found.gauge("moving", "1 during a move or a reference run.", float(seen.moving), tracker=name)
    if seen.pose_age_s is not None:
        found.gauge("pose_age_seconds", "Age of the newest telemetry.", seen.pose_age_s, tracker=name)
    if seen.pose is None or telemetry is None:
        return
    found.gauge("faults", "Latched faults of the positioner.", len(telemetry.faults), tracker=name)
    found.by_axis("angle_degrees", "Where the tracker stands.", seen.pose.a_deg, seen.pose.b_deg, tracker=name)
    if math.isfinite(telemetry.supply_v):
        found.gauge("supply_volts", "Motor supply of the positioner.", telemetry.supply_v, tracker=name)
    currents_a = (telemetry.a_motor_current_a, telemetry.b_motor_current_a)
    found.by_axis("motor_amperes", "Current of a motor.", *currents_a, tracker=name)


def _module(found: _Families, load: LoadState, name: str) -> None:
    found.gauge("load_up", "1 while the electronic load answers.", float(load.down_why is None), tracker=name)
    curve = load.curve
    if curve is not None and curve.quality is CurveQuality.OK and load.down_why is None:
        found.gauge("module_power_watts", "Maximum power of the latest whole curve.", curve.pmpp_w, tracker=name)


def _bridge(found: _Families, seen: Snapshot) -> None:
    counts = seen.bridge
    if counts is None:
        return
    about = "1 while the bridge listens where the configuration says."
    found.gauge("bridge_up", about, float(seen.bridge_down_why is None))
    found.count("bridge_accepted", "Scans accepted from the bridge.", counts.accepted)
    # A scan that comes after all is no longer lost, but Prometheus takes a count that falls for one that began anew.
    about = "Scans that had not come yet when a later one came."
    found.count("bridge_lost", about, counts.lost + counts.reordered)
    for reason in _REFUSALS:
        found.count("bridge_refused", "Datagrams refused, by reason.", attrgetter(reason)(counts), reason=reason)


def _link(found: _Families, link: LinkStatus, name: str) -> None:
    of = {"tracker": name}
    found.gauge("mqtt_up", "1 while there is a connection to the broker.", float(link.connected), **of)
    about = "Connections made; every one but the first is a reconnection."
    found.count("mqtt_connections", about, link.connections, **of)
    found.gauge("mqtt_waiting", "Messages that wait to be sent.", link.waiting, **of)
    found.count("mqtt_sent", "Messages handed over to the broker.", link.sent, **of)
    found.count("mqtt_received", "Messages heard from the broker.", link.received, **of)
    found.count("mqtt_dropped", "Messages lost for want of room.", link.dropped, **of)
    about = "How many things do not work although the link may, such as a topic."
    found.gauge("mqtt_troubles", about, len(link.troubles), **of)
    for item in link.inputs:
        about = "1 while a safety input keeps the tracker stowed."
        found.gauge("mqtt_input_stowing", about, float(item.stowing), **of, input=item.name)
        if item.age_s is not None:
            found.gauge(
                "mqtt_input_age_seconds", "Time since a safety input was last heard.", item.age_s, **of, input=item.name
            )


def _alarms(found: _Families, alarms: Sequence[Alarm], tracker: str) -> None:
    found.gauge("alarms", "How many alarms are on.", sum(alarm.on for alarm in alarms), tracker=tracker)
    waiting = sum(alarm.acknowledged_utc_s is None for alarm in alarms)
    found.gauge("alarms_unacknowledged", "Alarms that nobody has acknowledged.", waiting, tracker=tracker)
    for alarm in alarms:
        labels = {"tracker": tracker, "name": alarm.name, "severity": alarm.kind.severity.value}
        if alarm.on:
            found.gauge("alarm", "1 for an alarm that is on.", 1.0, **labels)
            raised = "When an alarm that is on was raised, in seconds of UTC."
            found.gauge("alarm_raised_timestamp_seconds", raised, alarm.raised_utc_s, **labels)
        if alarm.acknowledged_utc_s is None:
            about = "1 for an alarm, on or over, that nobody has acknowledged."
            found.gauge("alarm_unacknowledged", about, 1.0, **labels)
