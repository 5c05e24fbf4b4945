"""What planes receive in the light that the cube shows: the tracker's own, a chronometric tracker's, and the best.

The estimate of :mod:`solar.laws.light` (beam B, uniform diffuse D, horizon H; albedo rho) is put on three planes,

    I(n) = B max(s.n, 0) + D (1 + n_z)/2 + H sqrt(1 - n_z^2) + rho (B s_z + D) (1 - n_z)/2,

equation (1) of Andriamahefa et al. (2023) with the horizon's part. These are results of a model, for the light is
measured only in the planes of the four faces; what counts are the differences between them in the same light.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from solar.frames import Array, Limits, angles_within, normal_from_angles
from solar.laws.light import (
    FACES_NEEDED,
    aim_vector,
    irradiance_on,
    light_from_faces,
    usable_faces,
    without_unreachable_beam,
)


class ReceivedIrradiance(NamedTuple):
    """Irradiance [W/m2] of three planes at the same instants, arrays of one shape; NaN in all if one is unknown.

    Attributes
    ----------
    actual_w_m2
        Where the tracker stands.
    chronometric_w_m2
        Where a tracker would stand that points at the sun at every instant, within its limits.
    best_w_m2
        The most that any pose within the limits receives: the bound of every law.
    """

    actual_w_m2: Array
    chronometric_w_m2: Array
    best_w_m2: Array


def received_irradiance(
    faces: ArrayLike, sun: ArrayLike, a_deg: ArrayLike, b_deg: ArrayLike, limits: Limits, albedo: ArrayLike = 0.2
) -> ReceivedIrradiance:
    """Return what the three planes receive, by the faces' readings of the same instants.

    Parameters
    ----------
    faces
        Irradiances east, south, west, zenith [W/m2], shape (..., 4), NaN for a reading that is not good.
    sun
        Unit vectors to the apparent sun, shape (..., 3). With the sun below the horizon the result is NaN.
    a_deg, b_deg
        Where the tracker stands [deg], shape (...), NaN where unknown.
    limits
        Of the tracker, for the other two planes.
    albedo
        Of the ground around the cube, shape (...).
    """
    readings, sun = np.asarray(faces, dtype=np.float64), np.asarray(sun, dtype=np.float64)
    usable = usable_faces(readings, sun)
    light = light_from_faces(readings, sun, albedo, usable)
    actual = irradiance_on(light, sun, albedo, normal_from_angles(a_deg, b_deg))
    chronometric = irradiance_on(light, sun, albedo, normal_from_angles(*angles_within(sun, limits)))
    aimed = normal_from_angles(
        *angles_within(aim_vector(without_unreachable_beam(light, sun, limits), sun, albedo), limits)
    )
    # The closed form finds the best pose in the sun's vertical plane; at the limits another may be a little better.
    best = np.maximum(irradiance_on(light, sun, albedo, aimed), np.fmax(actual, chronometric))
    known = (usable.sum(axis=-1) >= FACES_NEEDED) & (sun[..., 2] > 0.0) & np.isfinite(actual)
    return ReceivedIrradiance(*(np.where(known, part, np.nan) for part in (actual, chronometric, best)))


def insolation(utc_s: ArrayLike, irradiance_w_m2: ArrayLike, longest_s: float = 60.0) -> tuple[float, float]:
    """Return the insolation [kWh/m2] of rising instants, shape (n,), and the time [s] that they stand for.

    Each value holds until the next instant, for `longest_s` at most; the last holds as long as the one before it. NaN
    and the rest of a longer gap count as nothing.
    """
    time, power = np.asarray(utc_s, dtype=np.float64), np.asarray(irradiance_w_m2, dtype=np.float64)
    if time.size < 2:
        return 0.0, 0.0
    steps = np.minimum(np.diff(time), longest_s)
    steps = np.append(steps, steps[-1])
    known = np.isfinite(power)
    return float((power[known] * steps[known]).sum()) / 3.6e6, float(steps[known].sum())
