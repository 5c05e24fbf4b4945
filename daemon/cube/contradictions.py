"""Faces that contradict each other for half an hour, and which of them are not believed until they agree."""

from collections.abc import Sequence

from daemon.base.records import FACES
from solar.faces.changes import ChangeMisfits, change_misfits
from solar.faces.contradiction import AGREEMENT_THRESHOLD, Misfits, misfits
from solar.faces.plausible import Doubt
from solar.frames import Array

MINUTES = 30
_EVERY_MINUTES = 5
_PUZZLED_LOOKS = 2
_MISFIT_DOUBTS = (Doubt.CONTRADICTED, Doubt.SWAPPED, Doubt.INCONSISTENT)
# These doubts about one face leave the others open: they may contradict each other for a reason of their own.
_DOUBTS_OF_ONE_FACE = (Doubt.NONE, Doubt.TOO_BRIGHT, *_MISFIT_DOUBTS)
# This doubt comes from what the other faces predict, and one of those may be the wrong one.
_DOUBT_BY_PREDICTION = Doubt.FROZEN


class Contradictions:
    """Looks at the last half hour every five minutes; what it finds stands until it looks again.

    Attributes
    ----------
    wrongly_frozen_face
        The face that was taken for frozen although the fault is in the one found now; None for none.
    """

    def __init__(self) -> None:
        self._forget()

    def _forget(self) -> None:
        self._minutes = self._puzzled = 0
        self._misfits: Misfits | None = None
        self.wrongly_frozen_face: int | None = None
        self._found_doubts = [Doubt.NONE] * len(FACES)

    def find_doubts(self, faces_w_m2: Array, sun: Array, whys: Sequence[Doubt]) -> list[Doubt]:
        """Return the doubt that each of the four faces raises by contradicting others.

        Parameters
        ----------
        faces_w_m2, sun
            The minutes so far, at most the last half hour, as for :func:`solar.faces.contradiction.misfits`.
        whys
            The doubt that each face is already under.
        """
        frozen = [face for face, why in enumerate(whys) if why is _DOUBT_BY_PREDICTION]
        if len(faces_w_m2) < MINUTES or any(why not in (*_DOUBTS_OF_ONE_FACE, _DOUBT_BY_PREDICTION) for why in whys):
            self._forget()
        elif self._minutes % _EVERY_MINUTES == 0:
            self._misfits = misfits(faces_w_m2, sun)
            self._found_doubts = (
                self._judged_beside(frozen) if frozen else self._judge_faces(whys, change_misfits(faces_w_m2, sun))
            )
        self._minutes += 1
        return self._found_doubts

    def agrees(self, face: int, whys: Sequence[Doubt]) -> bool:
        """Tell whether the last look allows a face to be used again, given the doubt that it is under."""
        if whys[face] not in (*_MISFIT_DOUBTS, _DOUBT_BY_PREDICTION):
            return True
        if self._misfits is None:
            return False
        if whys[face] is Doubt.SWAPPED:
            return self._misfits.rules_out_swaps([place for place, why in enumerate(whys) if why is Doubt.SWAPPED])
        # All four faces are needed again soon, whatever ground explains them; one face alone can be done without.
        return (
            self._misfits.whole < AGREEMENT_THRESHOLD
            if whys[face] is Doubt.INCONSISTENT
            else self._misfits.rules_out_half_gain(face)
        )

    def _judged_beside(self, frozen: Sequence[int]) -> list[Doubt]:
        """Accuse another face than the frozen one only if the others contradict each other even without that one."""
        self._puzzled = 0
        found = [Doubt.NONE] * len(FACES)
        other = self._misfits.other_wrong_face(frozen[0]) if self._misfits is not None and len(frozen) == 1 else None
        self.wrongly_frozen_face = None if other is None else frozen[0]
        if other is not None:
            found[other] = Doubt.CONTRADICTED
        return found

    def _judge_faces(self, whys: Sequence[Doubt], change: ChangeMisfits | None) -> list[Doubt]:
        found = [Doubt.NONE] * len(FACES)
        self.wrongly_frozen_face = None
        contradict = self._misfits is not None and self._misfits.is_contradictory
        accused = _agreed_faces(
            () if self._misfits is None else self._misfits.suspect_faces, () if change is None else change.suspect_faces
        )
        self._puzzled = 0 if accused or not contradict else self._puzzled + 1
        if accused:
            for face in accused:
                found[face] = Doubt.CONTRADICTED if len(accused) == 1 else Doubt.SWAPPED
        elif self._puzzled >= _PUZZLED_LOOKS and not any(why in (Doubt.CONTRADICTED, Doubt.SWAPPED) for why in whys):
            return [Doubt.INCONSISTENT] * len(FACES)
        return found


def _agreed_faces(by_readings: tuple[int, ...], by_changes: tuple[int, ...]) -> tuple[int, ...]:
    """Return the faces that readings or changes accuse; none if the two accuse different faces."""
    differ = bool(by_readings and by_changes) and by_readings != by_changes
    return () if differ else by_readings or by_changes
