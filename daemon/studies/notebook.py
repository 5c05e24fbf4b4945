"""The studies as a notebook calls them: choices by keyword, tables as data frames. Public through `heliocube`."""

import asyncio
import math
import warnings
from collections.abc import Callable, Collection
from concurrent.futures import ThreadPoolExecutor
from datetime import UTC, datetime
from pathlib import Path
from tempfile import TemporaryDirectory
from threading import Event
from typing import Any, TypeVar

import numpy as np
import pandas as pd

from daemon.base.errors import UserError
from daemon.base.records import FACES
from daemon.store.export import KINDS, export
from daemon.studies.inputs import instant, settings_for
from daemon.studies.recorded import RecordedScans, read_csv, unit_note
from daemon.studies.replay import replay as run_replay
from daemon.studies.simulate import simulate as run_simulation
from solar.ephemeris import Site
from solar.irradiance import is_possible

__all__ = ["UserError", "read_faces", "read_store", "replay", "simulate"]

Tables = dict[str, pd.DataFrame]
Place = Site | tuple[float, float, float]
Date = str | datetime | np.datetime64
Result = TypeVar("Result")


def simulate(
    start: Date,
    *,
    days: float = 1.0,
    weather: str | Path | None = None,
    law: str | None = None,
    site: Place | None = None,
    seed: int | np.integer[Any] | None = None,
    config: Path | str | None = None,
) -> Tables:
    """Run the service on the simulated rig under virtual time and return its records; a day takes some seconds.

    Parameters
    ----------
    start
        First day or instant, such as ``"2022-10-14"``; UTC where it names no zone.
    days
        How many.
    weather
        ``clear``, ``overcast``, ``variable``, ``broken`` or a measured file (CSV, BSRN, SURFRAD, MIDC, TMY3).
    law
        Pointing law by name, such as ``mu-prime`` or ``optimal``.
    site
        The site, a `Site` or its three numbers; None is the configuration's.
    seed
        Seed of weather and noise: the same seed gives the same tables.
    config
        Configuration file; None is the simulated rig as it comes.

    Returns
    -------
    A frame for each kind (``scans``, ``decisions``, ``moves``, ``poses``, ``modes``, ``events``, ``curves``), with a
    UTC index named ``time``. docs/data.md has the columns. A kind without a record has an empty frame.

    Raises
    ------
    UserError
        A choice cannot be used; one sentence says which and what would be.
    ValueError
        `days` is no length of time.

    Warns
    -----
    UserWarning
        For weather that is missing or does not fit the site, and for a law that failed, so that another pointed.
    """
    if not (isinstance(days, int | float | np.integer | np.floating) and 0.0 < days < math.inf):
        raise ValueError(f"days must be a number above 0, not {days}")
    # With a 32-bit float of numpy all later times would be 32-bit floats, too coarse for the clock to advance.
    days = float(days)
    if isinstance(seed, np.integer):
        seed = seed.item()
    settings = settings_for(_path(config, "config"), weather=_text(weather), law=law, site=_place(site), seed=seed)
    with TemporaryDirectory(prefix="heliocube-") as folder:
        first, out = _instant(start, "start"), Path(folder)
        summary = _in_a_loop_of_its_own(
            lambda progress: run_simulation(settings, first, days, out, "parquet", progress)
        )
        _warn(*summary.warnings, *summary.failed_laws)
        return _tables(Path(folder))


def read_store(
    directory: Path | str,
    *,
    start: Date | None = None,
    end: Date | None = None,
    kinds: Collection[str] | None = None,
) -> Tables:
    """Return what a store holds from `start` up to, not including, `end`; the service may go on writing meanwhile.

    Parameters
    ----------
    directory
        Folder of the store, `store.directory` of its configuration.
    start, end
        UTC where they name no zone; None is as far as the store goes.
    kinds
        Such as ``["scans", "poses"]``; None is all.

    Returns
    -------
    Frames as from `simulate`, with the columns that ``heliocube export`` adds: the same quantities under pvlib's names,
    the run and its tracker.

    Raises
    ------
    UserError
        There is no store, the span is empty, or a kind does not exist.
    """
    wanted = [kinds] if isinstance(kinds, str) else list(kinds or ())
    unknown = [kind for kind in wanted if kind not in KINDS]
    if unknown:
        raise UserError(f"kinds: {unknown[0]!r} is not one of {', '.join(KINDS)}")
    with TemporaryDirectory(prefix="heliocube-") as folder:
        first = None if start is None else _instant(start, "start")
        last = None if end is None else _instant(end, "end")
        export(_required_path(directory, "directory"), Path(folder), "parquet", first, last, wanted)
        return _tables(Path(folder))


def read_faces(path: Path | str) -> pd.DataFrame:
    """Return recorded readings of a cube: a UTC index named ``time``, columns east, south, west, zenith [W/m2].

    Parameters
    ----------
    path
        CSV file, plain or ``.gz``, with the columns time,east,south,west,zenith. A face without a
        possible reading is NaN. A last line in which the file breaks off is left out, with a `UserWarning`.

    Raises
    ------
    UserError
        One sentence with the file, the line, the value and what is expected.
    """
    recording = read_csv(_required_path(path, "path"))
    if recording.broken:
        _warn(f"{path}: {recording.broken.note()}")
    rows = recording.rows
    # Seconds since 1970 in a float are exact to a microsecond, and no file has finer times.
    times = pd.to_datetime(rows.utc_s, unit="s", utc=True).round("us")
    index = pd.DatetimeIndex(times, name="time")
    return pd.DataFrame(rows.faces_w_m2, index=index, columns=list(FACES))


def replay(
    faces: pd.DataFrame, *, site: Place, law: str | None = None, config: Path | str | None = None
) -> pd.DataFrame:
    """Let recorded readings drive a simulated tracker through the code that runs live.

    Parameters
    ----------
    faces
        Readings as from `read_faces`, in rising time, 1 to 60 s apart; gaps are allowed. As there, a number that no
        face can read means that the face has no reading.
    site, law, config
        As for `simulate`.

    Returns
    -------
    One row per reading, a UTC index named ``time``: a_set, b_set, a, b [deg] (set, and where the tracker stands), mode,
    law (of the last decision; NaN in modes that do not decide), dni_est, dhi_est [W/m2], albedo_est (estimates of the
    law `optimal`, NaN for others), simulated (always True, as the tracker is).

    Raises
    ------
    UserError
        The rows are too few, too far apart, not within 1979 to 2099 or not all numbers, or a choice cannot be used.

    Warns
    -----
    UserWarning
        For readings that look like kW/m2, and for a law that failed, so that another pointed.
    """
    settings = settings_for(_path(config, "config"), law=law, site=_place(site))
    with TemporaryDirectory(prefix="heliocube-") as folder:
        out = Path(folder) / "positions.csv"
        rows = _rows(faces)
        _warn(*filter(None, [unit_note("the frame", rows, settings.site.place())]))
        _warn(
            *_in_a_loop_of_its_own(lambda progress: run_replay(settings, rows, "the frame", out, progress)).failed_laws
        )
        return pd.read_csv(out, index_col="time", parse_dates=["time"])


def _warn(*texts: str) -> None:
    """Warn the caller of the function that calls this."""
    for text in texts:
        warnings.warn(text, stacklevel=3)


def _in_a_loop_of_its_own(work: Callable[[Callable[[float], None]], Result]) -> Result:
    """Return the result of `work`, which runs an event loop, in a thread of its own where one runs here already.

    A thread may run one event loop at a time, and the kernel of a notebook runs one. An interrupt ends the work at its
    next call of the progress function.
    """
    try:
        asyncio.get_running_loop()
    except RuntimeError:
        return work(lambda _share: None)
    interrupted = Event()

    def advance(_share: float) -> None:
        if interrupted.is_set():
            raise UserError("interrupted")

    with ThreadPoolExecutor(1) as thread:
        try:
            return thread.submit(work, advance).result()
        except BaseException:
            # The interrupt may have come before `submit` returned, while the thread is at work already.
            interrupted.set()
            raise


def _rows(faces: pd.DataFrame) -> RecordedScans:
    # An argument that is no frame, such as the array in one, gets the same sentence.
    index = getattr(faces, "index", None)
    if not isinstance(index, pd.DatetimeIndex) or index.tz is None or not index.is_monotonic_increasing:
        raise UserError("the readings need an index of times with their zone, in rising order, as read_faces gives it")
    if not index.is_unique:
        raise UserError(f"the readings have the time {index[index.duplicated()][0]} twice; keep only the right one")
    missing = [face for face in FACES if face not in faces]
    if missing:
        raise UserError(f"the readings have no column {', '.join(missing)}: east, south, west and zenith are needed")
    doubled = [face for face in FACES if list(faces.columns).count(face) > 1]
    if doubled:
        raise UserError(f"the readings have two columns {doubled[0]}; keep only the right one")
    since = index - pd.Timestamp(0, tz=UTC)
    seconds = np.asarray(since / pd.Timedelta(seconds=1), dtype=np.float64)
    try:
        values = faces[list(FACES)].to_numpy(dtype=np.float64, na_value=np.nan)
    except (TypeError, ValueError) as error:
        raise UserError(f"the readings must be numbers [W/m2], NaN where a face has none ({error})") from None
    return RecordedScans(seconds, np.where(is_possible(values), values, np.nan))


def _tables(folder: Path) -> Tables:
    return {file.stem: pd.read_parquet(file) for file in sorted(folder.glob("*.parquet"))}


def _instant(at: Date, name: str) -> datetime:
    return instant(str(at), name)


def _place(site: Place | None) -> dict[str, object] | None:
    if site is None:
        return None
    try:
        place = Site(*site)
    except (TypeError, ValueError):
        raise UserError(f"site: {site!r} is not a place; write heliocube.Site(48.7176, 2.2090, 156.0)") from None
    return {"name": f"{place.latitude_deg:g}, {place.longitude_deg:g}", **place._asdict()}


def _path(file: Path | str | None, name: str) -> Path | None:
    return None if file is None else _required_path(file, name)


def _required_path(file: Path | str, name: str) -> Path:
    try:
        return Path(file)
    except TypeError:
        kind = type(file).__name__
        raise UserError(f"{name}: a path is needed, such as 'data/day', and not a value of the type {kind}") from None


def _text(choice: str | Path | None) -> str | None:
    if isinstance(choice, pd.DataFrame):
        raise UserError('weather: a file is needed; write the frame with to_csv("weather.csv", index_label="time")')
    return None if choice is None else str(choice)
