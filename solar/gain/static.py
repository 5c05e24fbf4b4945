"""Dual axis against a static panel: K_DS, exact.

A panel that faces the direction (n_p along the earth's axis, n_q in the equator's plane) sees the sun as a horizontal
panel does at the latitude asin(n_p), with noon at the hour angle psi of its own meridian:

    cos(theta) = n_p sin(delta) + n_q cos(delta) cos(w - psi)

so it is lit for |w - psi| < xi, its own sunset. The day is [-w0, w0]; their overlap is one arc, or two when the sun is
up for long. Each arc's energy is elementary. This stands in for Maiga (2022), (2), (8)-(11), whose breakpoints are not
where cos(theta) changes its sign.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from scipy.special import cosdg, sindg

from solar.frames import Array
from solar.gain.geometry import HOURS_PER_RAD, SunPath, energy_ratio, require_within, sun_path

_TURN = 2.0 * np.pi


class StaticEnergy(NamedTuple):
    """Daily energy of a static panel [h].

    Attributes
    ----------
    clip_h
        Of max(0, cos theta): a panel with one face.
    abs_h
        Of |cos theta|, as Maiga (2022), (1), has it: light on the back counts in full.
    signed_h
        Of cos theta itself; clip_h is the mean of abs_h and signed_h.
    """

    clip_h: Array
    abs_h: Array
    signed_h: Array


def static_energy(phi_deg: ArrayLike, beta_deg: ArrayLike, n: ArrayLike, lambda_deg: ArrayLike = 0.0) -> StaticEnergy:
    """Return the daily energy of static panels; latitude, tilt, day and azimuth deviation broadcast together.

    The exact value of Maiga (2022), (1), with C1, C2, C3 of (4)-(6). Every latitude with its polar day and night, any
    azimuth deviation. Raises `ValueError` for a latitude outside -90..90, a tilt outside -90..90, a day outside
    1..365, or a number that is not finite.
    """
    day = sun_path(phi_deg, n)
    beta = require_within("tilt", beta_deg, -90.0, 90.0, " deg")
    deviation = require_within("azimuth", lambda_deg, -360.0, 360.0, " deg")
    return _energy(day, sindg(beta), cosdg(beta), sindg(deviation), cosdg(deviation))


def k_ds(
    phi_deg: ArrayLike,
    beta_deg: ArrayLike,
    n: ArrayLike,
    lambda_deg: ArrayLike = 0.0,
    *,
    rear_face: bool = False,
) -> Array:
    """Return K_DS = R_max / R_S, at least 1: dual axis against static, Maiga (2022), (10)-(11), made exact.

    With `rear_face` light on the back counts in full, as in the paper's (1). Arguments and errors as
    :func:`static_energy`.
    """
    energy = static_energy(phi_deg, beta_deg, n, lambda_deg)
    return energy_ratio(sun_path(phi_deg, n).max_h, energy.abs_h if rear_face else energy.clip_h)


def _energy(day: SunPath, sin_beta: Array, cos_beta: Array, sin_lambda: Array, cos_lambda: Array) -> StaticEnergy:
    axial = cos_beta * day.sin_phi - sin_beta * day.cos_phi * cos_lambda
    noonward = cos_beta * day.cos_phi + sin_beta * day.sin_phi * cos_lambda
    eastward = sin_beta * sin_lambda
    psi = np.arctan2(-eastward, noonward)
    level = axial * day.sin_delta
    swing = np.hypot(noonward, eastward) * day.cos_delta
    xi = 2.0 * np.arctan2(np.sqrt(np.maximum(swing + level, 0.0)), np.sqrt(np.maximum(swing - level, 0.0)))

    clip = _arc(level, swing, psi, *_overlap(psi, xi, day.w0))
    # The lit arc of the day before or after reaches into this day when both are long.
    neighbour = psi - np.copysign(_TURN, psi)
    begin, end = _overlap(neighbour, xi, day.w0)
    again = end > begin
    at = [np.broadcast_to(part, clip.shape)[again] for part in (level, swing, neighbour, begin, end)]
    clip[again] += _arc(*at)
    clip = HOURS_PER_RAD * np.maximum(clip, 0.0)
    signed = 2.0 * HOURS_PER_RAD * (level * day.w0 + noonward * day.cos_delta * np.sin(day.w0))
    return StaticEnergy(clip, np.maximum(2.0 * clip - signed, 0.0), signed)


def _overlap(centre: Array, half_width: Array, w0: Array) -> tuple[Array, Array]:
    """Begin and end of the lit arc within the day; equal where there is none."""
    begin = np.maximum(centre - half_width, -w0)
    return begin, np.maximum(np.minimum(centre + half_width, w0), begin)


def _arc(level: Array, swing: Array, psi: Array, begin: Array, end: Array) -> Array:
    """Integral of level + swing cos(w - psi) from `begin` to `end`, as a new array."""
    length = end - begin
    total: Array = level * length + 2.0 * swing * np.sin(0.5 * length) * np.cos(0.5 * (begin + end) - psi)
    return np.array(total)
