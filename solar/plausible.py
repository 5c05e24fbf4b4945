"""Which faces of a cube cannot be true: judged against each other, the sun's position and what a clear sky can give.

The limits are wide: they find what a broken wire, a dead supply or a stuck address line makes of the readings, and let
every weather pass. A gain that is some percent off is left to calibration.
"""

from enum import IntEnum

import numpy as np
from numpy.typing import ArrayLike, NDArray

from solar.frames import Array

_SOLAR_CONSTANT_W_M2 = 1361.0
LOWEST_SINE = float(np.sin(np.radians(5.0)))
"""Sine of the sun's elevation below which nothing is judged."""
_BRIGHT_DAY_SINE = float(np.sin(np.radians(10.0)))
# The shaded face of a clear day over dark ground still reads several percent of the zenith face.
_DEAD_SHARE = 0.01
_LIT_W_M2 = 30.0
# The darkest thunderstorm lets more through than this.
_DARK_W_M2 = 1.0
_SAME_SHARE = 0.002
_SAME_MV = 0.015
_SEEN_MV = 0.1
# Beyond what clouds at their brightest add to sun and sky.
_OVER_SHARE = 1.3
_OVER_W_M2 = 100.0
_SHADED_W_M2 = 60.0
_PAIRINGS = (((3, 0), (1, 2)), ((3, 1), (0, 2)), ((3, 2), (0, 1)))


class Doubt(IntEnum):
    """Why a face cannot be true."""

    NONE = 0
    DEAD = 1
    DARK = 2
    SAME = 3
    OVER = 4


def doubts(faces_w_m2: ArrayLike, voltages_mv: ArrayLike, sun: ArrayLike, normals: ArrayLike) -> NDArray[np.int64]:
    """Return what is wrong with each face, as values of `Doubt`, shape (n, 4); nothing is known of NaN.

    Parameters
    ----------
    faces_w_m2, voltages_mv
        Means over some minutes of east, south, west and zenith, shape (n, 4): calibrated, and as measured.
    sun
        Unit vectors to the sun, shape (n, 3). Nothing is judged with the sun lower than 5 deg.
    normals
        Of the faces, shape (4, 3).

    Notes
    -----
    Dead
        a face reads less than 1 % of the second brightest, which is lit.
    Dark
        no face reads 1 W/m2 with the sun higher than 10 deg.
    Same
        the zenith face and another one read the same voltage, and so do the other two: the switch has taken two
        inputs for one, or one for all.
    Over
        a face reads more than the sun at its angle, clouds at their brightest and the ground can give; for a vertical
        face by the zenith face. Two such faces accuse the zenith face.
    """
    faces, voltages = np.atleast_2d(np.asarray(faces_w_m2, float)), np.atleast_2d(np.asarray(voltages_mv, float))
    up = np.atleast_2d(np.asarray(sun, float))
    found = np.zeros(faces.shape, dtype=np.int64)
    dead = _dead(faces)
    over = _over(faces, np.maximum(up @ np.asarray(normals, float).T, 0.0))
    # A dead zenith face is no measure for the others.
    over[dead[:, 3]] = False
    for doubt, seen in (
        (Doubt.OVER, over),
        (Doubt.SAME, _same(voltages)),
        (Doubt.DARK, _dark(faces, up[:, 2])),
        (Doubt.DEAD, dead),
    ):
        found[seen] = doubt
    found[up[:, 2] < LOWEST_SINE] = Doubt.NONE
    return found


def lit(faces_w_m2: ArrayLike, sun: ArrayLike) -> NDArray[np.bool_]:
    """Tell where there is light enough for a face without doubts to count as sound, shape (n,)."""
    faces, up = np.atleast_2d(np.asarray(faces_w_m2, float)), np.atleast_2d(np.asarray(sun, float))
    return (_second(faces) > _LIT_W_M2) & (up[:, 2] >= LOWEST_SINE)


def _second(faces: Array) -> Array:
    brightest: Array = np.sort(np.nan_to_num(faces, nan=-np.inf), axis=-1)[:, -2]
    return brightest


def _dead(faces: Array) -> NDArray[np.bool_]:
    second = _second(faces)[:, None]
    result: NDArray[np.bool_] = (second > _LIT_W_M2) & (faces < _DEAD_SHARE * second)
    return result


def _dark(faces: Array, sine: Array) -> NDArray[np.bool_]:
    dark = (np.abs(faces) < _DARK_W_M2).all(axis=-1) & (sine >= _BRIGHT_DAY_SINE)
    return np.repeat(dark[:, None], 4, axis=1)


def _same(voltages: Array) -> NDArray[np.bool_]:
    found = np.zeros(voltages.shape[0], dtype=np.bool_)
    for pairs in _PAIRINGS:
        found |= np.logical_and.reduce([_alike(voltages[:, one], voltages[:, other]) for one, other in pairs])
    seen = (np.abs(voltages) > _SEEN_MV).any(axis=-1)
    return np.repeat((found & seen)[:, None], 4, axis=1)


def _alike(one: Array, other: Array) -> NDArray[np.bool_]:
    result: NDArray[np.bool_] = np.abs(one - other) <= _SAME_MV + _SAME_SHARE * np.maximum(np.abs(one), np.abs(other))
    return result


def _over(faces: Array, cosines: Array) -> NDArray[np.bool_]:
    sun_w_m2 = _OVER_SHARE * _SOLAR_CONSTANT_W_M2 * cosines
    found = faces > sun_w_m2 + _OVER_W_M2
    # A vertical face sees half of the sky that the zenith face sees, and the ground that this sky lights.
    found[:, :3] = faces[:, :3] > sun_w_m2[:, :3] + faces[:, 3:] + _SHADED_W_M2
    accused = found[:, :3].sum(axis=-1) >= 2
    found[accused, :3] = False
    found[accused, 3] = True
    return found
