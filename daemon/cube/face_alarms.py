"""Alarms for faces that are not believed or not read, and for what their sensors report of themselves."""

import math
from abc import ABC, abstractmethod
from collections.abc import Iterable, Mapping, Sequence
from typing import ClassVar

from daemon.base.alarms.alarms import Alarms, mentions_all
from daemon.base.clock import Clock, minute_utc
from daemon.base.records import FACES, Quality, Scan
from drivers.interfaces import CubeReading

# Not quite a minute at 5 s a scan: a reading out of range now and then does not show a wrong or lost sensor.
_ALARM_SCANS = 10


def join_names(names: Sequence[str]) -> str:
    """Return names as they stand in a sentence: ``east, south and west``."""
    return " and ".join([", ".join(names[:-1]), names[-1]] if len(names) > 1 else names)


def face_reads_text(names: Sequence[str]) -> str:
    """Return the words between the names of faces and what they read."""
    return "faces read" if len(names) > 1 else "face reads"


def update_since(since: Mapping[str, str], names: Iterable[str], clock: Clock) -> dict[str, str]:
    """Return since when each of the names has been told: as in `since`, or from now on for a new name."""
    now = minute_utc(clock.utc())
    return {name: since.get(name, now) for name in names}


def since_text(since: Mapping[str, str]) -> str:
    """Return since when, with the names of faces only if the times differ."""
    if len(set(since.values())) == 1:
        return next(iter(since.values()))
    return join_names([f"{at} ({name})" for name, at in since.items()])


class _FaceAlarm(ABC):
    """Raises an alarm for faces that have had certain qualities for ten scans, until they have had others for ten.

    Parameters
    ----------
    alarms
        The alarms of no tracker.
    clock
        The service's time: a second face raises the alarm anew, and each has a time of its own.
    """

    _qualities: ClassVar[tuple[Quality, ...]]

    def __init__(self, alarms: Alarms, clock: Clock) -> None:
        self._alarms = alarms
        self._clock = clock
        self._counts = [0] * len(FACES)
        self._since: dict[str, str] = {}

    def note(self, scan: Scan) -> None:
        """Take in a scan: ten that name a face raise the alarm, and ten that do not name it end the alarm."""
        named = [face.quality in self._qualities for face in scan.faces]
        # Nearly every scan of a year names no face and follows others that named none: it needs no counting.
        if any(named) or any(self._counts):
            steps = zip(self._counts, named, strict=True)
            self._counts = [
                min(count + 1, _ALARM_SCANS) if is_named else max(count - 1, 0) for count, is_named in steps
            ]
            counts = zip(FACES, self._counts, strict=True)
            faces = [name for name, count in counts if count == _ALARM_SCANS or (count > 0 and name in self._since)]
            if faces or self._since:
                self._since = update_since(self._since, faces, self._clock)
        self._update_alarm(scan)

    @abstractmethod
    def _update_alarm(self, scan: Scan) -> None:
        """Raise the alarm, or end it, by the faces that are in it after a scan."""


class RemoteFaceAlarm(_FaceAlarm):
    """Raises `cube-face` in the tracker's process, for faces that a cube on another machine does not believe."""

    _qualities = (Quality.IMPLAUSIBLE,)

    def _update_alarm(self, _scan: Scan) -> None:
        names = tuple(self._since)
        if not names:
            self._alarms.set("cube-face", None)
            return
        reads = face_reads_text(names)
        text = f"the {join_names(names)} {reads} what cannot be true; not used since {since_text(self._since)}"
        self._alarms.set("cube-face", f"{text}; the cube's own alarms say why", of=names)


class SensorAlarm:
    """Raises `cube-sensor` for what sensors say of themselves, until they have not said it for ten scans.

    Parameters
    ----------
    alarms
        The alarms of no tracker.
    clock
        The process' time: each sensor has a time of its own.
    """

    def __init__(self, alarms: Alarms, clock: Clock) -> None:
        self._alarms = alarms
        self._clock = clock
        self._since: dict[str, str] = {}
        self._notes = [""] * len(FACES)
        self._quiet_scans = [0] * len(FACES)
        self._told_unread = [False] * len(FACES)

    def note(self, reading: CubeReading) -> None:
        """Take in a reading: a note is told at once, and its end is told late, since a bad cable comes and goes.

        If a face that had a note but gave readings now gives none, for another reason, the alarm is raised anew.
        """
        if not (reading.notes or self._since):
            self._alarms.set("cube-sensor", None)
            return
        worse = False
        for place, sample in enumerate(reading.faces):
            self._quiet_scans[place] = 0 if sample.note else self._quiet_scans[place] + 1
            if sample.note and math.isnan(sample.value) and sample.note != self._notes[place]:
                worse = worse or not self._told_unread[place]
                self._told_unread[place] = True
            if sample.note or self._quiet_scans[place] >= _ALARM_SCANS:
                self._notes[place] = sample.note
            if not self._notes[place]:
                self._told_unread[place] = False
        told = {name: note for name, note in zip(FACES, self._notes, strict=True) if note}
        if told or self._since:
            self._since = update_since(self._since, told, self._clock)
        texts = [f"{note} (since {self._since[name]})" for name, note in told.items()]
        self._alarms.set("cube-sensor", "; ".join(texts) or None, of=told, worse=worse)


class UnreadFaceAlarm(_FaceAlarm):
    """Raises `face-unread` for faces without a reading while others have one: the tracker goes on by three.

    A face whose digital sensor says so itself (`cube-sensor`) is not named twice.
    """

    _qualities = (Quality.OVER_RANGE, Quality.STALE, Quality.MISSING, Quality.LATE)

    def _update_alarm(self, scan: Scan) -> None:
        faces = [name for name in self._since if not mentions_all(self._sensor_alarm_text(), (name,))]
        if not faces or len(self._since) == len(FACES):
            self._alarms.set("face-unread", None)
            return
        read = dict(zip(FACES, scan.faces, strict=True))
        if all(read[name].quality in self._qualities for name in faces):
            each = join_names([f"{name} ({read[name].quality} since {self._since[name]})" for name in faces])
            self._alarms.set("face-unread", f"no reading of {each} while other faces are read", of=faces)

    def _sensor_alarm_text(self) -> str:
        return next((alarm.text for alarm in self._alarms.active if alarm.name == "cube-sensor"), "")
