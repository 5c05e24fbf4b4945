"""Dual axis against the paper's single "horizontal" axis: K_DH, exact.

The device of Maiga (2022), (28), is a north-south axis tilted by beta and turned by the angle of the sun's elevation:
its normal is cos(alpha) e + sin(alpha) n, with e horizontal and across the axis, on the sun's side of noon, and n the
static panel's normal. A fixed axis has the same e in the morning and -e in the afternoon, so that what depends on
sin(lambda) cancels over the day.
"""

import numpy as np
from numpy.typing import ArrayLike
from scipy.special import cosdg, sindg

from solar.frames import Array
from solar.gain.geometry import HOURS_PER_RAD, SunPath, energy_ratio, require_within, sun_path


def k_dh(phi_deg: ArrayLike, beta_deg: ArrayLike, n: ArrayLike, lambda_deg: ArrayLike = 0.0) -> Array:
    """Return K_DH = R_max / R_H, at least 1: Maiga (2022), (48)-(49), for the true full day and made exact.

    Infinite where R_H is not positive. Arguments and errors as :func:`horizontal_energy_h`.
    """
    return energy_ratio(sun_path(phi_deg, n).max_h, horizontal_energy_h(phi_deg, beta_deg, n, lambda_deg))


def horizontal_energy_h(phi_deg: ArrayLike, beta_deg: ArrayLike, n: ArrayLike, lambda_deg: ArrayLike = 0.0) -> Array:
    """Return R_H [h], the daily sum of cos(OM, OQ) of Maiga (2022), (28), over the full day of a fixed axis.

    The sum is signed, as in the paper's (29): light on the back counts as negative, which matters for large azimuth
    deviations only. Latitude, tilt, day and azimuth deviation broadcast together; every latitude. Raises `ValueError`
    for a latitude or tilt outside -90..90, a day outside 1..365, or a number that is not finite.
    """
    beta = require_within("tilt", beta_deg, -90.0, 90.0, " deg")
    cos_lambda = cosdg(require_within("azimuth", lambda_deg, -360.0, 360.0, " deg"))
    level, southward, upward = horizontal_parts(phi_deg, n)
    energy: Array = cos_lambda * level + sindg(beta) * cos_lambda * southward + cosdg(beta) * upward
    return energy


def horizontal_parts(phi_deg: ArrayLike, n: ArrayLike) -> tuple[Array, Array, Array]:
    """Return the three parts of R_H [h] that latitude and day alone decide.

    R_H = cos(lambda) level + sin(beta) cos(lambda) southward + cos(beta) upward: twice -H11, H23 and H32 of Maiga
    (2022), (30), (35), (37), the first with its sign put right.
    """
    day = sun_path(phi_deg, n)
    a, b, w0 = day.a, day.b, day.w0
    sine, both = np.sin(w0), 0.5 * w0 + 0.25 * np.sin(2.0 * w0)
    # sin(alpha) = a + b cos w, and -N = c + d cos w for the sun's northward component N.
    c, d = -day.sin_delta * day.cos_phi, day.cos_delta * day.sin_phi
    southward = a * c * w0 + (a * d + b * c) * sine + b * d * both
    upward = a * a * w0 + 2.0 * a * b * sine + b * b * both
    scale = 2.0 * HOURS_PER_RAD
    return scale * _across_integral(day), scale * southward, scale * upward


def _across_integral(day: SunPath) -> Array:
    """Integral of cos(alpha) cos(delta) sin w from noon to sunset [rad]: -H11, with both its limits in general.

    With the zenith angles at noon and midnight it is (P(noon) - P(sunset))/(2 cos phi), P(s) = asin s + s sqrt(1-s^2).
    In polar day that has a limit at the pole, so it is written in the colatitude k: k/sin k + cos k cos 2 delta.
    """
    colatitude = np.arctan2(day.cos_phi, np.abs(day.sin_phi))
    ratio = np.divide(colatitude, day.cos_phi, out=np.ones(colatitude.shape), where=day.cos_phi > 0.0)
    polar_day = ratio + np.abs(day.sin_phi) * (day.cos_delta**2 - day.sin_delta**2)
    zenith = np.abs(np.arctan2(day.sin_phi * day.cos_delta - day.cos_phi * day.sin_delta, day.noon))
    swept = 0.5 * np.pi - zenith + 0.5 * np.sin(2.0 * zenith)
    ordinary = np.divide(swept, 2.0 * day.cos_phi, out=np.zeros(swept.shape), where=day.cos_phi > 0.0)
    return np.where(day.midnight > 0.0, np.where(day.w0 > 0.0, ordinary, 0.0), np.where(day.w0 > 0.0, polar_day, 0.0))
