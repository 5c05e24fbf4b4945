"""Faces that contradict each other for half an hour, and who is not believed for it until they agree."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from daemon.base.records import FACES
from solar.faces.contradiction import AGREEMENT, Misfits, misfits
from solar.faces.plausible import Doubt
from solar.frames import Array

MINUTES = 30
_EVERY_MINUTES = 5
_PUZZLED_LOOKS = 2
_OF_MISFITS = (Doubt.ODD, Doubt.SWAPPED, Doubt.TORN)
# What these say of one face leaves the others open: they may contradict each other for a reason of their own.
_OPEN = (Doubt.NONE, Doubt.OVER, *_OF_MISFITS)


class Contradictions:
    """Looks at the last half hour every five minutes; what it finds stands until it looks again."""

    def __init__(self) -> None:
        self._forget()

    def _forget(self) -> None:
        self._minutes = self._puzzled = 0
        self._fit: Misfits | None = None
        self._found = np.full(len(FACES), Doubt.NONE, dtype=np.int64)

    def look(self, faces_w_m2: Array, sun: Array, whys: Sequence[Doubt]) -> NDArray[np.int64]:
        """Return what contradicts in each face, as values of `Doubt`, shape (4,).

        Parameters
        ----------
        faces_w_m2, sun
            Of the minutes so far, the last half hour at the most, as for :func:`solar.faces.contradiction.misfits`.
        whys
            What is said against each face already.
        """
        if len(faces_w_m2) < MINUTES or any(why not in _OPEN for why in whys):
            self._forget()
        elif self._minutes % _EVERY_MINUTES == 0:
            self._fit = misfits(faces_w_m2, sun)
            self._found = self._judged(whys)
        self._minutes += 1
        return self._found

    def agrees(self, face: int, whys: Sequence[Doubt]) -> bool:
        """Tell whether what was found last says that a face doubted for this can be used again."""
        if whys[face] not in _OF_MISFITS:
            return True
        if self._fit is None:
            return False
        if whys[face] is Doubt.SWAPPED:
            return self._fit.in_order([place for place, why in enumerate(whys) if why is Doubt.SWAPPED])
        return self._fit.whole < AGREEMENT

    def _judged(self, whys: Sequence[Doubt]) -> NDArray[np.int64]:
        found = np.full(len(FACES), Doubt.NONE, dtype=np.int64)
        if self._fit is None or not self._fit.contradict:
            self._puzzled = 0
            return found
        accused = self._fit.accused
        self._puzzled = 0 if accused else self._puzzled + 1
        if accused:
            found[list(accused)] = Doubt.ODD if len(accused) == 1 else Doubt.SWAPPED
        elif self._puzzled >= _PUZZLED_LOOKS and not any(why in (Doubt.ODD, Doubt.SWAPPED) for why in whys):
            found[:] = Doubt.TORN
        return found
