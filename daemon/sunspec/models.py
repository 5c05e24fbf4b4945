"""The service as registers of SunSpec: which model holds which values, and what is written where there is no value.

Source: the model files of sunspec/models (1, 302, 305, 307, 601). Angles are those of the module's normal: elevation
from the horizontal, azimuth clockwise from true north.
"""

import math
from collections.abc import Mapping
from datetime import UTC, datetime
from typing import NamedTuple

from daemon.base.records import FACES, Mode, MoveOutcome, Target
from daemon.service.snapshot import Snapshot, TrackerState
from drivers.modbus.pdu import encode_number
from solar.frames import (
    azimuth_from_direction,
    equator_azimuth_deg,
    normal_from_angles,
    separation_deg,
)

BASE = 40000
_MARK, _END = (0x5375, 0x6E53), (0xFFFF, 0)
_NO_INT16, _NO_UINT16 = 0x8000, 0xFFFF
_NO_INT32 = (0x8000, 0)
NO_INT32 = -(1 << 31)

PER_DEG = 100.0
_DEG_SF = 0xFFFE
_DUAL_AXIS = 5
AUTOMATIC, MANUAL = 0, 1
_NOT_AT_TARGET, _OBSTRUCTED = 1 << 0, 1 << 1 | 1 << 2
_STOW_WANTED_ALARM = "stow-wanted"
# Nearly flat, the azimuth of the normal is noise.
_FLAT_ABOVE_DEG = 89.5


class Registers(NamedTuple):
    """Everything that can be read.

    Attributes
    ----------
    words
        From `BASE` on.
    controls
        First register of each block that may be written, five long (elevation, azimuth, mode), and the tracker's name.
    """

    words: tuple[int, ...]
    controls: Mapping[int, str]


class ManualTarget(NamedTuple):
    """The angles that a control room has set for a tracker [0.01 deg]; None for one that it has not set."""

    elevation: int | None = None
    azimuth: int | None = None


class SunSpecMap:
    """Makes the registers of snapshots.

    Parameters
    ----------
    serial
        The device's serial number, which tells it from others, at most 31 letters.
    unit
        Its Modbus address.
    tolerance_deg
        By tracker, the distance from the target that counts as arrived.
    """

    def __init__(self, serial: str, unit: int, tolerance_deg: Mapping[str, float]) -> None:
        self._serial = serial
        self._unit = unit
        self._tolerance_deg = tolerance_deg
        self._azimuth_deg: dict[str, float] = {}

    def registers(self, seen: Snapshot, manual: Mapping[str, ManualTarget]) -> Registers:
        """Return all models: common, irradiance, place, weather if the wind is known, trackers if there are any."""
        words: list[int] = [*_MARK, *_model(1, self._common(seen)), *_model(302, _irradiance(seen))]
        words += _model(305, _location(seen))
        if any(tracker.wind for tracker in seen.trackers):
            words += _model(307, _weather(seen))
        controls: dict[int, str] = {}
        if seen.trackers:
            first = BASE + len(words)
            words += _model(601, self._trackers(seen, manual))
            if len(seen.trackers) == 1:
                controls[first + 20] = seen.trackers[0].name
            for number, tracker in enumerate(seen.trackers):
                controls[first + 28 + 22 * number + 16] = tracker.name
        return Registers((*words, *_END), controls)

    def _common(self, seen: Snapshot) -> list[int]:
        kind = "heliocube SIMULATED" if seen.simulated else "heliocube"
        texts = [("heliocube", 16), (kind, 16), (seen.role, 8), (seen.version, 8), (self._serial, 16)]
        return [word for text, size in texts for word in text_words(text, size)] + [self._unit, _NO_INT16]

    def _trackers(self, seen: Snapshot, manual: Mapping[str, ManualTarget]) -> list[int]:
        now = datetime.fromtimestamp(seen.time_utc_s, UTC)
        only = seen.trackers[0] if len(seen.trackers) == 1 else None
        alarms = 0
        blocks: list[int] = []
        for tracker in seen.trackers:
            alarm = self._alarm(tracker)
            alarms |= alarm
            blocks += [*text_words(tracker.name, 8), *self._target(seen, tracker), *self._position(seen, tracker)]
            blocks += [*_control(tracker, manual), alarm]
        whole = _control(only, manual) if only is not None else [*_NO_INT32, *_NO_INT32, _NO_UINT16]
        return [
            *text_words(seen.site.name, 8),
            _DUAL_AXIS,
            *text_words(f"{now:%Y%m%d}", 5),
            *text_words(f"{now:%H%M%S}", 3),
            now.timetuple().tm_yday,
            *whole,
            alarms,
            _DEG_SF,
            len(seen.trackers),
            *blocks,
        ]

    def is_at(self, tracker: TrackerState, a_deg: float, b_deg: float) -> bool:
        """Tell whether a tracker is seen to be at a place of A and B [deg]."""
        pose = tracker.positioner.pose
        if pose is None or tracker.positioner.pose_is_stale:
            return False
        away_deg = separation_deg(normal_from_angles(a_deg, b_deg), normal_from_angles(pose.a_deg, pose.b_deg))
        return float(away_deg) <= self._tolerance_deg[tracker.name]

    def _alarm(self, tracker: TrackerState) -> int:
        positioner = tracker.positioner
        mode = tracker.control.mode
        bits = _OBSTRUCTED if positioner.blocked_why is not None or mode is Mode.FAULT else 0
        kept_from_it = any(alarm.on and alarm.name == _STOW_WANTED_ALARM for alarm in tracker.alarms)
        # In a fault a stow that is wanted cannot be carried out, and a move that the fault has ended is not resumed.
        fault = mode is Mode.FAULT
        stow = mode is Mode.STOW or (fault and _wants_stow(tracker))
        if kept_from_it or (stow and not tracker.at_stow):
            # A person keeps the tracker still, or a stow that has failed waits to be tried again: it is not on its way.
            return bits | _NOT_AT_TARGET
        target = _target_or_last(tracker) if fault else positioner.target
        if target is None or positioner.pose is None or positioner.pose_is_stale:
            return bits
        return bits if self.is_at(tracker, target.a_deg, target.b_deg) else bits | _NOT_AT_TARGET

    def _target(self, seen: Snapshot, tracker: TrackerState) -> list[int]:
        target = _target_or_last(tracker)
        if target is None:
            return [*_NO_INT32, *_NO_INT32]
        return self._angles(f"{tracker.name} target", target.a_deg, target.b_deg, seen.site.latitude_deg)

    def _position(self, seen: Snapshot, tracker: TrackerState) -> list[int]:
        pose = tracker.positioner.pose
        if pose is None or tracker.positioner.pose_is_stale:
            return [*_NO_INT32, *_NO_INT32]
        return self._angles(f"{tracker.name} pose", pose.a_deg, pose.b_deg, seen.site.latitude_deg)

    def _angles(self, name: str, a_deg: float, b_deg: float, latitude_deg: float) -> list[int]:
        """Return elevation and azimuth; a flat module has no azimuth, and keeps the last one that it had."""
        azimuth_deg, elevation_deg = azimuth_from_direction(normal_from_angles(a_deg, b_deg), latitude_deg)
        if float(elevation_deg) < _FLAT_ABOVE_DEG:
            self._azimuth_deg[name] = float(azimuth_deg)
        kept_deg = self._azimuth_deg.get(name, equator_azimuth_deg(latitude_deg))
        return [*degree_words(float(elevation_deg)), *degree_words(kept_deg)]


def _target_or_last(tracker: TrackerState) -> Target | None:
    """Return where the tracker is sent, or where it was sent last unless that move was called off."""
    target, last = tracker.positioner.target, tracker.positioner.last_move
    if target is None and last is not None and last.outcome is not MoveOutcome.INTERRUPTED:
        return Target(last.target_a_deg, last.target_b_deg, last.why)
    return target


def _wants_stow(tracker: TrackerState) -> bool:
    return tracker.wishes.stow is not None or any(source.why is not None for source in tracker.wind)


def _model(number: int, points: list[int]) -> list[int]:
    return [number, len(points), *points]


def _irradiance(seen: Snapshot) -> list[int]:
    """Return the zenith as GHI of the first group, and east, south, west as OTI of the next three."""
    values: dict[str, int] = {}
    for name in FACES:
        face = None if seen.scan is None else seen.scan.faces[FACES.index(name)]
        good = face is not None and seen.face_quality(name) == "ok" and math.isfinite(face.irradiance_w_m2)
        # The model has no sign: the night is 0.
        values[name] = min(max(round(face.irradiance_w_m2), 0), 0xFFFE) if face is not None and good else _NO_UINT16
    none = [_NO_UINT16] * 4
    first = [values["zenith"], *none]
    return [*first, *(word for name in ("east", "south", "west") for word in (*none, values[name]))]


def _location(seen: Snapshot) -> list[int]:
    now, site = datetime.fromtimestamp(seen.time_utc_s, UTC), seen.site
    degrees = [encode_number(value * 1e7, "int32") for value in (site.latitude_deg, site.longitude_deg)]
    return [
        *text_words(f"{now:%H%M%S}Z", 6),
        *text_words(f"{now:%Y%m%d}", 4),
        *text_words(site.name, 20),
        *degrees[0],
        *degrees[1],
        *encode_number(site.altitude_m, "int32"),
    ]


def _weather(seen: Snapshot) -> list[int]:
    """Return the weather, of which only the strongest wind that any source reports now [m/s] is known."""
    speeds = [status.speed_m_s for tracker in seen.trackers for status in tracker.wind]
    known = [speed for speed in speeds if math.isfinite(speed)]
    wind = encode_number(max(known), "int16")[0] if known else _NO_INT16
    return [_NO_INT16, _NO_INT16, _NO_INT16, wind, *[_NO_INT16] * 7]


def _control(tracker: TrackerState, manual: Mapping[str, ManualTarget]) -> list[int]:
    wanted = manual.get(tracker.name, ManualTarget())
    words = [_NO_INT32 if each is None else encode_number(each, "int32") for each in wanted]
    return [*words[0], *words[1], MANUAL if in_manual(tracker) else AUTOMATIC]


def in_manual(tracker: TrackerState) -> bool:
    """Tell whether a person, or a control room, keeps the tracker from following the law."""
    wishes = tracker.wishes
    return wishes.standstill_reason is not None or any(
        wish is not None for wish in (wishes.stow, wishes.snow, wishes.hold)
    )


def degree_words(value_deg: float) -> tuple[int, ...]:
    """Return an angle [deg] in hundredths as two registers."""
    return encode_number(value_deg * PER_DEG, "int32")


def text_words(text: str, size: int) -> list[int]:
    """Return a text in registers, cut to their number and filled with zeros; what is not ASCII is a question mark."""
    data = text.encode("ascii", "replace")[: 2 * size].ljust(2 * size, b"\0")
    return [int.from_bytes(data[2 * index : 2 * index + 2], "big") for index in range(size)]
