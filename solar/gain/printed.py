"""The closed forms as Maiga (2022) prints them, and the three scripts of its appendix: for whoever must reproduce it.

Not all of it is right: docs/theory.md says what is. Use :mod:`solar.gain` for answers. Latitude and tilt carry the
paper's sign rule: in the south both are negative, but for the vertical axis, which takes the size of the tilt.

A value that is not a real number is NaN here: beyond the polar circles T0 is complex, (8) and (9) are complex for large
azimuth deviations near the equator and 0/0 for an azimuth deviation of zero. The scripts go on with complex T1 and T2,
and end in real numbers; :func:`script1` tells where.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from scipy.special import cosdg, cotdg, sindg, tandg

from solar.frames import Array
from solar.gain.geometry import declination_deg

ComplexArray = np.ndarray[tuple[int, ...], np.dtype[np.complex128]]
_HOURS = 12.0 / np.pi


class Script1(NamedTuple):
    """K of the first script, and where its T1 and T2 are complex numbers that the script does not notice."""

    k_ds: Array
    complex_breakpoints: np.ndarray[tuple[int, ...], np.dtype[np.bool_]]


def k_ds_eq11(phi_deg: ArrayLike, beta_deg: ArrayLike, n: ArrayLike, lambda_deg: ArrayLike) -> Array:
    """Return K_DS of Maiga (2022), (3)-(11); NaN where T0, T1 or T2 is not a real number."""
    k_ds, is_complex = script1(phi_deg, beta_deg, n, lambda_deg)
    return np.where(is_complex, np.nan, k_ds)


def k_ds_eq13(phi_deg: ArrayLike, beta_deg: ArrayLike, n: ArrayLike) -> Array:
    """Return the limit of K_DS for an azimuth deviation that falls to zero from above; Maiga (2022), (11)-(13).

    T1 = T2 = noon there, so each half of the day counts with the size of its sum.
    """
    day = _Day(phi_deg, n)
    beta = np.asarray(beta_deg, dtype=np.float64)
    c1 = day.sin_delta * (cosdg(beta) * day.sin_phi - sindg(beta) * day.cos_phi)
    c2 = day.cos_delta * (cosdg(beta) * day.cos_phi + sindg(beta) * day.sin_phi)
    return _quotient(2.0 * day.t0_h, 2.0 * np.abs(c1 * day.t0_h + _HOURS * c2 * day.sin_w0))


def k_dv_eq25(phi_deg: ArrayLike, beta_deg: ArrayLike, n: ArrayLike) -> Array:
    """Return K_DV of Maiga (2022), (16)-(25), with the a^4/4 of (16)."""
    return _k_dv(phi_deg, beta_deg, n, quartic=0.25)


def k_dh_eq49(phi_deg: ArrayLike, beta_deg: ArrayLike, n: ArrayLike, lambda_deg: ArrayLike) -> Array:
    """Return K_DH of Maiga (2022), (30)-(49)."""
    day = _Day(phi_deg, n)
    x5 = -(day.a**2 / 4.0) * (day.b**2 + 3.0 * day.a**2 / 16.0 + 1.25)
    beta = np.asarray(beta_deg, dtype=np.float64)
    return _k_dh(day, beta, lambda_deg, quartic=0.125, x5=x5, upward=cosdg(beta))


def script1(phi_deg: ArrayLike, beta_deg: ArrayLike, n: ArrayLike, lambda_deg: ArrayLike) -> Script1:
    """Return K_DS as the first script of Maiga (2022), appendix 3, computes it, complex T1 and T2 included."""
    day = _Day(phi_deg, n)
    beta, deviation = np.asarray(beta_deg, dtype=np.float64), np.asarray(lambda_deg, dtype=np.float64)
    c1 = day.sin_delta * (cosdg(beta) * day.sin_phi - sindg(beta) * day.cos_phi * cosdg(deviation))
    c2 = day.cos_delta * (cosdg(beta) * day.cos_phi + sindg(beta) * day.sin_phi * cosdg(deviation))
    c3 = sindg(beta) * day.cos_delta * sindg(deviation)
    with np.errstate(divide="ignore", invalid="ignore"):
        tangent = day.sin_delta / day.cos_delta
        cotangent = cotdg(deviation)
        under_root = cotangent**2 + day.sin_phi**2 - day.cos_phi**2 * tangent**2
        root = np.emath.sqrt(under_root)
        g = 2.0 * _HOURS * np.arctan((root - cotangent) / (day.cos_phi * tangent + day.sin_phi))
        total = _sizes(c1, c2, c3, day.t0_h, g)
    is_complex = (under_root < 0.0) | np.isnan(day.t0_h)
    k_ds = _quotient(2.0 * day.t0_h, total)
    return Script1(k_ds, np.broadcast_to(is_complex, k_ds.shape))


def script2(phi_deg: ArrayLike, beta_deg: ArrayLike, n: ArrayLike) -> Array:
    """Return K_DV as the second script of Maiga (2022), appendix 3, computes it: (25) with a^4/8."""
    return _k_dv(phi_deg, beta_deg, n, quartic=0.125)


def script3(phi_deg: ArrayLike, beta_deg: ArrayLike, n: ArrayLike, lambda_deg: ArrayLike) -> Array:
    """Return K_DH as the third script of Maiga (2022), appendix 3, computes it.

    It differs from (49) by a^4/4 in X1, by X5, and by cos(lambda) for cos(beta) in H32.
    """
    day = _Day(phi_deg, n)
    x5 = -(day.a**2 / 4.0) * (1.0 + day.b**2 + 3.0 * day.a**2 / 16.0 + 1.25)
    return _k_dh(day, beta_deg, lambda_deg, quartic=0.25, x5=x5, upward=cosdg(np.asarray(lambda_deg, np.float64)))


def least_eta(k: ArrayLike) -> Array:
    """Return the smallest K - 1 along the last axis, as the scripts print it over the days; NaN days are passed over.

    What the three scripts of Maiga (2022) end with; NaN where every day is.
    """
    ratios = np.asarray(k, dtype=np.float64)
    least: Array = np.fmin.reduce(ratios, axis=-1) - 1.0
    return least


class _Day:
    """T0, a, b and c = cos(w0) of Maiga (2022), (7), (22), (23), and the sines and cosines they share."""

    def __init__(self, phi_deg: ArrayLike, n: ArrayLike) -> None:
        phi = np.asarray(phi_deg, dtype=np.float64)
        delta = np.radians(declination_deg(n))
        self.sin_phi, self.cos_phi = sindg(phi), cosdg(phi)
        self.sin_delta, self.cos_delta = np.sin(delta), np.cos(delta)
        self.a, self.b = self.sin_delta * self.sin_phi, self.cos_delta * self.cos_phi
        with np.errstate(invalid="ignore"):
            self.t0_h = _HOURS * np.arccos(-tandg(phi) * np.tan(delta))
        self.w0 = self.t0_h / _HOURS
        self.c, self.sin_w0 = np.cos(self.w0), np.sin(self.w0)


def _sizes(c1: Array, c2: Array, c3: Array, t0_h: Array, g: Array | ComplexArray) -> Array:
    """Return the denominator of (11): the sizes of the sums over the rows of (3), with h = -g of (8), (9)."""
    w0, wg = t0_h / _HOURS, g / _HOURS
    first = c1 * (g + t0_h) + _HOURS * (c2 * (np.sin(wg) + np.sin(w0)) - c3 * (np.cos(wg) - np.cos(w0)))
    second = -2.0 * c1 * g - 2.0 * _HOURS * c2 * np.sin(wg)
    third = c1 * (t0_h + g) + _HOURS * (c2 * (np.sin(w0) + np.sin(wg)) - c3 * (np.cos(w0) - np.cos(wg)))
    total: Array = np.abs(first) + np.abs(second) + np.abs(third)
    return total


def _series(day: _Day, quartic: float) -> tuple[Array, Array, Array, Array]:
    """X1..X4 of (38)-(41); `quartic` is the factor of a^4 in X1."""
    a, b = day.a, day.b
    x1 = 1.0 - a**2 / 2.0 - quartic * a**4
    x2 = -a * b * (1.0 + a**2 / 2.0)
    x3 = -(a**2 / 2.0) * (1.0 + a**2 / 8.0 + b**2)
    x4 = -(a * b / 2.0) * (2.0 + a**2 / 2.0)
    return x1, x2, x3, x4


def _k_dv(phi_deg: ArrayLike, beta_deg: ArrayLike, n: ArrayLike, quartic: float) -> Array:
    day = _Day(phi_deg, n)
    beta = np.abs(np.asarray(beta_deg, dtype=np.float64))
    x1, x2, x3, x4 = _series(day, quartic)
    c = day.c
    across = x1 * (1.0 - c) + x2 / 2.0 * (1.0 - c**2) + x3 / 3.0 * (1.0 - c**3) + x4 / 4.0 * (1.0 - c**4)
    upward = day.a * day.t0_h + _HOURS * day.b * day.sin_w0
    return _quotient(day.t0_h, _HOURS * sindg(beta) * across + cosdg(beta) * upward)


def _k_dh(day: _Day, beta_deg: ArrayLike, lambda_deg: ArrayLike, *, quartic: float, x5: Array, upward: Array) -> Array:
    beta, deviation = np.asarray(beta_deg, dtype=np.float64), np.asarray(lambda_deg, dtype=np.float64)
    sin_beta, sin_lambda, cos_lambda = sindg(beta), sindg(deviation), cosdg(deviation)
    a, b, c, t0, w0 = day.a, day.b, day.c, day.t0_h, day.w0
    x1, x2, x3, x4 = _series(day, quartic)
    noon = np.arcsin(np.minimum(a + b, 1.0))
    d = _HOURS * sin_lambda * day.sin_delta * day.cos_phi
    e = -_HOURS * sin_lambda * day.cos_delta * day.sin_phi
    p1 = -a * sin_beta * cos_lambda * day.sin_delta * day.cos_phi
    p2 = -sin_beta * cos_lambda * (b * day.sin_delta * day.cos_phi - a * day.cos_delta * day.sin_phi)
    p3 = b * sin_beta * cos_lambda * day.cos_delta * day.sin_phi
    q1 = a * sin_beta * sin_lambda * day.cos_delta
    q2 = b / 2.0 * sin_beta * sin_lambda * day.cos_delta
    with np.errstate(divide="ignore", invalid="ignore"):
        h11 = -6.0 * cos_lambda * (noon + (a + b) * np.cos(noon)) / (np.pi * day.cos_phi)
    h12_13 = d * (x1 * (1 - c) + x2 / 2 * (1 - c**2) + x3 / 3 * (1 - c**3) + x4 / 4 * (1 - c**4))
    h21_22 = e * (x1 / 2 * (1 - c**2) + x2 / 3 * (1 - c**3) + x3 / 4 * (1 - c**4) + x4 / 5 * (1 - c**5))
    h23 = (p1 + p3 / 2.0) * t0 + 3.0 * p3 / np.pi * np.sin(2.0 * w0) + _HOURS * p2 * np.sin(w0)
    h31 = -6.0 / np.pi * (2.0 * q1 + q2) + _HOURS * q1 * c + 6.0 / np.pi * q2 * np.cos(2.0 * w0)
    h32 = upward * ((a**2 + b**2 / 2) * t0 + 2 * _HOURS * a * b * np.sin(w0) + 3 * b**2 / np.pi * np.sin(2 * w0))
    h33 = d * x5 / 5.0 * (1.0 - c**5) + e * x5 / 6.0 * (1.0 - c**6)
    return _quotient(t0, np.abs(h11 + h12_13 + h21_22 + h23 + h31 + h32 + h33))


def _quotient(numerator: Array, denominator: Array) -> Array:
    with np.errstate(divide="ignore"):
        quotient: Array = numerator / denominator
    return quotient
