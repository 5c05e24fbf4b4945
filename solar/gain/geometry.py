"""The sun's day as Maiga (2022) idealises it: Cooper's declination, true solar time, a horizon at 0 deg.

Signs, here and in the whole package: latitude phi is positive in the north; tilt beta is positive towards the south and
negative towards the north, in either hemisphere; azimuth deviation lambda is positive from south to east. The hour
angle w is negative before noon. An energy is in hours of the constant beam I_max: a device that faces the sun for the
whole day receives R_max = 2 T0. The year has the days n = 1..365.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy.special import cosdg, sindg

from solar.frames import Array

DAYS = np.arange(1.0, 366.0)
HOURS_PER_RAD = 12.0 / np.pi
# Below this share of R_max an energy is the rounding of a zero.
_ROUNDING = 1e-15


@dataclass(frozen=True, slots=True)
class SunPath:
    """One day's path of the sun, or many; each field has the shape that latitude and day number broadcast to.

    Attributes
    ----------
    sin_phi, cos_phi, sin_delta, cos_delta
        Of latitude and declination; these keep the shape of their own argument.
    noon, midnight
        cos(phi - delta) and cos(phi + delta): the sine of the elevation at noon, and minus that at midnight.
    w0
        Hour angle of sunset [rad]; 0 in polar night, pi in polar day.
    """

    sin_phi: Array
    cos_phi: Array
    sin_delta: Array
    cos_delta: Array
    noon: Array
    midnight: Array
    w0: Array

    @property
    def a(self) -> Array:
        """Maiga (2022), (22): sin(elevation) is a + b cos w."""
        return self.sin_delta * self.sin_phi

    @property
    def b(self) -> Array:
        """Maiga (2022), (23)."""
        return self.cos_delta * self.cos_phi

    @property
    def max_h(self) -> Array:
        """R_max = 2 T0 [h]: what a device that always faces the sun receives; Maiga (2022), (10)."""
        return 2.0 * HOURS_PER_RAD * self.w0


def declination_deg(n: ArrayLike) -> Array:
    """Return Cooper's declination [deg] of day `n`; Maiga (2022), (A1.1).

    It is off from the true one by up to 1.4 deg, most in October.
    """
    declination: Array = 23.45 * sindg(360.0 * (284.0 + np.asarray(n, dtype=np.float64)) / 365.0)
    return declination


def sun_path(phi_deg: ArrayLike, n: ArrayLike) -> SunPath:
    """Return the sun's path at latitudes [deg] on days 1..365, broadcast together; Maiga (2022), (7), (22), (23).

    Sunset is where cos w0 = -tan(phi) tan(delta), that is tan^2(w0/2) = cos(phi - delta)/cos(phi + delta), which is
    sharp for the shortest days too and needs no clipping at the polar circles. Raises `ValueError` for a latitude
    outside -90..90 or a day outside 1..365.
    """
    phi, day = require_within("latitude", phi_deg, -90.0, 90.0, " deg"), require_within("day", n, 1.0, 365.0)
    delta = declination_deg(day)
    noon, midnight = cosdg(phi - delta), cosdg(phi + delta)
    w0 = 2.0 * np.arctan2(np.sqrt(np.maximum(noon, 0.0)), np.sqrt(np.maximum(midnight, 0.0)))
    return SunPath(
        sin_phi=sindg(phi),
        cos_phi=cosdg(phi),
        sin_delta=sindg(delta),
        cos_delta=cosdg(delta),
        noon=noon,
        midnight=midnight,
        w0=w0,
    )


def half_day_h(phi_deg: ArrayLike, n: ArrayLike) -> Array:
    """Return T0 [h], half the time from sunrise to sunset: 0 in polar night, 12 in polar day; Maiga (2022), (7)."""
    return sun_path(phi_deg, n).max_h / 2.0


def energy_ratio(max_h: ArrayLike, received_h: ArrayLike) -> Array:
    """Return K = R_max / R of energies that broadcast together; Maiga (2022), (10), (24), (48).

    Infinite where the device receives nothing (or less than rounding), NaN where there is nothing to receive.
    """
    maximum, received = np.asarray(max_h, dtype=np.float64), np.asarray(received_h, dtype=np.float64)
    # The signed sum of the horizontal axis may be below zero.
    some = received > _ROUNDING * np.maximum(maximum, 0.0)
    ratio = np.full(np.broadcast_shapes(maximum.shape, received.shape), np.inf)
    np.divide(maximum, received, out=ratio, where=some)
    ratio[np.broadcast_to(~(maximum > 0.0) | np.isnan(received), ratio.shape)] = np.nan
    return ratio


def require_within(name: str, values: ArrayLike, low: float, high: float, unit: str = "") -> Array:
    """Return `values` as an array; raises `ValueError` with the first that is NaN or outside `low`..`high`."""
    numbers = np.asarray(values, dtype=np.float64)
    bad = ~((numbers >= low) & (numbers <= high))
    if bad.any():
        raise ValueError(f"{name} must be in {low:g}..{high:g}{unit}, not {numbers[bad].flat[0]:g}")
    return numbers
