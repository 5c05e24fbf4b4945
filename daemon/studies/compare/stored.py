"""Measurements of two trackers from the service's own store: I-V curves, poses and the cube's readings."""

import base64
import sqlite3
from collections.abc import Callable, Iterator, Sequence
from contextlib import closing, contextmanager
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path
from time import sleep
from typing import Any, Literal

import numpy as np
import pandas as pd

from daemon.base.clock import LoopClock
from daemon.base.errors import UserError
from daemon.base.records import FACES, Record
from daemon.config.settings import Settings
from daemon.store.schema import FILE_NAME, columns_of, open_for_reading, tracker_sql
from daemon.store.store import Origin, Store, new_run_id
from daemon.studies.compare.measurements import Measurement
from daemon.studies.recorded import stored_faces
from solar.ephemeris import Site
from solar.frames import Array
from solar.skies.sky_periods import diffuse_fraction_of_faces

# The service records the pose of a resting tracker, and reads the cube, more often than this.
_POSE_HOLDS_S = 900.0
_SCAN_WITHIN_S = 15.0
_MOST_WAITING = 20_000
_LOOK_EVERY = 1000
# The name of the tracker takes the place of {tracker}.
_CURVES = (
    "SELECT time, pmpp_w FROM curves JOIN runs USING (run)"
    " WHERE run = ? AND {tracker} = ? AND quality = 'ok' ORDER BY time"
)
_POSES = "SELECT time, a_deg, b_deg FROM poses JOIN runs USING (run) WHERE run = ? AND {tracker} = ? ORDER BY time"
_TRACKERS = "SELECT DISTINCT run, {tracker}, {of_run} FROM curves JOIN runs USING (run) ORDER BY run, 2"
_BEST_CURVE = (
    "SELECT time, pmpp_w, curve FROM curves JOIN runs USING (run) WHERE (? OR {tracker} = ?)"
    " AND quality = 'ok' AND curve != '' ORDER BY pmpp_w DESC LIMIT 1"
)


def parse_store(text: str) -> tuple[str | None, str]:
    """Return the tracker's name, if any, and the folder of ``DIR`` or ``NAME=DIR``."""
    name, found, folder = text.partition("=")
    return (name, folder) if found else (None, text)


def read_stores(stores: Sequence[tuple[str | None, Path]]) -> tuple[pd.DataFrame, Site]:
    """Return the measurements of every run in stores, as `read_tables` of pairs does, and the last run's site.

    GHI and DHI are the cube's: its zenith face, and 2 I_min - 0.2 I_Z.

    Parameters
    ----------
    stores
        Folders, each with a name or None. To runs of one tracker the name is given as their tracker's; in runs of
        several trackers it chooses the tracker of that name. With None each tracker keeps its own name.

    Raises
    ------
    UserError
        A store cannot be read, or holds no curves.
    """
    frames, sites = [], []
    for name, directory in stores:
        path = directory / FILE_NAME
        with closing(open_for_reading(path)) as connection:
            try:
                frames.append(_measurements(connection, name, path))
                sites.append(_last_site(connection))
            except sqlite3.Error as error:
                raise UserError(f"the store {path} cannot be read: {error}") from None
    return pd.concat(frames, ignore_index=True), sites[-1]


@dataclass(frozen=True, slots=True)
class KeptCurve:
    """The points of one I-V curve, shape (n,), in the order of rising voltage."""

    time_utc_s: float
    voltage_v: Array
    current_a: Array


def kept_curve(stores: Sequence[tuple[str | None, Path]], tracker: str) -> KeptCurve | None:
    """Return the kept curve with the highest power of a tracker, or None where no points were kept.

    Stores as for `read_stores`; those that have the name of another tracker are not read.
    """
    best: tuple[float, float, str] | None = None
    for name, directory in stores:
        if name not in (None, tracker):
            continue
        with closing(open_for_reading(directory / FILE_NAME)) as connection:
            # A store of an older version has neither the table nor the column.
            if not (columns_of(connection, "curves") and "tracker" in columns_of(connection, "runs")):
                continue
            query = _BEST_CURVE.format(tracker=tracker_sql(connection, "curves", "curves"))
            any_run = name is not None and not _has_several(connection)
            row = connection.execute(query, (any_run, tracker)).fetchone()
        if row is not None and (best is None or row[1] > best[1]):
            best = row
    if best is None:
        return None
    voltage, current = np.frombuffer(base64.b64decode(best[2]), "<f4").astype(np.float64).reshape(2, -1)
    order = np.argsort(voltage)
    return KeptCurve(best[0], voltage[order], current[order])


def _measurements(connection: sqlite3.Connection, name: str | None, path: Path) -> pd.DataFrame:
    light = _light(connection)
    found = []
    for run, own, one_of_several in _trackers(connection):
        if one_of_several and name not in (None, own):
            continue
        curves = _table(connection, "curves", _CURVES, (run, own), ["time", "pmpp_w"])
        if curves.empty:
            continue
        poses = _table(connection, "poses", _POSES, (run, own), ["time", "a_deg", "b_deg"])
        both = _join_by_time(curves, poses, "backward", _POSE_HOLDS_S)
        whole = _join_by_time(both, light, "nearest", _SCAN_WITHIN_S)
        found.append(whole.assign(tracker=name or own or f"run {run}", simulated=_simulated(connection, run)))
    if not found:
        raise UserError(_no_curve_sentence(f"the store {path}", name, list(_trackers(connection))))
    return pd.concat(found, ignore_index=True).reindex(columns=list(Measurement._fields))


def _no_curve_sentence(called: str, name: str | None, trackers: Sequence[tuple[int, str, bool]]) -> str:
    """Return the sentence for a store without a usable curve."""
    if not trackers:
        return f"{called} holds no I-V curves: they need an electronic load, section load of the configuration"
    there = ", ".join(sorted({f"'{own}'" for _, own, _ in trackers}))
    if name is not None and all(one_of_several and own != name for _, own, one_of_several in trackers):
        return f"{called} holds I-V curves of {there} and none of '{name}': name one of them, or leave the name out"
    return f"{called} holds I-V curves of {there}, but none of quality 'ok': see their column why"


def _trackers(connection: sqlite3.Connection) -> Iterator[tuple[int, str, bool]]:
    """Yield each run with curves and the name of each tracker in it, and whether the run has several."""
    if not columns_of(connection, "curves"):
        return
    of_run = "runs.tracker" if "tracker" in columns_of(connection, "runs") else "''"
    query = _TRACKERS.format(tracker=tracker_sql(connection, "curves", "curves"), of_run=of_run)
    for run, tracker, of_run in connection.execute(query).fetchall():
        yield run, tracker, not of_run and tracker != ""


def _has_several(connection: sqlite3.Connection) -> bool:
    return any(one_of_several for _, _, one_of_several in _trackers(connection))


def _table(
    connection: sqlite3.Connection, kind: str, query: str, of: tuple[int, str], columns: list[str]
) -> pd.DataFrame:
    rows = connection.execute(query.format(tracker=tracker_sql(connection, kind, kind)), of).fetchall()
    return pd.DataFrame(rows, columns=columns).astype(float)


def _light(connection: sqlite3.Connection) -> pd.DataFrame:
    utc_s, faces = stored_faces(connection)
    whole = np.isfinite(faces).all(axis=1)
    utc_s, faces = utc_s[whole], faces[whole]
    zenith = faces[:, FACES.index("zenith")]
    return pd.DataFrame({"time": utc_s, "ghi_w_m2": zenith, "dhi_w_m2": zenith * diffuse_fraction_of_faces(faces)})


def _simulated(connection: sqlite3.Connection, run: int) -> bool:
    return bool(connection.execute("SELECT simulated FROM runs WHERE run = ?", (run,)).fetchone()[0])


def _join_by_time(
    left: pd.DataFrame, right: pd.DataFrame, direction: Literal["backward", "nearest"], within_s: float
) -> pd.DataFrame:
    within: Any = within_s  # the stubs know times only, and ours are numbers
    return pd.merge_asof(left, right, on="time", direction=direction, tolerance=within)


def _last_site(connection: sqlite3.Connection) -> Site:
    row = connection.execute("SELECT latitude_deg, longitude_deg, altitude_m FROM runs ORDER BY run DESC").fetchone()
    return Site(*row)


def _refuse_real(path: Path) -> None:
    if not path.exists():
        return
    with closing(open_for_reading(path)) as connection:
        real = connection.execute("SELECT 1 FROM runs WHERE NOT simulated LIMIT 1").fetchone()
    if real is not None:
        raise UserError(
            f"--store: {path} has records of real instruments: name another folder for those of a simulation"
        )


@contextmanager
def open_simulation_stores(
    settings: Settings, names: Sequence[str], directory: Path, start_utc_s: float
) -> Iterator[Callable[[str, Record], None]]:
    """Keep the records of simulated trackers in one store, as a run for each; yields a function that keeps a record.

    Unlike the service, a simulation waits for the disk, and loses no record.

    Raises
    ------
    UserError
        The folder cannot be a store or has records of real instruments, or the disk fails.
    """
    _refuse_real(directory / FILE_NAME)
    site = settings.site
    clock = LoopClock(lambda: 0.0, start_utc_s)
    stores: dict[str, Store] = {}
    try:
        for name in names:
            origin = Origin(
                started_utc_s=start_utc_s,
                role="both",
                version=version("heliocube"),
                simulated=True,
                site=site.name,
                latitude_deg=site.latitude_deg,
                longitude_deg=site.longitude_deg,
                altitude_m=site.altitude_m,
                tracker=name,
                id=new_run_id(),
            )
            # Without an age limit (None): simulated records stay until a person removes them.
            stores[name] = Store(directory, settings.store.batch_s, None, origin, clock, _ignore)
        taken = 0

        def keep(name: str, record: Record) -> None:
            nonlocal taken
            stores[name].keep(record)
            taken += 1
            if taken % _LOOK_EVERY == 0:
                _catch_up(stores[name])

        yield keep
    finally:
        for store in stores.values():
            store.close()
    for store in stores.values():
        if store.status.waiting:
            raise UserError(f"--store: {store.status.path} could not be written to its end")


def _catch_up(store: Store) -> None:
    while (status := store.status).waiting > _MOST_WAITING:
        if status.down_why is not None:
            raise UserError(f"--store: {status.path} cannot be written: {status.down_why}")
        sleep(0.01)


def _ignore(_event: object) -> None:
    """Ignore an event of the store: its failures are raised instead."""
