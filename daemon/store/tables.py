"""Records as tables: one file per kind, CSV or Parquet, the same bytes for the same records."""

import contextlib
import csv
import math
from collections.abc import Callable, Mapping
from dataclasses import replace
from operator import attrgetter
from pathlib import Path
from types import TracebackType
from typing import Any, Literal, NamedTuple, Protocol, Self

from daemon.base.clock import iso_utc
from daemon.base.errors import UserError
from daemon.base.records import FACES, Decision, Event, Irradiances, IvCurve, ModeChange, Move, Pose, Record, Scan
from daemon.store.outputs import check_outputs

Format = Literal["csv", "parquet"]
# A record, or a named tuple with the columns' values.
Row = Record | tuple[Any, ...]

_ROWS_PER_GROUP = 16384
_BUFFER_BYTES = 1 << 18
_NO_IRRADIANCES = Irradiances(*[math.nan] * 5)


class TableError(UserError):
    """The tables cannot be written where they are wanted; the message is one sentence."""


class Column(NamedTuple):
    """One column: its name, where in the record its value is, and what it holds.

    Columns with `constant_value`, a value that is the same in every row, come after all columns from the records.
    """

    name: str
    path: str
    holds: Literal["time", "float", "int", "bool", "text"]
    constant_value: bool | None = None


def _columns_like_fields(holds: Literal["float", "text"], *names: str) -> list[Column]:
    return [Column(name, name, holds) for name in names]


_TIMES = [Column("time", "time_utc_s", "time"), *_columns_like_fields("float", "time_monotonic_s")]

_TRACKER = Column("tracker", "tracker", "text")

# The files' columns, in order. They are an interface to the users' own programs: add at the end, rename nothing.
COLUMNS: dict[type[Row], tuple[str, list[Column]]] = {
    Scan: (
        "scans",
        [
            *_TIMES,
            *_columns_like_fields("text", "source", "session"),
            Column("sequence", "sequence", "int"),
            Column("simulated", "simulated", "bool"),
            *[
                column
                for face in FACES
                for column in (
                    Column(f"{face}_w_m2", f"{face}.irradiance_w_m2", "float"),
                    Column(f"{face}_quality", f"{face}.quality", "text"),
                    Column(f"{face}_time", f"{face}.time_utc_s", "time"),
                )
            ],
            Column("calibration", "calibration", "text"),
        ],
    ),
    Decision: (
        "decisions",
        [
            *_TIMES,
            *_columns_like_fields("text", "mode", "law"),
            *[Column(f"{face}_w_m2", f"irradiances.{face}_w_m2", "float") for face in FACES],
            Column("coverage", "irradiances.coverage", "float"),
            *_columns_like_fields("float", "direction_azimuth_deg", "direction_elevation_deg"),
            *_columns_like_fields("float", "sun_azimuth_deg", "sun_elevation_deg"),
            Column("target_a_deg", "target.a_deg", "float"),
            Column("target_b_deg", "target.b_deg", "float"),
            Column("moved", "moved", "bool"),
            Column("why", "target.why", "text"),
            Column("dni_est", "estimate.dni_w_m2", "float"),
            Column("dhi_est", "estimate.dhi_w_m2", "float"),
            Column("albedo_est", "estimate.albedo", "float"),
            _TRACKER,
        ],
    ),
    Move: (
        "moves",
        [
            *_TIMES,
            *_columns_like_fields("float", "duration_s", "from_a_deg", "from_b_deg", "target_a_deg", "target_b_deg"),
            *_columns_like_fields("float", "end_a_deg", "end_b_deg"),
            *_columns_like_fields("text", "outcome", "why"),
            _TRACKER,
        ],
    ),
    Pose: (
        "poses",
        [
            *_TIMES,
            *_columns_like_fields("float", "a_deg", "b_deg"),
            Column("moving", "moving", "bool"),
            _TRACKER,
            *_columns_like_fields("float", "wind_m_s"),
        ],
    ),
    ModeChange: ("modes", [*_TIMES, *_columns_like_fields("text", "before", "after", "why"), _TRACKER]),
    Event: ("events", [*_TIMES, *_columns_like_fields("text", "subject", "text"), _TRACKER]),
    IvCurve: (
        "curves",
        [
            *_TIMES,
            *_columns_like_fields(
                "float", "duration_s", "pmpp_w", "pmpp_sigma_w", "vmpp_v", "impp_a", "voc_v", "isc_a"
            ),
            *_columns_like_fields("float", "zenith_start_w_m2", "zenith_end_w_m2"),
            Column("points", "points", "int"),
            *_columns_like_fields("text", "quality", "why", "curve"),
            _TRACKER,
        ],
    ),
}


def with_irradiances(record: Row) -> Row:
    """Return a decision without irradiances with NaN in their places; any other record as it is."""
    if isinstance(record, Decision) and record.irradiances is None:
        return replace(record, irradiances=_NO_IRRADIANCES)
    return record


def check_tables(
    directory: Path,
    table_format: Format,
    columns: Mapping[type[Row], tuple[str, list[Column]]] = COLUMNS,
    *,
    force: bool,
) -> None:
    """Raise `UserError`, before the work, for tables that a `TableWriter` could not write or would overwrite."""
    check_outputs([directory / f"{name}.{table_format}" for name, _ in columns.values()], "--out", force=force)


class TableWriter:
    """Takes records as they come and writes each kind to a table of its own.

    ``scans``, ``decisions``, ``moves``, ``poses``, ``modes``, ``events`` and ``curves``, in CSV with ISO 8601 times
    and empty cells for what is not a number, or in Parquet with timestamps and nulls. Until `close` the files bear the
    ending ``.part``; leaving the ``with`` block by an exception removes them.

    Parameters
    ----------
    directory
        Made if it is missing.
    format
        ``csv`` or ``parquet``, also the files' ending.
    columns
        Which kinds of records there are, with the name of their table and its columns.
    force
        Whether tables that are there are replaced, at the end.

    Raises
    ------
    UserError
        When a table is already there, or the directory cannot be written to.
    """

    def __init__(
        self,
        directory: Path,
        format: Format = "csv",  # noqa: A002 - the users' own word for it
        columns: Mapping[type[Row], tuple[str, list[Column]]] = COLUMNS,
        *,
        force: bool = False,
    ) -> None:
        self._directory = directory
        self._is_new_directory = not directory.exists()
        check_tables(directory, format, columns, force=force)
        self._tables: dict[type[Row], _Table] = {}
        make: Callable[[Path, list[Column]], _Table] = _CsvTable if format == "csv" else _ParquetTable
        try:
            directory.mkdir(parents=True, exist_ok=True)
            for kind, (name, its_columns) in columns.items():
                self._tables[kind] = make(directory / f"{name}.{format}", its_columns)
        except OSError as error:
            self.discard()
            raise self._write_error(error) from None

    def write(self, record: Row) -> None:
        """Append one record to the table of its kind; raises `TableError` where the disk does not take it."""
        try:
            self._tables[type(record)].append(with_irradiances(record))
        except OSError as error:
            raise self._write_error(error) from None

    def close(self) -> None:
        """Finish all tables and give them their names; raises `TableError`, and leaves nothing. May be called again."""
        try:
            for table in self._tables.values():
                table.finish()
        except OSError as error:
            self.discard()
            raise self._write_error(error) from None
        tables, self._tables = self._tables, {}
        for table in tables.values():
            table.part.replace(table.path)

    def discard(self) -> None:
        """Remove what was written, and the directory if it was made for it and is empty."""
        tables, self._tables = self._tables, {}
        for table in tables.values():
            # On a full disk a table cannot even be finished, and it is not wanted anyway.
            with contextlib.suppress(Exception):
                table.finish()
            table.part.unlink(missing_ok=True)
        if self._is_new_directory and self._directory.is_dir() and not any(self._directory.iterdir()):
            self._directory.rmdir()

    def _write_error(self, error: OSError) -> TableError:
        return TableError(f"{self._directory} cannot take the results: {error.strerror}")

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        if kind is None:
            self.close()
        else:
            self.discard()


class _Table(Protocol):
    path: Path
    part: Path

    def append(self, record: Row) -> None: ...

    def finish(self) -> None: ...


class _CsvTable:
    def __init__(self, path: Path, columns: list[Column]) -> None:
        self.path, self.part = path, _part(path)
        self._values = _values_of(columns)
        # The CSV writer itself writes counts and texts as they are, and nothing for None.
        self._texts = [(place, _TEXT[column.holds]) for place, column in enumerate(columns) if column.holds in _TEXT]
        self._file = self.part.open("w", newline="", encoding="utf-8", buffering=_BUFFER_BYTES)
        self._writer = csv.writer(self._file, lineterminator="\n")
        self._writer.writerow([column.name for column in columns])

    def append(self, record: Row) -> None:
        cells = list(self._values(record))
        for place, text in self._texts:
            cells[place] = text(cells[place])
        self._writer.writerow(cells)

    def finish(self) -> None:
        self._file.close()


class _ParquetTable:
    def __init__(self, path: Path, columns: list[Column]) -> None:
        import pyarrow as pa  # noqa: PLC0415 - half a second that CSV has no use for
        from pyarrow import parquet  # noqa: PLC0415 - as above

        self.path, self.part = path, _part(path)
        self._columns = columns
        self._values = _values_of(columns)
        types = {
            "time": pa.timestamp("us", tz="UTC"),
            "float": pa.float64(),
            "int": pa.int64(),
            "bool": pa.bool_(),
            "text": pa.string(),
        }
        fields = [(column.name, types[column.holds]) for column in columns]
        # pandas finds here that the times are the index.
        empty = pa.schema(fields).empty_table().to_pandas().set_index(columns[0].name)
        self._schema = pa.schema(fields, metadata=pa.Schema.from_pandas(empty).metadata)
        self._rows: list[tuple[Any, ...]] = []
        self._writer = parquet.ParquetWriter(self.part, self._schema)
        self._array, self._table = pa.array, pa.Table

    def append(self, record: Row) -> None:
        self._rows.append(self._values(record))
        if len(self._rows) >= _ROWS_PER_GROUP:
            self._flush()

    def finish(self) -> None:
        try:
            self._flush()
        finally:
            self._writer.close()

    def _flush(self) -> None:
        if not self._rows:
            return
        arrays = []
        for column, field, values in zip(self._columns, self._schema, zip(*self._rows, strict=True), strict=True):
            held = [_microseconds(time_s) for time_s in values] if column.holds == "time" else values
            arrays.append(self._array(held, type=field.type, from_pandas=True))
        self._writer.write_table(self._table.from_arrays(arrays, schema=self._schema))
        self._rows.clear()


def _values_of(columns: list[Column]) -> Callable[[Row], tuple[Any, ...]]:
    """Return a function that takes a record's values for its columns, in their order."""
    told = attrgetter(*[column.path for column in columns if column.constant_value is None])
    constant_value = tuple(column.constant_value for column in columns if column.constant_value is not None)
    return (lambda record: (*told(record), *constant_value)) if constant_value else told


def _part(path: Path) -> Path:
    return path.with_name(path.name + ".part")


def _microseconds(time_s: float | None) -> int | None:
    return None if time_s is None else round(time_s * 1e6)


def _time(time_s: float | None) -> str:
    # An archive or a salvaged store may have no time for a face.
    return "" if time_s is None else iso_utc(time_s)


def _number(value: float) -> float | str:
    # Adding 0.0 makes 0.0 of -0.0.
    return "" if value != value else value + 0.0


def _truth(value: bool) -> str:
    return "true" if value else "false"


_TEXT: dict[str, Callable[[Any], object]] = {
    "time": _time,
    "float": _number,
    "bool": _truth,
}
