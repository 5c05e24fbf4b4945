"""Tables of measured weather in the formats of BSRN, SURFRAD, MIDC and TMY3, read by pvlib."""

import re
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import NamedTuple

import pandas as pd
from pvlib import iotools
from pvlib.iotools.midc import MIDC_VARIABLE_MAP
from pvlib.iotools.surfrad import VARIABLE_MAP as SURFRAD_VARIABLE_MAP

from solar.ephemeris import Site

_SURFRAD_SITE = re.compile(r"\s*-?\d+\.\d+\s+-?\d+\.\d+\s+-?\d+\s+m\s+version\s+\d")
_MIDC_PREFIXES = {"Global Horiz": "ghi", "Direct Normal": "dni", "Diffuse Horiz": "dhi"}
_Found = tuple[pd.DataFrame, Site | None]


class WeatherFileFormat(NamedTuple):
    """A format: what reads a plain file of it, what stands between its cells, and how many lines a record has.

    `read` returns a frame with a UTC or local index and columns of ghi, dni, dhi, wind_speed and temp_air, and the site
    if the file tells; a damaged file may make it raise anything. With `separator` None blanks separate the cells.
    """

    read: Callable[[Path], _Found]
    separator: str | None
    lines: int = 1


def detect_file_format(first: str, second: str, third: str, typical_year: int | None) -> WeatherFileFormat | None:
    """Return the format that the first three lines of a file are of, or None; raises `ValueError` for a damaged TMY3.

    `typical_year` is the calendar year to lay a TMY3 file in, by default that of its first record.
    """
    if first.startswith(("*U", "*C")):
        return WeatherFileFormat(_bsrn, None, lines=2)
    if _SURFRAD_SITE.match(second):
        return WeatherFileFormat(_surfrad, None)
    if "Date (MM/DD/YYYY)" in second and "Time (HH:MM)" in second:
        return WeatherFileFormat(partial(_tmy3, year=int(third[6:10]) if typical_year is None else typical_year), ",")
    if first.startswith("DATE (MM/DD/YYYY)") or ",Year,DOY," in first:
        return WeatherFileFormat(partial(_midc, header=first), ",")
    return None


def _bsrn(path: Path) -> _Found:
    frame, meta = iotools.read_bsrn(path)
    return frame, Site(meta["latitude"], meta["longitude"], meta["altitude"])


def _surfrad(path: Path) -> _Found:
    frame, meta = iotools.read_surfrad(path, map_variables=False)
    frame = frame.rename(columns=SURFRAD_VARIABLE_MAP)
    return frame, Site(meta["latitude"], meta["longitude"], meta["elevation"])


def _midc(path: Path, header: str) -> _Found:
    return iotools.read_midc(path, variable_map=_midc_names(header), raw_data="Year,DOY" in header), None


def _tmy3(path: Path, year: int) -> _Found:
    frame, meta = iotools.read_tmy3(path, coerce_year=year)
    times = list(frame.index)
    if len(times) > 1 and times[-1] - times[-2] > pd.Timedelta(days=1):
        # pvlib moves the last hour to the next year, which is right only for a file that ends at New Year.
        times[-1] = times[-1].replace(year=times[-1].year - 1)
    frame.index = pd.DatetimeIndex(times) - pd.Timedelta(minutes=30)
    return frame, Site(meta["latitude"], meta["longitude"], meta["altitude"])


def _midc_names(header: str) -> dict[str, str]:
    """Map this file's columns to ghi, dni, dhi, wind_speed and temp_air; the names differ from station to station."""
    columns = [column.strip() for column in header.split(",")]
    known = {column: name for station in MIDC_VARIABLE_MAP.values() for column, name in station.items()}
    names: dict[str, str] = {}
    for column in columns:
        by_prefix = next((name for prefix, name in _MIDC_PREFIXES.items() if column.startswith(prefix)), None)
        name = known.get(column, by_prefix)
        name = "dni" if name in ("dni_chp1", "dni_nip") else name
        if name is not None and name not in names.values():
            names[column] = name
    return names
