"""Recorded readings of a cube: from a CSV file, or from the store that the service keeps."""

import math
import sqlite3
import zlib
from array import array
from collections.abc import Iterator
from contextlib import closing
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import TextIO

import numpy as np

from daemon.base.errors import UserError
from daemon.base.records import FACES, Quality
from daemon.store.schema import FILE_NAME, open_for_reading
from daemon.studies.inputs import check_table, check_unique_columns, not_utf8_error, with_decimal_point
from drivers.numbers import read_number
from solar.ephemeris import Site
from solar.frames import Array
from solar.irradiance import HIGHEST_W_M2, LOWEST_W_M2, kilowatts_note
from solar.tables import (
    MISSING_VALUES,
    BrokenLine,
    CellError,
    broken_line,
    numbered_rows,
    open_table,
    read_error_text,
    second_header_hint,
    summer_time_hint,
    zone_note,
)

COLUMNS = ("time", *FACES)
_ROWS_AT_ONCE = 50_000
# A logger writes these for a value above or below its range. They count as numbers that no face can read.
_OUT_OF_RANGE = frozenset({"inf", "+inf", "-inf"})
_GOOD_READINGS_SQL = ", ".join(f"CASE {face}_quality WHEN '{Quality.OK}' THEN {face}_w_m2 END" for face in FACES)
_SCANS = f"SELECT time, {_GOOD_READINGS_SQL} FROM scans WHERE time >= ? AND time < ? ORDER BY time"  # noqa: S608 - our own names


@dataclass(frozen=True, slots=True)
class RecordedScan:
    """One line of the file: UTC [s since 1970] and east, south, west, zenith [W/m2], NaN where the cell is empty."""

    time_utc_s: float
    irradiances_w_m2: tuple[float, float, float, float]


@dataclass(frozen=True, slots=True, eq=False)
class RecordedScans:
    """All rows in two arrays, 40 bytes a row: five numbers as Python objects would take six times as much.

    Attributes
    ----------
    utc_s
        In rising time [s since 1970], shape (n,).
    faces_w_m2
        East, south, west, zenith [W/m2], shape (n, 4), NaN where there is no reading.
    """

    utc_s: Array
    faces_w_m2: Array

    def __len__(self) -> int:
        return len(self.utc_s)

    def __iter__(self) -> Iterator[RecordedScan]:
        for first in range(0, len(self), _ROWS_AT_ONCE):
            some = slice(first, first + _ROWS_AT_ONCE)
            for at, (east, south, west, zenith) in zip(
                self.utc_s[some].tolist(), self.faces_w_m2[some].tolist(), strict=True
            ):
                yield RecordedScan(at, (east, south, west, zenith))


@dataclass(frozen=True, slots=True)
class Recording:
    """The rows of a file, and what is missing in them.

    Attributes
    ----------
    rows
        In rising time.
    missing
        Readings that are not there: empty cells and `impossible` ones.
    impossible
        Numbers that no face can read, taken as missing.
    first_impossible
        Where the first of them stands, and its text; empty without any.
    broken
        The last line, if the file breaks off in it; it is not among the rows.
    zone_note
        A sentence on how times without a zone were taken; empty where each time names its zone.
    """

    rows: RecordedScans
    missing: int
    impossible: int
    first_impossible: str
    broken: BrokenLine | None = None
    zone_note: str = ""

    def notes(self) -> list[str]:
        """Return what a person should know of the times and the missing readings, a sentence each."""
        found = [self.zone_note] if self.zone_note else []
        if self.broken:
            found.append(self.broken.note())
        if self.missing:
            found.append(f"{self.missing} of {len(FACES) * len(self.rows)} readings are missing")
        if self.impossible:
            found.append(
                f"{self.impossible} of the missing readings are numbers outside {LOWEST_W_M2:g}..{HIGHEST_W_M2:g} W/m2,"
                f" the first at {self.first_impossible}"
            )
        return found


def read_csv(path: Path) -> Recording:
    """Return the rows of a CSV file, plain or ``.gz``, with the columns time, east, south, west and zenith.

    ``time`` is ISO 8601, UTC where it names no zone, and rises from line to line. An empty cell, ``NaN``, ``NA``,
    ``N/A``, ``null`` or a number that no face can read means that the face has no reading. Other columns are ignored,
    and so are rows of empty cells, and a last line in which the file breaks off.

    Raises
    ------
    UserError
        One sentence with the file, the line, the value and what is expected.
    """
    separator = check_table(path)
    impossible: list[str] = []
    unzoned: list[str] = []
    try:
        with open_table(path) as file:
            broken = broken_line(path, separator)
            cells = array("d")
            for row in _rows(path, file, separator, impossible, unzoned, broken):
                cells.append(row.time_utc_s)
                cells.extend(row.irradiances_w_m2)
    except FileNotFoundError:
        raise UserError(f"{path} does not exist: name a CSV file with the columns {','.join(COLUMNS)}") from None
    except (OSError, EOFError, zlib.error) as error:
        raise UserError(f"{path} cannot be read: {read_error_text(error)}") from None
    except UnicodeDecodeError:
        raise not_utf8_error(path) from None
    except CellError as error:
        raise UserError(f"{path}, {error}") from None
    if not cells:
        raise UserError(f"{path} has no readings below its header: name a file that has some")
    table = np.frombuffer(cells).reshape(-1, 1 + len(FACES))
    rows = RecordedScans(table[:, 0], table[:, 1:])
    return Recording(
        rows=rows,
        missing=int(np.isnan(rows.faces_w_m2).sum()),
        impossible=len(impossible),
        first_impossible=impossible[0] if impossible else "",
        broken=broken,
        zone_note=zone_note(unzoned),
    )


def unit_note(name: str, rows: RecordedScans, site: Site) -> str | None:
    """Return a sentence if the readings of the source `name` look like kW/m2, else None."""
    highest_w_m2 = float(np.fmax.reduce(rows.faces_w_m2, axis=None, initial=np.nan))
    return kilowatts_note(name, "on any face", highest_w_m2, rows.utc_s, site)


def rows_of_store(directory: Path) -> RecordedScans:
    """Return the scans that the store in `directory` holds; only good readings count. Raises `UserError`."""
    path = directory / FILE_NAME
    with closing(open_for_reading(path)) as connection:
        try:
            utc_s, faces = stored_faces(connection)
        except sqlite3.Error as error:
            raise UserError(f"the store {path} cannot be read: {error}") from None
    if not utc_s.size:
        raise UserError(f"the store {path} holds no scans: a tracker's store has those that came over the bridge")
    return RecordedScans(utc_s, faces)


def stored_faces(
    connection: sqlite3.Connection, start_utc_s: float = -math.inf, end_utc_s: float = math.inf
) -> tuple[Array, Array]:
    """Return the scans of an open store from `start_utc_s` up to `end_utc_s`, the first of each instant.

    The instants [s], shape (n,), are increasing; the readings [W/m2], shape (n, 4), are east, south, west and zenith,
    NaN where one is not good. Raises `sqlite3.Error`.
    """
    cursor = connection.execute(_SCANS, (start_utc_s, end_utc_s))
    tables = [np.empty((0, 1 + len(FACES)))]
    while rows := cursor.fetchmany(_ROWS_AT_ONCE):
        tables.append(np.array(rows, dtype=np.float64))
    table = np.concatenate(tables)
    utc_s, first = np.unique(table[:, 0], return_index=True)
    return utc_s, table[first, 1:]


def _rows(
    path: Path, file: TextIO, separator: str, impossible: list[str], unzoned: list[str], broken: BrokenLine | None
) -> Iterator[RecordedScan]:
    rows = numbered_rows(file, separator)
    first = next(rows, None)
    if first is None:
        raise UserError(f"{path} is empty: name a CSV file with the columns {','.join(COLUMNS)}")
    header = [name.strip().lower() for name in first[1]]
    missing = [name for name in COLUMNS if name not in header]
    if missing:
        raise UserError(f"{path}, line 1: the column {missing[0]} is missing; the header must name {','.join(COLUMNS)}")
    check_unique_columns(f"{path}, line 1", header, COLUMNS)
    places = [header.index(name) for name in COLUMNS]
    before: list[float] = []
    for line, given in rows:
        if not any(cell.strip() for cell in given) or (broken and line == broken.number):
            continue
        cells = given if separator == "," else [with_decimal_point(cell, separator) for cell in given]
        try:
            row = _row(cells, len(header), places, before)
        except ValueError as error:
            raise UserError(f"{path}, line {line}: {error}") from None
        before = [*before[-1:], row.time_utc_s]
        if not unzoned and zone_note([cells[places[0]]]):
            unzoned.append(cells[places[0]])
        for name, place, value in zip(FACES, places[1:], row.irradiances_w_m2, strict=True):
            if not (LOWEST_W_M2 <= value <= HIGHEST_W_M2 or math.isnan(value)):
                impossible.append(f"line {line}: {name} {cells[place].strip()}")
        yield row if not impossible else _without_impossible(row)


def _row(cells: list[str], width: int, places: list[int], before: list[float]) -> RecordedScan:
    if len(cells) != width:
        raise ValueError(f"there are {len(cells)} cells where the header has {width}")
    stamp, *values = [cells[place].strip() for place in places]
    time_utc_s = _utc(stamp, len(before))
    if before and not (time_utc_s > before[-1]):
        hint = summer_time_hint(stamp, [*before, time_utc_s])
        raise ValueError(f"the time {stamp} is not later than that of the line before{hint}")
    east, south, west, zenith = map(_irradiance, FACES, values)
    return RecordedScan(time_utc_s, (east, south, west, zenith))


def _utc(text: str, row: int) -> float:
    try:
        instant = datetime.fromisoformat(text)
        return (instant if instant.tzinfo else instant.replace(tzinfo=UTC)).timestamp()
    except (ValueError, OverflowError):
        hint = second_header_hint(text, row)
        raise ValueError(f"the time {text!r} is not ISO 8601, such as 2022-10-14T10:20:05Z{hint}") from None


def _irradiance(name: str, text: str) -> float:
    if text.lower() in MISSING_VALUES:
        return math.nan
    if text.lower() in _OUT_OF_RANGE:
        return math.inf
    try:
        return read_number(text)
    except ValueError:
        raise ValueError(f"{name} is {text!r}, not a number of W/m2; leave the cell empty without a reading") from None


def _without_impossible(row: RecordedScan) -> RecordedScan:
    """Return the row without the numbers that no face can read."""
    east, south, west, zenith = (
        value if LOWEST_W_M2 <= value <= HIGHEST_W_M2 else math.nan for value in row.irradiances_w_m2
    )
    return RecordedScan(row.time_utc_s, (east, south, west, zenith))
