"""What the module has received today, beside a chronometric tracker and the best pose, by the light on the cube."""

import asyncio
import logging
import math
from collections.abc import Callable

import numpy as np
from pydantic import BaseModel, ConfigDict, Field

from daemon.base.clock import LEAST_SHOWN_UTC_S, MOST_SHOWN_UTC_S
from daemon.base.records import Pose, Quality, Scan
from daemon.base.state import StateFile, StateFolder, UnreadableStateError, roll_over_day
from daemon.tracker.phase import ALONE, Phase
from solar.ephemeris import Site, solar_days, sun_direction
from solar.frames import Limits
from solar.received import received_irradiance

log = logging.getLogger("heliocube.received")

FILE_NAME = "received.json"

_MEAN_S = 60.0
# Means are taken in together: then each costs a fraction of a millisecond.
_MOST_WAITING = 15
# No reading stands for longer than this: the slowest cube reads once a minute, now and then a little late.
_LONGEST_S = 90.0
_J_PER_KWH = 3.6e6

_NonNegative = Field(default=0.0, ge=0.0, allow_inf_nan=False)


class Insolation(BaseModel):
    """What planes have received on a solar day, over the time that is known; `day` is counted from 1970.

    Attributes
    ----------
    since_utc_s
        The first instant that counts.
    known_s
        The time that counts: with the sun up, a pose, and three good faces.
    actual_kwh_m2, chronometric_kwh_m2, best_kwh_m2
        As :class:`solar.received.ReceivedIrradiance`, over that time.
    """

    model_config = ConfigDict(frozen=True, extra="forbid", strict=True)

    day: int
    since_utc_s: float | None = Field(default=None, allow_inf_nan=False, ge=LEAST_SHOWN_UTC_S, le=MOST_SHOWN_UTC_S)
    known_s: float = _NonNegative
    actual_kwh_m2: float = _NonNegative
    chronometric_kwh_m2: float = _NonNegative
    best_kwh_m2: float = _NonNegative

    @property
    def gain(self) -> float:
        """Share that the tracker has received more than a chronometric one; NaN where that has received nothing."""
        return self.actual_kwh_m2 / self.chronometric_kwh_m2 - 1.0 if self.chronometric_kwh_m2 > 0.0 else math.nan


class ReceivedToday:
    """Counts through a solar day, minute by minute, what three planes receive.

    The irradiance is that of :func:`solar.received.received_irradiance`.

    Parameters
    ----------
    site, limits
        Of the tracker.
    albedo
        Returns the albedo of the ground around the cube, as far as it is known.
    folder
        Where the count is kept over a restart.
    utc_s
        The time of construction [s].
    phase
        When its turn is among the trackers of the process.
    file_name
        Of the kept count.
    """

    def __init__(
        self,
        site: Site,
        limits: Limits,
        albedo: Callable[[], float],
        folder: StateFolder,
        utc_s: float,
        phase: Phase = ALONE,
        file_name: str = FILE_NAME,
    ) -> None:
        self._phase = phase
        self._site, self._limits, self._albedo = site, limits, albedo
        self._file = StateFile(folder, file_name, Insolation, log, "the light received today")
        self._today = self._load() or Insolation(day=self.day_of(utc_s))
        self._day = self._today.day
        self._later_day: Insolation | None = None
        self._newest_s = -math.inf
        self._waiting_means: list[tuple[float, float, list[float]]] = []
        self._unsaved = 0
        self._begin_mean()

    def add(self, scan: Scan, pose: Pose | None, utc_s: float) -> None:
        """Take in a scan that has just arrived, at this UTC [s], and where the tracker stands; None: not known."""
        elapsed_s = scan.time_monotonic_s - self._newest_s
        self._newest_s = scan.time_monotonic_s
        if self.day_of(utc_s) != self._day:
            self._day = self.day_of(utc_s)
            self._begin_mean()
            self._in_turn(self._end_day)
        if not elapsed_s <= _LONGEST_S:
            # After a gap nobody knows what the light was.
            self._begin_mean()
            return
        values = [face.irradiance_w_m2 if face.quality is Quality.OK else math.nan for face in scan.faces]
        values += [math.nan, math.nan] if pose is None else [pose.a_deg, pose.b_deg]
        for place, value in enumerate(values):
            if not math.isnan(value):
                self._sums[place] += elapsed_s * value
                self._seconds[place] += elapsed_s
        self._elapsed_s += elapsed_s
        if self._elapsed_s >= _MEAN_S - 1e-3:
            self._end_mean(utc_s)

    @property
    def today_without_pending(self) -> Insolation:
        """The count without the minutes that wait to be taken in."""
        return self._today if self._today.day == self._day else Insolation(day=self._day)

    @property
    def today(self) -> Insolation:
        """The count so far; a started minute does not count yet."""
        self._end_day()
        self._add_waiting_means()
        return self._today

    def _begin_mean(self) -> None:
        self._elapsed_s = 0.0
        self._sums, self._seconds = [0.0] * 6, [0.0] * 6

    def _end_mean(self, utc_s: float) -> None:
        self._end_day()
        pairs = zip(self._sums, self._seconds, strict=True)
        means = [total / seconds if seconds > 0.0 else math.nan for total, seconds in pairs]
        self._waiting_means.append((utc_s - self._elapsed_s, self._elapsed_s, means))
        self._begin_mean()
        if len(self._waiting_means) == _MOST_WAITING:
            self._in_turn(self._add_waiting_means)

    def _in_turn(self, work: Callable[[], None]) -> None:
        """Work at once or during the next mean: all trackers of a process would do this at the same scan."""
        if self._phase.place == 0:
            work()
        else:
            asyncio.get_running_loop().call_later(self._phase.delay_s(_MEAN_S), work)

    def _end_day(self) -> None:
        """Take in the means that wait of the day that has ended, and begin the next or go on with a later one."""
        if self._today.day == self._day:
            return
        self._add_waiting_means()
        # With a clock that was years behind, the sun was reckoned at a wrong place: that count is no part of this day.
        fresh = Insolation(day=self._day)
        self._today, self._later_day = roll_over_day(self._day, self._today, self._later_day, fresh)

    def _add_waiting_means(self) -> None:
        """Add all means that wait, in one call: it costs little more than a single one."""
        if not self._waiting_means:
            return
        begun, lasting, means = (np.array(column) for column in zip(*self._waiting_means, strict=True))
        self._waiting_means.clear()
        sun = sun_direction(begun + lasting / 2.0, *self._site)
        planes = received_irradiance(means[:, :4], sun, means[:, 4], means[:, 5], self._limits, self._albedo())
        known = np.isfinite(planes.actual_w_m2)
        if known.any():
            self._add(float(begun[known][0]), lasting[known], [plane[known] for plane in planes])

    def _add(self, since_utc_s: float, lasting_s: np.ndarray, planes_w_m2: list[np.ndarray]) -> None:
        today = self._today
        actual, chronometric, best = (float((plane * lasting_s).sum()) / _J_PER_KWH for plane in planes_w_m2)
        self._today = Insolation(
            day=today.day,
            since_utc_s=since_utc_s if today.since_utc_s is None else today.since_utc_s,
            known_s=today.known_s + float(lasting_s.sum()),
            actual_kwh_m2=today.actual_kwh_m2 + actual,
            chronometric_kwh_m2=today.chronometric_kwh_m2 + chronometric,
            best_kwh_m2=today.best_kwh_m2 + best,
        )
        self._unsaved += len(lasting_s)
        if self._unsaved >= _MOST_WAITING and self._later_day is None:
            self._unsaved = 0
            self._file.save(self._today)

    def day_of(self, utc_s: float) -> int:
        """Count the solar days from midnight to midnight."""
        return int(solar_days(utc_s, self._site.longitude_deg))

    def _load(self) -> Insolation | None:
        try:
            return self._file.load()
        except UnreadableStateError as error:
            log.warning("%s: the light received today is counted from zero again", error)
            return None
