"""What a pointing law harvests on measured weather: the benchmark's engine, whole days side by side.

Days do not depend on each other (a tracker starts each at the night position), so they are the array's last axis and
the minutes of the solar day its first: a year is stepped through in as many steps as a day has minutes.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from solar.ephemeris import DAY_S, Site, extraterrestrial_dni, sun_direction
from solar.frames import FACE_NORMALS, Array, Limits, bounded, normal_from_angles
from solar.skies.allweather import all_weather_sky
from solar.skies.cie import cie_sky
from solar.skies.sky import SKY_MODELS, sky

ALL_WEATHER, CIE = "perez1993", "cie"
SKIES = (*SKY_MODELS, ALL_WEATHER, CIE)
DAY_TYPES = ("clear", "variable", "cloudy", "overcast")
_DAY_TYPE_BOUNDS = (0.3, 0.8, 0.97)
_NIGHT_A_DEG, _NIGHT_B_DEG = 0.0, 90.0


class IrradianceSource(Protocol):
    """A sky over n instants that shines on planes."""

    def irradiance_on(self, normals: ArrayLike, albedo: float = ...) -> Array:
        """Return the plane-of-array irradiance [W/m2] of normals (..., n, 3)."""


@dataclass(frozen=True, slots=True)
class DaylightWeather:
    """The n instants with the sun up and irradiance known, and the days they fall in.

    Attributes
    ----------
    utc_s, sun
        Instants, shape (n,), and unit vectors to the apparent sun, shape (n, 3).
    dni_w_m2, dhi_w_m2, extra_w_m2
        Direct normal, diffuse horizontal and extraterrestrial normal irradiance, shape (n,).
    step_s
        Time between instants; each stands for that long.
    step, day
        Place of each instant in arrays of shape (steps, days), shape (n,).
    site
        Where.
    first_day
        The first solar day, in days since 1970-01-01.
    """

    utc_s: Array
    sun: Array
    dni_w_m2: Array
    dhi_w_m2: Array
    extra_w_m2: Array
    step_s: float
    step: NDArray[np.intp]
    day: NDArray[np.intp]
    site: Site
    first_day: int

    @property
    def shape(self) -> tuple[int, int]:
        """Steps of the longest stretch of daylight in the solar day, and days."""
        return int(self.step.max()) + 1, int(self.day.max()) + 1

    def gridded(self, values: ArrayLike, missing: float) -> Array:
        """Return values of shape (n, ...) as (steps, days, ...), with `missing` where there is no weather."""
        flat = np.asarray(values, dtype=np.float64)
        grid = np.full((*self.shape, *flat.shape[1:]), missing)
        grid[self.step, self.day] = flat
        return grid

    def by_day(self, power_w_m2: Array) -> Array:
        """Return the insolation [kWh/m2] of each day, shape (days,), from irradiance of shape (n,)."""
        total: Array = np.bincount(self.day, power_w_m2, self.shape[1]).astype(np.float64)
        return total * (self.step_s / 3.6e6)

    def day_types(self) -> NDArray[np.intp]:
        """Return each day's type, shape (days,): index into DAY_TYPES by the daily diffuse fraction; -1 if no light."""
        diffuse = self.by_day(self.dhi_w_m2)
        total = self.by_day(self.dni_w_m2 * self.sun[:, 2] + self.dhi_w_m2)
        fraction = np.divide(diffuse, total, out=np.zeros_like(total), where=total > 0.0)
        return np.where(total > 0.0, np.digitize(fraction, _DAY_TYPE_BOUNDS), -1)

    def whole_days(self) -> float:
        """Return how many days with light the weather covers.

        A day counts by the share of its daylight that is known: the first and the last are seldom whole.
        """
        lit = np.flatnonzero(self.day_types() >= 0)
        known = np.bincount(self.day)[lit]
        per_day, east = round(DAY_S / self.step_s), round(self.site.longitude_deg * 240.0 / self.step_s)
        instants_s = self.step_s * ((self.first_day + lit)[:, None] * per_day - east + np.arange(per_day, dtype=float))
        daylight = np.count_nonzero(sun_direction(instants_s, *self.site)[..., 2] > 0.0, axis=1)
        return float((known / daylight).sum())


def arrange_daylight(
    utc_s: Array, dni_w_m2: Array, dhi_w_m2: Array, site: Site, step_s: float = 60.0
) -> DaylightWeather:
    """Return the daylight part of weather at instants `utc_s`, multiples of `step_s`, in solar days of the site.

    NaN is missing weather; negative values count as zero. Raises `ValueError` if no instant has sun and weather,
    or if none of those has any light.
    """
    sun = sun_direction(utc_s, *site)
    used = np.isfinite(dni_w_m2) & np.isfinite(dhi_w_m2) & (sun[:, 2] > 0.0)
    if not used.any():
        raise ValueError("there is no record with the sun above the horizon and dni and dhi present")
    if not np.any((dni_w_m2[used] > 0.0) | (dhi_w_m2[used] > 0.0)):
        raise ValueError("no record has any light while the sun is above the horizon: compare its times with the site")
    utc_s, sun = utc_s[used], sun[used]
    steps = np.round(utc_s / step_s).astype(np.int64)
    per_day = round(DAY_S / step_s)
    solar = steps + round(site.longitude_deg * 240.0 / step_s)
    day, step = solar // per_day, solar % per_day
    return DaylightWeather(
        utc_s=utc_s,
        sun=sun,
        dni_w_m2=np.maximum(dni_w_m2[used], 0.0),
        dhi_w_m2=np.maximum(dhi_w_m2[used], 0.0),
        extra_w_m2=extraterrestrial_dni(utc_s),
        step_s=step_s,
        step=step - step.min(),
        day=day - day.min(),
        site=site,
        first_day=int(day.min()),
    )


def build_sky(weather: DaylightWeather, model: str) -> IrradianceSource:
    """Return the weather's sky under one of SKIES; `ValueError` for another name."""
    if model == ALL_WEATHER:
        return all_weather_sky(weather.sun, weather.dni_w_m2, weather.dhi_w_m2, weather.extra_w_m2)
    if model == CIE:
        return cie_sky(weather.sun, weather.dni_w_m2, weather.dhi_w_m2, weather.utc_s)
    for known in SKY_MODELS:
        if model == known:
            return sky(known, weather.sun, weather.dni_w_m2, weather.dhi_w_m2, weather.extra_w_m2)
    raise ValueError(f"there is no sky {model!r}; choose one of {', '.join(SKIES)}")


def face_irradiances(light: IrradianceSource, albedo: float) -> Array:
    """Return what the cube's faces east, south, west, zenith read [W/m2], shape (n, 4)."""
    return np.stack([light.irradiance_on(normal[None, :], albedo) for normal in FACE_NORMALS], axis=-1)


def best_possible(weather: DaylightWeather, light: IrradianceSource, limits: Limits, albedo: float) -> Array:
    """Return the irradiance [W/m2] at the best (A, B) of every instant, shape (n,): no controller can beat it.

    Found by search: a grid of 10 by 7.5 deg, then a pattern search down to 0.25 deg.
    """
    count = len(weather.utc_s)
    best, best_a, best_b = np.full(count, -np.inf), np.zeros(count), np.zeros(count)

    def attempt(a_deg: Array, b_deg: Array) -> None:
        found = light.irradiance_on(normal_from_angles(a_deg, b_deg), albedo)
        better = found > best
        np.copyto(best, found, where=better)
        np.copyto(best_a, a_deg, where=better)
        np.copyto(best_b, b_deg, where=better)

    for a_deg in np.linspace(limits.a_min_deg, limits.a_max_deg, 11):
        for b_deg in np.linspace(limits.b_min_deg, limits.b_max_deg, 11):
            attempt(np.full(1, a_deg), np.full(1, b_deg))
    stride = 4.0
    while stride >= 0.25:
        for along_a, along_b in ((1, 0), (-1, 0), (0, 1), (0, -1)):
            a_deg = np.clip(best_a + along_a * stride, limits.a_min_deg, limits.a_max_deg)
            b_deg = np.clip(best_b + along_b * stride, limits.b_min_deg, limits.b_max_deg)
            attempt(a_deg, b_deg)
        stride /= 2.0
    return best


@dataclass(frozen=True, slots=True)
class Drive:
    """How the simulated tracker moves: A first, then B, at one constant speed.

    Attributes
    ----------
    speed_deg_per_s
        Of either axis; infinite for ideal moves.
    deadband_deg
        Targets nearer than this (A and B added) are not driven to.
    samples
        Poses per step that the irradiance is averaged over.
    """

    speed_deg_per_s: float = 0.9
    deadband_deg: float = 0.6
    samples: int = 6


@dataclass(frozen=True, slots=True)
class Harvest:
    """What one law did.

    Attributes
    ----------
    energy_kwh_m2, travel_deg, moves
        Per day, shape (days,). Travel adds A and B, from the night position at sunrise to the last pose of the day.
    return_deg
        From that last pose back to the night position.
    """

    energy_kwh_m2: Array
    travel_deg: Array
    moves: Array
    return_deg: Array


Steer = Callable[[int, Array, Array], tuple[Array, Array]]
ShadeLoss = Callable[[Array, Array], Array]
"""Returns the irradiance [W/m2] that planes at angles A and B [deg] lose at each instant; all of shape (n,)."""


def steer_fixed_tilt(weather: DaylightWeather, tilt_deg: float) -> Steer:
    """Stand still: a plane that never moves after dawn, tilted towards the equator; the limits do not hold for it."""
    days = weather.shape[1]
    return lambda _step, _a, _b: (np.zeros(days), np.full(days, 90.0 - tilt_deg))


def harvest(
    weather: DaylightWeather,
    light: IrradianceSource,
    albedo: float,
    drive: Drive,
    steer: Steer,
    taken: ShadeLoss | None = None,
) -> Harvest:
    """Drive a tracker through every day at once and add up what its plane receives.

    Parameters
    ----------
    weather, light, albedo
        The sky and the ground.
    drive
        The tracker.
    steer
        Called before each step with its number and the target poses [deg], shape (days,); returns new ones.
    taken
        Irradiance that the plane does not receive, such as what neighbours shade; None for nothing.
    """
    steps, days = weather.shape
    a, b = np.full(days, _NIGHT_A_DEG), np.full(days, _NIGHT_B_DEG)
    target_a, target_b = a.copy(), b.copy()
    poses = np.empty((2, drive.samples, steps, days))
    travel, moves = np.zeros(days), np.zeros(days)
    stride = drive.speed_deg_per_s * weather.step_s / drive.samples
    middle = 0.5 if np.isfinite(stride) else 1.0
    for step in range(steps):
        wanted_a, wanted_b = steer(step, target_a, target_b)
        apart = np.abs(wanted_a - target_a) + np.abs(wanted_b - target_b)
        go = apart > (drive.deadband_deg if np.isfinite(stride) else 0.0)
        moves += go
        target_a, target_b = np.where(go, wanted_a, target_a), np.where(go, wanted_b, target_b)
        if np.array_equal(a, target_a) and np.array_equal(b, target_b):
            # The tracker stands still, as in most minutes under a thrifty law.
            poses[:, :, step] = np.stack((a, b))[:, None]
            continue
        for sample in range(drive.samples):
            # np.clip takes several times as long on arrays of a few days.
            by_a = bounded(target_a - a, -stride, stride)
            left = stride - np.abs(by_a) if np.isfinite(stride) else stride
            by_b = bounded(target_b - b, -left, left)
            poses[0, sample, step], poses[1, sample, step] = a + middle * by_a, b + middle * by_b
            a, b = a + by_a, b + by_b
            travel += np.abs(by_a) + np.abs(by_b)
    received = np.zeros(len(weather.utc_s))
    for sample in range(drive.samples):
        a_deg, b_deg = poses[:, sample, weather.step, weather.day]
        received += light.irradiance_on(normal_from_angles(a_deg, b_deg), albedo) / drive.samples
        if taken is not None:
            received -= taken(a_deg, b_deg) / drive.samples
    back = np.abs(a - _NIGHT_A_DEG) + np.abs(b - _NIGHT_B_DEG)
    return Harvest(weather.by_day(received), travel, moves, back)
