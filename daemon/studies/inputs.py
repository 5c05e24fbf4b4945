"""What people give to the studies and commands as text: sites, instants, weather."""

import codecs
import gzip
import zlib
from collections.abc import Iterable, Mapping, Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any, get_args

from daemon.base.errors import UserError
from daemon.base.words import pluralise
from daemon.config.simulation import WeatherName
from drivers.numbers import read_number
from solar.tables import separator_of

if TYPE_CHECKING:
    import pandas as pd

    # The command line imports this module to show its help, which must not wait for scientific libraries.
    from daemon.config.settings import Settings

# Not Python's first and last year: there a time zone or a longitude can shift an instant beyond its calendar.
YEARS = range(2, 9999)
_SKIES = get_args(WeatherName)
_PACKED = (".bz2", ".tar", ".tar.gz", ".xz", ".zip", ".zst")
_LONGEST_LINE = 20_000
_NO_CSV = {
    b"PAR1": "is a Parquet file",
    b"PK\x03\x04": "is a spreadsheet or packed",
    b"\x1f\x8b": "is packed and its name does not end in .gz",
    b"#": "begins with a remark",
    b"sep=": "begins with 'sep='",
}


def parse_site(text: str, where: str = "--site") -> tuple[float, float, float]:
    """Return degrees north, degrees east and metres of ``LAT,LON`` or ``LAT,LON,ALT``; `UserError` for other text."""
    try:
        numbers = [read_number(part) for part in text.split(",")]
    except ValueError:
        numbers = []
    if len(numbers) not in (2, 3):
        raise UserError(f"{where}: '{text}' is not LAT,LON or LAT,LON,ALT, such as 48.7176,2.2090,156")
    latitude, longitude, altitude = (*numbers, 0.0)[:3]
    # Written so that NaN fails.
    if not (abs(latitude) <= 90.0 and abs(longitude) <= 180.0 and -430.0 <= altitude <= 9000.0):
        raise UserError(f"{where}: '{text}' is not on Earth: LAT is in -90..90, LON in -180..180, ALT in -430..9000")
    return latitude, longitude, altitude


def instant(text: str, option: str) -> datetime:
    """Return the UTC instant that an option gives as a date or time; raises `UserError`."""
    try:
        found = datetime.fromisoformat(text)
    except ValueError:
        found = None
    if found is None or found.year not in YEARS:
        raise UserError(f"{option}: '{text}' is not a date or time; write 2022-10-14 or 2022-10-14T08:00Z")
    return found.replace(tzinfo=UTC) if found.tzinfo is None else found.astimezone(UTC)


def site_values(text: str) -> dict[str, Any]:
    """Return the values of the section site for the text LAT,LON or LAT,LON,ALT; raises `UserError`."""
    latitude, longitude, altitude = parse_site(text)
    return {"name": text, "latitude_deg": latitude, "longitude_deg": longitude, "altitude_m": altitude}


def weather_choice(text: str) -> str | Path:
    """Return the built-in weather of that name, or the file."""
    return text if text in _SKIES else Path(text)


def check_weather_file(path: Path, built_in: Sequence[str] = _SKIES) -> None:
    """Raise `UserError` where there is no such file, before the libraries that read it are loaded.

    The sentence names the built-in skies that the command takes.
    """
    check_regular_file(path, "measured weather")
    if not path.exists():
        if built_in == _SKIES:
            raise UserError(
                f"there is no weather file at {path}, and it is not one of the built-in skies {', '.join(_SKIES)}"
            )
        known = f"{path} is a built-in sky that this command does not take"
        what = known if str(path) in _SKIES else f"there is no weather file at {path}"
        raise UserError(f"{what}: name {' or '.join(('a file of measured weather', *built_in))}")
    check_table(path)


def check_table(path: Path) -> str:
    """Return what stands between the cells of a CSV file: a comma, or the semicolon or the tab of a spreadsheet.

    A file that cannot be opened is left to the reader, which tells the reason; so is a pipe. Raises `UserError` for a
    device, which may have no end, for a table that is packed otherwise than with gzip, and for a file whose first lines
    are not those of a table.
    """
    if path.name.lower().endswith(_PACKED):
        raise UserError(
            f"{path} is packed in a way that cannot be read: unpack it, or pack the table alone with gzip (.gz)"
        )
    if path.is_char_device() or path.is_block_device():
        raise _special_file_error(path)
    if not path.is_file():
        return ","
    try:
        with gzip.open(path) if path.suffix.lower() == ".gz" else path.open("rb") as file:
            lines = [file.readline(_LONGEST_LINE) for _ in range(2)]
    except gzip.BadGzipFile:
        raise UserError(f"{path} is not packed with gzip, though its name ends in .gz: take the ending off") from None
    except (OSError, EOFError, zlib.error):
        return ","
    header = lines[0].removeprefix(codecs.BOM_UTF8)
    for beginning, what in _NO_CSV.items():
        if header.startswith(beginning):
            raise UserError(f"{path} {what}: a CSV file is needed, the names of its columns in the first line")
    if header.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)):
        raise UserError(f"{path} is text in UTF-16: save it as a CSV file in UTF-8 ('CSV UTF-8' in a spreadsheet)")
    for number, line in enumerate(lines, 1):
        # pandas needs minutes for thousands of columns.
        if len(line) == _LONGEST_LINE:
            raise UserError(
                f"{path}, line {number} is longer than {_LONGEST_LINE} characters: name a table with one line for each"
                " time, and keep only the columns that are needed"
            )
    return separator_of(header.decode("latin-1"))


def check_unique_columns(where: str, found: Sequence[str], counted: Iterable[str]) -> None:
    """Raise `UserError` if one of the columns in `counted` stands twice among those found."""
    for name in counted:
        if found.count(name) > 1:
            raise UserError(f"{where} has two columns {name}: keep only the right one")


def check_frame(path: Path, frame: "pd.DataFrame") -> None:
    """Raise `UserError` for a table in which pandas found too many cells in a line, or two columns of one name."""
    import pandas as pd  # noqa: PLC0415 - as above

    if not isinstance(frame.index, pd.RangeIndex):
        raise UserError(f"{path} has more cells in its lines than names in its header")
    # pandas adds ".1" to the name of the second of two columns with one name.
    names = [str(name).removesuffix(".1") for name in frame]
    check_unique_columns(str(path), names, names)


def with_decimal_point(number: str, separator: str) -> str:
    """Return the text of a number with a decimal point; tables separated by semicolons may have decimal commas."""
    return number.replace(",", ".") if separator == ";" else number


def not_utf8_error(where: Path | str) -> UserError:
    """Return the refusal of a table in another encoding."""
    return UserError(f"{where} is not text in UTF-8: save it as such ('CSV UTF-8' in a spreadsheet)")


def check_regular_file(path: Path, what: str) -> None:
    """Raise `UserError` for a folder, a device or a pipe where a file with `what` is meant."""
    if path.is_dir():
        raise UserError(f"{path} is a folder: name a file with {what} in it")
    if path.exists() and not path.is_file():
        raise _special_file_error(path)


def _special_file_error(path: Path) -> UserError:
    return UserError(f"{path} is no ordinary file: write its records into one and name that")


def check_data_files(paths: Sequence[Path], what: str) -> None:
    """Raise `UserError` for the first path at which there is no ordinary file with `what`."""
    for path in paths:
        check_regular_file(path, what)
        if not path.exists():
            raise UserError(f"there is no file {path} with {what}")


def impossible_note(source: str, count: int, first: str) -> str:
    """Return a sentence on how many numbers of a file are impossible, and where the first of them stands."""
    return f"{source} has {pluralise(count, 'impossible value')}, taken as missing; first {first}"


def settings_for(
    config: Path | None,
    *,
    weather: str | None = None,
    law: str | None = None,
    site: Mapping[str, Any] | None = None,
    seed: int | None = None,
    speed: float | None = None,
    start: datetime | None = None,
    cube: str | None = None,
    positioner: str | None = None,
    rotctld: str | None = None,
) -> "Settings":
    """Return the settings of a file, or the simulated rig's defaults, overridden by the choices that are given.

    Parameters
    ----------
    config
        The file.
    weather
        A built-in weather by name, or the path of a measured one.
    law
        Name of the pointing law.
    site
        Keys of the section site.
    seed, speed, start
        Keys of the section simulation.
    cube
        Driver that reads the cube's faces: its name, or a beginning that only one name has.
    positioner
        Driver of the positioner, named in the same way.
    rotctld
        Host and port of a rotctld whose rotator turns the module.

    Raises
    ------
    UserError
        The file, or a choice, cannot be used.
    """
    from daemon.config.file import load_settings, override  # noqa: PLC0415 - as above
    from daemon.config.plugin_sections import CUBE, DRIVER, POSITIONER, ROTCTLD  # noqa: PLC0415 - as above
    from daemon.config.settings import Settings  # noqa: PLC0415 - as above

    chosen = None if weather is None else weather_choice(weather)
    if isinstance(chosen, Path):
        check_weather_file(chosen)
    simulation = {
        "weather": chosen,
        "seed": seed,
        "speed": speed,
        "start_utc": start,
    }
    changes: dict[str, dict[str, Any]] = {
        "simulation": {key: value for key, value in simulation.items() if value is not None},
        "law": {} if law is None else {"driver": law},
        "site": dict(site or {}),
    }
    settings = load_settings(config) if config is not None else Settings()
    instruments = {}
    if cube is not None:
        instruments["cube"] = CUBE.table_with_changes(settings.instruments.cube, {DRIVER: CUBE.complete(cube)})
    if positioner is not None:
        driver = {DRIVER: POSITIONER.complete(positioner)}
        instruments["positioner"] = POSITIONER.table_with_changes(settings.instruments.positioner, driver)
    if rotctld is not None:
        driver = {DRIVER: ROTCTLD, "server": rotctld}
        instruments["positioner"] = POSITIONER.table_with_changes(settings.instruments.positioner, driver)
    changes["instruments"] = instruments
    return override(settings, changes)


def with_identical_trackers(settings: "Settings", number: int) -> "Settings":
    """Return the settings of `number` trackers that are all alike, for one process and one cube.

    Raises
    ------
    UserError
        The settings name their trackers.
    """
    from daemon.config.trackers import TrackerTable  # noqa: PLC0415 - as above

    if settings.tracker:
        names = ", ".join(table.name for table in settings.tracker)
        raise UserError(f"--trackers: the configuration names its trackers already ({names}); leave the option out")
    width = len(str(number))
    tables = tuple(TrackerTable(name=f"t{place:0{width}}") for place in range(1, number + 1))
    return settings.model_copy(update={"tracker": tables})
