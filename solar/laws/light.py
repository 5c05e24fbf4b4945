"""What the four faces say of the light, and where that light is collected best.

With the sun's position known, the faces are linear in three quantities: the beam B (with all diffuse light that falls
like it), the uniform part D of the diffuse light, and the part H that a bright horizon adds to a vertical plane:

    vertical face j:  B max(s_j, 0) + D/2 + H + rho (B s_z + D)/2
    zenith face:      B s_z + D

Four readings, three unknowns: no model of the sky is assumed. On a plane that sees the sun the same light gives

    I(n) = B s.n + D (1 + n_z)/2 + H sqrt(1 - n_z^2) + rho G (1 - n_z)/2 = M.n + constant
    M = B s + (D - rho G)/2 k + H h,     h horizontal, towards the sun's azimuth

in the sun's vertical plane, where the best normal lies: it is M's direction, found without a search,
and brought inside the tracker's limits by :func:`solar.frames.angles_within`, which is exact. Because I is
linear in B, D and H, the best pose for an uncertain future is the best pose for their expected values.
"""

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from solar.frames import FACE_NORMALS, Array, Limits, angles_within, bounded, stack_components

FACES_NEEDED = 3
"""How many faces tell the light, given the sun's position."""

# Weight of the assumption that H is 0, beside one face's reading: it decides only where faces are missing.
_HORIZON_PRIOR = 0.02
_RIDGE = 1e-6
_SMALLEST = 1e-4
_HORIZON_RANGE = (-0.3, 0.7)
_LOWEST_W_M2, _HIGHEST_W_M2 = -20.0, 2000.0
_DEAD_SHARE = 0.4
# Of the darkest vertical face; less than _DEAD_SHARE, for if the west face is missing a low sun may be on both others.
_DEAD_ZENITH_SHARE = 0.2
_ZENITH_SHARE = 0.03
_NOISE_W_M2 = 1.0
_SHARE_TOLERANCE = 1e-6
# A face that gets no larger share of the beam than this does not show it: the sine of 3 deg.
_LEAST_BEAM_SHARE = 0.05


class Light(NamedTuple):
    """The light of an instant, arrays of one shape [W/m2].

    Attributes
    ----------
    beam
        Normal to the sun: direct and circumsolar.
    uniform
        Horizontal irradiance of the uniform part of the sky.
    horizon
        What the horizon adds to a vertical plane; negative where it is dark.
    """

    beam: Array
    uniform: Array
    horizon: Array


def usable_faces(faces: ArrayLike, sun: ArrayLike) -> NDArray[np.bool_]:
    """Tell which of the faces, shape (..., 4) in the order east, south, west, zenith [W/m2], can be believed.

    Readings that are no finite number in -20..2000 W/m2 are not believed, nor are faces that are covered or dead: a
    vertical face that reads less than 3 % of the zenith face, or less than two fifths of another vertical one that
    gets no more beam by the sun's direction (shape (..., 3)); a zenith face that reads less than a fifth of every
    vertical one; each bound less 1 W/m2 for noise. At dawn a dead east face would draw the tracker away from the sun.
    """
    readings, sun = np.asarray(faces, dtype=np.float64), np.asarray(sun, dtype=np.float64)
    axes = max(readings.ndim, sun.ndim)
    possible = _are_possible(readings)
    seen, shares = _faces_first(np.where(possible, readings, 0.0), axes), beam_shares(sun, axes)
    vertical, zenith = seen[:3], seen[3]
    # Bounds of each face by each face. A face below the bound by itself is below that by the zenith face anyway.
    bounds = np.where(shares <= (shares + _SHARE_TOLERANCE)[:, None], _DEAD_SHARE * vertical, 0.0)
    least = np.maximum(np.maximum(bounds[:, 0], bounds[:, 1]), np.maximum(bounds[:, 2], _ZENITH_SHARE * zenith))
    believed = np.empty((*least.shape[1:], 4), dtype=np.bool_)
    _faces_first(believed, axes)[:3] = vertical >= least - _NOISE_W_M2
    believed[..., 3] = _zenith_believed(readings, possible)
    believed &= possible
    return believed


def is_zenith_usable(faces: ArrayLike) -> NDArray[np.bool_]:
    """Tell whether the zenith face can be believed, as :func:`usable_faces` does, shape (...), without the sun."""
    readings = np.asarray(faces, dtype=np.float64)
    possible = _are_possible(readings)
    result: NDArray[np.bool_] = possible[..., 3] & _zenith_believed(readings, possible)
    return result


def is_beam_observable(usable: ArrayLike, sun: ArrayLike) -> NDArray[np.bool_]:
    """Tell whether the faces that count show how much beam there is, shape (...).

    A low sun puts next to no beam on the zenith face, and none on the vertical faces that look away. Without the face
    that looks to the sun a clear dawn reads like a dull one. Four faces always show it.

    Parameters
    ----------
    usable
        Which faces count, shape (..., 4).
    sun
        Unit vector(s) to the apparent sun, shape (..., 3).
    """
    counts, sun = np.asarray(usable, dtype=np.bool_), np.asarray(sun, dtype=np.float64)
    east, south, west, zenith = _faces_first(counts, counts.ndim)
    east_told, south_told, west_told = beam_shares(sun) > _LEAST_BEAM_SHARE
    shown = east & east_told | south & south_told | west & west_told | zenith & (sun[..., 2] > _LEAST_BEAM_SHARE)
    result: NDArray[np.bool_] = east & south & west & zenith | shown
    return result


def _are_possible(readings: Array) -> NDArray[np.bool_]:
    # Written so that NaN fails.
    result: NDArray[np.bool_] = (readings >= _LOWEST_W_M2) & (readings <= _HIGHEST_W_M2)
    return result


def _zenith_believed(readings: Array, possible: NDArray[np.bool_]) -> NDArray[np.bool_]:
    east, south, west = _faces_first(np.where(possible, readings, np.inf), readings.ndim)[:3]
    least = _DEAD_ZENITH_SHARE * np.minimum(np.minimum(east, south), west)
    result: NDArray[np.bool_] = ~(np.isfinite(least) & (readings[..., 3] < least - _NOISE_W_M2))
    return result


def light_from_faces(
    faces: ArrayLike, sun: ArrayLike, albedo: ArrayLike = 0.2, usable: ArrayLike | None = None
) -> Light:
    """Return the light that explains the faces best, by least squares, within what is physically possible.

    Parameters
    ----------
    faces
        Irradiances [W/m2], shape (..., 4).
    sun
        Unit vector(s) to the apparent sun, shape (..., 3). There is no beam from below the horizon.
    albedo
        Of the ground around the cube, shape (...).
    usable
        Which faces count, shape (..., 4); by default what :func:`usable_faces` says. With one face missing the
        horizon is taken to be as bright as the vault where nothing tells otherwise; with fewer than three the result
        is finite and worth nothing.
    """
    readings, sun = np.asarray(faces, dtype=np.float64), np.asarray(sun, dtype=np.float64)
    counts = usable_faces(readings, sun) if usable is None else np.asarray(usable, dtype=np.bool_)
    rho = np.asarray(albedo, dtype=np.float64)
    axes = max(readings.ndim, counts.ndim, sun.ndim, rho.ndim + 1)
    weight = _faces_first(counts.astype(np.float64), axes)
    readings = _faces_first(np.where(counts, readings, 0.0), axes)
    towards, height = beam_shares(sun, axes), np.maximum(sun[..., 2], 0.0)
    solution = _solve(weight, readings, towards + 0.5 * rho * height, 0.5 * (1.0 + rho), height)
    return _bounded_light(solution, weight, towards, height)


def irradiance_on(light: Light, sun: ArrayLike, albedo: ArrayLike, normals: ArrayLike) -> Array:
    """Return the irradiance [W/m2], shape (...), of unit normals (..., 3) under suns (..., 3); no beam from behind."""
    sun, normals = np.asarray(sun, dtype=np.float64), np.asarray(normals, dtype=np.float64)
    height, up = np.maximum(sun[..., 2], 0.0), normals[..., 2]
    towards = np.maximum(np.sum(sun * normals, axis=-1), 0.0)
    level = np.sqrt(np.maximum(1.0 - up * up, 0.0))
    ground = np.asarray(albedo) * (light.beam * height + light.uniform)
    result: Array = (
        light.beam * towards + light.uniform * (1.0 + up) / 2.0 + light.horizon * level + ground * (1.0 - up) / 2.0
    )
    return result


def irradiance_on_faces(light: Light, sun: ArrayLike, albedo: ArrayLike) -> Array:
    """Return what the faces of a cube read [W/m2] in the light under suns (..., 3), shape (..., 4)."""
    return stack_components(*(irradiance_on(light, sun, albedo, normal) for normal in FACE_NORMALS))


def aim_vector(light: Light, sun: ArrayLike, albedo: ArrayLike = 0.2) -> Array:
    """Return M [W/m2], shape (..., 3): its product with a unit normal is the normal's irradiance but for a constant.

    `sun` need not be where it was when the light was measured: for a pose that is to last, take it ahead of that.
    """
    sun = np.asarray(sun, dtype=np.float64)
    height = np.maximum(sun[..., 2], 0.0)
    across = np.hypot(sun[..., 0], sun[..., 1])
    total = light.beam * height + light.uniform
    # A dark horizon takes away from the tilt that the beam asks for, but never tilts away from the sun.
    outward = np.maximum(light.beam * across + light.horizon, 0.0) / np.maximum(across, _SMALLEST)
    up = np.maximum(light.beam * height + 0.5 * (light.uniform - np.asarray(albedo) * total), 1e-3 * total)
    return stack_components(outward * sun[..., 0], outward * sun[..., 1], np.maximum(up, 1e-9))


def without_unreachable_beam(light: Light, sun: ArrayLike, limits: Limits) -> Light:
    """Return the light without its beam where no pose inside the limits sees the sun."""
    sun = np.asarray(sun, dtype=np.float64)
    seen = dot_with_normal(sun, *angles_within(sun, limits)) > 0.0
    return light._replace(beam=np.where(seen, light.beam, 0.0))


def dot_with_normal(vector: ArrayLike, a_deg: ArrayLike, b_deg: ArrayLike) -> Array:
    """Return the product of `vector`, shape (..., 3), with the normal at tracker angles [deg]."""
    vector = np.asarray(vector, dtype=np.float64)
    a, b = np.radians(a_deg), np.radians(b_deg)
    upright = vector[..., 0] * np.cos(b) + vector[..., 2] * np.sin(b)
    result: Array = upright * np.cos(a) - vector[..., 1] * np.sin(a)
    return result


def economical_pose(
    vector: ArrayLike,
    here: tuple[ArrayLike, ArrayLike],
    best_a_deg: ArrayLike,
    price_w_m2_per_deg: ArrayLike,
    limits: Limits,
) -> tuple[Array, Array]:
    """Return the pose [deg] between `here` and the best one from which another degree is not worth its price.

    Along one axis the irradiance is a cosine about that axis' best angle. Its slope falls to the price some way before
    that angle, and the rest of the way does not pay. B is chosen where A is best, then A for that B.

    Parameters
    ----------
    vector
        As from :func:`aim_vector`, shape (..., 3).
    here
        Angles (A, B).
    best_a_deg
        A of the best pose within the limits.
    price_w_m2_per_deg
        Irradiance that a degree of A or B has to gain.
    limits
        Of the tracker.
    """
    vector = np.asarray(vector, dtype=np.float64)
    south, east, up = vector[..., 0], vector[..., 1], vector[..., 2]
    upright = np.hypot(south, up) * np.cos(np.radians(best_a_deg))
    b_deg = _nearest_paying_angle(np.degrees(np.arctan2(up, south)), upright, here[1], price_w_m2_per_deg)
    b_deg = bounded(b_deg, limits.b_min_deg, limits.b_max_deg)
    upright = south * np.cos(np.radians(b_deg)) + up * np.sin(np.radians(b_deg))
    a_deg = _nearest_paying_angle(
        np.degrees(np.arctan2(-east, upright)), np.hypot(upright, east), here[0], price_w_m2_per_deg
    )
    return bounded(a_deg, limits.a_min_deg, limits.a_max_deg), b_deg


def _nearest_paying_angle(
    best_deg: Array, most_w_m2: Array, here_deg: ArrayLike, price_w_m2_per_deg: ArrayLike
) -> Array:
    """Return the angle nearest to `here_deg` from which no degree towards the best one gains more than its price."""
    slope = np.asarray(price_w_m2_per_deg) / np.radians(np.maximum(most_w_m2, _SMALLEST))
    left_deg = np.degrees(np.arcsin(np.minimum(slope, 1.0)))
    return bounded(here_deg, best_deg - left_deg, best_deg + left_deg)


def beam_shares(sun: Array, axes: int = 0) -> Array:
    """Cosines of the beam's incidence on east, south and west, shape (3, ...); zero where they are shaded.

    They have as many axes as `sun`, shape (..., 3), or `axes` if that is more, to broadcast with values by face.
    """
    south, east, up = _faces_first(sun, max(sun.ndim, axes))
    shares: Array = np.maximum((east, south, -east), 0.0) * (up > 0.0)
    return shares


def _faces_first(values: NDArray[Any], axes: int) -> NDArray[Any]:
    """Return a view of values (..., k) as (k, ...) with `axes` axes: one call of numpy then serves all faces."""
    whole = values.reshape((1,) * (axes - values.ndim) + values.shape)
    return whole.transpose(-1, *range(axes - 1))


def _solve(
    weight: Array, readings: Array, beam_share: Array, diffuse_share: Array, height: Array
) -> tuple[Array, Array, Array]:
    """Weighted least squares for (B, D, H), by Cramer's rule on the symmetric 3 x 3 normal equations.

    Weights are 0 and 1, and a reading without weight is 0.
    """
    w, w_zenith, y, y_zenith = weight[:3], weight[3], readings[:3], readings[3]
    w_beam, w_diffuse, w_height = w * beam_share, w * diffuse_share, w_zenith * height
    bb = _sum(w_height * height + _RIDGE, w_beam * beam_share)
    bd = _sum(w_height, w_beam * diffuse_share)
    bh = _sum(0.0, w_beam)
    dd = _sum(w_zenith + _RIDGE, w_diffuse * diffuse_share)
    hh = _sum(_HORIZON_PRIOR, w)
    dh = (hh - _HORIZON_PRIOR) * diffuse_share
    yb = _sum(w_height * y_zenith, w_beam * y)
    yd = _sum(y_zenith, w_diffuse * y)
    yh = _sum(0.0, y)
    c_bb, c_bd, c_bh = dd * hh - dh * dh, bh * dh - bd * hh, bd * dh - bh * dd
    c_dd, c_dh, c_hh = bb * hh - bh * bh, bd * bh - bb * dh, bb * dd - bd * bd
    determinant = bb * c_bb + bd * c_bd + bh * c_bh
    beam = (c_bb * yb + c_bd * yd + c_bh * yh) / determinant
    uniform = (c_bd * yb + c_dd * yd + c_dh * yh) / determinant
    horizon = (c_bh * yb + c_dh * yd + c_hh * yh) / determinant
    return beam, uniform, horizon


def _sum(first: Array | float, vertical: Array) -> Array:
    """Return the sum with the terms of the three vertical faces, in one order whatever the shape."""
    total: Array = first + vertical[0] + vertical[1] + vertical[2]
    return total


def _bounded_light(solution: tuple[Array, Array, Array], weight: Array, towards: Array, height: Array) -> Light:
    """Bring the beam above zero and below what the zenith face allows, and keep the fitted faces otherwise."""
    beam, uniform, horizon = solution
    zenith = np.maximum(beam * height + uniform, 0.0)
    vertical = 0.5 * uniform + horizon
    most = np.where(height > _SMALLEST, zenith / np.maximum(height, _SMALLEST), 0.0)
    kept = bounded(beam, 0.0, most)
    mean_share = _sum(0.0, weight[:3] * towards) / np.maximum(_sum(0.0, weight[:3]), 1.0)
    uniform = np.maximum(zenith - kept * height, 0.0)
    vertical = vertical + (beam - kept) * mean_share
    low, high = _HORIZON_RANGE
    return Light(kept, uniform, bounded(vertical - 0.5 * uniform, low * uniform, high * uniform))
