"""Which faces a cube on another machine does not believe, said where the tracker is operated."""

from daemon.base.alarms.alarms import Alarms
from daemon.base.records import FACES, Quality, Scan

# At 5 s a scan not quite a minute: a reading out of range now and then is no sensor that lies.
_SCANS = 10


class ToldFaces:
    """Raises the alarm `cube-face` in the tracker's process, from the quality that comes with each scan.

    Parameters
    ----------
    alarms
        Of what belongs to no tracker.
    """

    def __init__(self, alarms: Alarms) -> None:
        self._alarms = alarms
        self._counts = [0] * len(FACES)
        self._doubted: tuple[str, ...] = ()

    def note(self, scan: Scan) -> None:
        """Take in a scan: ten that doubt a face raise the alarm, ten more that do not end it."""
        for place, face in enumerate(scan.faces):
            step = 1 if face.quality is Quality.IMPLAUSIBLE else -1
            self._counts[place] = min(max(self._counts[place] + step, 0), _SCANS)
        counts = dict(zip(FACES, self._counts, strict=True))
        doubted = tuple(
            name for name, count in counts.items() if count == _SCANS or (count > 0 and name in self._doubted)
        )
        if doubted != self._doubted:
            self._doubted = doubted
            self._alarms.set("cube-face", _text(doubted), of=doubted)


def _text(doubted: tuple[str, ...]) -> str | None:
    if not doubted:
        return None
    read = "faces read" if len(doubted) > 1 else "face reads"
    return f"the {', '.join(doubted)} {read} what cannot be true and is not used; the cube's own alarms say why"
