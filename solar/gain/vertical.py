"""Dual axis against a single vertical axis: K_DV, exact, by Carlson's elliptic integrals.

The panel keeps the sun's azimuth and a fixed tilt, so its cosine of incidence is sin(elevation + tilt), and the day
needs two integrals over the hour angle: that of sin(elevation), elementary, and that of cos(elevation), elliptic.
"""

import numpy as np
from numpy.typing import ArrayLike
from scipy.special import cosdg, elliprd, elliprf, elliprj, sindg

from solar.frames import Array
from solar.gain.geometry import HOURS_PER_RAD, SunPath, energy_ratio, require_within, sun_path

# Stands for zero where phi = delta: the integrals have a removable logarithm there.
_TINY = 1e-30


def k_dv(phi_deg: ArrayLike, beta_deg: ArrayLike, n: ArrayLike) -> Array:
    """Return K_DV = R_max / R_V, at least 1: dual axis against a vertical axis, Maiga (2022), (24)-(25), made exact.

    Arguments and errors as :func:`vertical_energy_h`.
    """
    return energy_ratio(sun_path(phi_deg, n).max_h, vertical_energy_h(phi_deg, beta_deg, n))


def vertical_energy_h(phi_deg: ArrayLike, beta_deg: ArrayLike, n: ArrayLike) -> Array:
    """Return R_V [h], the daily energy of a vertical-axis tracker; latitude, tilt and day broadcast together.

    The exact value of Maiga (2022), (15). The tracker turns by itself towards the sun, so the sign of the tilt does not
    matter. Every latitude. Raises `ValueError` for a latitude or tilt outside -90..90 or a day outside 1..365.
    """
    day = sun_path(phi_deg, n)
    beta = np.abs(require_within("tilt", beta_deg, -90.0, 90.0, " deg"))
    energy: Array = 2.0 * HOURS_PER_RAD * (sindg(beta) * half_day_cosine(day) + cosdg(beta) * half_day_sine(day))
    return energy


def half_day_sine(day: SunPath) -> Array:
    """Return the integral of sin(elevation) over the hour angle from noon to sunset [rad]; Maiga (2022), (A2.12)."""
    return day.a * day.w0 + day.b * np.sin(day.w0)


def half_day_cosine(day: SunPath) -> Array:
    """Return the integral of cos(elevation) over the hour angle from noon to sunset [rad].

    Stands for the power series of Maiga (2022), (16)-(19), (A2.13)-(A2.18). With u = phi - delta, v = phi + delta,
    s = cot^2(w0/2), r = sin^2 u and

        x = r s
        y = 2 cos^2(u/2) (2 sin^2(u/2) s + 2 cos^2(v/2))
        z = 2 sin^2(u/2) (2 cos^2(u/2) s + 2 sin^2(v/2))

    it is, in Carlson's R_F, R_D, R_J (DLMF 19.16),

        (1 + cos u cos v) sin(w0)/2
        + r [R_F(x,y,z) + sin^2 v (R_D(x,y,z) + R_D(z,x,y))/3 + (4/3) a b R_J(x,y,z,r+x)]

    docs/theory.md derives it. In polar day s = 0 and the first term vanishes; in polar night all of it is zero.
    """
    sin_u = day.sin_phi * day.cos_delta - day.cos_phi * day.sin_delta
    sin_v = day.sin_phi * day.cos_delta + day.cos_phi * day.sin_delta
    integral = np.zeros(day.w0.shape)
    up = day.w0 > 0.0
    cos_u, cos_v, sin_u, sin_v, ab = (part[up] for part in (day.noon, day.midnight, sin_u, sin_v, day.a * day.b))
    # 1 + cos and 1 - cos, the latter without its cancellation.
    u_plus, v_plus = 1.0 + cos_u, 1.0 + cos_v
    u_minus, v_minus = np.maximum(sin_u * sin_u / u_plus, _TINY), sin_v * sin_v / v_plus
    r = u_minus * u_plus
    s = np.maximum(cos_v, 0.0) / cos_u
    x, y, z = r * s, u_plus * (u_minus * s + v_plus), u_minus * (u_plus * s + v_minus)
    boundary = np.where(cos_v > 0.0, 0.5 * (1.0 + cos_u * cos_v) * np.sin(day.w0[up]), 0.0)
    integral[up] = boundary + r * (
        elliprf(x, y, z)
        + sin_v * sin_v / 3.0 * (elliprd(x, y, z) + elliprd(z, x, y))
        + 4.0 / 3.0 * ab * elliprj(x, y, z, r + x)
    )
    return integral
