"""Powers of two trackers, instant by instant: read from tables or a simulation, and joined in pairs."""

import zlib
from collections.abc import Sequence
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from daemon.base.clock import iso_utc
from daemon.base.errors import UserError
from daemon.studies.compare.measurements import OPTIONAL, REQUIRED, SIMULATED, Measurement
from daemon.studies.inputs import check_frame, check_table, impossible_note, not_utf8_error
from solar.frames import Array
from solar.irradiance import HIGHEST_W_M2, LOWEST_W_M2, is_possible
from solar.tables import broken_line, read_error_text, unreadable, utc_times, zone_note

TOGETHER_WITHIN_S = 5.0
_NUMBERS = ("pmpp_w", *OPTIONAL)
_IRRADIANCES = tuple(name for name in OPTIONAL if name.endswith("_w_m2"))
_COLUMNS = (*REQUIRED, *OPTIONAL, SIMULATED)
_POWER_W = (-5.0, 2000.0)


@dataclass(frozen=True, slots=True)
class TrackerSeries:
    """One tracker's values, arrays of shape (n,); NaN for unknown. As in :class:`Measurement`."""

    pmpp_w: Array
    irradiance_w_m2: Array
    a_deg: Array
    b_deg: Array
    module_temp_degc: Array

    def select(self, chosen: NDArray[np.bool_]) -> "TrackerSeries":
        """Return some of the measurements."""
        return TrackerSeries(*(getattr(self, field.name)[chosen] for field in fields(TrackerSeries)))


@dataclass(frozen=True, slots=True)
class Pairs:
    """Measurements of both trackers that belong together, in the order of time, shape (n,), n > 0.

    Attributes
    ----------
    names
        Names of the two trackers.
    utc_s
        Instants of the first tracker's measurements.
    cube, chrono
        The first tracker and the one it is compared with.
    diffuse_fraction
        DHI/GHI; NaN for unknown.
    simulated
        Whether any measurement was simulated.
    """

    names: tuple[str, str]
    utc_s: Array
    cube: TrackerSeries
    chrono: TrackerSeries
    diffuse_fraction: Array
    simulated: bool = False

    def select(self, chosen: NDArray[np.bool_]) -> "Pairs":
        """Return some of the pairs."""
        return Pairs(
            names=self.names,
            utc_s=self.utc_s[chosen],
            cube=self.cube.select(chosen),
            chrono=self.chrono.select(chosen),
            diffuse_fraction=self.diffuse_fraction[chosen],
            simulated=self.simulated,
        )


def read_tables(paths: Sequence[Path]) -> tuple[pd.DataFrame, list[str]]:
    """Read CSV (``.gz`` too) or Parquet files.

    Returns
    -------
    One frame with all columns of `Measurement`, and notes on it for people, a sentence each. Impossible irradiances are
    NaN in it, and a last line in which a file breaks off is left out.

    Raises
    ------
    UserError
        A file cannot be read, lacks a column, has one that is unknown, or holds no measurement; or a tracker has two
        measurements of one time that differ.
    """
    notes: list[str] = []
    frames = []
    for path in paths:
        frame, told = _read(path)
        notes += filter(None, (*told, _leave_out_impossible(frame, path)))
        frames.append(frame)
    together = pd.concat(frames, ignore_index=True)
    _refuse_contradictions(together)
    return together, notes


def frame_of(measurements: Sequence[Measurement]) -> pd.DataFrame:
    """Return measurements as the frame that `read_tables` gives."""
    return pd.DataFrame(measurements, columns=list(Measurement._fields))


def pair(frame: pd.DataFrame, names: tuple[str, str], within_s: float = TOGETHER_WITHIN_S) -> Pairs:
    """Join the measurements of two trackers: each of the first with the other's that is nearest in time.

    A power below zero, which is a wattmeter's offset in the dark, counts as zero.

    Raises
    ------
    UserError
        A tracker has no measurements, or no two of them are within `within_s` of each other.
    """
    usable = frame[np.isfinite(frame["pmpp_w"])]
    # Both trackers' offsets go: the correction would remove only one's, and the other's nights would count as a gain.
    usable = usable.assign(pmpp_w=np.maximum(usable["pmpp_w"], 0.0))
    there = sorted(set(usable["tracker"]))
    for name in names:
        if name not in there:
            known = ", ".join(f"'{one}'" for one in there) or "none at all"
            raise UserError(
                f"there are no powers of '{name}', only of {known}: name the two trackers with --cube and --chrono"
            )
    ours, theirs = (_rows_of_tracker(usable, name) for name in names)
    within: Any = within_s  # the stubs know times only, and ours are numbers
    both = pd.merge_asof(ours, theirs, on="time", direction="nearest", tolerance=within, suffixes=("_cube", "_chrono"))
    both = both[np.isfinite(both["pmpp_w_chrono"])]
    if both.empty:
        spans = " and ".join(f"{name} {_span(one)}" for name, one in zip(names, (ours, theirs), strict=True))
        raise UserError(
            f"no two measurements are within {within_s:g} s of each other ({spans}): the trackers can only be compared"
            " over the same time"
        )
    cube, chrono = (
        TrackerSeries(*(both[f"{field.name}_{side}"].to_numpy(float) for field in fields(TrackerSeries)))
        for side in ("cube", "chrono")
    )
    ghi, dhi = (
        both[f"{name}_cube"].fillna(both[f"{name}_chrono"]).to_numpy(float) for name in ("ghi_w_m2", "dhi_w_m2")
    )
    lit = (ghi > 0.0) & (dhi >= 0.0)
    fraction = np.minimum(np.divide(dhi, ghi, out=np.full(ghi.shape, np.nan), where=lit), 1.0)
    simulated = bool((both[f"{SIMULATED}_cube"] | both[f"{SIMULATED}_chrono"]).any())
    return Pairs(
        names=names,
        utc_s=both["time"].to_numpy(float),
        cube=cube,
        chrono=chrono,
        diffuse_fraction=fraction,
        simulated=simulated,
    )


def _read(path: Path) -> tuple[pd.DataFrame, tuple[str, str]]:
    """Return a file's measurements, and notes that it breaks off and that it names no zone; each may be empty."""
    try:
        table, broken = (pd.read_parquet(path).reset_index(), "") if path.suffix.lower() == ".parquet" else _csv(path)
    except FileNotFoundError:
        raise UserError(f"there is no file {path} with measured powers") from None
    except UnicodeDecodeError:
        raise not_utf8_error(path) from None
    except (OSError, EOFError, zlib.error, ValueError) as error:
        # Errors of pandas and pyarrow derive from ValueError; the others come from a .gz that is cut off or damaged.
        raise UserError(f"{path} cannot be read: {read_error_text(error)}") from None
    table = table.drop(columns=[name for name in ("index",) if name in table]).dropna(how="all")
    missing = [name for name in REQUIRED if name not in table]
    unknown = [str(name) for name in table if name not in _COLUMNS]
    if missing or unknown:
        what = f"lacks the column {missing[0]}" if missing else f"has an unknown column {unknown[0]}"
        raise UserError(
            f"{path} {what}; the columns are {', '.join(REQUIRED)}, and where known {', '.join(_COLUMNS[3:])}"
        )
    if table.empty:
        raise UserError(f"{path} holds no measurements: there is nothing below its header; name one that has some")
    found = pd.DataFrame({"time": _times(table["time"], path), "tracker": _trackers(table["tracker"], path)})
    for name in _NUMBERS:
        found[name] = _numbers(table[name], path) if name in table else np.nan
    found[SIMULATED] = _booleans(table[SIMULATED], path) if SIMULATED in table else False
    low, high = _POWER_W
    wild = found["pmpp_w"].notna() & ~found["pmpp_w"].between(low, high)
    if wild.any():
        row = int(np.flatnonzero(wild)[0])
        raise UserError(
            f"{path}, row {found.index[row] + 1}: pmpp_w is {found['pmpp_w'].iloc[row]:g} W, which no module of a"
            f" tracker gives ({low:g}..{high:g} W)"
        )
    named = isinstance(table["time"].dtype, pd.DatetimeTZDtype)
    zone = "" if named else zone_note(table["time"].astype(str))
    return found, (broken, zone and f"{path}: {zone}")


def _csv(path: Path) -> tuple[pd.DataFrame, str]:
    separator = check_table(path)
    decimal = "," if separator == ";" else "."
    try:
        names = pd.read_csv(path, sep=separator, nrows=0, skipinitialspace=True).columns
        # Without the '=' pandas takes the name 'NA' for a missing one, even after a converter, and '01' for 1.
        as_written: Any = {name: "={}".format for name in names if name.strip().lower() == "tracker"}
        broken = broken_line(path, separator)
        # A broken last line would turn a column of numbers into texts. pandas' fast engine cannot skip the last line.
        whole: Any = {"skipfooter": 1, "engine": "python"} if broken else {}
        table = pd.read_csv(path, sep=separator, decimal=decimal, skipinitialspace=True, converters=as_written, **whole)
    except pd.errors.EmptyDataError:
        raise UserError(f"{path} is empty: name a table with the columns time and pmpp_w") from None
    except pd.errors.ParserError as error:
        raise UserError(unreadable(path, separator, error)) from None
    table = table.rename(columns=lambda name: name.strip().lower())
    check_frame(path, table)
    if as_written:
        trackers = table["tracker"].str[1:]
        table["tracker"] = trackers.mask(trackers == "")
    # A comma after the last name in the header makes a column without a name.
    nameless = [name for name in table if str(name).startswith("unnamed: ") and table[name].isna().all()]
    return table.drop(columns=nameless), f"{path}: {broken.note()}" if broken else ""


def _leave_out_impossible(frame: pd.DataFrame, path: Path) -> str | None:
    """Replace impossible irradiances by NaN, and return a sentence on how many there are, or None."""
    columns = list(_IRRADIANCES)
    values = frame[columns].to_numpy(float)
    wrong = ~(is_possible(values) | np.isnan(values))
    if not wrong.any():
        return None
    row, column = np.argwhere(wrong)[0].tolist()
    frame[columns] = np.where(wrong, np.nan, values)
    value = f"{columns[column]} {values[row, column]:g}, not in {LOWEST_W_M2:g}..{HIGHEST_W_M2:g}"
    return impossible_note(str(path), int(wrong.sum()), f"in row {frame.index[row] + 1}: {value}")


def _refuse_contradictions(frame: pd.DataFrame) -> None:
    """Raise `UserError` if a tracker has two powers at one time; the same row twice does no harm."""
    powers = frame[np.isfinite(frame["pmpp_w"])].drop_duplicates()
    again = powers[powers.duplicated(["time", "tracker"])]
    if not again.empty:
        first = again.iloc[0]
        raise UserError(
            f"'{first['tracker']}' has two different measurements at {iso_utc(first['time'])}, the first of"
            f" {len(again)} such repeats: keep only the right ones"
        )


def _times(column: Any, path: Path) -> Array:
    if isinstance(column.dtype, pd.DatetimeTZDtype):
        times = column.dt.tz_convert("UTC")
    else:
        times = utc_times(column.astype(str))
    if times.isna().any():
        row = int(np.flatnonzero(times.isna())[0])
        raise UserError(
            f"{path}, row {column.index[row] + 1}: '{column.iloc[row]}' is not a time; write 2022-10-14T08:00:05Z"
        )
    seconds: Array = times.dt.tz_localize(None).to_numpy("datetime64[us]").astype(np.int64) / 1e6
    return seconds


def _trackers(column: "pd.Series[Any]", path: Path) -> "pd.Series[str]":
    names = column.fillna("").astype(str).str.strip()
    nameless = np.flatnonzero(names == "")
    if nameless.size:
        raise UserError(
            f"{path}, row {column.index[nameless[0]] + 1}: there is no tracker's name; write whose power it is, or take"
            " the row out"
        )
    return names


def _numbers(column: "pd.Series[float]", path: Path) -> "pd.Series[float]":
    numbers = pd.to_numeric(column, errors="coerce").astype(float)
    wrong = numbers.isna() & column.notna()
    if wrong.any():
        row = int(np.flatnonzero(wrong)[0])
        raise UserError(
            f"{path}, row {column.index[row] + 1}: {column.name} is '{column.iloc[row]}', which is not a number"
        )
    return numbers


def _booleans(column: "pd.Series[Any]", path: Path) -> "pd.Series[bool]":
    words = column.astype(str).str.lower()
    wrong = ~words.isin(("true", "false"))
    if wrong.any():
        row = int(np.flatnonzero(wrong)[0])
        raise UserError(
            f"{path}, row {column.index[row] + 1}: {column.name} is '{column.iloc[row]}'; write true or false"
        )
    return words == "true"


def _rows_of_tracker(frame: pd.DataFrame, name: str) -> pd.DataFrame:
    own = frame[frame["tracker"] == name].drop(columns="tracker")
    return own.sort_values("time", kind="stable").drop_duplicates("time")


def _span(frame: pd.DataFrame) -> str:
    first, last = (iso_utc(float(frame["time"].iloc[place]))[:19] for place in (0, -1))
    return f"{first}Z..{last}Z"
