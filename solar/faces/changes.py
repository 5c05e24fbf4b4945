"""Which face does not change as the light does, when clouds pass before the sun.

From one minute to the next the sun hardly moves and the sky behind it changes little, but its beam comes and goes. By
:mod:`solar.laws.light` a face's change is then linear in three changes of the light: of the beam b, which falls on each
face by its own angle, of the uniform sky and of the horizon. The last two are small beside the first, and that is what
tells faces apart where the readings themselves do not: a south face in a shade of its own can pass for a weaker beam,
and two swapped vertical faces under a bright cloud read alike, but neither changes with the beam as it should.

What is left over of the changes is compared for the faces as they are, for each of them dead, shaded from the sun or at
half its gain, and for each two of them swapped.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from solar.faces.contradiction import PAIRS, SWAPS
from solar.faces.plausible import LOWEST_SUN_SINE
from solar.frames import Array, stack_components
from solar.laws.light import beam_shares

_CONTRADICT = 0.25
_EXPLAINED_SHARE = 0.3
_CLEAR_FACTOR = 1.5
_LARGE_W_M2 = 25.0
_LEAST_LARGE = 5
_PARTS, _PARTS_NEEDED = 3, 2
_ALBEDO = 0.2
# Weights of the assumption that uniform sky and horizon do not change, beside one face's change.
_UNIFORM_PRIOR, _HORIZON_PRIOR = 0.05, 0.15
_RIDGE = 1e-6
_HALF = 0.5


class ChangeMisfits(NamedTuple):
    """What is left over of the changes, as a share of them.

    Attributes
    ----------
    without_fault
        With four sound faces. Where they explain the changes, no fault is sought, and the other shares are infinite.
    single
        With one face that is dead, shaded or at half its gain, the least of the three, for each face, shape (4,).
    swapped
        With two faces swapped, for each of :data:`solar.faces.contradiction.PAIRS`, shape (6,).
    """

    without_fault: float
    single: Array
    swapped: Array

    @property
    def is_contradictory(self) -> bool:
        """Whether no change of the light explains those of the faces."""
        return self.without_fault > _CONTRADICT

    @property
    def suspect_faces(self) -> tuple[int, ...]:
        """The face that is wrong, or two that are swapped; empty where the changes do not tell."""
        shares = np.concatenate([self.single, self.swapped])
        best, second = np.sort(shares)[:2]
        explained = best < _EXPLAINED_SHARE * self.without_fault
        if not (self.is_contradictory and explained and second > _CLEAR_FACTOR * best):
            return ()
        place = int(np.argmin(shares))
        return (place,) if place < len(self.single) else PAIRS[place - len(self.single)]


def change_misfits(faces_w_m2: Array, sun: Array) -> ChangeMisfits | None:
    """Return how badly the changes of a cube's faces fit together; None where the light changes too seldom.

    Parameters
    ----------
    faces_w_m2
        Means of minutes that follow each other, about half an hour, east, south, west and zenith, shape (n, 4).
    sun
        Unit vectors to the sun then, shape (n, 3).
    """
    if not (sun[:, 2] >= LOWEST_SUN_SINE).all():
        return None
    steps = np.diff(faces_w_m2, axis=0)
    told = np.logical_and.reduce(np.isfinite(steps), axis=-1)
    if not _has_enough_changes(told & (np.abs(steps) > _LARGE_W_M2).any(axis=-1)):
        return None
    steps, up = steps[told], sun[1:][told]
    direct = stack_components(*beam_shares(up), up[:, 2])
    sound, total = _sound_responses(direct), (steps**2).sum()
    without_fault = float(np.sqrt(_squared_residuals(steps, sound[None]) / total)[0])
    if not without_fault > _CONTRADICT:
        return ChangeMisfits(without_fault, np.full(4, np.inf), np.full(len(PAIRS), np.inf))
    shares = np.sqrt(_squared_residuals(steps, _faulty_responses(sound, direct)) / total)
    dead, half, shaded, swapped = np.split(shares, [4, 8, 12])
    return ChangeMisfits(without_fault, np.min([dead, half, shaded], axis=0), swapped)


def _has_enough_changes(large: NDArray[np.bool_]) -> bool:
    """Tell whether there are enough large changes, and not all of them in the same third of the time."""
    parts = sum(bool(part.any()) for part in np.array_split(large, _PARTS))
    return bool(large.sum() >= _LEAST_LARGE) and parts >= _PARTS_NEEDED


def _sound_responses(direct: Array) -> Array:
    """Return how sound faces change with beam, uniform sky and horizon, shape (n, 4, 3).

    `direct` is what the beam alone gives, shape (n, 4), to the zenith face by the sun's height.
    """
    sound = np.empty((*direct.shape, 3))
    sound[..., 0] = direct + 0.5 * _ALBEDO * direct[:, 3:] * (np.arange(4) < 3)
    sound[..., 1] = [0.5 * (1.0 + _ALBEDO)] * 3 + [1.0]
    sound[..., 2] = [1.0, 1.0, 1.0, 0.0]
    return sound


def _faulty_responses(sound: Array, direct: Array) -> Array:
    """Return the same with each face dead, at half its gain and shaded, and each two swapped, shape (18, n, 4, 3)."""
    one = np.eye(4)[:, None, :, None]
    dead, half = sound * (1.0 - one), sound * (1.0 - (1.0 - _HALF) * one)
    shaded = sound - one * direct[..., None] * [1.0, 0.0, 0.0]
    return np.concatenate([dead, half, shaded, np.moveaxis(sound[:, SWAPS], 1, 0)])


def _squared_residuals(steps: Array, columns: Array) -> Array:
    """Return the squares left over, shape (k,), with the beam, uniform sky and horizon that explain each step best."""
    prior = np.diag([_RIDGE, _UNIFORM_PRIOR, _HORIZON_PRIOR])
    normal = np.swapaxes(columns, -1, -2) @ columns + prior
    seen = np.einsum("knfc,nf->knc", columns, steps)
    found = np.linalg.solve(normal, seen[..., None])[..., 0]
    result: Array = np.maximum((steps**2).sum() - (seen * found).sum(axis=(-1, -2)), 0.0)
    return result
