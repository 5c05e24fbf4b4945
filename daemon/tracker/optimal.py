"""The law `optimal` as the service runs it: fed by scans, asked by control, with a memory that outlives the process."""

import logging
import math
from pathlib import Path
from typing import Annotated

import numpy as np
from pydantic import BaseModel, ConfigDict, Field

from daemon.base.files import replace_file
from daemon.base.records import Estimate, Quality, Scan, Target
from daemon.config.sections import Law, SiteSettings
from daemon.tracker.pointing import Aim
from solar.ephemeris import DAY_S, SunDay, SunPosition, sun_day, sun_direction, sun_position
from solar.frames import Array, Limits, azimuth_from_direction, direction_from_azimuth
from solar.laws.light import usable_faces
from solar.laws.optimal import OptimalLaw, OptimalSettings
from solar.laws.site import ALBEDO_RANGE, GAIN_RANGE, Learned

log = logging.getLogger("heliocube.optimal")

_FILE_NAME = "learned.json"

Albedo = Annotated[float, Field(ge=ALBEDO_RANGE[0], le=ALBEDO_RANGE[1], allow_inf_nan=False)]
Gain = Annotated[float, Field(ge=GAIN_RANGE[0], le=GAIN_RANGE[1], allow_inf_nan=False)]

DECIDE_EVERY_S = 60.0
FACES_NEEDED = 3

_MEAN_S = 15.0
# No reading stands for longer than this; a cube that scans more slowly leaves the rest open.
_LONGEST_S = 60.0
# Means that nobody asks for in some mode without decisions are taken in this many at a time.
_MOST_WAITING = 40


class Kept(BaseModel):
    """Albedo and relative gains of the vertical faces, and the budget used on a solar day (counted from 1970)."""

    model_config = ConfigDict(frozen=True, extra="forbid", strict=True)

    albedo: Albedo
    gain_east: Gain = 1.0
    gain_south: Gain = 1.0
    gain_west: Gain = 1.0
    day: int
    travelled_deg: float = Field(default=0.0, ge=0.0, allow_inf_nan=False)
    moves: int = Field(default=0, ge=0)

    @property
    def learned(self) -> Learned:
        """What the science makes of it."""
        return Learned(self.albedo, self.gain_east, self.gain_south, self.gain_west)


class LearnedFile:
    """A small file beside the store; without a folder what is learned lives in memory only.

    Parameters
    ----------
    directory
        Of the file, or None.
    """

    def __init__(self, directory: Path | None) -> None:
        self._path = None if directory is None else directory / _FILE_NAME

    def load(self) -> Kept | None:
        """Return what was kept, or None; a file that cannot be used is told and learning begins anew."""
        if self._path is None:
            return None
        try:
            return Kept.model_validate_json(self._path.read_text())
        except (FileNotFoundError, NotADirectoryError):
            return None
        except (OSError, ValueError):
            log.warning("%s cannot be used: what was learned of the site is learned anew", self._path)
            return None

    def save(self, kept: Kept) -> None:
        """Replace the file as a whole; a disk that fails is told and does not hinder tracking."""
        if self._path is None:
            return
        try:
            replace_file(self._path, kept.model_dump_json())
        except OSError as error:
            log.warning("%s cannot be written (%s): a restart would forget what was learned", self._path, error)


class OptimalPointing:
    """Keeps one :class:`solar.laws.optimal.OptimalLaw` informed and asks it where to point.

    Parameters
    ----------
    site
        Where the tracker stands.
    settings
        Of the law.
    limits
        Of the tracker.
    scan_every_s
        What the first reading after a gap stands for [s].
    utc_s
        The time of construction [s].
    file
        Keeps what was learned and the budget that was used.
    """

    def __init__(
        self, site: SiteSettings, settings: Law, limits: Limits, scan_every_s: float, utc_s: float, file: LearnedFile
    ) -> None:
        self._site = (site.latitude_deg, site.longitude_deg, site.altitude_m)
        self._scan_every_s = scan_every_s
        self._file = file
        self._fresh = Learned(min(max(settings.albedo, ALBEDO_RANGE[0]), ALBEDO_RANGE[1]))
        self._settings = OptimalSettings(
            thrift=settings.thrift,
            travel_per_day_deg=settings.travel_per_day_deg,
            moves_per_day=settings.moves_per_day,
        )
        kept = file.load()
        self._law = OptimalLaw(self._settings, limits, learned=self._fresh if kept is None else kept.learned)
        self._day = self._day_of(utc_s)
        if kept is not None and kept.day == self._day:
            self._law.resume(kept.travelled_deg, kept.moves)
        self._sun_day: SunDay | None = None
        self._newest_s = -math.inf
        self._waiting: list[tuple[float, float, list[float]]] = []
        self._begin_mean()

    @property
    def kept(self) -> Kept:
        """What was learned, and what the day has used of its budget."""
        return Kept(
            **self._law.site.learned.to_dict(),
            day=self._day,
            travelled_deg=float(self._law.travelled_deg),
            moves=round(float(self._law.moves)),
        )

    @property
    def learned(self) -> Learned:
        """What was learned; another object when it has changed."""
        return self._law.site.learned

    def relearn(self) -> None:
        """Forget what was learned of the site."""
        self._waiting.clear()
        self._begin_mean()
        self._law.site.reset()
        self._law.site.learned = self._fresh
        self._file.save(self.kept)

    def turn(self, utc_s: float) -> None:
        """Begin a new day when the sun has passed its lowest point since the last call."""
        day = self._day_of(utc_s)
        if day == self._day:
            return
        self._take_in()
        self._day = day
        self._law.new_day()
        self._file.save(self.kept)

    def receive(self, scan: Scan, utc_s: float) -> None:
        """Take in a scan that has just arrived, at this UTC [s]."""
        elapsed_s = scan.time_monotonic_s - self._newest_s
        self._newest_s = scan.time_monotonic_s
        if not (elapsed_s <= _LONGEST_S):
            elapsed_s = self._scan_every_s
        self._elapsed_s += elapsed_s
        self._middle += elapsed_s * utc_s
        sums, seconds = self._sums, self._seconds
        for place, face in enumerate(scan.faces):
            if face.quality is Quality.OK:
                sums[place] += elapsed_s * face.irradiance_w_m2
                seconds[place] += elapsed_s
        if self._elapsed_s >= _MEAN_S - 1e-3:
            self._end_mean()

    def aim(self, a_deg: float, b_deg: float, utc_s: float) -> Aim:
        """Return where the law wants to point, with no target where it wants to stay.

        Parameters
        ----------
        a_deg, b_deg
            Where the tracker stands or is on its way to.
        utc_s
            Now [s].
        """
        # One call for all instants: it costs little more than one instant.
        instants = np.array([utc_s, utc_s + self._settings.lead_s, *(mean[0] for mean in self._waiting)])
        sun = sun_position(instants, *self._site)
        directions = direction_from_azimuth(sun.azimuth_deg, sun.elevation_deg, self._site[0])
        self._take_in(directions[2:])
        choice = self._law.choose(a_deg, b_deg, directions[1], self._daylight_left(utc_s))
        azimuth, elevation = azimuth_from_direction(choice.vector, self._site[0])
        target, why = None, f"optimal: {float(choice.gain_w_m2):.1f} W/m2 to gain, not worth a move"
        if choice.move:
            why = f"optimal: {float(choice.gain_w_m2):.1f} W/m2 to gain"
            target = Target(float(choice.a_deg), float(choice.b_deg), why)
        now = SunPosition(*(float(values[0]) for values in sun))
        return Aim(float(azimuth), float(elevation), now, target, why, self.estimate)

    @property
    def estimate(self) -> Estimate:
        """The light by the newest mean, NaN where it shows nothing."""
        light = self._law.light
        return Estimate(float(light.beam), float(light.uniform), float(self._law.site.learned.albedo))

    def affords(self, distance_deg: float) -> bool:
        """Whether one more move of this length [deg] stays within the day's budget."""
        return bool(self._law.affords(distance_deg))

    def book(self, distance_deg: float) -> None:
        """Take a move that was ordered out of the day's budget, and note that on disk."""
        self._law.book(distance_deg)
        self._file.save(self.kept)

    def believes_zenith(self, faces_w_m2: tuple[float, float, float, float], utc_s: float) -> bool:
        """Whether the zenith face of a mean [W/m2] can be believed beside the other three."""
        return bool(usable_faces(faces_w_m2, sun_direction(utc_s, *self._site))[3])

    def _day_of(self, utc_s: float) -> int:
        """Count the solar days from midnight to midnight."""
        return int((utc_s + self._site[1] * DAY_S / 360.0) // DAY_S)

    def _begin_mean(self) -> None:
        self._elapsed_s = self._middle = 0.0
        self._sums = [0.0] * 4
        self._seconds = [0.0] * 4

    def _end_mean(self) -> None:
        faces = [
            total / seconds if seconds > 0.0 else math.nan
            for total, seconds in zip(self._sums, self._seconds, strict=True)
        ]
        self._waiting.append((self._middle / self._elapsed_s, self._elapsed_s, faces))
        self._begin_mean()
        if len(self._waiting) >= _MOST_WAITING:
            self._take_in()

    def _take_in(self, sun: Array | None = None) -> None:
        """Tell the law all means that wait, in one call: it costs little more than a single one."""
        if not self._waiting:
            return
        utc_s, elapsed_s, faces = zip(*self._waiting, strict=True)
        self._waiting.clear()
        if sun is None:
            sun = sun_direction(np.array(utc_s), *self._site)
        self._law.observe(np.array(faces), sun, np.array(elapsed_s))

    def _daylight_left(self, utc_s: float) -> float:
        if self._sun_day is None or not (abs(self._sun_day.noon_utc_s - utc_s) < 0.51 * DAY_S):
            self._sun_day = sun_day(utc_s, *self._site)
        day = self._sun_day
        if day.sunrise_utc_s is None or day.sunset_utc_s is None:
            rise_s, set_s = day.noon_utc_s - DAY_S / 2.0, day.noon_utc_s + DAY_S / 2.0
        else:
            rise_s, set_s = day.sunrise_utc_s, day.sunset_utc_s
        return min(max((set_s - utc_s) / (set_s - rise_s), 0.0), 1.0)
