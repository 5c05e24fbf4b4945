"""Which faces of a cube cannot be true: judged against each other, the sun's position and what a clear sky can give.

The limits are wide: they find what a broken wire, a dead supply or a stuck address line makes of the readings, and let
every weather pass. A gain that is some percent off is left to calibration.
"""

import math
from collections.abc import Sequence
from enum import IntEnum

import numpy as np
from numpy.typing import ArrayLike, NDArray

from solar.frames import FACE_NORMALS, Array
from solar.laws.light import irradiance_on, light_from_faces

_SOLAR_CONSTANT_W_M2 = 1361.0
LOWEST_SUN_SINE = float(np.sin(np.radians(5.0)))
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
OTHER_FACES = ~np.eye(4, dtype=np.bool_)[:, None, :]
"""The faces by which each face is judged at every instant, shape (4, 1, 4): all but itself."""
_PAIRINGS = (((3, 0), (1, 2)), ((3, 1), (0, 2)), ((3, 2), (0, 1)))


class Doubt(IntEnum):
    """Why a face cannot be true."""

    NONE = 0
    DEAD = 1
    DARK = 2
    SAME = 3
    TOO_BRIGHT = 4
    FROZEN = 5
    NIGHT = 6
    CONTRADICTED = 7
    SWAPPED = 8
    INCONSISTENT = 9
    LOOSE_CONTACT = 10


class Response(IntEnum):
    """Whether a face follows the light that the other three show."""

    UNKNOWN = 0
    FOLLOWS = 1
    STAYS = 2


def doubts(faces_w_m2: Sequence[float], voltages_mv: Sequence[float], sun: Array, normals: Array) -> list[Doubt]:
    """Return what is wrong with each of the four faces; of one that is NaN nothing is known.

    Parameters
    ----------
    faces_w_m2, voltages_mv
        Means over some minutes of east, south, west and zenith: calibrated, and as measured.
    sun
        Unit vector to the sun, shape (3,). Nothing is judged with the sun lower than 5 deg.
    normals
        Of the faces, shape (4, 3).

    Notes
    -----
    Dead
        a face reads less than 1 % of the second brightest, which is lit.
    Dark
        no face reads 1 W/m2 with the sun higher than 10 deg.
    Same
        the zenith face and another one read the same voltage, and so do the other two: the multiplexer has taken one
        input for both of a pair, or for all.
    Over
        a face reads more than the sun at its angle, clouds at their brightest and the ground can give; for a vertical
        face by the zenith face. Two such faces accuse the zenith face.
    """
    height = float(sun[2])
    if not height >= LOWEST_SUN_SINE:
        return [Doubt.NONE] * 4
    dead = _dead(faces_w_m2)
    if _dark(faces_w_m2) and height >= _BRIGHT_DAY_SINE:
        found = [Doubt.DARK] * 4
    elif _are_paired(voltages_mv):
        found = [Doubt.SAME] * 4
    elif dead[3]:
        # A dead zenith face is no measure for the others.
        found = [Doubt.NONE] * 4
    else:
        found = [
            Doubt.TOO_BRIGHT if over else Doubt.NONE for over in _find_too_bright(faces_w_m2, (normals @ sun).tolist())
        ]
    return [Doubt.DEAD if gone else doubt for gone, doubt in zip(dead, found, strict=True)]


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


def responses(faces_w_m2: ArrayLike, sun: ArrayLike, believed: Sequence[bool]) -> list[Response]:
    """Return for each of the four faces of a cube whether it follows the light.

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
    frozen, or was dead from the beginning. A change in a single minute does not count, as one wrong reading of another
    face is enough for it. Nothing is known of a face that the sun does not reach all the while, nor without another
    vertical face that it reaches: the predictions are not good enough there. A frozen face spoils the predictions for
    the others, so that only the stillest of several that stay is named.
    """
    faces, up = np.asarray(faces_w_m2, float), np.asarray(sun, float)
    found = [Response.UNKNOWN] * 4
    south, east, height = up.min(axis=0).tolist()
    west = -float(up[:, 1].max())
    reached = [*(cosine > _LIT_COSINE for cosine in (east, south, west)), True]
    judged = [face for face in range(4) if _can_be_judged(face, reached, believed)]
    if not height >= LOWEST_SUN_SINE or not judged:
        return found
    stillest, least = None, _STAYS_SHARE
    ordered = np.sort(_predict_by_others(faces, up, judged))
    changes = np.ptp(faces, axis=0).tolist()
    for face, (lowest, second, last_but_one, highest) in zip(judged, ordered[:, [0, 1, -2, -1]].tolist(), strict=True):
        predicted, changed = highest - lowest, changes[face]
        # The predicted change without the one minute that widens it most.
        lasting = min(last_but_one - lowest, highest - second)
        if not predicted > _PREDICTED_W_M2:
            continue
        if changed > _FOLLOWS_SHARE * predicted:
            found[face] = Response.FOLLOWS
        elif lasting > _PREDICTED_W_M2 and changed < least * lasting:
            stillest, least = face, changed / lasting
    if stillest is not None:
        found[stillest] = Response.STAYS
    return found


def _can_be_judged(face: int, reached: Sequence[bool], believed: Sequence[bool]) -> bool:
    others = [other for other in range(4) if other != face]
    lit_beside = any(reached[other] for other in others if other != 3)
    return reached[face] and lit_beside and all(believed[other] for other in others)


def _predict_by_others(faces: Array, sun: Array, judged: Sequence[int]) -> Array:
    """Return what each of some faces should read by the other three, shape (faces, n): one fit for all of them."""
    light = light_from_faces(faces, sun, _ALBEDO, OTHER_FACES[judged])
    return irradiance_on(light, sun, _ALBEDO, FACE_NORMALS[judged, None, :])


def is_lit(faces_w_m2: Sequence[float], sun: Array) -> bool:
    """Tell whether there is light enough for a face without doubts to count as sound, as for :func:`doubts`."""
    return _second_brightest(faces_w_m2) > _LIT_W_M2 and bool(sun[2] >= LOWEST_SUN_SINE)


def _second_brightest(faces: Sequence[float]) -> float:
    return sorted(-math.inf if math.isnan(face) else face for face in faces)[-2]


def _dead(faces: Sequence[float]) -> list[bool]:
    second = _second_brightest(faces)
    return [second > _LIT_W_M2 and face < _DEAD_SHARE * second for face in faces]


def _dark(faces: Sequence[float]) -> bool:
    return all(abs(face) < _DARK_W_M2 for face in faces)


def _are_paired(voltages: Sequence[float]) -> bool:
    paired = any(
        all(_are_equal_voltages(voltages[one], voltages[other]) for one, other in pairs) for pairs in _PAIRINGS
    )
    return paired and any(abs(voltage) > _SEEN_MV for voltage in voltages)


def _are_equal_voltages(one: float, other: float) -> bool:
    return abs(one - other) <= _SAME_MV + _SAME_SHARE * max(abs(one), abs(other))


def _find_too_bright(faces: Sequence[float], cosines: Sequence[float]) -> list[bool]:
    sun_w_m2 = [_OVER_SHARE * _SOLAR_CONSTANT_W_M2 * max(cosine, 0.0) for cosine in cosines]
    zenith = faces[3]
    # A vertical face sees half of the sky that the zenith face sees, and the ground that this sky lights.
    found = [face > sun + zenith + _SHADED_W_M2 for face, sun in zip(faces[:3], sun_w_m2[:3], strict=True)]
    if sum(found) >= 2:
        return [False, False, False, True]
    return [*found, zenith > sun_w_m2[3] + _OVER_W_M2]
