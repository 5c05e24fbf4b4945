"""From the store to tables: a span of time, one file per kind of record, with pvlib's names where it has them."""

import math
import sqlite3
from collections import namedtuple
from collections.abc import Collection
from contextlib import closing
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from daemon.base.clock import iso_utc
from daemon.base.errors import UserError
from daemon.store.runs import require_records
from daemon.store.schema import FILE_NAME, columns_of, open_for_reading, tracker_sql, unreadable_store_error
from daemon.store.tables import COLUMNS, Column, Format, Row, TableWriter
from solar.frames import azimuth_from_direction, normal_from_angles

KINDS = tuple(name for name, _ in COLUMNS.values())

_ROWS_AT_ONCE = 4096


def _float_columns(*names: str) -> list[Column]:
    return [Column(name, name, "float") for name in names]


# These columns follow those of the tables: the same quantities as pvlib names them, then the run they come from.
_PVLIB = {
    "scans": _float_columns("ghi"),
    "decisions": _float_columns("solar_azimuth", "apparent_elevation", "apparent_zenith"),
    "poses": _float_columns("surface_tilt", "surface_azimuth"),
}
_RUN = [Column("run", "run", "int")]
_SIMULATED = [Column("simulated", "simulated", "bool")]
_TRACKER = [Column("tracker", "tracker", "text")]


@dataclass(frozen=True, slots=True)
class Exported:
    """What was written: the rows of each kind, and whether simulated instruments are behind any of them."""

    rows: dict[str, int]
    simulated: bool


def export(
    directory: Path,
    out: Path,
    table_format: Format,
    start: datetime | None,
    end: datetime | None,
    kinds: Collection[str],
    *,
    force: bool = False,
    needs_records: bool = False,
) -> Exported:
    """Write what the store in `directory` holds from `start` up to, not including, `end`, and return what that was.

    Rows are in the order of their time, then of run and number. The service may go on writing meanwhile.

    Parameters
    ----------
    directory
        Folder of the store.
    out
        Folder of the tables, made if it is missing.
    table_format
        ``csv`` or ``parquet``; in Parquet the UTC times are the index that pandas gives its frame.
    start, end
        With their time zone; None is as far as the store goes.
    kinds
        Of `KINDS`; an empty one means all.
    force
        Whether tables that are there are replaced.
    needs_records
        Whether a span without a record of any kind is refused, before anything is written.

    Raises
    ------
    UserError
        The span is empty or ends before it begins, or has no record; there is no store; the tables cannot be written.
    """
    if start is not None and end is not None and start >= end:
        raise UserError(f"the first instant {_text(start)} is not before the end {_text(end)}: exchange them")
    span = -math.inf if start is None else start.timestamp(), math.inf if end is None else end.timestamp()
    if needs_records:
        require_records(directory / FILE_NAME, *span)
    chosen = [name for name in KINDS if name in kinds or not kinds]
    with closing(open_for_reading(directory / FILE_NAME)) as connection:
        try:
            # One transaction: all kinds as they were at one instant.
            connection.execute("BEGIN")
            tables = {name: _Table(name) for name in chosen}
            columns: dict[type[Row], tuple[str, list[Column]]]
            columns = {table.row: (table.name, table.columns) for table in tables.values()}
            with TableWriter(out, table_format, columns, force=force) as writer:
                rows = {name: table.copy(connection, writer, span) for name, table in tables.items()}
                return Exported(rows, any(table.simulated for table in tables.values()))
        except sqlite3.Error as error:
            raise unreadable_store_error(directory / FILE_NAME, error) from None


class _Table:
    """One kind of record on its way from the store to a file."""

    def __init__(self, name: str) -> None:
        own = [column for column in dict(COLUMNS.values())[name] if column not in _TRACKER]
        self.name = name
        self.simulated = False
        self._stored = [column.name for column in own]
        simulated = [] if "simulated" in self._stored else _SIMULATED
        columns = [*own, *_PVLIB.get(name, []), *_RUN, *simulated, *_TRACKER]
        self.columns = [Column(column.name, column.name, column.holds) for column in columns]
        self.row = namedtuple(name, [column.name for column in self.columns])  # type: ignore[misc]  # made at run time
        self._floats = [place for place, column in enumerate(own) if column.holds == "float"]
        self._texts = [place for place, column in enumerate(own) if column.holds == "text"]
        self._truths = [place for place, column in enumerate(own) if column.holds == "bool"]

    def copy(self, connection: sqlite3.Connection, writer: TableWriter, span_utc_s: tuple[float, float]) -> int:
        there = columns_of(connection, self.name)
        if not there:
            return 0
        names = ", ".join(f"kept.{name}" if name in there else "NULL" for name in self._stored)
        tracker = tracker_sql(connection, self.name, "kept")
        query = (
            f"SELECT {names}, kept.run, runs.simulated, {tracker}, runs.latitude_deg FROM {self.name} AS kept "  # noqa: S608 - our own names
            "JOIN runs USING (run) WHERE kept.time >= ? AND kept.time < ? ORDER BY kept.time, kept.run, kept.number"
        )
        cursor = connection.execute(query, span_utc_s)
        own = self._stored.index("simulated") if "simulated" in self._stored else None
        count = 0
        while rows := cursor.fetchmany(_ROWS_AT_ONCE):
            derived = _pvlib_values(self.name, self._stored, rows)
            for (*values, run, simulated, name, _), more in zip(rows, derived, strict=True):
                for place in self._floats:
                    if values[place] is None:
                        values[place] = math.nan
                for place in self._texts:
                    values[place] = values[place] or ""
                for place in self._truths:
                    values[place] = bool(values[place])
                tail = [run, name] if own is not None else [run, bool(simulated), name]
                self.simulated |= bool(simulated if own is None else values[own])
                writer.write(self.row(*values, *more, *tail))
            count += len(rows)
        return count


def _pvlib_values(name: str, stored: list[str], rows: list[tuple[Any, ...]]) -> list[tuple[float, ...]]:
    """Return each row's values in the columns with pvlib's names."""

    def column(wanted: str) -> list[Any]:
        return [row[stored.index(wanted)] for row in rows]

    if name == "scans":
        pairs = zip(column("zenith_w_m2"), column("zenith_quality"), strict=True)
        return [(value if value is not None and quality == "ok" else math.nan,) for value, quality in pairs]
    if name == "decisions":
        azimuth, elevation = (np.array(column(f"sun_{angle}_deg"), float) for angle in ("azimuth", "elevation"))
        return _by_row(azimuth, elevation, 90.0 - elevation)
    if name == "poses":
        normals = normal_from_angles(np.array(column("a_deg"), float), np.array(column("b_deg"), float))
        north = np.array([row[-1] for row in rows]) >= 0
        (azimuth_north, elevation), (azimuth_south, _) = (azimuth_from_direction(normals, sign) for sign in (1.0, -1.0))
        return _by_row(90.0 - elevation, np.where(north, azimuth_north, azimuth_south))
    return [()] * len(rows)


def _by_row(*columns: NDArray[np.float64]) -> list[tuple[float, ...]]:
    return list(zip(*[column.tolist() for column in columns], strict=True))


def _text(instant: datetime) -> str:
    return iso_utc(instant.astimezone(UTC).timestamp())
