"""Turn a law into what steers the trackers of many days in the benchmark (:mod:`solar.energy`)."""

from collections.abc import Callable
from datetime import UTC, datetime

import numpy as np

from solar.energy import DaylightWeather, Steer
from solar.ephemeris import sun_direction
from solar.frames import Angles, Array, Limits, angles_within
from solar.laws.answers import checked_aim
from solar.laws.law import Faces, Law, Moment, Reading, TrackerFacts
from solar.rows.backtrack import backtracked_poses
from solar.rows.group import TrackerGroup

PAPER_EVERY_S = 300.0
PAPER_MEAN_S = 120.0


class LawFailedError(RuntimeError):
    """A law raised an error, or its answer was invalid, as the cause says; the text is the day, UTC."""


def known_pose_or_present(a_deg: Array, b_deg: Array, a_now: Array, b_now: Array) -> tuple[Array, Array]:
    """Return the first pose [deg] where it is known, and the second one elsewhere."""
    known = np.isfinite(a_deg + b_deg)
    return np.where(known, a_deg, a_now), np.where(known, b_deg, b_now)


def steer_towards(weather: DaylightWeather, directions: Array, limits: Limits, late_steps: int = 0) -> Steer:
    """Point along the direction of each instant, shape (n, 3), at once or `late_steps` late."""
    a_deg, b_deg = (weather.gridded(angle, np.nan) for angle in angles_within(directions, limits))

    def steer(step: int, a: Array, b: Array) -> tuple[Array, Array]:
        shown = step - late_steps
        return known_pose_or_present(a_deg[shown], b_deg[shown], a, b) if shown >= 0 else (a, b)

    return steer


def steer_by_mean(
    weather: DaylightWeather,
    faces: Array,
    limits: Limits,
    direction: Callable[[Array], Array],
    every_s: float = PAPER_EVERY_S,
    mean_s: float = PAPER_MEAN_S,
    group: TrackerGroup | None = None,
) -> Steer:
    """Run the paper's cycle: every `every_s`, from the mean of the last `mean_s`, in force from the next step on.

    Parameters
    ----------
    weather, faces
        The days, and the faces under their sky [W/m2], shape (n, 4).
    limits
        Of the tracker.
    direction
        Returns the directions, shape (steps, days, 3), for means (steps, days, 4); NaN where there is none.
    group
        The tracker with its neighbours, out of whose shade it turns; None for a tracker alone.
    """
    a_deg, b_deg = angles_within(direction(_means(weather, faces, mean_s)), limits)
    every = max(round(every_s / weather.step_s), 1)
    if group is not None:
        asked = slice(every - 1, None, every)
        rests_s = every * weather.step_s
        suns = (weather.sun, sun_direction(weather.utc_s + rests_s, *weather.site))
        instants = [weather.gridded(sun, np.nan)[asked] for sun in suns]
        a_deg[asked], b_deg[asked] = backtracked_poses(group, instants, a_deg[asked], b_deg[asked], limits)

    def steer(step: int, a: Array, b: Array) -> tuple[Array, Array]:
        return (
            known_pose_or_present(a_deg[step - 1], b_deg[step - 1], a, b) if step > 0 and step % every == 0 else (a, b)
        )

    return steer


def steer_by_readings(
    build: Callable[[TrackerFacts], Law], weather: DaylightWeather, faces: Array, limits: Limits
) -> Steer:
    """Run any law as the service would, a law of its own for each day; nothing is learned from one day for the next.

    Parameters
    ----------
    build
        Returns a law for a tracker.
    weather, faces, limits
        As for :func:`steer_by_mean`.

    Raises
    ------
    LawFailedError
        While it steers.
    """
    utc_s = weather.gridded(weather.utc_s, np.nan)
    readings = weather.gridded(faces, np.nan)
    means = _means(weather, faces, PAPER_MEAN_S)
    days = [_Day(build, weather, limits, float(np.nanmin(column))) for column in utc_s.T]

    def steer(step: int, a: Array, b: Array) -> tuple[Array, Array]:
        if step == 0:
            return a, b
        wanted_a, wanted_b = a.copy(), b.copy()
        for number, day in enumerate(days):
            now_s = float(utc_s[step - 1, number])
            if np.isfinite(now_s):
                heading = Angles(float(a[number]), float(b[number]))
                try:
                    target = day.steer(step, now_s, readings[step - 1, number], means[step - 1, number], heading)
                except Exception as error:
                    raise LawFailedError(f"{datetime.fromtimestamp(now_s, UTC):%Y-%m-%d}") from error
                wanted_a[number], wanted_b[number] = target
        return wanted_a, wanted_b

    return steer


class _Day:
    """One law on one day."""

    def __init__(
        self, build: Callable[[TrackerFacts], Law], weather: DaylightWeather, limits: Limits, begins_utc_s: float
    ) -> None:
        self._limits = limits
        self._law = build(
            TrackerFacts(
                site=weather.site,
                limits=limits,
                scan_every_s=weather.step_s,
                decide_every_s=PAPER_EVERY_S,
                utc_s=begins_utc_s,
            )
        )
        self._decide_every_steps = max(round(self._law.decide_every_s / weather.step_s), 1)

    def steer(self, step: int, utc_s: float, reading: Array, mean: Array, heading: Angles) -> Angles:
        law = self._law
        law.observe(Reading(utc_s, utc_s, _face_tuple(reading)))
        if step % self._decide_every_steps:
            return heading
        good = int(np.isfinite(mean).sum()) >= law.faces_needed
        target = checked_aim(law.aim(Moment(utc_s, _face_tuple(mean) if good else None, heading)), self._limits).target
        if target is None:
            return heading
        distance_deg = abs(target.a_deg - heading.a_deg) + abs(target.b_deg - heading.b_deg)
        if not law.affords(distance_deg):
            return heading
        law.book(distance_deg)
        return target


def _face_tuple(values: Array) -> Faces:
    east, south, west, zenith = values.tolist()
    return east, south, west, zenith


def _means(weather: DaylightWeather, faces: Array, mean_s: float) -> Array:
    """Return the mean of each face over the last `mean_s`, shape (steps, days, 4); NaN where a reading is missing."""
    grid = weather.gridded(faces, np.nan)
    count = max(round(mean_s / weather.step_s), 1)
    mean = grid.copy()
    for back in range(1, count):
        mean[back:] += grid[:-back]
    mean[: count - 1] = np.nan
    result: Array = mean / count
    return result
