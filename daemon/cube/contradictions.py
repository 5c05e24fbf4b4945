"""Faces that contradict each other for half an hour, and who is not believed for it until they agree."""

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
# What these say of one face leaves the others open: they may contradict each other for a reason of their own.
_OPEN = (Doubt.NONE, Doubt.OVER, *_OF_MISFITS)
# A face that was told by what the others say it should read: one of these may be the wrong one.
_BY_THE_OTHERS = Doubt.FROZEN


class Contradictions:
    """Looks at the last half hour every five minutes; what it finds stands until it looks again.

    Attributes
    ----------
    acquitted
        The face that was taken for frozen in place of the one that was found; None for none.
    """

    def __init__(self) -> None:
        self._forget()

    def _forget(self) -> None:
        self._minutes = self._puzzled = 0
        self._fit: Misfits | None = None
        self.acquitted: int | None = None
        self._found = [Doubt.NONE] * len(FACES)

    def look(self, faces_w_m2: Array, sun: Array, whys: Sequence[Doubt]) -> list[Doubt]:
        """Return what contradicts in each of the four faces.

        Parameters
        ----------
        faces_w_m2, sun
            Of the minutes so far, the last half hour at the most, as for :func:`solar.faces.contradiction.misfits`.
        whys
            What is said against each face already.
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
        """Tell whether what was found last says that a face doubted for this can be used again."""
        if whys[face] not in (*_OF_MISFITS, _BY_THE_OTHERS):
            return True
        if self._fit is None:
            return False
        if whys[face] is Doubt.SWAPPED:
            return self._fit.in_order([place for place, why in enumerate(whys) if why is Doubt.SWAPPED])
        # All four are needed again soon, whatever lies on the ground; one can be done without.
        return self._fit.whole < AGREEMENT if whys[face] is Doubt.TORN else self._fit.in_full(face)

    def _judged_beside(self, frozen: Sequence[int]) -> list[Doubt]:
        """Accuse another face than the frozen one only where the others contradict each other without it as well."""
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
    """Return whom the one or the other accuses; nobody where they accuse different faces."""
    differ = bool(by_readings and by_changes) and by_readings != by_changes
    return () if differ else by_readings or by_changes
