"""Readings for a calibration, from CSV or from the store of the service."""

import csv
import sqlite3
import zlib
from collections.abc import Sequence
from contextlib import closing
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
import pandas as pd

from daemon.base.clock import iso_utc
from daemon.base.errors import UserError
from daemon.base.records import FACES
from daemon.store.schema import FILE_NAME, columns_of, open_for_reading
from daemon.studies.inputs import check_frame, check_table, impossible_note, not_utf8_error
from daemon.studies.recorded import stored_faces
from solar.frames import Array
from solar.irradiance import HIGHEST_W_M2, LOWEST_W_M2
from solar.tables import (
    MISSING_VALUES,
    broken_line,
    read_error_text,
    second_header_hint,
    summer_time_hint,
    unreadable,
    utc_times,
    zone_note,
)

_MV, _W_M2 = "_mv", "_w_m2"
_REFERENCE_NAMES = ("ghi", "ghi_w_m2")
# Largest voltage of a sensor, of either sign: at a gain of 10 W/m2/mV it means four times what the sun can give.
_LARGEST_MV = 1000.0
_ANY_SIMULATED_SQL = "SELECT MAX(simulated) FROM runs WHERE run IN (SELECT run FROM scans WHERE time >= ? AND time < ?)"


@dataclass(frozen=True, slots=True)
class FaceReadings:
    """Readings of the four faces.

    Attributes
    ----------
    source
        The name that messages give them.
    utc_s, faces
        Increasing instants [s], shape (n,), and readings, shape (n, 4); NaN where no reading can be trusted.
    in_mv
        Whether they are voltages [mV]; else irradiances [W/m2] made with some earlier gains.
    calibrations
        Identifiers of the calibrations that irradiances were made with; empty for the gains of the settings.
    note
        What a person should know of the times, and of impossible numbers, which count as missing; may be empty.
    simulated
        Whether any of them comes from a model or a bench.
    """

    source: str
    utc_s: Array
    faces: Array
    in_mv: bool
    calibrations: frozenset[str]
    note: str = ""
    simulated: bool = False


@dataclass(frozen=True, slots=True)
class ReferenceReadings:
    """Global horizontal irradiance by a reference pyranometer, shape (n,) each, without NaN. As in `FaceReadings`."""

    source: str
    utc_s: Array
    ghi_w_m2: Array
    note: str
    simulated: bool


def read_reference(path: Path) -> ReferenceReadings:
    """Read a CSV with the columns time and ghi; raises `UserError` that names the file, the line and the cell."""
    frame, utc_s, told = _table(path, "time and ghi")
    name = next((name for name in _REFERENCE_NAMES if name in frame), None)
    if name is None:
        raise UserError(f"{path} has no column ghi; found: {', '.join(map(str, frame.columns))}")
    ghi, wrong = _possible_values(path, frame, [name])
    note = "; ".join(filter(None, (told, wrong)))
    there = np.isfinite(ghi[:, 0])
    if not there.any():
        raise UserError(f"{path} has no reading in its column {name}" + (f": {note}" if note else ""))
    return ReferenceReadings(
        source=str(path), utc_s=utc_s[there], ghi_w_m2=ghi[there, 0], note=note, simulated=_simulated(frame)
    )


def read_csv(path: Path) -> FaceReadings:
    """Read a CSV with time and either east_mv .. zenith_mv or east_w_m2 .. zenith_w_m2.

    Tables of `heliocube export` and `heliocube simulate` are such files: a face whose quality is not ok has no
    reading.
    Raises `UserError` that names the file, the line and the cell.
    """
    wanted = ", ".join(face + _MV for face in FACES)
    frame, utc_s, told = _table(path, f"time, {wanted}")
    for ending in (_MV, _W_M2):
        names = [face + ending for face in FACES]
        if set(names) <= set(frame.columns):
            break
    else:
        raise UserError(
            f"{path} needs the columns {wanted}, or the same ending in {_W_M2}; found: "
            f"{', '.join(map(str, frame.columns))}"
        )
    for face, name in zip(FACES, names, strict=True):
        if f"{face}_quality" in frame:
            frame[name] = frame[name].where(frame[f"{face}_quality"] == "ok", "")
    faces, wrong = _possible_values(path, frame, names)
    made_with = frozenset(frame["calibration"]) if "calibration" in frame else frozenset({""})
    return FaceReadings(
        source=str(path),
        utc_s=utc_s,
        faces=faces,
        in_mv=ending == _MV,
        calibrations=made_with,
        note="; ".join(filter(None, (told, wrong))),
        simulated=_simulated(frame),
    )


def read_store(directory: Path, start: datetime | None, end: datetime | None) -> FaceReadings:
    """Read the scans that a store holds from `start` up to `end`; raises `UserError` without any."""
    low = -np.inf if start is None else start.timestamp()
    high = np.inf if end is None else end.timestamp()
    path = directory / FILE_NAME
    with closing(open_for_reading(path)) as connection:
        known = "COALESCE(calibration, '')" if "calibration" in columns_of(connection, "scans") else "''"
        span = "FROM scans WHERE time >= ? AND time < ?"
        try:
            utc_s, faces = stored_faces(connection, low, high)
            made_with = connection.execute(f"SELECT DISTINCT {known} {span}", (low, high)).fetchall()
            simulated = bool(connection.execute(_ANY_SIMULATED_SQL, (low, high)).fetchone()[0])
        except sqlite3.Error as error:
            raise UserError(f"the store {path} cannot be read: {error}") from None
    if not utc_s.size:
        raise UserError(f"the store {path} has no scans in that time; see --from and --to")
    return FaceReadings(
        source=f"the store {path}",
        utc_s=utc_s,
        faces=faces,
        in_mv=False,
        calibrations=frozenset(row[0] for row in made_with),
        simulated=simulated,
    )


def span_text(utc_s: Array) -> str:
    """Return first and last instant for a message."""
    return f"{iso_utc(float(utc_s[0]))[:16]}Z to {iso_utc(float(utc_s[-1]))[:16]}Z"


def _table(path: Path, columns: str) -> tuple[pd.DataFrame, Array, str]:
    """Return a table's rows, their instants [s UTC], and a note on these for people, which may be empty.

    The error for an empty file names `columns` as those that it should have.
    """
    separator = check_table(path)
    try:
        frame = pd.read_csv(
            path, sep=separator, dtype=str, keep_default_na=False, encoding="utf-8-sig", skipinitialspace=True
        )
        broken = broken_line(path, separator)
    except FileNotFoundError:
        raise UserError(f"there is no file at {path}") from None
    except pd.errors.EmptyDataError:
        raise UserError(f"{path} is empty: name a CSV file with the columns {columns}") from None
    except UnicodeDecodeError:
        raise not_utf8_error(path) from None
    except pd.errors.ParserError as error:
        raise UserError(unreadable(path, separator, error)) from None
    except (OSError, EOFError, zlib.error, ValueError) as error:
        raise UserError(f"{path} cannot be read: {read_error_text(error)}") from None
    frame.columns = pd.Index([str(name).strip().lower() for name in frame.columns])
    if "time" not in frame:
        raise UserError(f"{path} has no column time; found: {', '.join(map(str, frame.columns))}")
    check_frame(path, frame)
    frame = frame[: -1 if broken else None]
    frame = frame[(frame != "").any(axis=1)]
    if separator == ";":
        frame = frame.replace(",", ".", regex=True)
    if frame.empty:
        raise UserError(f"{path} has a header and no data: name a file with readings below it")
    times = utc_times(frame["time"])
    bad = np.flatnonzero(times.isna())
    if bad.size:
        line, text = _line_of(path, bad[0]), frame["time"].iloc[bad[0]]
        hint = second_header_hint(text, int(bad[0]))
        raise UserError(f"{path}, line {line}: '{text}' is not a time such as 2022-03-01T12:00:00Z{hint}")
    utc_s = np.array([time.replace(tzinfo=UTC).timestamp() for time in times.dt.tz_localize(None)], dtype=np.float64)
    back = np.flatnonzero(np.diff(utc_s) <= 0.0)
    if back.size:
        row = int(back[0]) + 1
        remedy = summer_time_hint(frame["time"].iloc[row], utc_s[: row + 1].tolist()) or "; sort the file"
        raise UserError(f"{path}, line {_line_of(path, row)}: the time does not come after the one before{remedy}")
    told = [zone_note(frame["time"]), broken.note() if broken else ""]
    return frame, utc_s, "; ".join(f"{path}: {note}" for note in told if note)


def _simulated(frame: pd.DataFrame) -> bool:
    return "simulated" in frame and bool((frame["simulated"].str.strip().str.lower() == "true").any())


def _line_of(path: Path, row: int) -> int:
    """Return the number of a row's line in the file; lines of blanks and commas alone are no rows."""
    lines = pd.read_csv(
        path,
        sep="\0",
        names=["text"],
        dtype=str,
        keep_default_na=False,
        encoding="utf-8-sig",
        quoting=csv.QUOTE_NONE,
        skip_blank_lines=False,
    )
    # The first one is the header.
    return int(np.flatnonzero(lines["text"].str.strip(" \t,;") != "")[row + 1]) + 1


def _possible_values(path: Path, frame: pd.DataFrame, names: Sequence[str]) -> tuple[Array, str]:
    """Return columns of one unit, NaN where a number is missing or impossible, and a note on impossible ones."""
    numbers = np.stack([_numbers(path, frame[name]) for name in names], axis=-1)
    low, high = (-_LARGEST_MV, _LARGEST_MV) if names[0].endswith(_MV) else (LOWEST_W_M2, HIGHEST_W_M2)
    wrong = (numbers < low) | (numbers > high)
    if not wrong.any():
        return numbers, ""
    row, column = np.argwhere(wrong)[0].tolist()
    first = f"in line {_line_of(path, row)}: {names[column]} {numbers[row, column]:g}, not in {low:g}..{high:g}"
    return np.where(wrong, np.nan, numbers), impossible_note(str(path), int(wrong.sum()), first)


def _numbers(path: Path, column: "pd.Series[str]") -> Array:
    text = column.str.strip()
    missing = text.str.lower().isin(MISSING_VALUES).to_numpy()
    numbers = pd.to_numeric(text.mask(missing, ""), errors="coerce").to_numpy(dtype=np.float64)
    bad = np.flatnonzero(~missing & ~np.isfinite(numbers))
    if bad.size:
        raise UserError(
            f"{path}, line {_line_of(path, bad[0])}: {column.name} is '{column.iloc[bad[0]]}', not a number; leave the "
            "cell empty where the value is missing"
        )
    return numbers
