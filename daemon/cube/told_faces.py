"""Which faces are not believed, or not read, said where the tracker is operated: each scan brings its quality."""

from collections.abc import Container

from daemon.base.alarms.alarms import Alarms
from daemon.base.records import FACES, Quality, Scan

# At 5 s a scan not quite a minute: a reading out of range now and then is no sensor that lies, or is lost.
_SCANS = 10
_LIES = (Quality.IMPLAUSIBLE,)
_UNREAD = (Quality.OVER_RANGE, Quality.STALE, Quality.MISSING)


class _Lasting:
    """The faces that have been of some qualities for ten scans, until they have been of others for ten."""

    def __init__(self, qualities: Container[Quality]) -> None:
        self._qualities = qualities
        self._counts = [0] * len(FACES)
        self.names: tuple[str, ...] = ()

    def note(self, scan: Scan) -> bool:
        """Take in a scan, and return whether other faces are named now."""
        for place, face in enumerate(scan.faces):
            step = 1 if face.quality in self._qualities else -1
            self._counts[place] = min(max(self._counts[place] + step, 0), _SCANS)
        before, counts = self.names, dict(zip(FACES, self._counts, strict=True))
        self.names = tuple(
            name for name, count in counts.items() if count == _SCANS or (count > 0 and name in self.names)
        )
        return self.names != before


class ToldFaces:
    """Raises the alarm `cube-face` in the tracker's process, for faces that a cube on another machine does not believe.

    Parameters
    ----------
    alarms
        Of what belongs to no tracker.
    """

    def __init__(self, alarms: Alarms) -> None:
        self._alarms = alarms
        self._doubted = _Lasting(_LIES)

    def note(self, scan: Scan) -> None:
        """Take in a scan: ten that doubt a face raise the alarm, ten more that do not end it."""
        if not self._doubted.note(scan):
            return
        names = self._doubted.names
        read = "faces read" if len(names) > 1 else "face reads"
        text = f"the {', '.join(names)} {read} what cannot be true and is not used; the cube's own alarms say why"
        self._alarms.set("cube-face", text if names else None, of=names)


class UnreadFaces:
    """Raises the alarm `face-unread` for faces without a reading while others have one: the tracker goes on by three.

    What a digital sensor says of itself (`cube-sensor`) is not said twice.

    Parameters
    ----------
    alarms
        Of what belongs to no tracker.
    """

    def __init__(self, alarms: Alarms) -> None:
        self._alarms = alarms
        self._unread = _Lasting(_UNREAD)

    def note(self, scan: Scan) -> None:
        """Take in a scan: ten without a face raise the alarm, ten more with it end it."""
        if not self._unread.note(scan):
            return
        names, qualities = self._unread.names, dict(zip(FACES, scan.faces, strict=True))
        told = any(alarm.name == "cube-sensor" for alarm in self._alarms.active)
        if not names or len(names) == len(FACES) or told:
            self._alarms.set("face-unread", None)
            return
        each = ", ".join(f"{name} ({qualities[name].quality})" for name in names)
        self._alarms.set("face-unread", f"no reading of {each} while other faces are read", of=names)
