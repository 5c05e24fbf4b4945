"""What a report is made of: the records of one tracker in a span of time, from a store or from tables."""

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import pandas as pd
from pandas.api.types import is_bool_dtype, is_numeric_dtype

from daemon.base.errors import UserError
from daemon.base.records import FACES, Quality
from daemon.store.export import KINDS, export
from daemon.store.runs import PriorRecords, StoredRun, no_records_text, read_prior_records, record_time_range, runs_of
from daemon.store.schema import FILE_NAME
from daemon.store.tables import COLUMNS
from daemon.studies.inputs import check_frame, check_table, not_utf8_error
from daemon.studies.report.span import ReportSpan, RequestedSpan, utc_and_local_time
from solar.ephemeris import Site
from solar.frames import Array, Limits
from solar.tables import broken_line, unreadable, utc_times

# Columns that no figure needs: those of a month would fill the memory.
_UNUSED_COLUMNS = {"session", "source", "sequence", "calibration", "curve", "ghi", *(f"{face}_time" for face in FACES)}
# The last record belongs to the span.
_LAST_S = 1.0
_NOTHING_TOLD = PriorRecords()
_DAMAGED = "it is damaged or cut off; export it anew"
_NUMBERS = {kind: [column.name for column in columns if column.holds == "float"] for kind, columns in COLUMNS.values()}
_BOOLEAN_COLUMNS = ("moving", "simulated")
_NEEDED = {
    "scans": [f"{face}_{what}" for face in FACES for what in ("w_m2", "quality")],
    "decisions": ["mode", "target_a_deg", "target_b_deg"],
    "moves": [f"{when}_{angle}_deg" for when in ("from", "target", "end") for angle in "ab"] + ["outcome"],
    "poses": ["a_deg", "b_deg", "moving"],
    "modes": ["before", "after", "why"],
    "events": ["subject", "text"],
    "curves": ["pmpp_w", "quality"],
}
_CATEGORY_COLUMNS = {"mode", "law", "tracker", *(f"{face}_quality" for face in FACES)}


@dataclass(frozen=True, slots=True)
class Material:
    """The records of one tracker.

    Attributes
    ----------
    span
        The time that it covers.
    site, site_name, limits
        Place and name of the site, and the limits of the tracker's angles.
    tracker
        Name of the tracker.
    simulated
        Whether any record is simulated: then the page says so everywhere.
    source
        Where the records come from, in words.
    runs
        Runs of the service, as far as the records know them.
    tables
        A frame for each kind, with a UTC index and the columns of docs/data.md; empty without a record.
    before
        What the run in which the span begins had told before the span.
    budget_deg, budget_moves
        The budget of a day, if it is known.
    stow_wind_m_s
        Wind from which the tracker stows, if that is known.
    """

    span: ReportSpan
    site: Site
    site_name: str
    limits: Limits
    tracker: str
    simulated: bool
    source: str
    runs: tuple[StoredRun, ...]
    tables: dict[str, pd.DataFrame]
    before: PriorRecords = _NOTHING_TOLD
    budget_deg: float | None = None
    budget_moves: int | None = None
    stow_wind_m_s: float | None = None

    def times_of(self, kind: str) -> Array:
        """Return the UTC [s] of a kind's rows."""
        return index_utc_s(self.tables[kind])

    def column(self, kind: str, name: str) -> Array:
        """Return a column of numbers, NaN throughout where the table does not have it."""
        table = self.tables[kind]
        if name not in table:
            return np.full(len(table), np.nan)
        return table[name].to_numpy(dtype=np.float64, na_value=np.nan)

    def faces(self) -> Array:
        """Return the scans' readings [W/m2], shape (n, 4), NaN where a reading is not good."""
        scans = self.tables["scans"]
        columns = [
            np.where(scans[f"{face}_quality"] == Quality.OK, self.column("scans", f"{face}_w_m2"), np.nan)
            for face in FACES
            if f"{face}_quality" in scans
        ]
        return np.stack(columns, axis=-1) if columns else np.empty((0, len(FACES)))


def index_utc_s(table: pd.DataFrame) -> Array:
    """Return the UTC [s] of a table's index."""
    if not len(table):
        return np.empty(0)
    since = pd.DatetimeIndex(table.index) - pd.Timestamp(0, tz="UTC")
    return np.asarray(since / pd.Timedelta(seconds=1), dtype=np.float64)


def read_material(
    directory: Path,
    wanted: RequestedSpan,
    tracker: str | None,
    now_utc_s: float,
    progress: Callable[[float], None],
    called: str = "",
) -> list[Material]:
    """Return the material of every tracker of a store, or of the one that is named.

    Parameters
    ----------
    directory
        Folder of the store.
    wanted
        Which time.
    tracker
        Which tracker; None is all of them.
    now_utc_s
        The span ends here at the latest: the future does not count as missing.
    progress
        Called with the share that is read, 0..1.
    called
        Where the records come from, in words, if that is not this folder.

    Raises
    ------
    UserError
        There is no store, no such tracker, or nothing in that time.
    """
    path = directory / FILE_NAME
    called = called or f"the store {path}"
    runs = runs_of(path)
    if not runs:
        raise UserError(f"{called} holds nothing yet")
    span = wanted.span(runs[-1].origin.longitude_deg, now_utc_s)
    tables = _read_days(directory, span, progress)
    if not any(len(table) for table in tables.values()):
        raise UserError(no_records_text(span.start_utc_s, span.end_utc_s, str(path), record_time_range(path)))
    with_records = {int(run) for table in tables.values() if "run" in table for run in table["run"].unique()}
    there = [run for run in runs if run.run in with_records]
    last = there[-1].origin
    site = Site(last.latitude_deg, last.longitude_deg, last.altitude_m)
    # One run is enough, as each run raises lasting alarms anew.
    before = read_prior_records(path, there[0].run, span.start_utc_s)
    found = split_by_tracker(tables, span, site, last.site, called, runs=tuple(there), before=before)
    chosen = [material for material in found if tracker in (None, material.tracker)]
    if not chosen:
        names = ", ".join(material.tracker for material in found)
        raise UserError(f"--tracker {ascii(tracker)[:40]}: that store has {names} in that time")
    return chosen


def split_by_tracker(
    tables: dict[str, pd.DataFrame],
    span: ReportSpan,
    site: Site,
    site_name: str,
    source: str,
    *,
    runs: tuple[StoredRun, ...] = (),
    before: PriorRecords = _NOTHING_TOLD,
) -> list[Material]:
    """Return the material of every tracker in tables; `UserError` for tables without a record in the span."""
    inside = rows_within(tables, span)
    if not any(len(table) for table in inside.values()):
        raise UserError(no_records_text(span.start_utc_s, span.end_utc_s, source, None))
    return [
        Material(
            span=span,
            site=site,
            site_name=site_name,
            limits=Limits(),
            tracker=name,
            simulated=any(run.origin.simulated for run in runs) or _simulated(inside),
            source=source,
            runs=runs,
            tables={kind: _of_tracker(table, name) for kind, table in inside.items()},
            before=PriorRecords(*(tuple(said for said in kind if said[1] in ("", name)) for kind in before)),
        )
        for name in _trackers(inside.values()) or ["tracker"]
    ]


def span_of_tables(tables: dict[str, pd.DataFrame], source: str) -> ReportSpan:
    """Return the span from the first record of tables to the last; raises `UserError` without one."""
    filled = [table.index for table in tables.values() if len(table)]
    if not filled:
        raise UserError(f"{source} hold no record")
    first, last = min(index.min() for index in filled), max(index.max() for index in filled)
    name = f"{first:%Y%m%dT%H%MZ}_{last:%Y%m%dT%H%MZ}"
    return ReportSpan(first.timestamp(), last.timestamp() + _LAST_S, name)


def read_tables(
    directory: Path, table_format: str, warn: Callable[[str], None] = lambda _: None
) -> dict[str, pd.DataFrame]:
    """Return the tables of a folder that ``heliocube simulate`` or ``export`` wrote; raises `UserError`.

    `warn` is called with a sentence for each table that breaks off in its last line, which is left out.
    """
    found: dict[str, pd.DataFrame] = {}
    for kind in KINDS:
        path = directory / f"{kind}.{table_format}"
        if not path.exists():
            found[kind] = pd.DataFrame(index=pd.DatetimeIndex([], tz="UTC", name="time"))
            continue
        try:
            table = pd.read_parquet(path) if path.suffix == ".parquet" else _csv(path, warn)
        except UnicodeDecodeError:
            raise not_utf8_error(path) from None
        except OSError as error:
            raise UserError(f"{path} cannot be read: {error.strerror or _DAMAGED}") from None
        except ValueError:
            # The errors of pandas and pyarrow derive from ValueError.
            raise UserError(f"{path} is not a table that can be read: {_DAMAGED}") from None
        found[kind] = _slim(_checked(path, kind, table))
    return found


def _csv(path: Path, warn: Callable[[str], None]) -> pd.DataFrame:
    separator = check_table(path)
    if not path.stat().st_size:
        raise UserError(f"{path} is empty: export it anew, or take the file away")
    try:
        # Without the '=' pandas takes the name 'NA' for a missing one, even after a converter, and '01' for 1.
        named: Any = {"tracker": "={}".format}
        broken = broken_line(path, separator)
        # A broken last line would turn a column of numbers into texts. pandas' fast engine cannot skip the last line.
        whole: Any = {"skipfooter": 1, "engine": "python"} if broken else {}
        decimal = "," if separator == ";" else "."
        table: pd.DataFrame = pd.read_csv(path, sep=separator, decimal=decimal, converters=named, **whole)
    except pd.errors.ParserError as error:
        raise UserError(unreadable(path, separator, error)) from None
    check_frame(path, table)
    if broken:
        warn(f"{path}: {broken.note()}")
    # A record of the cube or of the process names no tracker.
    return table.assign(tracker=table["tracker"].str[1:]) if "tracker" in table else table


def _checked(path: Path, kind: str, table: pd.DataFrame) -> pd.DataFrame:
    """Return a table sorted by its times; raises `UserError` for a missing column or a cell that cannot be used."""
    if "time" in table:
        times = utc_times(table["time"].astype("str"))
        _refuse(path, table["time"].fillna(""), times.isna(), ", not such as 2022-10-14T08:00Z")
        table = table.drop(columns="time").set_index(pd.DatetimeIndex(times, name="time"))
    there = [table.index.name, *table.columns]
    missing = [name for name in ("time", *_NEEDED[kind]) if name not in there]
    if missing:
        raise UserError(f"{path} has no column {missing[0]}: export it anew, and rename none")
    for name in _NUMBERS[kind]:
        if name in table and not is_numeric_dtype(table[name]):
            numbers = pd.to_numeric(table[name], errors="coerce")
            _refuse(path, table[name], numbers.isna() & table[name].notna(), ", which is not a number")
            table[name] = numbers
    for name in _BOOLEAN_COLUMNS:
        if name in table and not is_bool_dtype(table[name]):
            _refuse(path, table[name], ~table[name].isin([True, False]) & table[name].notna(), "; write true or false")
    # The clock may have been set back while the records were written.
    return table.sort_index(kind="stable")


def _refuse(path: Path, column: "pd.Series[Any]", wrong: "pd.Series[bool]", why: str) -> None:
    """Raise `UserError` with the first cell that is wrong."""
    if wrong.any():
        row = int(np.flatnonzero(wrong)[0])
        raise UserError(f"{path}, row {row + 1}: {column.name} is '{column.iloc[row]}'{why}")


def rows_within(tables: dict[str, pd.DataFrame], span: ReportSpan) -> dict[str, pd.DataFrame]:
    """Return the rows of a span."""
    ends = (pd.Timestamp(at, unit="s", tz="UTC") for at in (span.start_utc_s, span.end_utc_s))
    first, last = ends
    return {kind: table[(table.index >= first) & (table.index < last)] for kind, table in tables.items()}


def _read_days(directory: Path, span: ReportSpan, progress: Callable[[float], None]) -> dict[str, pd.DataFrame]:
    """Read day by day, so that only the columns that are needed are held of a month."""
    parts: dict[str, list[pd.DataFrame]] = {kind: [] for kind in KINDS}
    days = span.days()
    for number, day in enumerate(days):
        with TemporaryDirectory(prefix="heliocube-") as folder:
            first, last = (utc_and_local_time(at, None)[0] for at in (day.start_utc_s, day.end_utc_s))
            export(directory, Path(folder), "parquet", first, last, ())
            for kind, table in read_tables(Path(folder), "parquet").items():
                parts[kind].append(table)
        progress((number + 1) / len(days))
    return {kind: _join_days(tables) for kind, tables in parts.items()}


def _join_days(tables: list[pd.DataFrame]) -> pd.DataFrame:
    filled = [table for table in tables if len(table)]
    if len(filled) <= 1:
        return filled[0] if filled else tables[0]
    # Days may have different categories: join them as text, and make categories of the whole again.
    return _slim(pd.concat([_as_text(table) for table in filled]))


def _as_text(table: pd.DataFrame) -> pd.DataFrame:
    return table.astype({name: "object" for name in table.columns if name in _CATEGORY_COLUMNS})


def _slim(table: pd.DataFrame) -> pd.DataFrame:
    """Return a table without columns that no figure needs, its repeated words held once."""
    kept = table.drop(columns=[name for name in table.columns if name in _UNUSED_COLUMNS])
    return kept.astype({name: "category" for name in kept.columns if name in _CATEGORY_COLUMNS})


def _trackers(tables: Iterable[pd.DataFrame]) -> list[str]:
    return sorted({str(name) for table in tables if "tracker" in table for name in table["tracker"].unique() if name})


def _of_tracker(table: pd.DataFrame, name: str) -> pd.DataFrame:
    """Return one tracker's rows; rows of no tracker, such as scans, belong to all."""
    if "tracker" not in table or not len(table):
        return table
    return table[table["tracker"].astype("object").fillna("").isin(["", name])]


def _simulated(tables: dict[str, pd.DataFrame]) -> bool:
    return any("simulated" in table and bool(table["simulated"].any()) for table in tables.values())
