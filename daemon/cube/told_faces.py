"""Which faces are not believed, or not read, said where the tracker is operated, and what their sensors say of it."""

import math
from abc import ABC, abstractmethod
from typing import ClassVar

from daemon.base.alarms.alarms import Alarms, tells
from daemon.base.records import FACES, Quality, Scan
from drivers.interfaces import CubeReading

# At 5 s a scan not quite a minute: a reading out of range now and then is no sensor that lies, or is lost.
_SCANS = 10


class _FaceAlarm(ABC):
    """Raises an alarm for faces that have been of some qualities for ten scans, until they have been of others for ten.

    Parameters
    ----------
    alarms
        Of what belongs to no tracker.
    """

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
        self._faces = faces
        self._tell(scan)

    @abstractmethod
    def _tell(self, scan: Scan) -> None:
        """Raise the alarm, or end it, by the faces that are in it after a scan."""


class ToldFaces(_FaceAlarm):
    """Raises `cube-face` in the tracker's process, for faces that a cube on another machine does not believe."""

    _qualities = (Quality.IMPLAUSIBLE,)

    def _tell(self, _scan: Scan) -> None:
        if not self._faces:
            self._alarms.set("cube-face", None)
            return
        read = "faces read" if len(self._faces) > 1 else "face reads"
        text = f"the {', '.join(self._faces)} {read} what cannot be true and is not used; the cube's own alarms say why"
        self._alarms.set("cube-face", text, of=self._faces)


class ToldSensors:
    """Raises `cube-sensor` for what sensors say of themselves, until they have not said it for ten scans.

    Parameters
    ----------
    alarms
        Of what belongs to no tracker.
    """

    def __init__(self, alarms: Alarms) -> None:
        self._alarms = alarms
        self._notes = [""] * len(FACES)
        self._quiet = [0] * len(FACES)
        self._told_unread = [False] * len(FACES)

    def note(self, reading: CubeReading) -> None:
        """Take in a reading: a note is told at once, and ended late, since a bad cable comes and goes.

        A face that had a note and gave readings, and gives none for another reason now, is told anew.
        """
        worse = False
        for place, sample in enumerate(reading.faces):
            self._quiet[place] = 0 if sample.note else self._quiet[place] + 1
            if sample.note and math.isnan(sample.value) and sample.note != self._notes[place]:
                worse = worse or not self._told_unread[place]
                self._told_unread[place] = True
            if sample.note or self._quiet[place] >= _SCANS:
                self._notes[place] = sample.note
            if not self._notes[place]:
                self._told_unread[place] = False
        told = {name: note for name, note in zip(FACES, self._notes, strict=True) if note}
        self._alarms.set("cube-sensor", "; ".join(told.values()) or None, of=told, worse=worse)


class UnreadFaces(_FaceAlarm):
    """Raises `face-unread` for faces without a reading while others have one: the tracker goes on by three.

    A face whose digital sensor says so itself (`cube-sensor`) is not named twice.
    """

    _qualities = (Quality.OVER_RANGE, Quality.STALE, Quality.MISSING)

    def _tell(self, scan: Scan) -> None:
        sensors = next((alarm.text for alarm in self._alarms.active if alarm.name == "cube-sensor"), "")
        faces = [name for name in self._faces if not tells(sensors, (name,))]
        if not faces or len(self._faces) == len(FACES):
            self._alarms.set("face-unread", None)
            return
        read = dict(zip(FACES, scan.faces, strict=True))
        if all(read[name].quality in self._qualities for name in faces):
            each = ", ".join(f"{name} ({read[name].quality})" for name in faces)
            self._alarms.set("face-unread", f"no reading of {each} while other faces are read", of=faces)
