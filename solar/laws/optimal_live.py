"""The law `optimal` as a tracker runs it: fed by scans, asked where to point, with a memory that outlives the process.

The law itself is :class:`solar.laws.optimal.OptimalLaw`; here its readings become means of some seconds, and its days
those of the site.
"""

import math
from typing import Any, ClassVar

import numpy as np
from pydantic import BaseModel, ConfigDict, Field

from solar.energy import DaylightWeather, Steer
from solar.ephemeris import SunPosition, share_of_daylight_left, solar_days, sun_direction, sun_position
from solar.frames import Angles, Array, Limits, azimuth_from_direction, direction_from_azimuth
from solar.laws.history import ReadingHistory
from solar.laws.law import Aim, Estimates, LawSettings, Moment, Reading, TrackerFacts
from solar.laws.light import FACES_NEEDED, light_from_faces, usable_faces
from solar.laws.memory import THRIFT_RANGE, OptimalSettings
from solar.laws.optimal import Choice, OptimalLaw
from solar.laws.reasons import move_reason
from solar.laws.site import ALBEDO_RANGE, GAIN_RANGE, LearnedSite, SiteLearning
from solar.laws.three_faces import ThreeFacesLaw
from solar.rows.group import TrackerGroup

DECIDE_EVERY_S = 60.0
_BUDGET_FORBIDS = "the law's budget of motion for the day does not allow it (law.moves_per_day, law.travel_per_day_deg)"


class LiveOptimalSettings(LawSettings):
    """optimal: where the expected light is collected best, for little travel."""

    knob: ClassVar[str | None] = "thrift"

    albedo: float = Field(
        0.2,
        ge=0,
        le=1,
        description="Share of the irradiance that the ground reflects; optimal begins with it and learns its own.",
    )
    thrift: float = Field(
        1.0,
        ge=THRIFT_RANGE[0],
        le=THRIFT_RANGE[1],
        description="Weight of wear against harvest; 2 travels less for a little energy.",
    )
    travel_per_day_deg: float = Field(
        1300.0, gt=0, le=100000, description="Degrees of travel in a day, A and B added, that are never exceeded."
    )
    moves_per_day: int = Field(250, ge=1, le=1440, description="Moves in a day that are never exceeded.")

    def optimal_settings(self) -> OptimalSettings:
        """Return the law's own settings."""
        return OptimalSettings(
            thrift=self.thrift, travel_per_day_deg=self.travel_per_day_deg, moves_per_day=self.moves_per_day
        )


class OptimalState(BaseModel):
    """Albedo and relative gains of the vertical faces, and the budget used on a solar day (counted from 1970)."""

    model_config = ConfigDict(extra="forbid", strict=True, allow_inf_nan=False)

    albedo: float = Field(ge=ALBEDO_RANGE[0], le=ALBEDO_RANGE[1])
    gain_east: float = Field(1.0, ge=GAIN_RANGE[0], le=GAIN_RANGE[1])
    gain_south: float = Field(1.0, ge=GAIN_RANGE[0], le=GAIN_RANGE[1])
    gain_west: float = Field(1.0, ge=GAIN_RANGE[0], le=GAIN_RANGE[1])
    day: int
    travelled_deg: float = Field(0.0, ge=0.0)
    moves: int = Field(0, ge=0)

    @property
    def learned(self) -> LearnedSite:
        """The albedo and gains, as the law uses them."""
        return LearnedSite(self.albedo, self.gain_east, self.gain_south, self.gain_west)


class LiveOptimal(ThreeFacesLaw):
    """Keeps one :class:`solar.laws.optimal.OptimalLaw` informed and asks it where to point.

    Parameters
    ----------
    settings, tracker
        Its parameters and what it points; `ValueError` if what was kept is not this law's.
    """

    needs_sun = True

    def __init__(self, settings: LiveOptimalSettings, tracker: TrackerFacts) -> None:
        super().__init__(tracker)
        self.decide_every_s = DECIDE_EVERY_S
        self._fresh = LearnedSite(min(max(settings.albedo, ALBEDO_RANGE[0]), ALBEDO_RANGE[1]))
        self._settings = settings.optimal_settings()
        kept = None if tracker.kept is None else OptimalState.model_validate(tracker.kept)
        known = self._fresh if kept is None else kept.learned
        self._law = OptimalLaw(self._settings, self.limits, learned=known, group=tracker.group)
        self._day = int(solar_days(tracker.utc_s, self.site.longitude_deg))
        if kept is not None and kept.day == self._day:
            self._law.resume(kept.travelled_deg, kept.moves)
        # Keep what a later day has used: a machine without a clock of its own is in 1970 until its time is set.
        self._later_day = kept if kept is not None and kept.day > self._day else None
        first = ReadingHistory(self.site, tracker.scan_every_s, self._day, self._law.memory)
        alike = (type(self), self.site, tracker.scan_every_s, self._day, *self._law.site.learned.to_dict().values())
        self._heard_link: ReadingHistory = tracker.common.setdefault(alike, first)

    def to_dict(self) -> dict[str, Any]:
        """Return what was learned, and what the day has used of its budget."""
        kept, later = self._state_to_keep(), self._later_day
        if later is not None:
            more = {"travelled_deg": later.travelled_deg + kept.travelled_deg, "moves": later.moves + kept.moves}
            kept = kept.model_copy(update={"day": later.day, **more})
        return kept.model_dump()

    def shown(self) -> dict[str, dict[str, float]]:
        """Return what was learned apart from what the day has used of its budget."""
        learned = self._state_to_keep().model_dump(exclude={"day"})
        return {"learned": learned, "today": {name: learned.pop(name) for name in ("travelled_deg", "moves")}}

    @property
    def learned(self) -> LearnedSite:
        """What was learned; another object when it has changed."""
        return self._heard_link.learned

    def relearn(self) -> None:
        """Forget what was learned of the site."""
        self._heard_link = self._heard_link.with_learned(self._fresh)

    def turn(self, utc_s: float) -> bool:
        """Begin a new day when the sun has passed its lowest point since the last call, or resume a later one."""
        day = int(solar_days(utc_s, self.site.longitude_deg))
        if day == self._day:
            return False
        before, later = self._state_to_keep(), self._later_day
        self._later_day = before if day < self._day else None
        self._day = day
        self._heard_link = self._heard_link.on(day)
        self._law.reset_budget()
        if later is not None and later.day == day:
            self._law.resume(later.travelled_deg + before.travelled_deg, later.moves + before.moves)
        return True

    def observe(self, reading: Reading) -> None:
        """Take in a scan that has just arrived."""
        self._heard_link = self._heard_link.after(reading)

    def aim(self, now: Moment) -> Aim:
        """Return where the law wants to point, with no target where it wants to stay."""
        utc_s = now.utc_s
        # One call for all instants: it costs little more than one instant.
        ahead = (self._settings.lead_s, self._settings.rest_s)
        instants = np.array([utc_s, *(utc_s + seconds for seconds in ahead), *self._heard_link.waiting_utc_s])
        suns = sun_position(instants, *self.site)
        directions = direction_from_azimuth(suns.azimuth_deg, suns.elevation_deg, self.site[0])
        self._law.memory = self._heard_link.memory(directions[3:])
        sun = SunPosition(*(float(values[0]) for values in suns))
        if now.heading is None:
            return Aim(
                azimuth_deg=math.nan,
                elevation_deg=math.nan,
                sun=sun,
                target=None,
                why="where the tracker stands is not known",
            )
        choice = self._law.choose(*now.heading, directions[1], share_of_daylight_left(utc_s, *self.site), directions[2])
        azimuth, elevation = azimuth_from_direction(choice.vector, self.site[0])
        moves = bool(choice.move)
        hindered = self._hindrance(choice, directions[1])
        why = move_reason(float(choice.gain_w_m2), float(choice.price_w_m2), moves=moves, hindered=hindered)
        target = Angles(float(choice.a_deg), float(choice.b_deg)) if moves else None
        light = self._law.light
        return Aim(
            azimuth_deg=float(azimuth),
            elevation_deg=float(elevation),
            sun=sun,
            target=target,
            why=why,
            beam_w_m2=float(light.beam),
            diffuse_w_m2=float(light.uniform),
            albedo=float(self.learned.albedo),
        )

    def affords(self, distance_deg: float) -> bool:
        """Whether one more move of this length [deg] stays within the day's budget."""
        return bool(self._law.affords(distance_deg))

    def book(self, distance_deg: float) -> None:
        """Charge a move that was ordered to the day's budget."""
        self._law.book(distance_deg)

    def estimates(self, faces: Array, sun: Array, learned: LearnedSite) -> Estimates:
        """Return the light that each reading shows by itself."""
        readings = SiteLearning(learned=learned).corrected(faces)
        usable = usable_faces(readings, sun)
        light = light_from_faces(readings, sun, learned.albedo, usable)
        good = (usable.sum(axis=-1) >= FACES_NEEDED) & (sun[..., 2] > 0.0)
        return Estimates(
            np.where(good, light.beam, np.nan),
            np.where(good, light.uniform, np.nan),
            np.full(len(faces), float(learned.albedo)),
        )

    def _hindrance(self, choice: Choice, sun_ahead: Array) -> str:
        """Return what forbids every move, or what forbids this one although it pays; empty if nothing does."""
        if not self._law.affords(0.0):
            return _BUDGET_FORBIDS
        if choice.move or not choice.gain_w_m2 > choice.price_w_m2:
            return ""
        return _BUDGET_FORBIDS if sun_ahead[2] > 0.0 else "the sun is about to set"

    def _state_to_keep(self) -> OptimalState:
        return OptimalState(
            **self.learned.to_dict(),
            day=self._day,
            travelled_deg=float(self._law.travelled_deg),
            moves=round(float(self._law.moves)),
        )


SETTINGS = LiveOptimalSettings
build = LiveOptimal


def steer(
    settings: LiveOptimalSettings,
    weather: DaylightWeather,
    faces: Array,
    limits: Limits,
    start: LearnedSite | None = None,
    group: TrackerGroup | None = None,
) -> Steer:
    """Run the law on many days at once; what each day teaches of the site serves the days after it.

    Parameters
    ----------
    settings
        The law's; the albedo to begin with is that of `start`.
    weather, faces, limits
        The days, the faces under their sky [W/m2], shape (n, 4), and the tracker's range.
    start
        What is known on the first morning.
    group
        The tracker with its neighbours; None for a tracker alone.
    """
    plan = settings.optimal_settings()
    days = weather.shape[1]
    grid = weather.gridded(faces, np.nan)
    sun = weather.gridded(weather.sun, 0.0)
    ahead, later = (
        weather.gridded(sun_direction(weather.utc_s + seconds, *weather.site), 0.0)
        for seconds in (plan.lead_s, plan.rest_s)
    )
    left = daylight_left(weather)
    law = OptimalLaw(plan, limits, (days,), learned_by_day(weather, faces, start), group)

    def next_pose(step: int, a: Array, b: Array) -> tuple[Array, Array]:
        if step == 0:
            return a, b
        law.observe(grid[step - 1], sun[step - 1], weather.step_s)
        choice = law.decide(a, b, ahead[step - 1], left[step - 1], later[step - 1])
        return choice.a_deg, choice.b_deg

    return next_pose


def daylight_left(weather: DaylightWeather) -> Array:
    """Return which share of each day's daylight is still to come after each step, shape (steps, days), 0..1."""
    light = weather.gridded(np.ones(len(weather.utc_s)), 0.0)
    left: Array = 1.0 - np.cumsum(light, axis=0) / np.maximum(light.sum(axis=0), 1.0)
    return left


def learned_by_day(weather: DaylightWeather, faces: Array, start: LearnedSite | None = None) -> LearnedSite:
    """Return what is known of the site on the morning of each day, arrays of shape (days,).

    What the faces teach does not depend on where the tracker points, so this can be known before it is driven.
    """
    site = SiteLearning(learned=start)
    known = [site.learned]
    order = np.argsort(weather.utc_s)
    ends = np.cumsum(np.bincount(weather.day))[:-1]
    for rows in np.split(order, ends)[:-1]:
        sun = weather.sun[rows]
        corrected = site.corrected(faces[rows])
        usable = usable_faces(corrected, sun)
        beam = light_from_faces(corrected, sun, site.learned.albedo, usable).beam
        site.observe(corrected, sun, usable, beam, weather.step_s)
        site.end_of_day()
        known.append(site.learned)
    return LearnedSite(*(np.array([float(getattr(each, name)) for each in known]) for name in LearnedSite.__slots__))
