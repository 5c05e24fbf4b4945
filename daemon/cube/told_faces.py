"""Which faces are not believed, or not read, said where the tracker is operated: each scan brings its quality."""

from abc import ABC, abstractmethod
from typing import ClassVar

from daemon.base.alarms.alarms import Alarms
from daemon.base.records import FACES, Quality, Scan

# At 5 s a scan not quite a minute: a reading out of range now and then is no sensor that lies, or is lost.
_SCANS = 10


class _FaceAlarm(ABC):
    """Raises an alarm for faces that have been of some qualities for ten scans, until they have been of others for ten.

    Parameters
    ----------
    alarms
        Of what belongs to no tracker.
    """

    _name: ClassVar[str]
    _qualities: ClassVar[tuple[Quality, ...]]

    def __init__(self, alarms: Alarms) -> None:
        self._alarms = alarms
        self._counts = [0] * len(FACES)
        self._faces: tuple[str, ...] = ()

    def note(self, scan: Scan) -> None:
        """Take in a scan: ten that name a face raise the alarm, ten more that do not end it."""
        for place, face in enumerate(scan.faces):
            step = 1 if face.quality in self._qualities else -1
            self._counts[place] = min(max(self._counts[place] + step, 0), _SCANS)
        counts = dict(zip(FACES, self._counts, strict=True))
        faces = tuple(name for name, count in counts.items() if count == _SCANS or (count > 0 and name in self._faces))
        if faces != self._faces:
            self._faces = faces
            self._alarms.set(self._name, self._text(faces, scan) if faces else None, of=faces)

    @abstractmethod
    def _text(self, faces: tuple[str, ...], scan: Scan) -> str | None:
        """Return what the alarm says of some faces, None for nothing."""


class ToldFaces(_FaceAlarm):
    """Raises `cube-face` in the tracker's process, for faces that a cube on another machine does not believe."""

    _name = "cube-face"
    _qualities = (Quality.IMPLAUSIBLE,)

    def _text(self, faces: tuple[str, ...], _scan: Scan) -> str:
        read = "faces read" if len(faces) > 1 else "face reads"
        return f"the {', '.join(faces)} {read} what cannot be true and is not used; the cube's own alarms say why"


class UnreadFaces(_FaceAlarm):
    """Raises `face-unread` for faces without a reading while others have one: the tracker goes on by three.

    What a digital sensor says of itself (`cube-sensor`) is not said twice.
    """

    _name = "face-unread"
    _qualities = (Quality.OVER_RANGE, Quality.STALE, Quality.MISSING)

    def _text(self, faces: tuple[str, ...], scan: Scan) -> str | None:
        if len(faces) == len(FACES) or any(alarm.name == "cube-sensor" for alarm in self._alarms.active):
            return None
        read = dict(zip(FACES, scan.faces, strict=True))
        each = ", ".join(f"{name} ({read[name].quality})" for name in faces)
        return f"no reading of {each} while other faces are read"
