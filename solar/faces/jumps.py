"""Which face jumps alone and is back within two minutes, as a loose contact makes it.

A cloud that passes before the sun changes every face that the sun reaches, and the sky and the ground that the others
see. What shows for a minute on one face alone is no light.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from solar.frames import FACE_NORMALS, Array

# How far a face has to be from its median, and how much of that any other face may share: for its reading to be
# replaced, and for the face to be accused.
_UNSURE_W_M2, _UNSURE_SHARED = 15.0, 0.2
_SURE_W_M2, _SURE_SHARED = 80.0, 0.05
_REACHED_COSINE = 0.15
_REACHED_OTHERS = 2
_JUMPS = 2
# The median of so many minutes is what a face reads without a jump; a jump of one or two is over within them.
_MINUTES, _MINUTES_BESIDE = 5, 2
_SAME_FACE = np.eye(4, dtype=np.bool_)


class Jumps(NamedTuple):
    """The jumps of some minutes, and what the faces read without them.

    Attributes
    ----------
    sure
        In which minutes a face, and no other, was surely far from its median of five, shape (n, 4).
    without_jumps
        The faces [W/m2], with that median where a face may have been, shape (n, 4).
    """

    sure: NDArray[np.bool_]
    without_jumps: Array

    def repeated(self, sun: Array, believed: Sequence[bool]) -> NDArray[np.bool_]:
        """Tell which face has jumped, and come back, more than once, shape (4,).

        `sun` are the unit vectors to the sun, shape (n, 3). The sun has to reach two other faces that are `believed`:
        clouds that pass before it now and then leave one of them at its own median.
        """
        reached = (sun @ FACE_NORMALS.T > _REACHED_COSINE) & np.asarray(believed)
        others = reached.sum(axis=-1, keepdims=True) - reached
        back = (self.sure & (others >= _REACHED_OTHERS))[:-_MINUTES_BESIDE]
        begun = back[1:] & ~back[:-1]
        result: NDArray[np.bool_] = back[0] + begun.sum(axis=0) >= _JUMPS
        return result


def find_jumps(faces_w_m2: Array) -> Jumps:
    """Find the jumps of minutes that follow each other.

    Parameters
    ----------
    faces_w_m2
        East, south, west and zenith, shape (n, 4). With fewer than five minutes, and beside NaN, no jump is found.
    """
    count = len(faces_w_m2)
    if count < _MINUTES:
        return Jumps(np.zeros(faces_w_m2.shape, dtype=np.bool_), faces_w_m2)
    medians = _medians(faces_w_m2)
    # The first five minutes have one median, and so have the last.
    middle = np.concatenate([medians[:1]] * _MINUTES_BESIDE + [medians] + [medians[-1:]] * _MINUTES_BESIDE)
    apart = np.abs(faces_w_m2 - middle)
    unsure = apart > _UNSURE_W_M2
    if not unsure.any():
        # A sure jump is above the unsure bound as well.
        return Jumps(unsure, faces_w_m2)
    others = np.where(_SAME_FACE, 0.0, apart[:, None, :]).max(axis=-1)
    sure = (apart > _SURE_W_M2) & (others < _SURE_SHARED * apart)
    unsure &= others < _UNSURE_SHARED * apart
    return Jumps(sure, np.where(unsure, middle, faces_w_m2))


def _medians(faces: Array) -> Array:
    """Return the median of each five minutes that follow each other, shape (n - 4, 4), NaN being above everything."""
    one, two, three, four, five = (faces[first : len(faces) - _MINUTES + 1 + first] for first in range(_MINUTES))
    # The median of five is neither the least nor the greatest of four of them, but the median of the other three.
    # `fmin` and `maximum` both take NaN for the greater one.
    low = np.maximum(np.fmin(one, two), np.fmin(three, four))
    high = np.fmin(np.maximum(one, two), np.maximum(three, four))
    result: Array = np.fmin(np.maximum(np.fmin(low, high), five), np.maximum(low, high))
    return result
