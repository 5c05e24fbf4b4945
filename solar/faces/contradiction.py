"""Whether four faces can show one light at all, and which of them is wrong when they cannot.

Beam, uniform sky and horizon (:mod:`solar.laws.light`) are three unknowns for four readings, within bounds: no beam is
negative, no horizon much darker than the vault. What is left over between the readings and the best such light is the
misfit. Three sound faces can nearly always be explained. So each face is left out in turn: over half an hour the misfit
vanishes only when the one left out is the wrong one, because otherwise that one is still among the three. Two faces
that are swapped are found in the same way, by swapping them back.
"""

from collections.abc import Collection
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from solar.faces.plausible import LOWEST_SUN_SINE, OTHER_FACES
from solar.frames import Array
from solar.laws.light import Light, irradiance_on_faces, light_from_faces

PAIRS = ((0, 1), (0, 2), (1, 2), (0, 3), (1, 3), (2, 3))
"""Places of two faces that may be swapped."""
SWAPS = np.array([[{one: other, other: one}.get(face, face) for face in range(4)] for one, other in PAIRS])
"""The order of the faces with each of `PAIRS` swapped, shape (6, 4)."""
CONTRADICTION_THRESHOLD = 0.15
"""A misfit above this share of the readings says that the faces contradict each other."""
AGREEMENT_THRESHOLD = 0.08
"""A misfit below this share says that they agree."""
_SOLVED = 0.06
_CLEAR_FACTOR = 2.0
_ALBEDOS = np.array([0.1, 0.3, 0.7])
_WITHOUT_SNOW = _ALBEDOS[:2]
_HORIZON_RANGE = (-0.2, 0.7)
# Snow and the brightest horizon explain so much that a face at half its gain agrees with the rest once or twice a day.
_ORDINARY_HORIZON_RANGE = (-0.2, 0.4)
_LIT_W_M2 = 30.0
_PARTS = 3
_LEAST_MINUTES = 24
_ALL_FACES = np.ones((1, 1, 4), dtype=np.bool_)
_DOUBLING = (1.0 + np.eye(4))[:, None, :]


class Misfits:
    """What is left over of the readings, as a share of them; all but `whole` and `least` are worked out when asked for.

    Parameters
    ----------
    faces_w_m2, sun
        As for :func:`misfits`, of minutes in which all four faces are known.

    Attributes
    ----------
    whole
        By all four faces.
    least
        The same in the part of the time where they agree best.
    """

    def __init__(self, faces_w_m2: Array, sun: Array) -> None:
        self._faces, self._sun = faces_w_m2, sun
        whole, least = self._misfit_and_least(faces_w_m2[None])
        self.whole, self.least = float(whole[0]), float(least[0])

    @cached_property
    def without(self) -> Array:
        """By the three others, for each face, shape (4,)."""
        return self._misfits_without_each[0]

    @cached_property
    def least_without(self) -> Array:
        """The same in the part of the time where they agree best."""
        return self._misfits_without_each[1]

    @cached_property
    def swapped(self) -> Array:
        """By all four with two swapped back, for each of `PAIRS`, shape (6,)."""
        return self._misfit_and_least(np.moveaxis(self._faces[:, SWAPS], 0, 1))[0]

    @cached_property
    def without_snow(self) -> float:
        """By all four where the ground has no snow and the horizon is no brighter than it usually is."""
        over, _ = self._misfit_and_least(
            self._faces[None], albedos=_WITHOUT_SNOW, horizon_range=_ORDINARY_HORIZON_RANGE
        )
        return float(over[0])

    @cached_property
    def doubled(self) -> Array:
        """By all four with one read twice, for each face, shape (4,): what a face at half its gain would hide."""
        return self._misfit_and_least(self._faces * _DOUBLING)[0]

    @property
    def is_contradictory(self) -> bool:
        """Whether no light explains the faces, at no time."""
        return self.least > CONTRADICTION_THRESHOLD

    @property
    def suspect_faces(self) -> tuple[int, ...]:
        """The face that is wrong, or two that are swapped; empty where that cannot be told."""
        if not self.is_contradictory:
            return ()
        swapped, single = _clear_minimum(self.swapped), _clear_minimum(self.without)
        if swapped is not None and single is not None:
            # A face that stands still may for a while look like its neighbour.
            return ()
        if swapped is not None:
            # Where one wrong face explains the readings about as well, it is no swap: half a gain can look like one.
            alone = float(self.without.min()) < _CLEAR_FACTOR * float(self.swapped[swapped])
            return () if alone else PAIRS[swapped]
        return () if single is None else (single,)

    def others_agree_without(self, face: int) -> bool:
        """Tell whether this face alone may be wrong, as the three others agree."""
        return float(self.without[face]) < AGREEMENT_THRESHOLD

    def other_wrong_face(self, face: int) -> int | None:
        """Return the face that is wrong instead, if the others contradict each other without this one too; or None."""
        if not float(self.least_without[face]) > CONTRADICTION_THRESHOLD or len(self.suspect_faces) != 1:
            return None
        return self.suspect_faces[0]

    def rules_out_half_gain(self, face: int) -> bool:
        """Tell whether the faces agree as they are, and would not if this one read twice as much."""
        return self.without_snow < AGREEMENT_THRESHOLD and float(self.doubled[face]) > AGREEMENT_THRESHOLD

    def rules_out_swaps(self, places: Collection[int]) -> bool:
        """Tell whether the faces agree as they are, and would not with any two of these swapped."""
        pairs = [place for place, pair in enumerate(PAIRS) if set(pair) <= set(places)]
        return (
            self.whole < AGREEMENT_THRESHOLD
            and float(self.swapped[pairs].min(initial=np.inf)) > CONTRADICTION_THRESHOLD
        )

    @cached_property
    def _misfits_without_each(self) -> tuple[Array, Array]:
        return self._misfit_and_least(self._faces[None], OTHER_FACES)

    def _misfit_and_least(
        self,
        faces: Array,
        used: NDArray[np.bool_] = _ALL_FACES,
        albedos: Array = _ALBEDOS,
        horizon_range: tuple[float, float] = _HORIZON_RANGE,
    ) -> tuple[Array, Array]:
        """Return what is left over, shape (k,), of faces, shape (k or 1, n, 4): of all the time, and where it is least.

        `used` tells which of them count, shape (k or 1, 1, 4).
        """
        left = _squared_residuals(faces, self._sun, used, albedos, horizon_range)
        there = (used * faces**2).sum(axis=-1)
        parts = zip(np.array_split(left, _PARTS, axis=-1), np.array_split(there, _PARTS, axis=-1), strict=True)
        least = np.min([np.sqrt(over.sum(axis=-1) / all_of_it.sum(axis=-1)) for over, all_of_it in parts], axis=0)
        return np.sqrt(left.sum(axis=-1) / there.sum(axis=-1)), least


def misfits(faces_w_m2: Array, sun: Array) -> Misfits | None:
    """Return how badly the faces of a cube fit together; None where the light or the readings do not suffice.

    Parameters
    ----------
    faces_w_m2
        Means of minutes that follow each other, about half an hour, east, south, west and zenith, shape (n, 4).
    sun
        Unit vectors to the sun then, shape (n, 3).
    """
    good = np.isfinite(faces_w_m2).all(axis=-1) & (sun[:, 2] >= LOWEST_SUN_SINE)
    faces, up = faces_w_m2[good], sun[good]
    if len(faces) < _LEAST_MINUTES or not np.sort(faces)[:, -2].mean() > _LIT_W_M2:
        return None
    return Misfits(faces, up)


def _clear_minimum(shares: Array) -> int | None:
    """Return the place of the one share that is near zero; None if there is none, or more than one."""
    best, second = np.sort(shares)[:2]
    return (
        int(np.argmin(shares)) if best < _SOLVED and second > max(_CLEAR_FACTOR * best, AGREEMENT_THRESHOLD) else None
    )


def _squared_residuals(
    faces: Array, sun: Array, used: NDArray[np.bool_], albedos: Array, horizon_range: tuple[float, float]
) -> Array:
    """Return the squares left over, shape (k, n), for the albedo that explains the faces best."""
    albedo = albedos[:, None, None]
    light = light_from_faces(faces, sun, albedo, used)
    over = np.where(used, faces - bounded_face_irradiances(light, sun, albedo, horizon_range), 0.0)
    squares: Array = (over**2).sum(axis=-1).min(axis=0)
    return squares


def bounded_face_irradiances(
    light: Light, sun: Array, albedo: Array | float, horizon_range: tuple[float, float] = _HORIZON_RANGE
) -> Array:
    """Return what the faces of a cube read [W/m2] in a light whose horizon is within a range, shape (..., 4).

    The range is in shares of the uniform part; by default it is that of all horizons.
    """
    low, high = horizon_range
    horizon = np.clip(light.horizon, low * light.uniform, high * light.uniform)
    return irradiance_on_faces(light._replace(horizon=horizon), sun, albedo)
