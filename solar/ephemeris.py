"""Where the sun is: the NREL solar position algorithm (SPA), on numbers and on arrays, without pandas.

SPA is split in its two natural halves. The geocentric half (declination, right ascension, sidereal time, distance) is
slow to compute and slow to change: it is computed at whole hours and interpolated linearly, which costs less than
1e-5 deg. The topocentric half (site, parallax, refraction) is exact at every instant. Sources: Reda & Andreas (2004),
Solar Energy 76, 577, as implemented by :mod:`pvlib.spa`.
"""

import math
from datetime import UTC, datetime
from functools import lru_cache
from numbers import Real
from typing import TYPE_CHECKING, Any, Generic, NamedTuple, Self, TypeAlias, TypeVar, overload

import numpy as np
from numpy.typing import NDArray

from solar.frames import Array, direction_from_azimuth
from solar.spa import load_spa

if TYPE_CHECKING:
    from collections.abc import Sequence

    import pandas as pd

SOLAR_CONSTANT_W_M2 = 1366.1
TEMPERATURE_DEGC = 12.0
REFRACTION_AT_HORIZON_DEG = 0.5667
# The upper limb is seen on the horizon: 34' of refraction and 16' of radius.
RISE_ELEVATION_DEG = -0.8333
HOUR_S = 3600.0
DAY_S = 86400.0
REMEMBERED_HOURS = 128
REMEMBERED_DAYS = 16
REMEMBERED_WHOLE_DAYS = 1000

_LEAST_HOURS_PER_DAY = 4
# From so many instants an hour on, all hours from the first to the last are looked up.
_DENSE_PER_HOUR = 4
_STEPS = 2
_PATH_EVERY_S = 60.0
_YEAR_10000_S = 253402300800.0

Number = TypeVar("Number", float, Array)
Instant: TypeAlias = float | datetime | np.datetime64
"""Seconds since 1970-01-01 UTC, or a date and time, in UTC where it has no zone."""
Instants: TypeAlias = "Sequence[float] | NDArray[Any] | pd.Index[Any] | pd.Series[Any]"
"""Many instants, as seconds or as dates of numpy, such as the index of a frame."""


class _Place(NamedTuple):
    latitude_deg: float
    longitude_deg: float
    altitude_m: float


class Site(_Place):
    """A place on Earth: degrees north, degrees east, metres above sea level; raises `ValueError` for any other."""

    __slots__ = ()

    def __new__(cls, latitude_deg: float, longitude_deg: float, altitude_m: float) -> Self:
        """Check the numbers, and make the place."""
        _check_place(latitude_deg, longitude_deg, altitude_m)
        return super().__new__(cls, latitude_deg, longitude_deg, altitude_m)


class SunPosition(NamedTuple, Generic[Number]):
    """Where the sun stands [deg]: floats for one instant, arrays of the instants' shape otherwise.

    Attributes
    ----------
    azimuth_deg
        From North, clockwise, 0..360.
    elevation_deg
        Apparent: with refraction. What beams, sensors and trackers see.
    geometric_elevation_deg
        Without refraction.
    """

    azimuth_deg: Number
    elevation_deg: Number
    geometric_elevation_deg: Number


class SunDay(NamedTuple):
    """The solar day of one site.

    Attributes
    ----------
    sunrise_utc_s, sunset_utc_s
        The sun's upper limb on a flat horizon, within half a day of noon; None on a day without one. Where the polar
        day begins or ends, a day may have only one of them.
    noon_utc_s
        The sun crosses the meridian.
    highest_elevation_deg
        Apparent elevation at noon. Without sunrise and sunset, below zero it is a polar night, above zero a polar day.
    """

    sunrise_utc_s: float | None
    noon_utc_s: float
    sunset_utc_s: float | None
    highest_elevation_deg: float


@overload
def sun_position(
    utc_s: Instant, latitude_deg: float, longitude_deg: float, altitude_m: float = ...
) -> SunPosition[float]: ...
@overload
def sun_position(
    utc_s: Instants, latitude_deg: float, longitude_deg: float, altitude_m: float = ...
) -> SunPosition[Array]: ...
def sun_position(
    utc_s: "Instant | Instants", latitude_deg: float, longitude_deg: float, altitude_m: float = 0.0
) -> SunPosition[float] | SunPosition[Array]:
    """Return the sun's position at `utc_s` [s since 1970-01-01 UTC], one instant or an array of any shape.

    A datetime, dates of numpy and the index of a frame are taken too, as UTC where they have no zone. Refraction is
    that of mean pressure at `altitude_m` and 12 deg C. Raises `ValueError` for a time that is no instant, not finite,
    after the year 9999 or in 32 bits, and for a place that is not on Earth.
    """
    _check_place(latitude_deg, longitude_deg, altitude_m)
    instants = _as_seconds(utc_s)
    azimuth, apparent, geometric = _topocentric(instants.ravel(), latitude_deg, longitude_deg, altitude_m)
    if instants.ndim == 0:
        return SunPosition(float(azimuth[0]), float(apparent[0]), float(geometric[0]))
    shape = instants.shape
    return SunPosition(azimuth.reshape(shape), apparent.reshape(shape), geometric.reshape(shape))


def sun_direction(
    utc_s: "Instant | Instants", latitude_deg: float, longitude_deg: float, altitude_m: float = 0.0
) -> Array:
    """Return the unit vector(s) towards the apparent sun, shape (..., 3), in the frame of :mod:`solar.frames`.

    Raises `ValueError` as `sun_position` does.
    """
    instants = _as_seconds(utc_s)
    sun = sun_position(instants, latitude_deg, longitude_deg, altitude_m)
    return direction_from_azimuth(sun.azimuth_deg, sun.elevation_deg, latitude_deg)


def extraterrestrial_dni(utc_s: "Instant | Instants") -> Array:
    """Return the normal irradiance outside the atmosphere [W/m2], of the shape of `utc_s` [s UTC]."""
    instants = _as_seconds(utc_s)
    *_, distance_au = _geocentric(instants.ravel())
    normal: Array = SOLAR_CONSTANT_W_M2 / distance_au**2
    return normal.reshape(instants.shape)


def solar_days(utc_s: Number, longitude_deg: float) -> Number:
    """Return the solar day that an instant [s UTC], or each of many, falls in at a longitude, by mean midnights.

    Days are counted from 1970-01-01. Where midnight UTC falls in daylight, a UTC day is halves of two solar days.
    """
    return (utc_s + longitude_deg * 240.0) // DAY_S


def sun_day(utc_s: Instant, latitude_deg: float, longitude_deg: float, altitude_m: float = 0.0) -> SunDay:
    """Return sunrise, noon and sunset of the solar day that one instant falls in at that longitude.

    Raises `ValueError` as `sun_position` does, and for more than one instant.
    """
    _check_place(latitude_deg, longitude_deg, altitude_m)
    instant = _as_seconds(utc_s)
    if instant.ndim:
        raise ValueError(f"sun_day takes one instant, not an array of {instant.shape}")
    return _sun_day(solar_days(float(instant), longitude_deg), latitude_deg, longitude_deg, altitude_m)


def share_of_daylight_left(utc_s: float, latitude_deg: float, longitude_deg: float, altitude_m: float = 0.0) -> float:
    """Return how much of the solar day's daylight is still to come, 0..1; without sunrise or sunset, of the day."""
    day = sun_day(utc_s, latitude_deg, longitude_deg, altitude_m)
    rise_s, set_s = day.sunrise_utc_s, day.sunset_utc_s
    if rise_s is None or set_s is None:
        rise_s, set_s = day.noon_utc_s - DAY_S / 2.0, day.noon_utc_s + DAY_S / 2.0
    return min(max((set_s - utc_s) / (set_s - rise_s), 0.0), 1.0)


@lru_cache(maxsize=REMEMBERED_DAYS)
def _sun_day(mean_solar_day: float, latitude_deg: float, longitude_deg: float, altitude_m: float) -> SunDay:
    """Work a solar day out once for all trackers of a process: all of them ask when the day begins."""
    noon_utc_s = _noon_utc_s((mean_solar_day + 0.5) * DAY_S - longitude_deg * 240.0, longitude_deg)
    instants = noon_utc_s + np.arange(-DAY_S / 2.0, DAY_S / 2.0 + 1.0, _PATH_EVERY_S)
    sun = sun_position(instants, latitude_deg, longitude_deg, altitude_m)
    above_deg = sun.geometric_elevation_deg - RISE_ELEVATION_DEG
    # Near the poles the sun is not highest at noon.
    top = int(np.argmax(above_deg))
    return SunDay(
        _first_below(instants[top::-1], above_deg[top::-1]),
        noon_utc_s,
        _first_below(instants[top:], above_deg[top:]),
        float(sun.elevation_deg[len(instants) // 2]),
    )


def _noon_utc_s(mean_noon_utc_s: float, longitude_deg: float) -> float:
    """Repeat Newton's method on the hour angle, which is never farther from zero than the equation of time."""
    noon_utc_s = mean_noon_utc_s
    for _ in range(_STEPS):
        sidereal, ascension, *_ = _geocentric(np.array([noon_utc_s]))
        hour_angle = (float(sidereal[0] - ascension[0]) + longitude_deg + 180.0) % 360.0 - 180.0
        noon_utc_s -= hour_angle * 240.0
    return noon_utc_s


def _first_below(instants: Array, above_deg: Array) -> float | None:
    """Return when the sun, followed from its highest point, reaches the horizon; None if never, or never above it."""
    below = np.flatnonzero(above_deg <= 0.0)
    if not below.size or below[0] == 0:
        return None
    pair = slice(int(below[0]) - 1, int(below[0]) + 1)
    return float(np.interp(0.0, -above_deg[pair], instants[pair]))


def _topocentric(utc_s: Array, latitude_deg: float, longitude_deg: float, altitude_m: float) -> list[Array]:
    """Azimuth, apparent elevation and geometric elevation [deg] of instants of shape (n,)."""
    spa = load_spa()
    sidereal, ascension, declination, distance_au = _geocentric(utc_s)
    hour_angle = spa.local_hour_angle(sidereal, longitude_deg, ascension)
    parallax = spa.equatorial_horizontal_parallax(distance_au)
    u = spa.uterm(latitude_deg)
    x, y = spa.xterm(u, latitude_deg, altitude_m), spa.yterm(u, latitude_deg, altitude_m)
    shift = spa.parallax_sun_right_ascension(x, parallax, hour_angle, declination)
    local_declination = spa.topocentric_sun_declination(declination, x, y, parallax, shift, hour_angle)
    local_hour_angle = spa.topocentric_local_hour_angle(hour_angle, shift)
    geometric = spa.topocentric_elevation_angle_without_atmosphere(latitude_deg, local_declination, local_hour_angle)
    # The pressure of the standard atmosphere, as in `pvlib.atmosphere.alt2pres`.
    pressure_hpa = ((44331.514 - altitude_m) / 11880.516) ** (1.0 / 0.1902632)
    refraction = spa.atmospheric_refraction_correction(
        pressure_hpa, TEMPERATURE_DEGC, geometric, REFRACTION_AT_HORIZON_DEG
    )
    astronomers = spa.topocentric_astronomers_azimuth(local_hour_angle, local_declination, latitude_deg)
    return [
        np.asarray(angle, dtype=np.float64)
        for angle in (spa.topocentric_azimuth_angle(astronomers), geometric + refraction, geometric)
    ]


def _geocentric(utc_s: Array) -> Array:
    """Sidereal time, right ascension, declination [deg] and distance [au] of instants (n,): shape (4, n)."""
    hours = np.floor(utc_s / HOUR_S).astype(np.int64)
    first, last = (int(hours.min()), int(hours.max())) if hours.size else (0, 0)
    if (last - first) * _DENSE_PER_HOUR <= hours.size:
        # A running law asks often, for a few instants: to sort them would take longer.
        position = hours - first
        known = _at_hours(np.arange(first, last + 2))
        before, rise = known[:, :-1], known[:, 1:] - known[:, :-1]
    else:
        whole, position = np.unique(hours, return_inverse=True)
        before = _at_hours(whole)
        rise = _at_hours(whole + 1) - before
    # Right ascension wraps once a year; sidereal time advances by 15.04 deg in an hour and wraps once a day.
    rise[:2] = (rise[:2] + 180.0) % 360.0 - 180.0
    return before[:, position] + rise[:, position] * (utc_s / HOUR_S - hours)


def _at_hours(hours: NDArray[np.int64]) -> Array:
    """Geocentric quantities at whole hours since 1970, shape (4, n), from memory if they were asked for before."""
    if not hours.size:
        return np.empty((4, 0))
    if hours.size > REMEMBERED_HOURS // 8:
        days, position = np.unique(hours // 24, return_inverse=True)
        # To compute all hours of a day for one or two of them would take longer.
        if hours.size < days.size * _LEAST_HOURS_PER_DAY:
            return _geocentric_exact(hours.astype(np.float64) * HOUR_S)
        return _at_days(days)[:, position, hours % 24]
    return np.array([_at_hour(hour) for hour in hours.tolist()]).T


_whole_days: dict[int, Array] = {}


def _at_days(days: NDArray[np.int64]) -> Array:
    """Geocentric quantities at all hours of days since 1970, shape (4, n, 24).

    A calibration asks for the same days a hundred times, and a study once for each law.
    """
    known = {day: _whole_days.get(day) for day in days.tolist()}
    missing = [day for day, found in known.items() if found is None]
    if missing:
        hours = np.array(missing, dtype=np.float64)[:, None] * 24.0 + np.arange(24.0)
        exact = _geocentric_exact(hours.ravel() * HOUR_S).reshape(4, len(missing), 24)
        new = {day: exact[:, at].copy() for at, day in enumerate(missing)}
        if len(_whole_days) + len(new) > REMEMBERED_WHOLE_DAYS:
            _whole_days.clear()
        if len(new) <= REMEMBERED_WHOLE_DAYS:
            _whole_days.update(new)
        known |= new
    return np.stack([found for found in known.values() if found is not None], axis=1)


@lru_cache(maxsize=REMEMBERED_HOURS)
def _at_hour(hour: int) -> Array:
    return _geocentric_exact(np.array([hour * HOUR_S]))[:, 0]


def _geocentric_exact(utc_s: Array) -> Array:
    spa, delta_t = load_spa(), _delta_t_s(utc_s)
    angles = spa.solar_position_numpy(utc_s, 0, 0, 0, 0, 0, delta_t, 0, 1, sst=True)
    (distance_au,) = spa.solar_position_numpy(utc_s, 0, 0, 0, 0, 0, delta_t, 0, 1, esd=True)
    return np.array([*angles, distance_au])


def _delta_t_s(utc_s: Array) -> Array:
    """Terrestrial time minus universal time [s], constant over a month."""
    months = utc_s.astype("datetime64[s]").astype("datetime64[M]").astype(np.int64)
    return np.asarray(load_spa().calculate_deltat(1970 + months // 12, months % 12 + 1), dtype=np.float64)


def _check_place(latitude_deg: float, longitude_deg: float, altitude_m: float) -> None:
    # NaN is within no limit; the air's pressure is a complex number above 44 km.
    numbers = all(isinstance(number, Real) for number in (latitude_deg, longitude_deg, altitude_m))
    if not (numbers and abs(latitude_deg) <= 90.0 and math.isfinite(longitude_deg) and -430.0 <= altitude_m <= 9000.0):
        raise ValueError(
            "a site is -90 to 90 degrees north, degrees east and -430 to 9000 metres above sea level, and not"
            f" {latitude_deg}, {longitude_deg}, {altitude_m}"
        )


def _as_seconds(utc_s: "Instant | Instants") -> Array:
    kept_as = getattr(utc_s, "dtype", None)
    kind = getattr(kept_as, "kind", "")
    if kind == "M":
        # A plain conversion to float would count in whatever unit the dates are kept in.
        dates = np.asarray(utc_s, dtype="datetime64[us]")
        instants: Array = np.asarray((dates - np.datetime64(0, "us")) / np.timedelta64(1, "s"))
    elif kept_as in (np.float16, np.float32):
        raise ValueError(f"seconds since 1970 in {kept_as} are wrong by a minute: make them float64 where they arise")
    else:
        try:
            if hasattr(utc_s, "columns") or kind in ("m", "b", "c"):
                raise TypeError  # noqa: TRY301 - one sentence tells it with the others
            if isinstance(utc_s, datetime):
                utc_s = (utc_s if utc_s.tzinfo else utc_s.replace(tzinfo=UTC)).timestamp()
            instants = np.asarray(utc_s, dtype=np.float64)
        except (TypeError, ValueError):
            raise ValueError(
                f"a time is seconds since 1970, a datetime, dates of numpy or an index of them, and not {utc_s!r:.60}"
            ) from None
    # NaN is within no limit.
    if not np.all(np.abs(instants) < _YEAR_10000_S):
        raise ValueError(f"the time must be finite seconds since 1970 (no milliseconds), and not {utc_s!s:.60}")
    return instants


_SUN_EVERY_S = 60.0
_MINUTES_AT_ONCE = 60


class SunElevation:
    """The sun's apparent elevation [deg] for decisions by the minute, computed for an hour at once.

    Parameters
    ----------
    site
        Where.
    """

    def __init__(self, site: Site) -> None:
        self._site = site
        self._minutes = range(0)
        self._elevation_deg: list[float]

    def __call__(self, utc_s: float) -> float:
        """Return the elevation at the beginning of the minute that this UTC [s] lies in (the sun moves 0.25 deg)."""
        minute = int(utc_s // _SUN_EVERY_S)
        if minute not in self._minutes:
            self._minutes = range(minute, minute + _MINUTES_AT_ONCE)
            instants = _SUN_EVERY_S * np.array(self._minutes, dtype=np.float64)
            self._elevation_deg = sun_position(instants, *self._site).elevation_deg.tolist()
        return self._elevation_deg[minute - self._minutes.start]


class SunDirection:
    """The unit vector towards the apparent sun, computed for an hour at once and interpolated within the minutes.

    Parameters
    ----------
    site
        Where.
    """

    def __init__(self, site: Site) -> None:
        self._site = site
        self._minutes = range(0)
        self._suns: Array

    def __call__(self, utc_s: float) -> Array:
        """Return the direction at an instant [s UTC], shape (3,), to a hundred thousandth of its length."""
        minute = int(utc_s // _SUN_EVERY_S)
        if minute not in self._minutes:
            self._minutes = range(minute, minute + _MINUTES_AT_ONCE)
            instants = _SUN_EVERY_S * np.arange(minute, minute + _MINUTES_AT_ONCE + 1, dtype=np.float64)
            self._suns = sun_direction(instants, *self._site)
        share = utc_s / _SUN_EVERY_S - minute
        before, after = self._suns[minute - self._minutes.start :][:2]
        now: Array = before + share * (after - before)
        return now
