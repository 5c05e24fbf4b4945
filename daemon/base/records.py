"""What flows through the house: one frozen record per kind, passed on unchanged.

Every record carries UTC [s since 1970] for stamps; those that time a measurement carry monotonic time [s] as well.
What belongs to one tracker bears its name; scans, and events of the process or its cube, bear none.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from enum import StrEnum
from typing import NamedTuple

FACES = ("east", "south", "west", "zenith")


class Quality(StrEnum):
    """How far one face's reading can be trusted."""

    OK = "ok"
    OVER_RANGE = "over-range"
    STALE = "stale"
    IMPLAUSIBLE = "implausible"
    LATE = "late"
    SELF_TEST_FAILED = "self-test-failed"
    MISSING = "missing"


class Mode(StrEnum):
    """What the tracker is doing."""

    STARTING = "starting"
    TRACKING = "tracking"
    FALLBACK = "fallback"
    NIGHT = "night"
    HOLD = "hold"
    STOW = "stow"
    FAULT = "fault"
    SNOW = "snow"
    MAINTENANCE = "maintenance"


class FaceReading(NamedTuple):
    """Irradiance on one face of the cube.

    Attributes
    ----------
    irradiance_w_m2
        Calibrated; NaN where there is no number.
    quality
        Only ``ok`` readings reach a pointing law.
    time_utc_s, time_monotonic_s
        When the conversion ended, on the cube's clocks.
    """

    irradiance_w_m2: float
    quality: Quality
    time_utc_s: float
    time_monotonic_s: float


@dataclass(frozen=True, slots=True)
class Scan:
    """One pass over the four faces.

    Attributes
    ----------
    source, session, sequence
        Which cube, which run of its program, and the count of scans in that run, from 0.
    time_utc_s, time_monotonic_s
        End of the scan: on the cube's clocks as sent; the receiver replaces the monotonic time by its own.
    simulated
        True when the cube is a simulation.
    calibration
        Identifier of the calibration file that the irradiances were made with; empty for the settings' own gains.
    """

    source: str
    session: str
    sequence: int
    time_utc_s: float
    time_monotonic_s: float
    east: FaceReading
    south: FaceReading
    west: FaceReading
    zenith: FaceReading
    simulated: bool = False
    calibration: str = ""

    @property
    def faces(self) -> tuple[FaceReading, FaceReading, FaceReading, FaceReading]:
        """East, south, west, zenith."""
        return self.east, self.south, self.west, self.zenith

    @property
    def ok(self) -> bool:
        """Whether all four faces are good."""
        east, south, west, zenith = self.faces
        return east.quality is south.quality is west.quality is zenith.quality is Quality.OK


@dataclass(frozen=True, slots=True)
class Irradiances:
    """Time-weighted mean irradiance of each face over one window [W/m2].

    Attributes
    ----------
    coverage
        Share of the window that readings stand for, 0..1; the worst face counts.
    """

    east_w_m2: float
    south_w_m2: float
    west_w_m2: float
    zenith_w_m2: float
    coverage: float


@dataclass(frozen=True, slots=True)
class Target:
    """Where to point, inside the limits, and why."""

    a_deg: float
    b_deg: float
    why: str


@dataclass(frozen=True, slots=True)
class Estimate:
    """What a law makes of the light and the ground; NaN from laws that estimate nothing.

    Attributes
    ----------
    dni_w_m2
        Normal to the sun: direct and circumsolar.
    dhi_w_m2
        Horizontal irradiance of the rest of the sky.
    albedo
        Of the ground around the cube.
    """

    dni_w_m2: float = math.nan
    dhi_w_m2: float = math.nan
    albedo: float = math.nan


NO_ESTIMATE = Estimate()


@dataclass(frozen=True, slots=True)
class Decision:
    """One run of the pointing law and what came of it.

    Attributes
    ----------
    law
        Name of the law that spoke.
    direction_azimuth_deg, direction_elevation_deg
        Where the law wants to look before limits; NaN when it has no direction.
    sun_azimuth_deg, sun_elevation_deg
        Ephemeris at that instant, apparent elevation.
    moved
        Whether a move was ordered.
    estimate
        What the law made of the light.
    """

    time_utc_s: float
    time_monotonic_s: float
    mode: Mode
    law: str
    irradiances: Irradiances | None
    direction_azimuth_deg: float
    direction_elevation_deg: float
    sun_azimuth_deg: float
    sun_elevation_deg: float
    target: Target
    moved: bool
    estimate: Estimate = NO_ESTIMATE
    tracker: str = ""


class MoveOutcome(StrEnum):
    """How a move ended."""

    ARRIVED = "arrived"
    INTERRUPTED = "interrupted"
    REFUSED = "refused"
    STALLED = "stalled"
    OVERSHOT = "overshot"
    TIMED_OUT = "timed-out"
    LINK_LOST = "link-lost"


@dataclass(frozen=True, slots=True)
class Move:
    """One move of the tracker, from order to end."""

    time_utc_s: float
    time_monotonic_s: float
    duration_s: float
    from_a_deg: float
    from_b_deg: float
    target_a_deg: float
    target_b_deg: float
    end_a_deg: float
    end_b_deg: float
    outcome: MoveOutcome
    why: str
    tracker: str = ""


@dataclass(frozen=True, slots=True)
class Pose:
    """Where the tracker truly stands, from its own telemetry; and the wind there.

    `wind_m_s` is the strongest that a source of stow has read since the pose before; NaN where none was read.
    """

    time_utc_s: float
    time_monotonic_s: float
    a_deg: float
    b_deg: float
    moving: bool
    tracker: str = ""
    wind_m_s: float = math.nan


class CurveQuality(StrEnum):
    """How far the maximum power of a curve can be trusted."""

    OK = "ok"
    STOPPED = "stopped"
    NO_MAXIMUM = "no-maximum"
    DARK = "dark"
    CLOCK = "clock"


@dataclass(frozen=True, slots=True)
class IvCurve:
    """One I-V curve of the module on the tracker, and what it says; NaN where it says nothing.

    Attributes
    ----------
    time_utc_s, time_monotonic_s
        Start of the sweep.
    pmpp_w, vmpp_v, impp_a
        Maximum power point by a local fit around the knee.
    pmpp_sigma_w
        Standard uncertainty of `pmpp_w` by the scatter of the points; calibration and drift are not in it.
    voc_v
        Read in open circuit before the sweep.
    isc_a
        By a straight line through the points at low voltage.
    zenith_start_w_m2, zenith_end_w_m2
        What the cube's zenith face read last before the sweep and before its end.
    points
        How many points were measured.
    quality, why
        ``ok``: the whole curve was measured and has a maximum; otherwise what is wrong. ``clock``: only its time is
        in doubt.
    curve
        The points, voltages and then currents, as base64 of little-endian 32-bit floats; empty unless kept.
    """

    time_utc_s: float
    time_monotonic_s: float
    duration_s: float
    pmpp_w: float
    pmpp_sigma_w: float
    vmpp_v: float
    impp_a: float
    voc_v: float
    isc_a: float
    zenith_start_w_m2: float
    zenith_end_w_m2: float
    points: int
    quality: CurveQuality
    why: str
    curve: str = ""
    tracker: str = ""


@dataclass(frozen=True, slots=True)
class ModeChange:
    """A transition of the state machine and its reason."""

    time_utc_s: float
    time_monotonic_s: float
    before: Mode
    after: Mode
    why: str
    tracker: str = ""


@dataclass(frozen=True, slots=True)
class Event:
    """Something worth telling that is none of the other records: a device lost or back, a clock step, a command."""

    time_utc_s: float
    time_monotonic_s: float
    subject: str
    text: str
    tracker: str = ""


Record = Scan | Decision | Move | Pose | IvCurve | ModeChange | Event


Subscriber = Callable[[Record], None]


def tag_with_tracker(publish: Subscriber, tracker: str) -> Subscriber:
    """Return a function that hands records on to `publish` with the name of their tracker; a scan belongs to none."""

    def publish_named(record: Record) -> None:
        publish(record if isinstance(record, Scan) or record.tracker == tracker else replace(record, tracker=tracker))

    return publish_named


def is_relevant_to(record: Record, tracker: str) -> bool:
    """Whether a record is one tracker's own, or that of no tracker."""
    return isinstance(record, Scan) or record.tracker in ("", tracker)


class Bus:
    """Hands every record to every subscriber whom it concerns, at once and in order; subscribers must not block."""

    def __init__(self) -> None:
        self._subscribers: list[Subscriber] = []
        self._subscribers_by_tracker: dict[str, list[Subscriber]] = {}

    def subscribe(self, subscriber: Subscriber, tracker: str = "") -> None:
        """Add a subscriber for all records from now on, or for those that concern one tracker: its own and nobody's.

        If each of hundreds of trackers asked every record whose it is, the asking would be most of the work.
        """
        if tracker:
            self._subscribers_by_tracker.setdefault(tracker, []).append(subscriber)
        else:
            self._subscribers.append(subscriber)

    def publish(self, record: Record) -> None:
        """Hand one record on."""
        for subscriber in self._subscribers:
            subscriber(record)
        tracker = "" if isinstance(record, Scan) else record.tracker
        chosen = (self._subscribers_by_tracker.get(tracker, ()),) if tracker else self._subscribers_by_tracker.values()
        for subscribers in chosen:
            for subscriber in subscribers:
                subscriber(record)
