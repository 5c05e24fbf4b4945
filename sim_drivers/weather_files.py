"""Measured weather from files: our own CSV, and the formats of BSRN, SURFRAD, MIDC and TMY3.

Our CSV has a header ``time,ghi,dni,dhi`` and optionally ``wind_speed,temp_air`` in any order, plain or gzipped; tabs,
or semicolons with decimal commas, may stand in place of commas. ``time`` is ISO 8601; without an offset it is UTC.
Irradiance is in W/m2, wind in m/s, temperature in deg C; an empty cell, ``NaN``, ``NA``, ``N/A`` and ``null`` are a
missing value, and so is a number out of the quantity's range. A last line that breaks off is left out. Negative
irradiance at night (a pyranometer's thermal offset) becomes zero. A column ``simulated`` with ``true`` in any row says
that nobody has measured it.

A value is taken to hold at the instant it is stamped with, and to change linearly until the next. The hours of TMY3
are stamped at their end; they are moved back to their middle, and the typical year, whose months come from different
years, is laid in one calendar year.
"""

import gzip
import zlib
from collections.abc import Callable, Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import NoReturn

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike, NDArray

from sim_drivers.weather import Conditions, WeatherError
from sim_drivers.weather_file_formats import WeatherFileFormat, detect_file_format
from solar.ephemeris import Site, sun_position
from solar.frames import Array
from solar.irradiance import HIGHEST_W_M2, LOWEST_W_M2, kilowatts_note
from solar.tables import (
    MISSING_VALUES,
    broken_line,
    read_error_text,
    second_header_hint,
    separator_of,
    summer_time_hint,
    unreadable,
    utc_times,
    without_broken_line,
)

LONGEST_GAP_S = 3600.0
IRRADIANCES = ("ghi", "dni", "dhi")
OPTIONAL = ("wind_speed", "temp_air")


class WeatherFileError(WeatherError):
    """A weather file cannot be used, or does not tell what was asked; one sentence for the user."""


class MeasuredWeather:
    """Weather read from a file, linear between its records.

    Parameters
    ----------
    name
        How messages call the file.
    utc_s
        Strictly increasing instants of the records, shape (n,), n >= 1.
    values
        ``ghi, dni, dhi, wind_speed, temp_air`` by name, each of shape (n,); NaN where missing. A record counts where
        all three irradiances are there.
    site
        Where it was measured, if the file tells.
    left_out
        Which parts of the file do not count, a sentence each.
    simulated
        Whether the file says of itself that a model made it.

    Raises
    ------
    WeatherFileError
        If no record counts.
    """

    def __init__(
        self,
        name: str,
        utc_s: Array,
        values: dict[str, Array],
        site: Site | None = None,
        left_out: Sequence[str] = (),
        *,
        simulated: bool = False,
    ) -> None:
        complete = np.all([np.isfinite(values[quantity]) for quantity in IRRADIANCES], axis=0)
        if not complete.any():
            raise WeatherFileError("; ".join((f"{name} has no record with ghi, dni and dhi all present", *left_out)))
        self.name = name
        self.site = site
        self.simulated = simulated
        self._left_out = tuple(left_out)
        self.utc_s = utc_s[complete]
        self.irradiance_w_m2 = {key: np.maximum(values[key][complete], 0.0) for key in IRRADIANCES}
        self._optional_values = {key: _present_values(utc_s, values[key]) for key in OPTIONAL}

    def note(self) -> str | None:
        """Return a sentence that tells people which parts of the file do not count, or None."""
        return "; ".join(self._left_out) or None

    @property
    def start_utc_s(self) -> float:
        """The first record's instant."""
        return float(self.utc_s[0])

    @property
    def end_utc_s(self) -> float:
        """The last record's instant."""
        return float(self.utc_s[-1])

    def covers(self, utc_s: Array) -> NDArray[np.bool_]:
        """Tell for each instant whether it lies within the file and not inside a gap of more than 60 min."""
        return np.isfinite(_interpolate(np.asarray(utc_s), self.utc_s, self.irradiance_w_m2["dhi"]))

    def at(self, utc_s: Array) -> Conditions:
        """Return the weather at instants of shape (n,).

        Raises `WeatherFileError` for an instant outside the file, naming its span, or inside a gap, naming the gap.
        """
        instants = np.asarray(utc_s, dtype=np.float64)
        covered = self.covers(instants)
        if not covered.all():
            self._refuse(float(instants[~covered][0]))
        ghi, dni, dhi = (_interpolate(instants, self.utc_s, self.irradiance_w_m2[key]) for key in IRRADIANCES)
        wind, temperature = (_interpolate(instants, *self._optional_values[key]) for key in OPTIONAL)
        return Conditions(ghi_w_m2=ghi, dni_w_m2=dni, dhi_w_m2=dhi, wind_speed_m_s=wind, temp_air_degc=temperature)

    def _refuse(self, utc_s: float) -> NoReturn:
        if not (self.start_utc_s <= utc_s <= self.end_utc_s):
            raise WeatherFileError(
                f"{self.name} has no weather for {_iso(utc_s)}: it runs from {_iso(self.start_utc_s)} "
                f"to {_iso(self.end_utc_s)}"
            )
        after = int(np.searchsorted(self.utc_s, utc_s, side="right"))
        raise WeatherFileError(
            f"{self.name} has no weather for {_iso(utc_s)}: it has a gap from {_iso(self.utc_s[after - 1])} "
            f"to {_iso(self.utc_s[after])}"
        )


def load_weather(path: Path, *, typical_year: int | None = None) -> MeasuredWeather:
    """Read a weather file; the format is told from its first lines.

    Parameters
    ----------
    path
        Plain or ``.gz``.
    typical_year
        Calendar year to lay a TMY3 file in; by default the year of its first record.

    Raises
    ------
    WeatherFileError
        In one sentence: no file, no data, a missing column (with those found), an unreadable time (with its line), a
        time that repeats or goes backwards (with its line and both times), a cell that is not a number.
    """
    try:
        return _read(path, typical_year)
    except WeatherFileError:
        raise
    except FileNotFoundError:
        raise WeatherFileError(f"there is no weather file at {path}") from None
    except UnicodeDecodeError:
        raise WeatherFileError(f"{path} cannot be read, as it is not text in UTF-8: save it as such") from None
    except (
        OSError,
        EOFError,
        zlib.error,
        ArithmeticError,
        AttributeError,
        LookupError,
        TypeError,
        ValueError,
    ) as error:
        # The formats' readers may raise anything for a damaged file.
        raise WeatherFileError(f"weather file {path} cannot be read: {read_error_text(error)}") from error


def site_mismatch(weather: MeasuredWeather, site: Site) -> str | None:
    """Tell in one sentence that `weather` was not measured at `site`, or return None if it may have been.

    GHI - DHI must equal DNI sin(elevation), and there is no beam at night. At the right site the two agree to 1 or 2 %
    on most days; an hour of time or 10 deg of longitude too many shows as more than 8 %. Fewer than ten sunny records
    tell nothing, except that a sky too dark for a high sun shows a wrong unit.
    """
    elevation_deg = sun_position(weather.utc_s, *site).elevation_deg
    ghi, dni, dhi = (weather.irradiance_w_m2[key] for key in IRRADIANCES)
    if (too_dark := kilowatts_note(weather.name, "of ghi", float(ghi.max()), weather.utc_s, site)) is not None:
        return too_dark
    sunny = dni > 200.0
    if np.count_nonzero(sunny) < 10:
        return None
    where = f"a site at {site.latitude_deg:g} N, {site.longitude_deg:g} E"
    at_night = float(np.mean(elevation_deg[sunny] < -1.0))
    if at_night > 0.02:
        return (
            f"{weather.name} does not fit {where}: {at_night:.0%} of its sunshine falls into the night there; "
            "check the site and that times are UTC"
        )
    usable = sunny & (elevation_deg > 10.0)
    beam = dni[usable] * np.sin(np.radians(elevation_deg[usable]))
    error = float(np.median(np.abs(ghi[usable] - dhi[usable] - beam) / beam)) if usable.any() else 0.0
    if error > 0.08:
        return (
            f"{weather.name} does not fit {where}: ghi - dhi differs from dni sin(elevation) by {error:.0%} there; "
            "check the site, that times are UTC, and that means are stamped with their middle"
        )
    return None


def _read(path: Path, typical_year: int | None) -> MeasuredWeather:
    if path.is_dir():
        raise WeatherFileError(f"{path} is a folder: name a file of measured weather in it")
    if path.exists() and not path.is_file():
        # To open a pipe would wait for its writer.
        raise WeatherFileError(f"{path} is no ordinary file: write its records into one and name that")
    first, second, third = _head(path)
    if not (first + second + third).strip():
        raise WeatherFileError(
            f"weather file {path} is empty: name one with records, such as CSV with the columns time, ghi, dni and dhi"
        )
    network = detect_file_format(first, second, third, typical_year)
    if network is not None:
        return _read_network(path, network)
    separator = separator_of(first)
    try:
        return _csv(path, separator)
    except pd.errors.ParserError as error:
        raise WeatherFileError(f"weather file {unreadable(path, separator, error)}") from None


def _csv(path: Path, separator: str) -> MeasuredWeather:
    frame = pd.read_csv(
        path,
        sep=separator,
        dtype=str,
        keep_default_na=False,
        skip_blank_lines=False,
        encoding="utf-8-sig",
        skipinitialspace=True,
        # Not inferred: for a file packed otherwise pandas' error has many words.
        compression="gzip" if _is_gzipped(path) else None,
    )
    found = [str(column).strip().lower() for column in frame.columns]
    frame.columns = pd.Index(found)
    for column in ("time", *IRRADIANCES):
        if column not in found:
            raise WeatherFileError(f"weather file {path} has no column {column}; found: {', '.join(found)}")
    for column in ("time", *IRRADIANCES, *OPTIONAL, "simulated"):
        # pandas adds a number to the second of two columns with one name.
        if found.count(column) > 1 or f"{column}.1" in found:
            raise WeatherFileError(f"weather file {path} has two columns {column}: keep only the right one")
    if not isinstance(frame.index, pd.RangeIndex):
        raise WeatherFileError(f"weather file {path} has more cells in its lines than names in its header")
    broken = broken_line(path, separator)
    cells = frame[: -1 if broken else None].fillna("").apply(lambda column: column.str.strip())
    if separator == ";":
        # A spreadsheet writes semicolons where numbers have a decimal comma.
        cells = cells.replace(",", ".", regex=True)
    # A file may end in blank lines; the index keeps the line numbers of the others.
    cells = cells[(cells != "").any(axis=1)]
    if cells.empty:
        raise WeatherFileError(f"weather file {path} has a header and no data: name one with records below it")
    line = cells.index.to_numpy() + 2
    times = utc_times(cells["time"])
    bad = _first_true(times.isna())
    if bad is not None:
        raise WeatherFileError(
            f"weather file {path}, line {line[bad]}: {cells['time'].iloc[bad]!r} is not a time such as "
            f"2016-06-05T12:00:00Z{second_header_hint(cells['time'].iloc[bad], bad)}"
        )
    utc_s = _seconds(pd.DatetimeIndex(times))
    _check_order(utc_s, lambda row: f"weather file {path}, line {line[row]}", cells["time"])
    values = {key: np.full(utc_s.size, np.nan) for key in (*IRRADIANCES, *OPTIONAL)}
    impossible: list[str] = []
    for column in [name for name in values if name in found]:
        text = cells[column].mask(cells[column].str.lower().isin(MISSING_VALUES), "")
        numbers = pd.to_numeric(text, errors="coerce").to_numpy(dtype=np.float64)
        bad = _first_true((text != "") & np.isnan(numbers))
        if bad is not None:
            raise WeatherFileError(
                f"weather file {path}, line {line[bad]}: {column} is {text.iloc[bad]!r}, not a number; "
                "leave the cell empty where the value is missing"
            )
        low, high = _plausible(column)
        possible = (numbers >= low) & (numbers <= high)
        wrong = np.flatnonzero(~possible & ~np.isnan(numbers))
        impossible += [f"in line {line[row]}: {column} {text.iloc[row]}, not in {low:g}..{high:g}" for row in wrong]
        values[column] = np.where(possible, numbers, np.nan)
    simulated = "simulated" in found and bool((cells["simulated"].str.lower() == "true").any())
    left_out = [f"weather file {path}: {broken.note()}"] if broken else []
    if impossible:
        count = "1 impossible value" if len(impossible) == 1 else f"{len(impossible)} impossible values"
        left_out.append(f"weather file {path} has {count}, taken as missing; first {impossible[0]}")
    return MeasuredWeather(f"weather file {path}", utc_s, values, left_out=left_out, simulated=simulated)


def _read_network(path: Path, network: WeatherFileFormat) -> MeasuredWeather:
    with without_broken_line(path, network.separator, network.lines) as (whole, broken):
        frame, site = network.read(whole)
    for column in IRRADIANCES:
        if column not in frame:
            found = ", ".join(str(name) for name in frame.columns)
            raise WeatherFileError(f"weather file {path} has no column for {column}; found: {found}")
    utc_s = _seconds(pd.DatetimeIndex(frame.index))
    _check_order(utc_s, lambda row: f"weather file {path}, record {row + 1}")
    values = {}
    for key in (*IRRADIANCES, *OPTIONAL):
        numbers = frame[key].to_numpy(dtype=np.float64) if key in frame else np.full(utc_s.size, np.nan)
        low, high = _plausible(key)
        # These networks mark a missing value by a number such as -9999 or -7999.
        values[key] = np.where((numbers >= low) & (numbers <= high), numbers, np.nan)
    left_out = [f"weather file {path}: {broken.note()}"] if broken else []
    return MeasuredWeather(f"weather file {path}", utc_s, values, site, left_out)


def _head(path: Path) -> tuple[str, str, str]:
    with gzip.open(path, "rb") if _is_gzipped(path) else path.open("rb") as file:
        first, second, third = (file.readline(100_000).decode("utf-8", "replace") for _ in range(3))
    return first.lstrip("\ufeff"), second, third


def _is_gzipped(path: Path) -> bool:
    return path.suffix.lower() == ".gz"


def _plausible(quantity: str) -> tuple[float, float]:
    if quantity in IRRADIANCES:
        return LOWEST_W_M2, HIGHEST_W_M2
    return (0.0, 100.0) if quantity == "wind_speed" else (-90.0, 60.0)


def _check_order(utc_s: Array, place: Callable[[int], str], texts: "pd.Series[str] | None" = None) -> None:
    bad = _first_true(np.diff(utc_s) <= 0.0)
    if bad is not None:
        before, after = _iso(utc_s[bad]), _iso(utc_s[bad + 1])
        hint = "" if texts is None else summer_time_hint(texts.iloc[bad + 1], utc_s[: bad + 2].tolist())
        raise WeatherFileError(f"{place(bad + 1)}: the time {after} follows {before}; times must increase{hint}")


def _interpolate(utc_s: Array, times: Array, values: Array) -> Array:
    """Interpolate linearly; NaN outside `times` and inside gaps of more than 60 min."""
    if times.size == 0:
        return np.full(utc_s.shape, np.nan)
    after = np.clip(np.searchsorted(times, utc_s, side="left"), 0, times.size - 1)
    before = np.maximum(after - 1, 0)
    bridged = (times[after] - times[before] <= LONGEST_GAP_S) | (utc_s == times[after])
    inside = (utc_s >= times[0]) & (utc_s <= times[-1])
    return np.where(bridged & inside, np.interp(utc_s, times, values), np.nan)


def _present_values(utc_s: Array, values: Array) -> tuple[Array, Array]:
    present = np.isfinite(values)
    return utc_s[present], values[present]


def _seconds(index: pd.DatetimeIndex) -> Array:
    seconds = (index - pd.Timestamp(0, tz="UTC")) / pd.Timedelta(seconds=1)
    return np.asarray(seconds, dtype=np.float64)


def _first_true(mask: ArrayLike) -> int | None:
    """Position of the first True."""
    flags = np.asarray(mask, dtype=np.bool_)
    return int(flags.argmax()) if flags.any() else None


def _iso(utc_s: float) -> str:
    return datetime.fromtimestamp(utc_s, UTC).isoformat(timespec="seconds").replace("+00:00", "Z")
