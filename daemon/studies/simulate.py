"""Days in seconds: the service itself, on the in-process rig, under virtual time."""

import asyncio
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from datetime import UTC, datetime
from pathlib import Path
from random import Random
from typing import Literal

from daemon.base.clock import LoopClock
from daemon.base.errors import UserError
from daemon.base.process import SystemdNotifier, simulated_time_in_log
from daemon.base.records import Bus, Decision, Mode, ModeChange, Move, Record, Scan
from daemon.base.timeloop import virtual_time
from daemon.config.file import with_loopback_bridge
from daemon.config.links import StoreSettings
from daemon.config.rules import END_OF_STARTS, FIRST_START
from daemon.config.settings import Settings
from daemon.cube.calibration import calibration_in_force
from daemon.motion.polling import SIMULATED
from daemon.rigs.simulated import build_simulated_rig, build_weather
from daemon.service.rig import Role
from daemon.service.service import Service
from daemon.store.tables import TableError, TableWriter
from daemon.studies.failed_laws import failed_laws
from daemon.studies.simulated_day import SIMULATED_COLUMNS, PlaneInsolation, Poses, with_plane_orientation
from solar.ephemeris import DAY_S, sun_day

_PROGRESS_EVERY_S = 900.0


@dataclass(slots=True)
class Summary:
    """The results of a simulation.

    Attributes
    ----------
    scans
        How many the one cube made.
    decisions, moves
        How many, of all trackers.
    travel_deg
        Sum over both axes of the angles by which all trackers turned, from start to end of each move.
    mode_s
        Seconds in each mode, of all trackers.
    warnings
        About the weather file.
    failed_laws
        A sentence for each law that failed, so that another one pointed from then on.
    interrupted_utc_s
        The simulated instant at which Ctrl-C ended it, or None.
    insolation
        What the plane of each tracker received, and what a chronometric tracker's would have received.
    """

    scans: int = 0
    decisions: int = 0
    moves: int = 0
    travel_deg: float = 0.0
    mode_s: dict[Mode, float] = field(default_factory=lambda: dict.fromkeys(Mode, 0.0))
    warnings: list[str] = field(default_factory=list)
    failed_laws: list[str] = field(default_factory=list)
    interrupted_utc_s: float | None = None
    insolation: tuple[PlaneInsolation, ...] = ()


def simulate(
    settings: Settings,
    start: datetime,
    days: float,
    out: Path,
    table_format: Literal["csv", "parquet"],
    progress: Callable[[float], None],
    *,
    force: bool = False,
) -> Summary:
    """Run the service in both roles over `days` from `start` (UTC) and write its records to `out`.

    The same settings and seed give byte-identical files. After Ctrl-C they hold what was done by then.

    Parameters
    ----------
    progress
        Called with the share done, 0..1.
    force
        Whether tables that are there are replaced.

    Raises
    ------
    UserError
        The time is not within 1979 to 2099, the sun never rises in it, the weather does not cover it, or `out` cannot
        be written.
    """
    start_utc_s = start.replace(tzinfo=start.tzinfo or UTC).timestamp()
    end_utc_s = start_utc_s + days * DAY_S
    if not FIRST_START.timestamp() <= start_utc_s <= end_utc_s <= END_OF_STARTS.timestamp():
        years = f"{FIRST_START.year} to {END_OF_STARTS.year - 1}"
        raise UserError(f"the simulated time must be within the years {years}: choose another start or fewer days")
    _require_daylight(settings, start_utc_s, end_utc_s)
    calibration = calibration_in_force(settings.cube)
    weather, warning = build_weather(settings, start_utc_s, end_utc_s, with_gaps=True)
    # No store: records go to tables, and a simulation must not obey commands that an operator gave to a real rig.
    settings = with_loopback_bridge(settings, insecure=True).model_copy(update={"store": StoreSettings()})
    interrupted_utc_s, latitude_deg, poses = None, settings.site.latitude_deg, Poses()
    tally = _Tally(start_utc_s, [name for name, _ in settings.trackers])
    with (
        TableWriter(out, table_format, SIMULATED_COLUMNS, force=force) as tables,
        virtual_time() as runner,
    ):
        loop = runner.get_loop()
        clock = LoopClock(loop.time, start_utc_s)
        bus = Bus()
        full: list[TableError] = []

        def write(record: Record) -> None:
            # `count_down` raises it later: code that publishes a record must not fail because of the disk.
            if not full:
                try:
                    tables.write(with_plane_orientation(record, latitude_deg))
                except TableError as error:
                    full.append(error)

        bus.subscribe(write)
        bus.subscribe(tally.count)
        bus.subscribe(poses.note)
        service = Service(
            settings,
            Role.BOTH,
            build_simulated_rig(settings, Role.BOTH, clock, weather),
            clock,
            Random(settings.simulation.seed),  # noqa: S311 - reproducibility is the point; nothing secret depends on it
            bus,
            None,
            SystemdNotifier({}, 0),
            calibration=calibration,
            polling=SIMULATED,
        )
        try:
            with simulated_time_in_log(clock):
                runner.run(_run_until_end(service, days * DAY_S, progress, full))
        except KeyboardInterrupt:
            interrupted_utc_s = clock.utc()
    end_utc_s = end_utc_s if interrupted_utc_s is None else interrupted_utc_s
    summary = tally.close(end_utc_s, warning)
    summary.interrupted_utc_s = interrupted_utc_s
    summary.failed_laws = failed_laws(service.trackers)
    summary.insolation = tuple(poses.insolation(settings, weather, start_utc_s, end_utc_s))
    return summary


async def _run_until_end(
    service: Service, duration_s: float, progress: Callable[[float], None], full: Sequence[TableError]
) -> None:
    stop = asyncio.Event()

    async def count_down() -> None:
        elapsed_s = 0.0
        while elapsed_s < duration_s:
            step_s = min(_PROGRESS_EVERY_S, duration_s - elapsed_s)
            await asyncio.sleep(step_s)
            elapsed_s += step_s
            progress(elapsed_s / duration_s)
            if full:
                raise full[0]
        stop.set()

    await service.run(stop, count_down())


def _require_daylight(settings: Settings, start_utc_s: float, end_utc_s: float) -> None:
    site = settings.site.place()
    utc_s = start_utc_s
    while True:
        day = sun_day(utc_s, site.latitude_deg, site.longitude_deg, site.altitude_m)
        if day.highest_elevation_deg > 0:
            return
        utc_s += DAY_S
        if utc_s > end_utc_s:
            raise UserError(
                f"the sun does not rise at latitude {site.latitude_deg:g} deg in the simulated time (its highest "
                f"elevation is {day.highest_elevation_deg:.1f} deg): choose another start or another site"
            )


class _Tally:
    def __init__(self, start_utc_s: float, trackers: Sequence[str]) -> None:
        self._summary = Summary()
        self._modes = dict.fromkeys(trackers, (Mode.STARTING, start_utc_s))

    def count(self, record: Record) -> None:
        summary = self._summary
        if isinstance(record, Scan):
            summary.scans += 1
        elif isinstance(record, Decision):
            summary.decisions += 1
        elif isinstance(record, Move):
            summary.moves += 1
            summary.travel_deg += abs(record.end_a_deg - record.from_a_deg) + abs(record.end_b_deg - record.from_b_deg)
        elif isinstance(record, ModeChange):
            self._enter(record.after, record.time_utc_s, record.tracker)

    def _enter(self, mode: Mode, utc_s: float, tracker: str) -> None:
        before, since_utc_s = self._modes[tracker]
        self._summary.mode_s[before] += utc_s - since_utc_s
        self._modes[tracker] = (mode, utc_s)

    def close(self, end_utc_s: float, warning: str | None) -> Summary:
        for tracker, (mode, _) in tuple(self._modes.items()):
            self._enter(mode, end_utc_s, tracker)
        self._summary.warnings = [] if warning is None else [warning]
        return self._summary
