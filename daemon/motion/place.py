"""Where the axes rest, kept over a restart: it shows when a reference run ends too early.

A positioner may lose its count while no service is there to see it. Then nothing else tells how far away the end switch
must be, and a switch that is stuck half-way would be believed. While an axis moves, no place is kept for it: it goes on
by itself when the service dies.
"""

import logging

from pydantic import BaseModel, ConfigDict, FiniteFloat

from daemon.base.records import Pose, Target
from daemon.base.state import StateFile, StateFolder, UnreadableStateError
from drivers.interfaces import Positioner, Recalling

log = logging.getLogger("heliocube.motion")

FILE_NAME = "place.json"
# Finer than a reference run is judged, and coarser than the changes that an axis at rest shows.
_CHANGED_DEG = 0.2
# Finer than the place of an axis is judged after a restart: an axis sent no further than this counts as staying.
_STAYS_DEG = 1.0


class _KeptPositions(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid", strict=True)

    a: FiniteFloat | None = None
    b: FiniteFloat | None = None


class KeptPlace:
    """Tells a positioner where it stood before this process, and keeps where it comes to rest.

    Parameters
    ----------
    folder
        Folder of the file.
    positioner
        Not connected yet. Nothing is kept for a positioner that makes no use of it.
    doubt
        Why its reference has been in doubt since before the restart, or None.
    has_fixed_start_pose
        True where the earlier place of rest tells nothing; then nothing is kept.
    """

    def __init__(
        self, folder: StateFolder, positioner: Positioner, doubt: str | None, *, has_fixed_start_pose: bool
    ) -> None:
        self._file = StateFile(folder, FILE_NAME, _KeptPositions, log, "where the axes stand")
        self._positioner = positioner if isinstance(positioner, Recalling) and not has_fixed_start_pose else None
        self._rested: Pose | None = None
        self._kept = _KeptPositions()
        if self._positioner is not None:
            kept = self._load()
            self._positioner.recall(kept.a, kept.b, doubt or "")

    def note_departure(self, to: Target | None) -> None:
        """Keep the place of an axis only if it stays there on the way to a target; keep none if there is no target."""
        rested = self._rested
        if rested is None:
            return
        a_stays = to is not None and abs(to.a_deg - rested.a_deg) <= _STAYS_DEG
        b_stays = to is not None and abs(to.b_deg - rested.b_deg) <= _STAYS_DEG
        if not (a_stays or b_stays):
            self._rested = None
        left = _KeptPositions(a=self._kept.a if a_stays else None, b=self._kept.b if b_stays else None)
        if left != self._kept:
            self._keep(left)

    def note_rest(self, pose: Pose) -> None:
        """Take note that both axes have come to rest."""
        if self._positioner is None:
            return
        a, b = self._positioner.standing()
        known, kept = (a is None, b is None), (self._kept.a is None, self._kept.b is None)
        if known == kept and self._rested and not displacement_text(self._rested, pose, _CHANGED_DEG):
            return
        self._rested = pose
        self._keep(_KeptPositions(a=a, b=b))

    def _keep(self, kept: _KeptPositions) -> None:
        self._kept = kept
        self._file.save(kept)

    def _load(self) -> _KeptPositions:
        try:
            return self._file.load() or _KeptPositions()
        except UnreadableStateError as error:
            log.warning("%s: if the positioner has lost its count since, a stuck end switch may not be noticed", error)
            return _KeptPositions()


def displacement_text(before: Pose, now: Pose, tolerance_deg: float) -> str:
    """Return in words that an axis stands elsewhere than before; empty if neither does. NaN is elsewhere."""
    turned = abs(before.a_deg - now.a_deg), abs(before.b_deg - now.b_deg)
    if all(way <= tolerance_deg for way in turned):
        return ""
    return (
        f"positioner stands at A {now.a_deg:z.1f}, B {now.b_deg:z.1f} deg; before the loss it stood at "
        f"A {before.a_deg:z.1f}, B {before.b_deg:z.1f} deg"
    )
