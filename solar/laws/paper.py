"""Pointing laws: where to look, from the four faces of the cube or from the sun.

Faces come as arrays of shape (..., 4) in the order east, south, west, zenith [W/m2]; directions go out with shape
(..., 3) in the frame of :mod:`solar.frames`, of any length. NaN in every component means 'no direction'.
Reference: Andriamahefa et al., EPJ Photovoltaics 14, 35 (2023).
"""

from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from solar.frames import Array, as_vectors

_FACES = ("east", "south", "west", "zenith")
_ABSURD_W_M2 = 1e6
_EXPLAINED_SIGMAS = 2.0

ZENITH = np.array([0.0, 0.0, 1.0])


def mu_prime(faces: ArrayLike, *, uniform_threshold: float = 0.01) -> Array:
    """Return mu', equation (12), with I_min = min(I_E, I_W).

    Parameters
    ----------
    faces
        Irradiances [W/m2], shape (..., 4); of a frame with named columns, the columns east, south, west and zenith.
    uniform_threshold
        I_S - I_min counts as zero (B = 90 deg) unless it is more than this share of I_Z: under a uniform sky it is
        noise about zero. The jump of B at the threshold is atan(uniform_threshold).

    Returns
    -------
    Directions [W/m2], shape (..., 3); NaN where a face is no possible number or I_Z is not positive.

    Raises
    ------
    ValueError
        The last axis has not four faces, a frame lacks one by name, one is no number, or the threshold is no share.
    """
    _check_share("uniform threshold", uniform_threshold)
    east, south, west, zenith, valid = _split(faces)
    equatorward = _zero_below(south - np.minimum(east, west), uniform_threshold * zenith)
    return _direction(equatorward, east - west, zenith, valid)


def sun_vector(
    faces: ArrayLike, *, albedo: float = 0.2, uniform_threshold: float = 0.01, gain_uncertainty: float = 0.03
) -> Array:
    """Return s, equation (11), with the better DHI = 2 I_min - albedo I_Z that the paper offers; its length is BNI.

    Where a uniform sky and wrong gains can explain s there is no beam to point at, and the direction is the zenith,
    where a uniform sky is best collected. Wrong gains explain an s that is no longer than two standard errors,

        sigma^2 = g^2 [(I_S^2 + I_min^2) + (I_E^2 + I_W^2) + ((1 + albedo)^2 I_Z^2 + 4 I_min^2)]

    one bracket for each component of s, g the relative standard error of each face's gain. A negative vertical
    component counts as zero.

    Parameters
    ----------
    faces
        Irradiances [W/m2], shape (..., 4); of a frame with named columns, the columns east, south, west and zenith.
    albedo
        Of the ground around the cube.
    uniform_threshold
        Share of I_Z below which a difference between faces is noise.
    gain_uncertainty
        g.

    Returns
    -------
    Directions [W/m2], shape (..., 3); NaN where a face is no possible number or I_Z is not positive.

    Raises
    ------
    ValueError
        The last axis has not four faces, a frame lacks one by name, one is no number, or the albedo, the threshold or
        the uncertainty is no share.
    """
    for name, value in (
        ("albedo", albedo),
        ("uniform threshold", uniform_threshold),
        ("gain uncertainty", gain_uncertainty),
    ):
        _check_share(name, value)
    east, south, west, zenith, valid = _split(faces)
    least = np.minimum(east, west)
    equatorward = _zero_below(south - least, uniform_threshold * zenith)
    up = np.maximum(zenith - (2 * least - albedo * zenith), 0.0)
    beam = np.sqrt(equatorward**2 + (east - west) ** 2 + up**2)
    horizontal = south**2 + least**2 + east**2 + west**2
    sigma = gain_uncertainty * np.sqrt(horizontal + ((1 + albedo) * zenith) ** 2 + (2 * least) ** 2)
    sees_sun = beam > np.maximum(uniform_threshold * zenith, _EXPLAINED_SIGMAS * sigma)
    return _direction(
        np.where(sees_sun, equatorward, ZENITH[0]),
        np.where(sees_sun, east - west, ZENITH[1]),
        np.where(sees_sun, up, ZENITH[2]),
        valid,
    )


def complete_poleward(vector: ArrayLike, sun_direction: ArrayLike) -> Array:
    """Return `vector` with the component that no face of the cube can see: away from the equator.

    Equation (9) holds only while the sun is on the equator's side; beyond the East-West plane I_S - I_min is 0 whatever
    the sun does. There the sun's azimuth by ephemeris fills the gap: i = j (i_sun / j_sun). A vector stays as it is if
    it has an equatorward component of its own, or if the sun is within 45 deg of the pole's azimuth.

    Parameters
    ----------
    vector, sun_direction
        The cube's vector and the sun by ephemeris, shapes (..., 3).
    """
    seen, sun = np.broadcast_arrays(np.asarray(vector, dtype=np.float64), np.asarray(sun_direction, dtype=np.float64))
    blind = (seen[..., 0] == 0) & (sun[..., 0] < 0) & (np.abs(sun[..., 0]) <= np.abs(sun[..., 1]))
    ratio = np.divide(sun[..., 0], sun[..., 1], out=np.zeros(sun.shape[:-1]), where=blind)
    poleward = np.where(blind & (seen[..., 1] * sun[..., 1] > 0), seen[..., 1] * ratio, seen[..., 0])
    return np.stack([poleward, seen[..., 1], seen[..., 2]], axis=-1)


def chronometric(sun_direction: ArrayLike) -> Array:
    """Return the sun's direction(s), shape (..., 3), NaN where below the horizon; `ValueError` for another shape."""
    sun = as_vectors(sun_direction)
    return np.where(sun[..., 2:] > 0, sun, np.nan)


def _check_share(name: str, value: float) -> None:
    # Written so that NaN fails.
    if not (isinstance(value, int | float | np.integer | np.floating) and 0.0 <= value <= 1.0):
        raise ValueError(f"the {name} must be a share from 0 to 1, not {value}")


def _split(faces: ArrayLike) -> tuple[Array, Array, Array, Array, np.ndarray]:
    readings = _readings(faces)
    if readings.shape[-1:] != (4,):
        raise ValueError(
            f"the faces are East, South, West, Zenith along the last axis, not an array of {readings.shape}"
        )
    # Written so that NaN fails; the bound keeps squares finite, no irradiance comes near it.
    valid = (np.abs(readings) < _ABSURD_W_M2).all(axis=-1) & (readings[..., 3] > 0)
    clean = np.where(valid[..., None], readings, 0.0)
    return clean[..., 0], clean[..., 1], clean[..., 2], clean[..., 3], valid


def _readings(faces: Any) -> Array:
    is_frame = hasattr(faces, "iloc")
    if is_frame:
        faces = _order_columns(faces)
    try:
        return np.asarray(faces.to_numpy(dtype=np.float64, na_value=np.nan) if is_frame else faces, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise ValueError(f"the faces must be numbers [W/m2], NaN where one is missing ({error})") from None


def _order_columns(frame: Any) -> Any:
    """Return the faces of a frame by their names: numpy would take its columns in the order in which they stand."""
    names = list(frame.columns if hasattr(frame, "columns") else frame.index)
    missing = [name for name in _FACES if name not in names]
    if not missing:
        return frame[list(_FACES)]
    if any(isinstance(name, str) for name in names):
        raise ValueError(
            f"the faces have no column {', '.join(missing)}: east, south, west and zenith are needed; found:"
            f" {', '.join(map(str, names))}"
        )
    return frame


def _zero_below(difference: Array, threshold: Array) -> Array:
    return np.where(difference > threshold, difference, 0.0)


def _direction(equatorward: Array, east: Array, up: Array, valid: np.ndarray) -> Array:
    return np.where(valid[..., None], np.stack([equatorward, east, up], axis=-1), np.nan)
