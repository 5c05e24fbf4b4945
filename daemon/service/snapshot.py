"""Everything there is to see of the service at one instant, as values: what every display and interface renders."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cache
from importlib.metadata import version
from typing import Any

from daemon.base.alarms.alarm import Alarm
from daemon.base.records import FACES, IvCurve, Mode, Move, Pose, Quality, Scan, Target
from daemon.base.sleeps import Sleep, slept_since
from daemon.bridge.refusals import Statistics
from daemon.config.sections import SiteSettings
from daemon.cube.calibration import CubeCalibration
from daemon.motion.motion import Motion
from daemon.received.shadow import ShadowState, Travel
from daemon.received.today import Insolation
from daemon.service.health import LoopState
from daemon.service.mode_times import ModesOfDay
from daemon.service.recent import News, RecentRecords
from daemon.service.service import Service
from daemon.service.status import LinkStatus
from daemon.service.tracker import Tracker
from daemon.store.store import StoreStatus
from daemon.tracker.control import ControlState
from daemon.tracker.curves import IvAcquisition
from daemon.tracker.pointing import DecisionPreview
from daemon.tracker.stow import StowStatus
from daemon.tracker.wishes import Wishes
from drivers.interfaces import PositionerIdentity, Telemetry
from solar.frames import Limits

# A pose is told every 5 s at rest and more often on the way.
POSE_STALE_S = 30.0


@dataclass(frozen=True, slots=True)
class PositionerState:
    """How a positioner is, by motion and its telemetry; None for what is not known or is not the case."""

    connected: bool
    down_why: str | None
    identity: PositionerIdentity | None
    telemetry: Telemetry | None
    pose: Pose | None
    pose_age_s: float | None
    moving: bool
    homing: bool
    target: Target | None
    blocked_why: str | None
    doubt_why: str | None
    concerns: tuple[str, ...]
    unexplained_why: str | None
    last_move: Move | None

    @property
    def pose_is_stale(self) -> bool:
        """Whether the pose is not known to be true any more."""
        return not (self.connected and self.pose_age_s is not None and self.pose_age_s <= POSE_STALE_S)


@dataclass(frozen=True, slots=True)
class LoadState:
    """How an electronic load is, and its latest curve without the points."""

    identity: str | None
    down_why: str | None
    curve: IvCurve | None


@dataclass(frozen=True, slots=True)
class DayUse:
    """What the laws have moved on this solar day and may still move; degrees are A and B added."""

    travelled_deg: float
    moves: int
    travel_left_deg: float
    moves_left: int


@dataclass(frozen=True, slots=True)
class TrackerState:
    """How one tracker is.

    Attributes
    ----------
    name_in_commands
        Its name where commands need one, because the process has other trackers; None for the only tracker.
    control
        Mode, reason, decision and means.
    next
        What the next decision would be by the present readings, or None; None at a glance.
    silent_s
        Time since control's last tick.
    law, law_shown
        The pointing law, and what it shows of itself; nothing at a glance.
    wishes
        What persons asked for and is in force.
    at_stow
        Whether it surely stands at the stow position.
    today
        What the laws have moved today and may still move.
    received
        What its plane has received today, next to a chronometric tracker's, by the light on the cube's faces; at a
        glance without the latest quarter of an hour.
    shadow
        The law in its shadow; None where there is none, and at a glance.
    modes
        How long it has been in each today.
    wind
        How each source of stow stands.
    alarms
        Its own alarms that are on, or that wait for a person to look.
    load
        None where there is no load.
    decisions, moves
        How many there were, the moves by their outcome.
    """

    name: str
    name_in_commands: str | None
    control: ControlState
    next: DecisionPreview | None
    silent_s: float
    law: str
    law_shown: Mapping[str, Any]
    wishes: Wishes
    at_stow: bool
    today: DayUse
    received: Insolation
    shadow: ShadowState | None
    modes: ModesOfDay
    limits: Limits
    positioner: PositionerState
    load: LoadState | None
    wind: tuple[StowStatus, ...]
    alarms: tuple[Alarm, ...]
    decisions: int
    moves: Mapping[str, int]

    @property
    def wind_m_s(self) -> float:
        """The strongest wind that a source last read; NaN where none measures any."""
        return max((source.speed_m_s for source in self.wind if math.isfinite(source.speed_m_s)), default=math.nan)

    @property
    def stow_release_in_s(self) -> float:
        """How much longer all sources must be calm until none stows; NaN while none stows, or one does not tell."""
        missing_s = [source.release_in_s for source in self.wind if source.why is not None]
        return max(missing_s) if missing_s and all(map(math.isfinite, missing_s)) else math.nan


@dataclass(frozen=True, slots=True)
class Snapshot:
    """How the process is.

    Attributes
    ----------
    speed
        Speed of the clock relative to the machine's.
    time_utc_s, time_monotonic_s
        When the snapshot was taken.
    sleeps
        The sleeps of the machine until then.
    sun_elevation_deg
        By ephemeris, at the site.
    sky
        One line about a simulated sky, or None.
    scan, scan_stale_s, scans
        The newest scan, the age from which it is not used, and how many scans there were.
    fallback_after_s
        After so long without scans, trackers follow the sun by the ephemeris.
    has_cube, cube_down_why
        Whether this process reads a cube, and why it does not answer, or None.
    calibration
        The cube's calibration, or None.
    cube_alarms
        The alarms of no tracker.
    trackers
        In the order of the settings; none in the cube's process.
    bridge, bridge_down_why
        Counts of the receiver, or None; and why it hears nothing, or None.
    store
        None where no records are kept.
    links
        The links to the broker by their trackers; that of the cube's process by the empty name.
    news
        What happened lately, the latest last.
    loop
        How late the event loop was.
    """

    version: str
    simulated: bool
    speed: float
    role: str
    time_utc_s: float
    time_monotonic_s: float
    sleeps: tuple[Sleep, ...]
    site: SiteSettings
    sun_elevation_deg: float
    sky: str | None
    scan: Scan | None
    scan_stale_s: float
    scans: int
    fallback_after_s: float
    has_cube: bool
    cube_down_why: str | None
    calibration: CubeCalibration | None
    cube_alarms: tuple[Alarm, ...]
    trackers: tuple[TrackerState, ...]
    bridge: Statistics | None
    bridge_down_why: str | None
    store: StoreStatus | None
    links: Mapping[str, LinkStatus]
    news: tuple[News, ...]
    loop: LoopState

    @property
    def scan_is_stale(self) -> bool:
        """Whether the newest scan has become too old to be used, or there is none."""
        return self.scan is None or not (self.age_s(self.scan.time_monotonic_s) <= self.scan_stale_s)

    def age_s(self, since_s: float) -> float:
        """Return how long ago a monotonic time [s] was, sleeps of the machine included."""
        return self.time_monotonic_s - since_s + slept_since(since_s, self.sleeps)

    @property
    def cube_trouble(self) -> str | None:
        """Why there are no readings: the cube's own reason, or that none come from the process that reads it.

        Nothing is said of missing scans while the bridge is down: that is not the cube's trouble.
        """
        if self.has_cube or self.bridge_down_why or not self.trackers:
            return self.cube_down_why
        if self.scan is None:
            starting = all(each.control.mode is Mode.STARTING for each in self.trackers)
            return None if starting else "no scan has come since the start of the service"
        age_s = self.age_s(self.scan.time_monotonic_s)
        return None if age_s <= self.fallback_after_s else f"no scan for {age_s:.0f} s"

    def face_quality(self, name: str) -> Quality:
        """Return what a face's reading is worth now: ``stale`` where it was good and has become too old."""
        if self.scan is None:
            return Quality.MISSING
        quality = self.scan.faces[FACES.index(name)].quality
        return Quality.STALE if self.scan_is_stale and quality is Quality.OK else quality


def snapshot(
    service: Service,
    recent: RecentRecords,
    speed: float,
    store: StoreStatus | None,
    links: Mapping[str, LinkStatus],
    *,
    tracker: str | None = None,
    glance: bool = False,
) -> Snapshot:
    """Take a snapshot.

    Parameters
    ----------
    service, recent
        What is seen, and what has come over its bus lately.
    speed
        Speed of the service's clock relative to the machine's.
    store
        How the store is, or None where there is none.
    links
        How the links to the broker are, by tracker.
    tracker
        The only tracker that is looked at, or None for all.
    glance
        Whether to leave out what takes longest to find out: hundreds of trackers are looked at in one go.
    """
    settings, acquisition = service.settings, service.acquisition
    utc_s, sleeps = service.clock.utc(), service.sleeps.sleeps_until_now()
    now_s = service.clock.monotonic()
    return Snapshot(
        version=_version(),
        simulated=service.rig.simulated,
        speed=speed,
        role=service.role.value,
        time_utc_s=utc_s,
        time_monotonic_s=now_s,
        sleeps=sleeps,
        site=settings.site,
        sun_elevation_deg=service.sun_elevation_deg(utc_s),
        sky=None if service.rig.sky_text is None else service.rig.sky_text(),
        scan=recent.scan,
        scan_stale_s=settings.safety.scan_stale_s,
        scans=recent.scans,
        fallback_after_s=settings.safety.fallback_after_s,
        has_cube=acquisition is not None,
        cube_down_why=acquisition.outage.reason if acquisition and acquisition.outage.is_down else None,
        calibration=service.calibration,
        cube_alarms=service.cube_alarms.shown,
        trackers=tuple(
            _tracker(each, recent, sleeps, glance=glance) for each in service.trackers if tracker in (None, each.name)
        ),
        bridge=None if service.receiver is None else service.receiver.statistics,
        bridge_down_why=None if service.receiver is None else service.receiver.down_why,
        store=store,
        links={name: _link(link, now_s, sleeps) for name, link in links.items()},
        news=tuple(recent.news),
        loop=service.loop_watch.state,
    )


@cache
def _version() -> str:
    """Return the program's version; it comes from a file, which is read only once."""
    return version("heliocube")


def _link(link: LinkStatus, now_s: float, sleeps: tuple[Sleep, ...]) -> LinkStatus:
    if not sleeps:
        return link
    inputs = (
        item if item.age_s is None else replace(item, age_s=item.age_s + slept_since(now_s - item.age_s, sleeps))
        for item in link.inputs
    )
    return replace(link, inputs=tuple(inputs))


def _tracker(tracker: Tracker, recent: RecentRecords, sleeps: tuple[Sleep, ...], *, glance: bool) -> TrackerState:
    control, now_s = tracker.control, tracker.clock.monotonic()
    budget, shadow = control.budget, None if tracker.shadow is None or glance else tracker.shadow.state
    received, day = tracker.received.today_without_pending if glance else tracker.received.today, budget.used.day
    # A count ends with the first scan of the next day, and that may come late: show none of yesterday's until then.
    if received.day != day:
        received = Insolation(day=day)
    if shadow is not None and shadow.received.day != day:
        shadow = replace(shadow, received=Insolation(day=day), travel=Travel(day=day))
    positioner = _positioner(tracker.motion, now_s, sleeps)
    return TrackerState(
        name=tracker.name,
        name_in_commands=tracker.log_name or None,
        control=control.state,
        next=None if glance else control.preview_decision(),
        silent_s=now_s - control.last_tick_s,
        law=tracker.settings.law.driver,
        law_shown={} if glance else control.pointing.law.shown(),
        wishes=control.wishes,
        at_stow=control.at_stow and not positioner.pose_is_stale,
        today=DayUse(budget.used.travelled_deg, budget.used.moves, budget.travel_left_deg, budget.moves_left),
        received=received,
        shadow=shadow,
        modes=tracker.mode_times.today(),
        limits=tracker.settings.limits.limits(),
        positioner=positioner,
        load=None if tracker.curves is None else _load(tracker.curves),
        wind=tuple(
            each._replace(age_s=each.age_s + slept_since(now_s - each.age_s, sleeps))
            for each in tracker.stow_watch.statuses(now_s)
        ),
        alarms=tracker.alarms.shown,
        decisions=recent.decisions[tracker.name],
        moves=dict(recent.moves[tracker.name]),
    )


def _positioner(motion: Motion, now_s: float, sleeps: tuple[Sleep, ...]) -> PositionerState:
    pose, pose_age_s = motion.pose, None
    if pose is not None:
        pose_age_s = now_s - pose.time_monotonic_s + slept_since(pose.time_monotonic_s, sleeps)
    return PositionerState(
        connected=motion.connected,
        down_why=motion.outage.reason if motion.outage.is_down else None,
        identity=motion.identity,
        telemetry=motion.telemetry,
        pose=pose,
        pose_age_s=pose_age_s,
        moving=motion.moving,
        homing=motion.homing,
        target=motion.target,
        blocked_why=motion.blocked,
        doubt_why=motion.doubt,
        concerns=motion.concerns,
        unexplained_why=motion.unexplained_motion,
        last_move=motion.last_move,
    )


def _load(curves: IvAcquisition) -> LoadState:
    down_why = curves.outage.reason if curves.outage.is_down else None
    return LoadState(curves.identity, down_why, None if curves.last is None else replace(curves.last, curve=""))
