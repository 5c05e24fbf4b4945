"""The same devices under a real sky: an atmosphere, diffuse light, the ground, and the sun where it really is.

Irradiance on each device comes from the transposition of :mod:`solar.skies.sky`, the sun from :mod:`solar.ephemeris`.
Tilts and azimuth deviations carry the signs of :mod:`solar.gain.geometry`. Every panel has one face. K can be below 1
here: a panel that faces a cloud receives less diffuse light than one that lies flat.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from solar.ephemeris import DAY_S, Site, extraterrestrial_dni, solar_days, sun_position
from solar.frames import Array, direction_from_azimuth
from solar.skies.sky import Sky, SkyModel, normal_from_tilt, sky

ALBEDO = 0.2
# Midnight before the first day of a year without a leap day.
_YEAR_UTC_S = 1672531200.0


@dataclass(frozen=True, slots=True)
class SkySeries:
    """The sky over one site at n daylight instants.

    Attributes
    ----------
    day
        Day of the year, 1..366, in mean solar time; shape (n,).
    azimuth_deg, elevation_deg
        The apparent sun, shape (n,).
    """

    latitude_deg: float
    day: NDArray[np.int64]
    azimuth_deg: Array
    elevation_deg: Array
    overhead: Sky


class TiltRange(NamedTuple):
    """The best tilt [deg] and the tilts on both sides that lose a given share of its energy, within 0..90."""

    best_deg: float
    low_deg: float
    high_deg: float


def year_instants(longitude_deg: float, step_s: float) -> Array:
    """Return the middles [s UTC] of all steps of `step_s` in 365 mean solar days, those of 2023."""
    begin_utc_s = _YEAR_UTC_S - longitude_deg * 240.0
    return np.asarray(begin_utc_s + (np.arange(round(365 * DAY_S / step_s)) + 0.5) * step_s, dtype=np.float64)


def daylight(site: Site, utc_s: Array) -> Array:
    """Return those instants [s UTC] at which the apparent sun of :mod:`solar.ephemeris` has an elevation > 0."""
    return utc_s[sun_position(utc_s, *site).elevation_deg > 0.0]


def sky_series(site: Site, utc_s: Array, dni_w_m2: Array, dhi_w_m2: Array, model: SkyModel = "perez1990") -> SkySeries:
    """Return the sky at instants of shape (n,) with their direct normal and diffuse horizontal irradiance [W/m2].

    Its parts are those of :func:`solar.skies.sky.sky`, whose models are cited there.
    """
    sun = sun_position(utc_s, *site)
    dates = solar_days(utc_s, site.longitude_deg).astype(np.int64).astype("datetime64[D]")
    day = (dates - dates.astype("datetime64[Y]").astype("datetime64[D]")).astype(np.int64) + 1
    towards = direction_from_azimuth(sun.azimuth_deg, sun.elevation_deg, site.latitude_deg)
    overhead = sky(model, towards, dni_w_m2, dhi_w_m2, extraterrestrial_dni(utc_s))
    return SkySeries(
        latitude_deg=site.latitude_deg,
        day=day,
        azimuth_deg=sun.azimuth_deg,
        elevation_deg=sun.elevation_deg,
        overhead=overhead,
    )


def dual_irradiance(series: SkySeries, albedo: float = ALBEDO) -> Array:
    """Return the irradiance [W/m2] on a panel that faces the sun, shape (n,); the real sky's (10) of Maiga (2022)."""
    return series.overhead.irradiance_on(series.overhead.sun, albedo)


def static_irradiance(
    series: SkySeries, beta_deg: ArrayLike, lambda_deg: ArrayLike = 0.0, albedo: float = ALBEDO
) -> Array:
    """Return the irradiance [W/m2] on static panels, shape (..., n); the real sky's (1) of Maiga (2022).

    Tilt and azimuth deviation [deg] broadcast together to the shape (...).
    """
    azimuth = 180.0 - np.asarray(lambda_deg, dtype=np.float64)
    normal = normal_from_tilt(np.asarray(beta_deg, dtype=np.float64), azimuth, series.latitude_deg)
    return series.overhead.irradiance_on(normal[..., None, :], albedo)


def vertical_irradiance(series: SkySeries, beta_deg: ArrayLike, albedo: float = ALBEDO) -> Array:
    """Return the irradiance [W/m2] on vertical-axis trackers, shape (..., n); the real sky's (15) of Maiga (2022)."""
    tilt = np.abs(np.asarray(beta_deg, dtype=np.float64))[..., None]
    return series.overhead.irradiance_on(normal_from_tilt(tilt, series.azimuth_deg, series.latitude_deg), albedo)


def horizontal_irradiance(
    series: SkySeries, beta_deg: ArrayLike, lambda_deg: ArrayLike = 0.0, albedo: float = ALBEDO
) -> Array:
    """Return the irradiance [W/m2] on the paper's horizontal-axis trackers, shape (..., n); (28) of Maiga (2022).

    As :func:`static_irradiance`; the normal is cos(elevation) e + sin(elevation) n, with e across the axis on the
    sun's side of noon and n the static panel's normal.
    """
    beta, deviation = np.broadcast_arrays(np.asarray(beta_deg, np.float64), np.asarray(lambda_deg, np.float64))
    latitude = series.latitude_deg
    upper = normal_from_tilt(beta, 180.0 - deviation, latitude)[..., None, :]
    eastern = direction_from_azimuth(90.0 - deviation, 0.0, latitude)[..., None, :]
    side = np.where(series.overhead.sun[..., 1] >= 0.0, 1.0, -1.0)
    elevation = np.radians(np.maximum(series.elevation_deg, 0.0))
    normal = (side * np.cos(elevation))[:, None] * eastern + np.sin(elevation)[:, None] * upper
    return series.overhead.irradiance_on(normal, albedo)


def best_tilt_vertical_sky(series: SkySeries, loss: float, albedo: float = ALBEDO) -> TiltRange:
    """Return the best tilt of a vertical-axis tracker over the series; the real sky's (15) of Maiga (2022).

    The energy is evaluated at every whole degree and read between them by a parabola at the peak and by straight lines
    where it falls by `loss` (0.01 is 1 %).
    """
    tilts = np.arange(91.0)
    energy = np.array([float(vertical_irradiance(series, tilt, albedo).sum()) for tilt in tilts])
    peak = int(np.clip(energy.argmax(), 1, 89))
    before, at, after = energy[peak - 1 : peak + 2]
    best = float(np.clip(tilts[peak] + 0.5 * (before - after) / (before - 2.0 * at + after), 0.0, 90.0))
    floor = (1.0 - loss) * energy.max()
    low = float(np.interp(floor, energy[: peak + 1], tilts[: peak + 1]))
    high = float(np.interp(-floor, -energy[peak:], tilts[peak:]))
    return TiltRange(best, low, high)
