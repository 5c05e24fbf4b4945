"""The interface of pointing laws: what a law is given, and what it answers.

A law is a module with two names, found through the entry points of the group `heliocube.law`:

`SETTINGS`
    Its parameters, a child of :class:`LawSettings`.
`build(settings, tracker)`
    Returns the :class:`Law` for a :class:`TrackerFacts`.

The module may have a third, `steer(settings, weather, faces, limits)`, which runs the law on the days of a
:class:`solar.energy.DaylightWeather` side by side. Without it the benchmark runs the law itself, day by day and slower.
"""

from abc import ABC, abstractmethod
from collections.abc import Hashable, Mapping
from dataclasses import dataclass, field
from typing import Any, ClassVar, NamedTuple
from weakref import WeakValueDictionary

import numpy as np
from pydantic import BaseModel, ConfigDict, Field

from solar.ephemeris import Site, SunPosition, sun_direction, sun_position
from solar.frames import Angles, Array, Limits, angles_within, azimuth_from_direction, direction_from_azimuth
from solar.laws.reasons import shade_reason
from solar.rows.backtrack import backtracked_poses
from solar.rows.group import TrackerGroup

Faces = tuple[float, float, float, float]
"""Irradiances of the faces east, south, west and zenith [W/m2]; NaN for a face without a reading."""


class LawSettings(BaseModel):
    """The pointing law and its parameters."""

    model_config = ConfigDict(extra="forbid", frozen=True, strict=True, allow_inf_nan=False, validate_default=True)

    knob: ClassVar[str | None] = None
    """The one parameter that the benchmark varies as `NAME:VALUE`."""

    driver: str = Field("", description="Name of the law.")
    shadow: str = Field(
        "",
        description="A second law that runs for comparison. It moves nothing, and reports each night what it"
        " would have gained.",
    )


@dataclass(frozen=True, slots=True)
class TrackerFacts:
    """What a law is told once, of the tracker that it points.

    Attributes
    ----------
    site
        Where it stands.
    limits
        Of its angles.
    scan_every_s
        Time from one reading of the cube to the next.
    decide_every_s
        Time from one decision to the next for laws without a rhythm of their own.
    utc_s
        Now.
    kept
        What :meth:`Law.to_dict` of an earlier run gave, or None.
    group
        The tracker and the neighbours that may shade it; None for a tracker that stands alone.
    common
        What laws of trackers at one cube share; each entry lasts for as long as one of the laws holds it.
    """

    site: Site
    limits: Limits
    scan_every_s: float
    decide_every_s: float
    utc_s: float
    kept: Mapping[str, Any] | None = None
    group: TrackerGroup | None = None
    common: "WeakValueDictionary[Hashable, Any]" = field(default_factory=WeakValueDictionary)


class Reading(NamedTuple):
    """One scan of the cube: its time of day, its time by a clock that nobody sets, and its good faces."""

    utc_s: float
    monotonic_s: float
    faces_w_m2: Faces


@dataclass(frozen=True, slots=True)
class Moment:
    """What a law is told when it is asked where to point.

    Attributes
    ----------
    utc_s
        Now.
    mean_w_m2
        Mean of the newest readings of each face; None while too few faces have any.
    heading
        Where the tracker stands or is on its way to; None while that is not known.
    sun_known
        False while the time of day is in doubt, and with it the sun's position.
    """

    utc_s: float
    mean_w_m2: Faces | None
    heading: Angles | None
    sun_known: bool = True


@dataclass(frozen=True, slots=True)
class Aim:
    """A law's answer.

    Attributes
    ----------
    azimuth_deg, elevation_deg
        Of the direction before limits; NaN when there is none.
    sun
        The sun's position at the same instant, by ephemeris.
    target
        Where to point, inside the limits; None to stay.
    why
        In words, without the law's name.
    beam_w_m2, diffuse_w_m2, albedo
        The law's estimates: the beam normal to the sun, the rest of the light on a horizontal plane, and the ground's
        albedo; NaN from laws that estimate nothing.
    """

    azimuth_deg: float
    elevation_deg: float
    sun: SunPosition[float]
    target: Angles | None
    why: str = ""
    beam_w_m2: float = np.nan
    diffuse_w_m2: float = np.nan
    albedo: float = np.nan


class Estimates(NamedTuple):
    """The light that readings show, by what was known of the site: arrays of one shape, NaN where they show nothing."""

    beam_w_m2: Array
    diffuse_w_m2: Array
    albedo: Array


class Law(ABC):
    """One law that points one tracker.

    Parameters
    ----------
    tracker
        What it points.

    Attributes
    ----------
    faces_needed
        How many good faces a reading needs to be steered by.
    needs_sun
        Whether the law is useless while the sun's position is in doubt: the tracker then stays.
    decide_every_s
        Time from one decision to the next.
    learned
        What was learned of the site; another object when it has changed, None for a law that learns nothing.
    """

    faces_needed: int = 4
    needs_sun: bool = False

    def __init__(self, tracker: TrackerFacts) -> None:
        self.site = tracker.site
        self.limits = tracker.limits
        self.group = tracker.group
        self.decide_every_s = tracker.decide_every_s

    @abstractmethod
    def aim(self, now: Moment) -> Aim:
        """Return where the law wants to point."""

    # A law overrides the methods below only if it has a use for them.

    @property
    def learned(self) -> Any:
        """What was learned of the site, for :meth:`estimates`."""
        return None

    def observe(self, reading: Reading) -> None:  # noqa: B027
        """Take in a scan that has just arrived. Not called while the time of day is in doubt."""

    def turn(self, utc_s: float) -> bool:  # noqa: ARG002
        """Look whether a new day has begun since the last call; True if that has changed :meth:`to_dict`."""
        return False

    def affords(self, distance_deg: float) -> bool:  # noqa: ARG002
        """Whether one more move of this length, A and B added [deg], stays within the law's own plan of the day."""
        return True

    def book(self, distance_deg: float) -> None:  # noqa: B027
        """Charge a move that was ordered to the plan of the day."""

    def believes_zenith(self, faces_w_m2: Faces, utc_s: float) -> bool:  # noqa: ARG002
        """Whether the zenith face of a mean can be believed, to tell day from night by it."""
        return True

    def relearn(self) -> None:  # noqa: B027
        """Forget what was learned of the site."""

    def to_dict(self) -> dict[str, Any] | None:
        """Return what a later run needs to go on from here, as plain numbers and texts; None for nothing."""
        return None

    def shown(self) -> dict[str, dict[str, float]]:
        """Return what a person may want to see: what was `learned` of the site, and what was used up `today`."""
        return {}

    def estimates(self, faces: Array, sun: Array, learned: Any) -> Estimates:  # noqa: ARG002
        """Return what faces (n, 4) [W/m2] show under suns (n, 3), given what was `learned`."""
        return Estimates(*np.full((3, len(faces)), np.nan))

    def sun(self, utc_s: float) -> SunPosition[float]:
        """Return the sun's position at this UTC [s]."""
        return sun_position(utc_s, *self.site)


class DirectionLaw(Law):
    """A law that gives a direction, from which the limits and the neighbours' shade make angles."""

    @abstractmethod
    def direction(self, now: Moment, to_sun: Array) -> Array:
        """Return the direction, shape (3,), of any length; NaN or zero for none. `to_sun` is the ephemeris' vector."""

    def reason(self, azimuth_deg: float, elevation_deg: float) -> str:  # noqa: ARG002
        """Return in words why it points in its direction; empty for nothing to say."""
        return ""

    def aim(self, now: Moment) -> Aim:
        """Return the angles that are closest to the direction, and out of the neighbours' shade."""
        sun = self.sun(now.utc_s)
        to_sun = direction_from_azimuth(sun.azimuth_deg, sun.elevation_deg, self.site[0])
        direction = self.direction(now, to_sun)
        if not (np.isfinite(direction).all() and np.any(direction)):
            return Aim(
                azimuth_deg=np.nan,
                elevation_deg=np.nan,
                sun=sun,
                target=None,
                why="the readings give no direction",
            )
        a_deg, b_deg = angles_within(direction, self.limits)
        azimuth, elevation = map(float, azimuth_from_direction(direction, self.site[0]))
        wanted = Angles(float(a_deg), float(b_deg))
        target = self._out_of_shade(wanted, to_sun, now.utc_s) if now.sun_known else wanted
        reason = self.reason(azimuth, elevation)
        return Aim(
            azimuth_deg=azimuth,
            elevation_deg=elevation,
            sun=sun,
            target=target,
            why=reason if target == wanted else shade_reason(wanted, target, reason),
        )

    def _out_of_shade(self, wanted: Angles, to_sun: Array, utc_s: float) -> Angles:
        if self.group is None:
            return wanted
        later = sun_direction(utc_s + self.decide_every_s, *self.site)
        a_deg, b_deg = backtracked_poses(self.group, [to_sun, later], *wanted, self.limits)
        return Angles(float(a_deg), float(b_deg))


NO_DIRECTION = np.full(3, np.nan)
