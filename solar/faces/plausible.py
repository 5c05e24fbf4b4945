"""Which faces of a cube cannot be true: judged against each other, the sun's position and what a clear sky can give.

The limits are wide: they find what a broken wire, a dead supply or a stuck address line makes of the readings, and let
every weather pass. A gain that is some percent off is left to calibration.
"""

from collections.abc import Sequence
from enum import IntEnum

import numpy as np
from numpy.typing import ArrayLike, NDArray

from solar.frames import FACE_NORMALS, Array
from solar.laws.light import irradiance_on, light_from_faces

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
# A change that the others predict, and how little of it a face shows that does not follow the light.
_PREDICTED_W_M2 = 60.0
_STAYS_SHARE = 0.1
_FOLLOWS_SHARE = 0.3
_LIT_COSINE = 0.15
_ALBEDO = 0.2
# With the sun so low the sky gives a millionth of a day's light: 20 W/m2 on one face alone is a fault and no lamp.
_NIGHT_SINE = float(np.sin(np.radians(-6.0)))
_NIGHT_W_M2 = 20.0
_NIGHT_OTHERS_W_M2 = 5.0
_PAIRINGS = (((3, 0), (1, 2)), ((3, 1), (0, 2)), ((3, 2), (0, 1)))


class Doubt(IntEnum):
    """Why a face cannot be true."""

    NONE = 0
    DEAD = 1
    DARK = 2
    SAME = 3
    OVER = 4
    FROZEN = 5
    NIGHT = 6
    ODD = 7
    SWAPPED = 8
    TORN = 9
    LOOSE = 10


class Response(IntEnum):
    """Whether a face follows the light that the other three show."""

    UNKNOWN = 0
    FOLLOWS = 1
    STAYS = 2


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


def lit_at_night(faces_w_m2: ArrayLike, sun: ArrayLike) -> NDArray[np.bool_]:
    """Tell which face, shape (4,), reads light with the sun 6 deg below the horizon while the other three read none.

    Parameters
    ----------
    faces_w_m2
        Means over some minutes of east, south, west and zenith, shape (4,).
    sun
        Unit vector to the sun, shape (3,).
    """
    faces, height = np.asarray(faces_w_m2, float), np.asarray(sun, float)[2]
    bright = faces > _NIGHT_W_M2
    alone = np.sum(np.abs(faces) < _NIGHT_OTHERS_W_M2) == len(faces) - 1
    return bright & bool(alone and height < _NIGHT_SINE)


def responses(faces_w_m2: ArrayLike, sun: ArrayLike, believed: Sequence[bool]) -> NDArray[np.int64]:
    """Return for each face of a cube whether it follows the light, as values of `Response`, shape (4,).

    Parameters
    ----------
    faces_w_m2
        Means of minutes that follow each other, about half an hour, east, south, west and zenith, shape (n, 4).
    sun
        Unit vectors to the sun then, shape (n, 3).
    believed
        Which of the four faces others can be judged by.

    Notes
    -----
    The other three faces and the sun's position give the light (:mod:`solar.laws.light`), and the light what the face
    should read. Where that changes by more than 60 W/m2 and the face by less than a tenth of it, it stays: it is
    frozen, or was dead from the beginning. What a single minute has is no such change, as one wrong reading of another
    face is enough for it. Nothing is known of a face that the sun does not reach all the while, nor
    without another vertical one that it reaches: the predictions are not good enough there. A frozen face spoils the
    predictions for the others, so that of several which stay only the stillest is named.
    """
    faces, up = np.asarray(faces_w_m2, float), np.asarray(sun, float)
    found = np.full(4, Response.UNKNOWN, dtype=np.int64)
    if not (up[:, 2] >= LOWEST_SINE).all():
        return found
    reached = np.stack([up[:, 1], up[:, 0], -up[:, 1], up[:, 2]]).min(axis=1) > _LIT_COSINE
    reached[3] = True
    stillest, least = None, _STAYS_SHARE
    judged = [face for face in range(4) if _can_be_judged(face, reached, believed)]
    for face, by_the_others in zip(judged, _by_the_others(faces, up, judged), strict=True):
        predicted, lasting = float(np.ptp(by_the_others)), _but_for_one_minute(by_the_others)
        changed = float(np.ptp(faces[:, face]))
        if not predicted > _PREDICTED_W_M2:
            continue
        if changed > _FOLLOWS_SHARE * predicted:
            found[face] = Response.FOLLOWS
        elif lasting > _PREDICTED_W_M2 and changed < least * lasting:
            stillest, least = face, changed / lasting
    if stillest is not None:
        found[stillest] = Response.STAYS
    return found


def _can_be_judged(face: int, reached: NDArray[np.bool_], believed: Sequence[bool]) -> bool:
    others = [other for other in range(4) if other != face]
    lit_beside = any(reached[other] for other in others if other != 3)
    return bool(reached[face]) and lit_beside and all(believed[other] for other in others)


def _but_for_one_minute(w_m2: Array) -> float:
    """Return the range of some minutes without the one that widens it most."""
    ordered = np.sort(w_m2)
    return float(min(ordered[-2] - ordered[0], ordered[-1] - ordered[1]))


def _by_the_others(faces: Array, sun: Array, judged: Sequence[int]) -> Array:
    """Return what each of some faces should read by the other three, shape (faces, n): one fit for all of them."""
    if not judged:
        return np.empty((0, len(faces)))
    usable = np.ones((len(judged), *faces.shape), dtype=np.bool_)
    for place, face in enumerate(judged):
        usable[place, :, face] = False
    light = light_from_faces(np.broadcast_to(faces, usable.shape), sun, _ALBEDO, usable)
    return irradiance_on(light, sun, _ALBEDO, FACE_NORMALS[list(judged), None, :])


def lit(faces_w_m2: ArrayLike, sun: ArrayLike) -> NDArray[np.bool_]:
    """Tell where there is light enough for a face without doubts to count as sound, shape (n,)."""
    faces, up = np.atleast_2d(np.asarray(faces_w_m2, float)), np.atleast_2d(np.asarray(sun, float))
    return (_second(faces) > _LIT_W_M2) & (up[:, 2] >= LOWEST_SINE)


def _second(faces: Array) -> Array:
    brightest: Array = np.sort(np.where(np.isnan(faces), -np.inf, faces))[:, -2]
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
    found[accused] = [False, False, False, True]
    return found
