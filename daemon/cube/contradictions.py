"""Faces that contradict each other for half an hour, and which of them are not believed until they agree."""

from collections.abc import Sequence

from daemon.base.records import FACES
from solar.faces.changes import Changes, changes
from solar.faces.contradiction import AGREEMENT, Misfits, misfits
from solar.faces.plausible import Doubt
from solar.frames import Array

MINUTES = 30
_EVERY_MINUTES = 5
_PUZZLED_LOOKS = 2
_OF_MISFITS = (Doubt.ODD, Doubt.SWAPPED, Doubt.TORN)
# These doubts about one face leave the others open: they may contradict each other for a reason of their own.
_OPEN = (Doubt.NONE, Doubt.OVER, *_OF_MISFITS)
# This doubt comes from what the other faces predict, and one of those may be the wrong one.
_BY_THE_OTHERS = Doubt.FROZEN


class Contradictions:
    """Looks at the last half hour every five minutes; what it finds stands until it looks again.

    Attributes
    ----------
    acquitted
        The face that was taken for frozen although the fault is in the one found now; None for none.
    """

    def __init__(self) -> None:
        self._forget()

    def _forget(self) -> None:
        self._minutes = self._puzzled = 0
        self._fit: Misfits | None = None
        self.acquitted: int | None = None
        self._found = [Doubt.NONE] * len(FACES)

    def look(self, faces_w_m2: Array, sun: Array, whys: Sequence[Doubt]) -> list[Doubt]:
        """Return the doubt that each of the four faces raises by contradicting others.

        Parameters
        ----------
        faces_w_m2, sun
            The minutes so far, at most the last half hour, as for :func:`solar.faces.contradiction.misfits`.
        whys
            The doubt that each face is already under.
        """
        frozen = [face for face, why in enumerate(whys) if why is _BY_THE_OTHERS]
        if len(faces_w_m2) < MINUTES or any(why not in (*_OPEN, _BY_THE_OTHERS) for why in whys):
            self._forget()
        elif self._minutes % _EVERY_MINUTES == 0:
            self._fit = misfits(faces_w_m2, sun)
            self._found = self._judged_beside(frozen) if frozen else self._judged(whys, changes(faces_w_m2, sun))
        self._minutes += 1
        return self._found

    def agrees(self, face: int, whys: Sequence[Doubt]) -> bool:
        """Tell whether the last look allows a face to be used again, given the doubt that it is under."""
        if whys[face] not in (*_OF_MISFITS, _BY_THE_OTHERS):
            return True
        if self._fit is None:
            return False
        if whys[face] is Doubt.SWAPPED:
            return self._fit.in_order([place for place, why in enumerate(whys) if why is Doubt.SWAPPED])
        # All four faces are needed again soon, whatever ground explains them; one face alone can be done without.
        return self._fit.whole < AGREEMENT if whys[face] is Doubt.TORN else self._fit.in_full(face)

    def _judged_beside(self, frozen: Sequence[int]) -> list[Doubt]:
        """Accuse another face than the frozen one only if the others contradict each other even without that one."""
        self._puzzled = 0
        found = [Doubt.NONE] * len(FACES)
        other = self._fit.instead_of(frozen[0]) if self._fit is not None and len(frozen) == 1 else None
        self.acquitted = None if other is None else frozen[0]
        if other is not None:
            found[other] = Doubt.ODD
        return found

    def _judged(self, whys: Sequence[Doubt], change: Changes | None) -> list[Doubt]:
        found = [Doubt.NONE] * len(FACES)
        self.acquitted = None
        contradict = self._fit is not None and self._fit.contradict
        accused = _agreed(() if self._fit is None else self._fit.accused, () if change is None else change.accused)
        self._puzzled = 0 if accused or not contradict else self._puzzled + 1
        if accused:
            for face in accused:
                found[face] = Doubt.ODD if len(accused) == 1 else Doubt.SWAPPED
        elif self._puzzled >= _PUZZLED_LOOKS and not any(why in (Doubt.ODD, Doubt.SWAPPED) for why in whys):
            return [Doubt.TORN] * len(FACES)
        return found


def _agreed(by_readings: tuple[int, ...], by_changes: tuple[int, ...]) -> tuple[int, ...]:
    """Return the faces that readings or changes accuse; none if the two accuse different faces."""
    differ = bool(by_readings and by_changes) and by_readings != by_changes
    return () if differ else by_readings or by_changes
