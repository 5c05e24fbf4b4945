"""Reads and checks a table of sites that a person has written, before work on any of them begins."""

import zlib
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import get_args

from daemon.base.errors import UserError
from daemon.config.simulation import WeatherName
from daemon.studies.inputs import check_table, check_unique_columns, not_utf8_error, parse_site, with_decimal_point
from solar.tables import CellError, numbered_rows, open_table, read_error_text

REQUIRED = ("name", "latitude", "longitude")
OPTIONAL = ("altitude", "weather", "year")
YEAR_OF_A_MODEL = 2023
_YEARS = range(1950, 2101)


@dataclass(frozen=True, slots=True)
class AskedSite:
    """One line of the table.

    Attributes
    ----------
    name
        As the table has it; one name in several lines means several years of one site.
    latitude_deg, longitude_deg, altitude_m
        Where the site is.
    weather
        Measured files, or the name of a built-in weather.
    year
        Year of the built-in weather; None for files, which have their own times.
    """

    name: str
    latitude_deg: float
    longitude_deg: float
    altitude_m: float
    weather: tuple[Path, ...] | WeatherName
    year: int | None

    @property
    def place(self) -> tuple[float, float, float]:
        """Latitude [deg], longitude [deg] and altitude [m]."""
        return self.latitude_deg, self.longitude_deg, self.altitude_m

    @property
    def weather_text(self) -> str:
        """The weather in a word: the model, or the files' names."""
        return self.weather if isinstance(self.weather, str) else ";".join(path.name for path in self.weather)


def read_sites(path: Path, model: WeatherName | None) -> list[AskedSite]:
    """Return the sites of a CSV file; a line without weather gets that of the `model`.

    Raises
    ------
    UserError
        With the line and what to write there.
    """
    separator = check_table(path)
    try:
        with open_table(path) as file:
            rows = numbered_rows(file, separator)
            names = [name.strip().lower() for name in next(rows, (1, []))[1]]
            _check_columns(path, names)
            sites = [
                _site(path, line, names, cells, model, separator) for line, cells in rows if any(map(_is_filled, cells))
            ]
    except UnicodeDecodeError:
        raise not_utf8_error(f"--sites: {path}") from None
    except CellError as error:
        raise UserError(f"--sites: {path} {error}") from None
    except (OSError, EOFError, zlib.error) as error:
        raise UserError(f"--sites: {path} cannot be read: {read_error_text(error)}") from None
    if not sites:
        raise UserError(f"--sites: {path} has no line with a site below its header")
    _check_names(path, sites)
    return sites


def _is_filled(cell: str) -> bool:
    return bool(cell.strip())


def _check_columns(path: Path, names: list[str]) -> None:
    missing = [name for name in REQUIRED if name not in names]
    unknown = [name or "''" for name in names if name not in (*REQUIRED, *OPTIONAL)]
    known = f"{', '.join(REQUIRED)}, and if you like {', '.join(OPTIONAL)}"
    if missing:
        raise UserError(f"--sites: {path} has no column {missing[0]}; its columns are {known}")
    check_unique_columns(f"--sites: {path}", names, (*REQUIRED, *OPTIONAL))
    if unknown:
        raise UserError(f"--sites: {path} has a column {unknown[0]}, which is not known; its columns are {known}")


def _site(
    path: Path, line: int, names: list[str], row: list[str], model: WeatherName | None, separator: str
) -> AskedSite:
    where = f"{path} line {line}"
    told = dict(zip(names, row, strict=False))
    cells = {name: told.get(name, "").strip() for name in (*REQUIRED, *OPTIONAL)}
    if len(row) > len(names):
        raise UserError(f"--sites: {where} has more cells than there are columns")
    if not cells["name"]:
        raise UserError(f"--sites: {where} has no name")
    place = (cells["latitude"], cells["longitude"], cells["altitude"] or "0")
    text = ",".join(with_decimal_point(number, separator) for number in place)
    latitude_deg, longitude_deg, altitude_m = parse_site(text, f"--sites: {where}")
    weather = _weather(path, where, cells["weather"], model)
    return AskedSite(
        name=cells["name"],
        latitude_deg=latitude_deg,
        longitude_deg=longitude_deg,
        altitude_m=altitude_m,
        weather=weather,
        year=_year(where, cells["year"], weather),
    )


def _weather(path: Path, where: str, text: str, model: WeatherName | None) -> tuple[Path, ...] | WeatherName:
    if not text:
        if model is None:
            raise UserError(
                f"--sites: {where} has no weather: name its files there, or with --model a built-in sky for all such"
                " lines"
            )
        return model
    for name in get_args(WeatherName):
        if text == name:
            found: WeatherName = name
            return found
    return tuple(file for pattern in text.split(";") for file in _files(path.parent, where, pattern.strip()))


def _files(folder: Path, where: str, pattern: str) -> Iterator[Path]:
    named = (folder / pattern).absolute()
    if named.is_file():
        yield named
        return
    try:
        found = sorted(named.parent.glob(named.name)) if pattern else []
    except (OSError, ValueError):
        found = []
    if not found:
        known = ", ".join(get_args(WeatherName))
        raise UserError(f"--sites: {where}: there is no weather file '{pattern}', and it is none of {known}")
    yield from found


def _year(where: str, text: str, weather: tuple[Path, ...] | WeatherName) -> int | None:
    if not isinstance(weather, str):
        if text:
            raise UserError(f"--sites: {where} has a year; weather files have their own: leave it empty")
        return None
    if not text:
        return YEAR_OF_A_MODEL
    if not (text.isascii() and text.isdigit() and int(text) in _YEARS):
        raise UserError(f"--sites: {where}: '{text}' is not a year in {_YEARS.start}..{_YEARS.stop - 1}")
    return int(text)


def _check_names(path: Path, sites: list[AskedSite]) -> None:
    known: dict[str, AskedSite] = {}
    for site in sites:
        if known.setdefault(site.name, site).place != site.place:
            raise UserError(f"--sites: {path} has '{site.name}' at two places: give each a name of its own")
    if len(set(sites)) < len(sites):
        twice = next(site for at, site in enumerate(sites) if site in sites[:at])
        raise UserError(f"--sites: {path} has '{twice.name}' twice with the same weather: leave one out")
