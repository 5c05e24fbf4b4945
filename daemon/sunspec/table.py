"""The registers that a client may read and write: those of a snapshot, and the manual override of model 601.

A control room sets elevation and azimuth and then the mode, in one write or in several. So the angles have no effect
until the mode is written, and are forgotten after some minutes; those of a goto are forgotten when somebody ends it.
Half an angle, one without the other, mode 2 (calibrate) and a direction that the tracker cannot take are refused.
"""

from collections.abc import Callable
from typing import NamedTuple

from daemon.base.records import Mode
from daemon.service.snapshot import Snapshot, TrackerState
from daemon.sunspec.models import (
    AUTOMATIC,
    BASE,
    MANUAL,
    NO_INT32,
    PER_DEG,
    ManualTarget,
    Registers,
    SunSpecMap,
    in_manual,
)
from drivers.modbus.pdu import DEVICE_FAILURE, ILLEGAL_ADDRESS, ILLEGAL_FUNCTION, ILLEGAL_VALUE, decode_number
from drivers.modbus.server import NoBits, RefusedRequestError
from solar.frames import angles_from_direction, direction_from_azimuth

_KEPT_S = 0.2
_ANGLES_WAIT_S = 300.0
_CONTROL_WORDS = 5
_ELEVATION, _AZIMUTH, _MODE = 0, 2, 4


class Override(NamedTuple):
    """What a write asks of a tracker.

    Attributes
    ----------
    tracker
        Its name.
    name
        ``goto``, ``hold`` or ``auto``.
    a_deg, b_deg
        Where to, for ``goto``.
    """

    tracker: str
    name: str
    a_deg: float = 0.0
    b_deg: float = 0.0


class _FormerState(NamedTuple):
    """What was known of a tracker before the last write to it."""

    manual: ManualTarget | None
    written_s: float | None
    gone_to: tuple[float, float] | None


class SunSpecTable(NoBits):
    """The registers; a `drivers.modbus.server.RegisterTable`.

    Parameters
    ----------
    registers
        Makes them of snapshots.
    see
        Takes a snapshot.
    monotonic_s
        The service's time.
    writable
        Whether the manual override may be written at all.
    """

    def __init__(
        self, registers: SunSpecMap, see: Callable[[], Snapshot], monotonic_s: Callable[[], float], *, writable: bool
    ) -> None:
        self._map = registers
        self._see = see
        self._now = monotonic_s
        self._writable = writable
        self._manual: dict[str, ManualTarget] = {}
        self._written_s: dict[str, float] = {}
        self._goto_places: dict[str, tuple[float, float]] = {}
        self._former_states: dict[str, _FormerState] = {}
        # By tracker; None for a write of angles alone.
        self._newest: dict[str, Override | None] = {}
        self._snapshot_s = -_KEPT_S
        self._latest_snapshot: Snapshot | None = None
        self._registers = Registers((), {})
        self._pending_override: Override | None = None

    def read(self, function: int, register: int, count: int) -> tuple[int, ...]:  # noqa: ARG002 - 3 and 4 alike
        """Return registers; all that are read within a fifth of a second show the same moment."""
        words = self._current().words
        first = register - BASE
        if not (first >= 0 and first + count <= len(words)):
            raise RefusedRequestError(ILLEGAL_ADDRESS)
        return words[first : first + count]

    def write(self, function: int, register: int, values: tuple[int, ...]) -> None:  # noqa: ARG002 - 6 and 16 alike
        """Take in angles and mode of one tracker; `pop_override` returns what they ask of it."""
        if not self._writable:
            raise RefusedRequestError(ILLEGAL_FUNCTION)
        # Take a new snapshot: a person may have ended the override a moment ago.
        self._snapshot_s = -_KEPT_S
        controls = self._current().controls
        start = next((first for first in controls if first <= register < first + _CONTROL_WORDS), None)
        if start is None or register + len(values) > start + _CONTROL_WORDS:
            raise RefusedRequestError(ILLEGAL_ADDRESS)
        name = controls[start]
        target, mode = self._target_and_mode(self._manual.get(name, ManualTarget()), register - start, values)
        self._pending_override = None if mode is None else self._override(self._tracker(name), target, mode)
        self._newest[name] = self._pending_override
        self._former_states[name] = _FormerState(
            self._manual.get(name), self._written_s.get(name), self._goto_places.get(name)
        )
        if register < start + _MODE:
            self._manual[name], self._written_s[name] = target, self._now()
            self._goto_places.pop(name, None)
        self._snapshot_s = -_KEPT_S

    def is_held(self, tracker: str) -> bool:
        """Tell whether a person's stop, maintenance, stow or snow holds a tracker at this very instant.

        A program that writes zeros from afar must end none of them.
        """
        # Take a new snapshot: the person may have given the command a moment ago.
        self._snapshot_s = -_KEPT_S
        self._current()
        wishes = self._tracker(tracker).wishes
        return wishes.standstill_reason is not None or wishes.stow is not None or wishes.snow is not None

    def is_in_force(self, asked: Override) -> bool:
        """Tell whether a tracker already does what is asked of it, as telemetry shows.

        Many programs write the same every second: each write would be an order, an event and a file that is written.
        """
        if self.is_held(asked.tracker):
            return False
        # From the snapshot that `is_held` has just taken.
        tracker = self._tracker(asked.tracker)
        hold, target = tracker.wishes.hold, tracker.positioner.target
        if asked.name == "auto":
            return not in_manual(tracker)
        if hold is None or tracker.control.mode is not Mode.HOLD:
            return False
        if asked.name == "hold":
            return hold.goto_deg is None and target is None
        place = (asked.a_deg, asked.b_deg)
        there = self._map.is_at(tracker, *place) if target is None else (target.a_deg, target.b_deg) == place
        return hold.goto_deg == place and there

    def pop_override(self) -> Override | None:
        """Return what the last write asks of a tracker, once."""
        asked, self._pending_override = self._pending_override, None
        return asked

    def note_carried_out(self, asked: Override) -> None:
        """Take note that an override was carried out: after ``auto`` the earlier angles are forgotten."""
        self._snapshot_s = -_KEPT_S
        if self._newest.get(asked.tracker) is not asked:
            # A later write came while this one waited for its effect: the angles are those of the later one.
            return
        if asked.name == "auto":
            self._forget(asked.tracker)
        elif asked.name == "goto":
            self._goto_places[asked.tracker] = (asked.a_deg, asked.b_deg)

    def note_refusal(self, asked: Override) -> None:
        """Take note that an override was refused: forget the angles of the same write, and restore the earlier ones.

        Otherwise a mode that is written alone later would move the tracker to the refused place.
        """
        self._snapshot_s = -_KEPT_S
        name = asked.tracker
        if self._newest.get(name) is not asked:
            return
        self._forget(name)
        before = self._former_states[name]
        if before.manual is not None:
            self._manual[name] = before.manual
        if before.written_s is not None:
            self._written_s[name] = before.written_s
        if before.gone_to is not None:
            self._goto_places[name] = before.gone_to

    def _current(self) -> Registers:
        now_s = self._now()
        if not now_s - self._snapshot_s < _KEPT_S:
            self._latest_snapshot = self._see()
            self._forget_outdated_angles(self._latest_snapshot, now_s)
            self._registers = self._map.registers(self._latest_snapshot, self._manual)
            self._snapshot_s = now_s
        return self._registers

    def _forget_outdated_angles(self, seen: Snapshot, now_s: float) -> None:
        """Forget angles whose goto somebody has ended, and those that have waited too long for the mode.

        Otherwise a mode that is written alone would move the tracker to where nobody wants it now.
        """
        for tracker in seen.trackers:
            hold, gone_to = tracker.wishes.hold, self._goto_places.get(tracker.name)
            if gone_to is not None:
                over = hold is None or hold.goto_deg != gone_to
            else:
                over = now_s - self._written_s.get(tracker.name, now_s) > _ANGLES_WAIT_S
            if over:
                self._forget(tracker.name)

    def _forget(self, name: str) -> None:
        for each in (self._manual, self._written_s, self._goto_places):
            each.pop(name, None)

    def _target_and_mode(
        self, target: ManualTarget, offset: int, values: tuple[int, ...]
    ) -> tuple[ManualTarget, int | None]:
        """Return the angles and the mode after a write; half an angle is none."""
        end = offset + len(values)
        if offset in (_ELEVATION + 1, _AZIMUTH + 1) or end in (_ELEVATION + 1, _AZIMUTH + 1):
            raise RefusedRequestError(ILLEGAL_VALUE)
        if offset == _ELEVATION:
            target = target._replace(elevation=_angle(values[:2], 0, 9000))
        if offset <= _AZIMUTH < end:
            at = _AZIMUTH - offset
            target = target._replace(azimuth=_angle(values[at : at + 2], -36000, 36000))
        if end <= _MODE:
            return target, None
        mode = values[_MODE - offset]
        if mode not in (AUTOMATIC, MANUAL):
            raise RefusedRequestError(ILLEGAL_VALUE)
        return target, mode

    def _override(self, tracker: TrackerState, target: ManualTarget, mode: int) -> Override:
        if tracker.wishes.held_by_program:
            # The service holds the tracker until a person has looked at it, and no program in a control room can look.
            raise RefusedRequestError(DEVICE_FAILURE)
        if mode == AUTOMATIC:
            if self.is_held(tracker.name):
                raise RefusedRequestError(DEVICE_FAILURE)
            return Override(tracker.name, "auto")
        if target.elevation is None and target.azimuth is None:
            return Override(tracker.name, "hold")
        if target.elevation is None or target.azimuth is None:
            raise RefusedRequestError(ILLEGAL_VALUE)
        latitude_deg = self._snapshot().site.latitude_deg
        direction = direction_from_azimuth(target.azimuth / PER_DEG, target.elevation / PER_DEG, latitude_deg)
        a_deg, b_deg = (round(float(angle), 3) for angle in angles_from_direction(direction))
        if not tracker.limits.contain(a_deg, b_deg):
            raise RefusedRequestError(ILLEGAL_VALUE)
        return Override(tracker.name, "goto", a_deg, b_deg)

    def _tracker(self, name: str) -> TrackerState:
        return next(tracker for tracker in self._snapshot().trackers if tracker.name == name)

    def _snapshot(self) -> Snapshot:
        return self._latest_snapshot or self._see()


def _angle(words: tuple[int, ...], low: int, high: int) -> int | None:
    """Return an angle; None for the mark of an angle that is not set, as in a block that is written back as read."""
    value = int(decode_number(words, "int32"))
    if value == NO_INT32:
        return None
    if not low <= value <= high:
        raise RefusedRequestError(ILLEGAL_VALUE)
    return value
