"""Recorded cube data through the running service's own window, laws, modes, control and motion, under virtual time."""

import asyncio
import contextlib
import csv
import gzip
import math
from array import array
from collections.abc import Callable, Coroutine, Sequence
from pathlib import Path
from random import Random
from typing import Any, NamedTuple, TextIO, cast

import numpy as np
from numpy.typing import NDArray

from daemon.base.clock import LoopClock, iso_utc
from daemon.base.errors import UserError
from daemon.base.files import atomic_output_path
from daemon.base.process import SystemdNotifier, simulated_time_in_log
from daemon.base.records import FACES, Bus, Decision, Event, FaceReading, Mode, ModeChange, Quality, Record, Scan
from daemon.base.timeloop import VirtualTimeLoop, virtual_time
from daemon.config.file import with_loopback_bridge
from daemon.config.links import StoreSettings
from daemon.config.rules import END_OF_STARTS, FIRST_START
from daemon.config.settings import Settings, settings_of_tracker
from daemon.cube.face_watch import FaceWatch
from daemon.cube.repeats import Repeats
from daemon.motion.polling import Polling
from daemon.rigs.simulated import build_simulated_positioner
from daemon.service.rig import Rig, Role, TrackerInstruments
from daemon.service.service import Service
from daemon.service.tracker import Tracker
from daemon.studies.failed_laws import failed_laws
from daemon.studies.recorded import RecordedScan, RecordedScans
from solar.ephemeris import DAY_S, sun_direction
from solar.frames import Angles, Array
from solar.laws.law import Law

COLUMNS = ("time", "a_set", "b_set", "a", "b", "mode", "law", "dni_est", "dhi_est", "albedo_est", "simulated")

# The service starts this long before the first row, to be connected when the row comes.
_WARM_UP_S = 10.0
_SLOWEST_S, _QUICKEST_S = 60.0, 0.5
# Slow polling is enough: nothing fails here that polling a resting tracker, or polling a move more often, would show.
_POLLING = Polling(idle_s=300.0, moving_s=1.0)
_STALE_AFTER_ROWS = 2.5
# With the sun below `_DEEP_NIGHT_DEG`, a gap is skipped up to `_AWAKE_S` before its end: in whole days while two are
# left, then in steps of `_SKIP_S`.
_SKIP_S = 600.0
_AWAKE_S = 120.0
_DEEP_NIGHT_DEG = -1.0
_QUALITIES = tuple(Quality)
_NO_VOLTAGES_MV = [math.nan] * 4
_PROGRESS_EVERY_ROWS = 1000
_ROWS_AT_ONCE = 50_000


class ReplayResult(NamedTuple):
    """What the service made of the rows that were done: all of them, or those before Ctrl-C.

    Attributes
    ----------
    qualities
        Qualities of their readings, as places in `Quality`, shape (rows, 4).
    events
        The service's events meanwhile, alarms among them.
    failed_laws
        A sentence for each law that failed, so that another one pointed from then on.
    """

    qualities: NDArray[np.uint8]
    events: list[Event]
    failed_laws: list[str]


def replay(
    settings: Settings, rows: RecordedScans, called: str, out: Path, progress: Callable[[float], None]
) -> ReplayResult:
    """Run the tracker's role on recorded readings and write one line per row to `out`.

    Parameters
    ----------
    settings
        With the site and the law. The rhythm of the cube is taken from the rows; store, bridge and wind are left out.
    rows
        Readings to run on.
    called
        Where the rows are from, as messages name it.
    out
        CSV file with `COLUMNS`, compressed if it ends in ``.gz``; replaced if it is there, and only when all is done.
    progress
        Called with the share done, 0..1.

    Raises
    ------
    UserError
        The rows are too few, too far apart or not within 1979 to 2099, `out` cannot be written, or the settings have
        several trackers.
    """
    settings = _settings_for_rows(settings_of_tracker(settings, None), rows, called)
    # A folder that cannot be written to is reported before the work and not after it.
    try:
        out.parent.mkdir(parents=True, exist_ok=True)
        with atomic_output_path(out) as part, _opened(part, out.suffix.lower()) as file:
            log = _run(settings, rows, progress)
            done = len(log.modes)
            qualities = np.frombuffer(log.qualities, dtype=np.uint8).reshape(-1, len(FACES))[:done]
            _write(file, settings, rows, log, qualities == _QUALITIES.index(Quality.OK))
    except OSError as error:
        raise UserError(f"--out: {out} cannot be written: {error.strerror}") from None
    return ReplayResult(qualities, log.events, failed_laws(log.trackers))


class _Log:
    """What the tracker did, row by row, and which law pointed it."""

    def __init__(self, trackers: Sequence[Tracker]) -> None:
        self.trackers = trackers
        self.pointing = trackers[0].control.pointing
        self.angles = array("d")
        # One byte for each reading.
        self.qualities = bytearray()
        self.events: list[Event] = []
        self.modes: list[Mode] = []
        self.laws: list[str] = []
        self.law = ""
        self.learned: list[tuple[int, Any]] = []

    def note(self, record: Record) -> None:
        """Keep what the service tells; a subscriber of the bus."""
        if isinstance(record, Event):
            self.events.append(record)
        elif isinstance(record, Decision):
            # Not always the mode's own law: a law that fails or has used up its share of the day gives way to another.
            self.law = record.law
        elif isinstance(record, ModeChange) and record.after not in (Mode.TRACKING, Mode.FALLBACK):
            self.law = ""


def _settings_for_rows(settings: Settings, rows: RecordedScans, called: str) -> Settings:
    """Return the settings with the rhythm of the rows, and without what a replay must not use."""
    if len(rows) < 2:
        raise UserError(f"{called}: a replay needs two rows at least, to know how far apart they are")
    first_s, last_s = float(rows.utc_s[0]), float(rows.utc_s[-1])
    if not FIRST_START.timestamp() <= first_s <= last_s < END_OF_STARTS.timestamp():
        raise UserError(
            f"{called}: the times must be within the years {FIRST_START.year} to {END_OF_STARTS.year - 1}; these begin"
            f" at {iso_utc(first_s)[:19]}Z and end at {iso_utc(last_s)[:19]}Z: put them right"
        )
    every_s = float(np.median(np.diff(rows.utc_s)))
    if every_s > _SLOWEST_S + 0.5:
        raise UserError(
            f"{called}: the rows are {every_s:.0f} s apart and a tracker needs one every {_SLOWEST_S:.0f} s at least: "
            "name the readings themselves, not their means"
        )
    stale_s = max(settings.safety.scan_stale_s, _STALE_AFTER_ROWS * every_s)
    changes = {
        "cube": settings.cube.model_copy(update={"scan_every_s": max(every_s, _QUICKEST_S)}),
        "safety": settings.safety.model_copy(update={"scan_stale_s": stale_s}),
        "store": StoreSettings(),
    }
    return with_loopback_bridge(settings, insecure=True).model_copy(update=changes)


def _run(settings: Settings, rows: RecordedScans, progress: Callable[[float], None]) -> _Log:
    with virtual_time() as runner:
        loop = cast("VirtualTimeLoop", runner.get_loop())
        clock = LoopClock(loop.time, float(rows.utc_s[0]) - _WARM_UP_S)
        truth, positioner = build_simulated_positioner(settings, clock)
        bus = Bus()
        service = Service(
            settings,
            Role.TRACKER,
            Rig(None, (TrackerInstruments(positioner, has_fixed_start_pose=True),), None, simulated=True),
            clock,
            Random(settings.simulation.seed),  # noqa: S311 - reproducibility is the point; nothing secret depends on it
            bus,
            None,
            SystemdNotifier({}, 0),
            polling=_POLLING,
        )
        log = _Log(service.trackers)
        bus.subscribe(log.note)
        # After Ctrl-C the rows that are done remain, and are valid.
        with contextlib.suppress(KeyboardInterrupt), simulated_time_in_log(clock):
            runner.run(_run_with_feeder(service, _Feeder(service, truth, loop, clock, log).run(rows, progress)))
    return log


async def _run_with_feeder(service: Service, feeding: Coroutine[Any, Any, None]) -> None:
    """Feed the tracker's parts while they run; a part that dies ends all."""
    motion = service.trackers[0].motion
    async with asyncio.TaskGroup() as group:
        moving = group.create_task(motion.run())
        await group.create_task(feeding)
        moving.cancel()


class _Feeder:
    """Hands scans over in place of the bridge, and calls control at its times, without a task and timers of its own."""

    def __init__(
        self, service: Service, truth: Callable[[float], Angles], loop: VirtualTimeLoop, clock: LoopClock, log: _Log
    ) -> None:
        (tracker,) = service.trackers
        self._control, self._motion = tracker.control, tracker.motion
        self._cube = service.settings.cube
        self._watch = FaceWatch(service.settings.site, self._cube, clock, service.cube_alarms)
        self._repeats = Repeats(self._cube.scan_every_s)
        self._sun_elevation_deg = service.sun_elevation_deg
        self._truth = truth
        self._loop = loop
        self._clock = clock
        self._log = log
        self._last_sleep_end_s = -math.inf
        self._last_angles = (math.nan,) * 4
        self._last_angles_at_rest = False
        self._gap_s = max(_AWAKE_S, 2.0 * self._cube.scan_every_s)

    async def run(self, rows: RecordedScans, progress: Callable[[float], None]) -> None:
        log, control, loop = self._log, self._control, self._loop
        start_s = _WARM_UP_S - float(rows.utc_s[0])
        for number, row in enumerate(rows):
            due_s = row.time_utc_s + start_s
            if due_s - loop.time() > self._gap_s:
                await self._pass_gap(due_s)
            await self._live_until(due_s)
            control.receive(self._scan(number, row), self._clock.utc())
            log.angles.extend(self._angles())
            log.modes.append(control.mode)
            log.laws.append(log.law)
            learned = control.pointing.law.learned
            if learned is not None and (not log.learned or log.learned[-1][1] is not learned):
                log.learned.append((number, learned))
            if number % _PROGRESS_EVERY_ROWS == 0:
                progress(number / len(rows))
        progress(1.0)

    async def _live_until(self, due_s: float) -> None:
        """Let control tick whenever it would by itself, until it is time for the next reading."""
        control, loop = self._control, self._loop
        while True:
            now_s = loop.time()
            tick_s = max(control.next_tick_s, now_s)
            await self._wait(min(tick_s, due_s) - now_s)
            if tick_s > due_s:
                return
            control.tick()

    async def _wait(self, duration_s: float) -> None:
        """Let time pass; while the tracker rests time may jump, as nothing else runs but the polling at rest."""
        if self._motion.is_idle and self._loop.time() - self._last_sleep_end_s < _POLLING.idle_s:
            self._loop.skip(max(duration_s, 0.0))
        else:
            # A short move may begin and end during this sleep.
            self._last_angles_at_rest = False
            await asyncio.sleep(max(duration_s, 0.0))
            self._last_sleep_end_s = self._loop.time()

    def _scan(self, number: int, row: RecordedScan) -> Scan:
        """Return the scan that a cube would have made of the row: its faces are judged as on a rig."""
        utc_s, now_s = row.time_utc_s, self._loop.time()
        self._watch.note(list(row.irradiances_w_m2), _NO_VOLTAGES_MV)
        east, south, west, zenith = (
            FaceReading(value, self._quality(face, value), utc_s, now_s)
            for face, value in enumerate(row.irradiances_w_m2)
        )
        self._log.qualities.extend(_QUALITIES.index(reading.quality) for reading in (east, south, west, zenith))
        return Scan(
            source=self._cube.name,
            session="replay",
            sequence=number,
            time_utc_s=utc_s,
            time_monotonic_s=now_s,
            east=east,
            south=south,
            west=west,
            zenith=zenith,
            simulated=True,
        )

    def _quality(self, face: int, value: float) -> Quality:
        if math.isnan(value):
            return Quality.MISSING
        self._repeats.note(face, value)
        if not (self._cube.minimum_w_m2 <= value <= self._cube.maximum_w_m2) or self._watch.implausible(face):
            return Quality.IMPLAUSIBLE
        return Quality.STALE if self._repeats.frozen(face, value, rounded=True) else Quality.OK

    def _angles(self) -> tuple[float, float, float, float]:
        """Return where the tracker was sent last and where it stands; at rest it is looked at only once."""
        motion = self._motion
        if motion.is_idle and self._last_angles_at_rest:
            return self._last_angles
        truth = self._truth(self._loop.time())
        heading, last = motion.target, motion.last_move
        if heading is not None:
            a_set, b_set = heading.a_deg, heading.b_deg
        elif last is not None:
            a_set, b_set = last.target_a_deg, last.target_b_deg
        else:
            # It was never sent anywhere: its set point is where it stands.
            a_set, b_set = truth
        seen = (a_set, b_set, *truth)
        self._last_angles_at_rest = motion.is_idle and seen == self._last_angles
        self._last_angles = seen
        return seen

    async def _pass_gap(self, due_s: float) -> None:
        """Let a gap pass, in large steps at night while the tracker rests: nothing happens then."""
        while (left_s := due_s - _AWAKE_S - self._loop.time()) > 0:
            skip_s = min(left_s, _SKIP_S)
            if left_s > 2.0 * DAY_S:
                skip_s = (left_s // DAY_S - 1.0) * DAY_S
            if self._may_skip(skip_s):
                self._loop.skip(skip_s)
                self._control.tick()
            else:
                await self._live_until(self._loop.time() + min(left_s, _AWAKE_S))

    def _may_skip(self, skip_s: float) -> bool:
        if self._control.mode is not Mode.NIGHT or not self._motion.is_idle:
            return False
        utc_s = self._clock.utc()
        return all(self._sun_elevation_deg(at_s) < _DEEP_NIGHT_DEG for at_s in (utc_s, utc_s + skip_s))


def _opened(path: Path, suffix: str) -> TextIO:
    if suffix == ".gz":
        return cast("TextIO", gzip.open(path, "wt", encoding="utf-8", newline=""))
    return path.open("w", encoding="utf-8", newline="")


def _write(file: TextIO, settings: Settings, rows: RecordedScans, log: _Log, good: NDArray[np.bool_]) -> None:
    writer = csv.writer(file, lineterminator="\n")
    writer.writerow(COLUMNS)
    angles = np.frombuffer(log.angles).reshape(-1, 4)
    site = settings.site.place()
    # Only the rows that were done before Ctrl-C.
    for first in range(0, len(good), _ROWS_AT_ONCE):
        some = slice(first, min(first + _ROWS_AT_ONCE, len(good)))
        utc_s = rows.utc_s[some]
        faces = np.where(good[some], rows.faces_w_m2[some], np.nan)
        estimates: list[tuple[str, ...]] = [("", "", "")] * len(utc_s)
        if log.learned:
            estimates = _estimates(log.pointing.law, faces, sun_direction(utc_s, *site), first, log.learned)
        for at, time_utc_s in enumerate(utc_s.tolist()):
            mode, law = log.modes[first + at], log.laws[first + at]
            a_set, b_set, a, b = angles[first + at].tolist()
            texts = [f"{value:z.3f}" for value in (a_set, b_set, a, b)]
            writer.writerow([iso_utc(time_utc_s), *texts, mode.value, law, *estimates[at], "true"])


def _estimates(
    law: Law, faces: Array, sun: Array, first: int, learned: Sequence[tuple[int, Any]]
) -> list[tuple[str, ...]]:
    """Return beam, diffuse and albedo for each row, from its own good readings and what the law had learned by then."""
    found: list[tuple[str, ...]] = []
    ends = [begin for begin, _ in learned[1:]] + [first + len(faces)]
    for (begin, known), end in zip(learned, ends, strict=True):
        part = slice(max(begin - first, 0), max(min(end - first, len(faces)), 0))
        columns = law.estimates(faces[part], sun[part], known)
        beam, diffuse = ([_format_or_empty(value, ".1f") for value in column.tolist()] for column in columns[:2])
        found += zip(beam, diffuse, [_format_or_empty(value, ".4f") for value in columns.albedo.tolist()], strict=True)
    return found


def _format_or_empty(value: float, form: str) -> str:
    return "" if math.isnan(value) else format(value, form)
