"""The state of the service as metrics for Prometheus, in a registry of its own."""

import math
from collections.abc import Callable, Iterator
from importlib.metadata import version
from operator import attrgetter

from prometheus_client import CollectorRegistry, generate_latest
from prometheus_client.core import CounterMetricFamily, GaugeMetricFamily, Metric
from prometheus_client.registry import Collector

from daemon.base.alarms import Alarms
from daemon.base.records import FACES, CurveQuality, Mode, MoveOutcome, Quality
from daemon.motion.motion import Motion
from daemon.service.recent import Recent
from daemon.service.service import Service
from daemon.service.status import LinkStatus
from daemon.store.store import StoreStatus
from daemon.tracker.control import Control
from daemon.tracker.curves import IvAcquisition

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
    "replayed",
)


class Metrics(Collector):
    """Reads the service anew at each scrape; what is stale or unknown is left out, not repeated.

    Parameters
    ----------
    service, recent
        What is read.
    store
        Returns how the store is, or None where there is none.
    mqtt
        Returns how the link to the broker is, or None where there is none.
    """

    def __init__(
        self,
        service: Service,
        recent: Recent,
        store: Callable[[], StoreStatus | None],
        mqtt: Callable[[], LinkStatus | None],
    ) -> None:
        self._service = service
        self._recent = recent
        self._store = store
        self._mqtt = mqtt
        self._registry = CollectorRegistry()
        self._registry.register(self)

    def text(self) -> bytes:
        """Return all metrics in the text format of Prometheus."""
        return generate_latest(self._registry)

    def collect(self) -> Iterator[Metric]:
        """Yield each metric; called by the registry."""
        service = self._service
        info = _gauge("info", "Always 1; which program and role this is.", "version", "role", "simulated")
        info.add_metric([version("heliocube"), service.role.value, str(service.rig.simulated).lower()], 1.0)
        yield info
        elevation_deg = service.sun_elevation_deg(service.clock.utc())
        yield _one("sun_elevation_degrees", "Elevation of the sun by ephemeris.", elevation_deg)
        yield from _alarms(service.alarms)
        yield from self._cube()
        if service.control is not None and service.motion is not None:
            yield from self._tracker(service.control, service.motion)
        if service.curves is not None:
            yield from _module(service.curves)
        yield from self._bridge()
        status = self._store()
        if status is not None:
            yield _one("store_up", "1 while the store can write.", float(status.down_why is None))
            yield _one("store_waiting", "Records that wait to be written.", float(status.waiting))
            yield _count("store_written", "Records written.", status.written)
            yield _count("store_lost", "Records lost for want of room.", status.lost)

        link = self._mqtt()
        if link is not None:
            yield from _link(link)

    def _cube(self) -> Iterator[Metric]:
        now_s, scan = self._service.clock.monotonic(), self._recent.scan
        acquisition = self._service.acquisition
        if acquisition is not None:
            yield _one("cube_up", "1 while the cube's instruments answer.", float(not acquisition.outage.is_down))
        yield _count("scans", "Scans taken, or accepted from the bridge.", self._recent.counts["Scan"])
        if scan is None:
            return
        age_s = now_s - scan.time_monotonic_s
        yield _one("scan_age_seconds", "Age of the newest scan.", age_s)
        values = _gauge("irradiance_watts_per_square_meter", "Irradiance on a face, while it is good.", "face")
        good = _gauge("face_ok", "1 while a face's reading is good.", "face")
        fresh = age_s <= self._service.settings.safety.scan_stale_s
        for name, face in zip(FACES, scan.faces, strict=True):
            ok = fresh and face.quality is Quality.OK
            good.add_metric([name], float(ok))
            if ok:
                values.add_metric([name], face.irradiance_w_m2)
        yield values
        yield good

    def _tracker(self, control: Control, motion: Motion) -> Iterator[Metric]:
        modes = _gauge("mode", "1 for the mode the tracker is in.", "mode")
        for mode in Mode:
            modes.add_metric([mode.value], float(mode is control.mode))
        yield modes
        yield _one("positioner_up", "1 while the positioner sends telemetry.", float(motion.connected))
        yield _one("moving", "1 during a move or a reference run.", float(motion.moving))
        yield _one(
            "faults", "Latched faults of the positioner.", len(motion.telemetry.faults) if motion.telemetry else 0
        )
        pose = motion.pose
        if pose is not None:
            age_s = self._service.clock.monotonic() - pose.time_monotonic_s
            yield _one("pose_age_seconds", "Age of the newest telemetry.", age_s)
        if pose is not None and motion.connected:
            yield _by_axis("angle_degrees", "Where the tracker stands.", pose.a_deg, pose.b_deg)
            if motion.telemetry is not None:
                telemetry = motion.telemetry
                yield _one("supply_volts", "Motor supply of the positioner.", telemetry.supply_v)
                currents_a = (telemetry.a_motor_current_a, telemetry.b_motor_current_a)
                yield _by_axis("motor_amperes", "Current of a motor.", *currents_a)
        if control.state.decision is not None:
            target = control.state.decision.target
            yield _by_axis("target_degrees", "Where the latest decision points.", target.a_deg, target.b_deg)
        used = control.budget.used
        yield _one("day_travel_degrees", "What the laws have travelled today, A and B added.", used.travelled_deg)
        yield _one("day_moves", "Moves of the laws today.", used.moves)
        yield _count("decisions", "Decisions of the pointing law.", self._recent.counts["Decision"])
        moves = CounterMetricFamily("heliocube_moves", "Moves, by how they ended.", labels=["outcome"])
        for outcome in MoveOutcome:
            moves.add_metric([outcome.value], self._recent.moves[outcome])
        yield moves

    def _bridge(self) -> Iterator[Metric]:
        if self._service.receiver is None:
            return
        counts = self._service.receiver.statistics
        yield _count("bridge_accepted", "Scans accepted from the bridge.", counts.accepted)
        yield _count("bridge_lost", "Scans that never came.", counts.lost)
        refused = CounterMetricFamily("heliocube_bridge_refused", "Datagrams refused, by reason.", labels=["reason"])
        for reason in _REFUSALS:
            refused.add_metric([reason], attrgetter(reason)(counts))
        yield refused


def _link(link: LinkStatus) -> Iterator[Metric]:
    yield _one("mqtt_up", "1 while there is a connection to the broker.", float(link.connected))
    yield _count("mqtt_connections", "Connections made; every one but the first is a reconnection.", link.connections)
    yield _one("mqtt_waiting", "Messages that wait to be sent.", link.waiting)
    yield _count("mqtt_sent", "Messages handed over to the broker.", link.sent)
    yield _count("mqtt_received", "Messages heard from the broker.", link.received)
    yield _count("mqtt_dropped", "Messages lost for want of room.", link.dropped)
    yield _one("mqtt_troubles", "What does not work although the link may, such as a topic.", len(link.troubles))
    stowing = _gauge("mqtt_input_stowing", "1 while a safety input keeps the tracker stowed.", "input")
    ages = _gauge("mqtt_input_age_seconds", "Time since a safety input was last heard.", "input")
    for item in link.inputs:
        stowing.add_metric([item.name], float(item.stowing))
        if item.age_s is not None:
            ages.add_metric([item.name], item.age_s)
    yield stowing
    yield ages


def _alarms(alarms: Alarms) -> Iterator[Metric]:
    yield _one("alarms", "How many alarms are on.", len(alarms.active))
    each = _gauge("alarm", "1 for an alarm that is on.", "name")
    for alarm in alarms.active:
        each.add_metric([alarm.name], 1.0)
    yield each


def _gauge(name: str, about: str, *labels: str) -> GaugeMetricFamily:
    return GaugeMetricFamily(f"heliocube_{name}", about, labels=labels)


def _module(curves: IvAcquisition) -> Iterator[Metric]:
    yield _one("load_up", "1 while the electronic load answers.", float(not curves.outage.is_down))
    if curves.last is not None and curves.last.quality is CurveQuality.OK and not curves.outage.is_down:
        yield _one("module_power_watts", "Maximum power of the latest whole curve.", curves.last.pmpp_w)


def _one(name: str, about: str, value: float) -> GaugeMetricFamily:
    return GaugeMetricFamily(f"heliocube_{name}", about, value=value)


def _count(name: str, about: str, value: float) -> CounterMetricFamily:
    return CounterMetricFamily(f"heliocube_{name}", about, value=value)


def _by_axis(name: str, about: str, a_value: float, b_value: float) -> GaugeMetricFamily:
    family = _gauge(name, about, "axis")
    for axis, value in (("a", a_value), ("b", b_value)):
        if math.isfinite(value):
            family.add_metric([axis], value)
    return family
