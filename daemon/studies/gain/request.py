"""What a person asks of `heliocube gain`, read and checked."""

import zlib
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from daemon.base.errors import UserError
from daemon.studies.gain.choices import Device
from daemon.studies.inputs import check_table, check_unique_columns, not_utf8_error, with_decimal_point
from drivers.numbers import read_number
from solar.frames import Array
from solar.tables import CellError, numbered_rows, open_table, read_error_text

LARGEST_GRID = 20_000_000
POINT_COLUMNS = {
    "phi_deg": (-90.0, 90.0),
    "beta_deg": (-90.0, 90.0),
    "n": (1.0, 365.0),
    "lambda_deg": (-180.0, 180.0),
}


@dataclass(frozen=True, slots=True)
class DeviceTilts:
    """Tilts [deg] of each device; in a grid of shape (tilts, azimuths, 1)."""

    static: Array
    vertical: Array
    horizontal: Array


@dataclass(frozen=True, slots=True)
class Request:
    """A grid of latitudes, tilts, azimuth deviations and days.

    Attributes
    ----------
    tilts_deg
        None: each device has its own best tilt for the year at its latitude.
    days
        None: sums over the year.
    """

    latitudes_deg: Array
    tilts_deg: Array | None
    azimuths_deg: Array
    days: Array | None
    against: tuple[Device, ...]
    printed: bool

    def __post_init__(self) -> None:
        axes = (self.latitudes_deg, self.tilts_deg, self.azimuths_deg, self.days)
        rows = int(np.prod([axis.size for axis in axes if axis is not None], dtype=np.int64))
        if rows > LARGEST_GRID:
            raise UserError(f"this asks for {rows} rows, more than {LARGEST_GRID}; take longer steps or fewer values")


def numbers(text: str, option: str, low: float, high: float) -> Array:
    """Read ``A``, ``A,B,C``, ``FROM:TO`` (step 1) or ``FROM:TO:STEP``, ends included; `UserError` names the option."""
    try:
        parts = [read_number(part) for part in text.replace(",", ":").split(":")]
    except ValueError:
        raise UserError(f"{option}: '{text}' is not a number, a list A,B,C or a range FROM:TO:STEP") from None
    for part in parts[:2] if ":" in text else parts:
        if not (low <= part <= high):
            raise UserError(f"{option}: {part:g} is not in {low:g}..{high:g}")
    if ":" not in text:
        return np.array(parts)
    if "," in text or len(parts) > 3:
        raise UserError(f"{option}: '{text}' is not a number, a list A,B,C or a range FROM:TO:STEP")
    begin, end, step = (*parts, 1.0)[:3]
    if not (0.0 < step < np.inf) or begin > end:
        raise UserError(f"{option}: the range '{text}' must rise by a step above 0")
    steps = np.floor((end - begin) / step + 1e-9)
    if not steps < LARGEST_GRID:
        raise UserError(f"{option}: the range '{text}' has more than {LARGEST_GRID} values; take a longer step")
    # Rounding may carry the last value a little beyond the end, which may be a pole.
    return np.asarray(np.minimum(begin + step * np.arange(int(steps) + 1), end), dtype=np.float64)


def latitudes(lat: float | None, lat_range: str | None) -> Array:
    """Return the latitudes [deg] that the options give: one, several, or both together in rising order."""
    if lat is None and lat_range is None:
        raise UserError("give --lat or --lat-range, such as --lat 48.7 or --lat-range 0:65:1")
    if lat is not None and not (-90.0 <= lat <= 90.0):
        raise UserError(f"--lat: {lat:g} is not in -90..90")
    several = np.array([]) if lat_range is None else numbers(lat_range, "--lat-range", -90.0, 90.0)
    return several if lat is None else np.union1d(several, [lat])


def days(text: str) -> Array:
    """Read days of the year, 1..365, as :func:`numbers` does."""
    chosen = numbers(text, "--day", 1.0, 365.0)
    if np.any(chosen != np.round(chosen)):
        raise UserError(f"--day: '{text}' must give whole days of the year, 1..365")
    return chosen


def devices(text: str) -> tuple[Device, ...]:
    """Read a list of devices, each once, in the order of :class:`Device`."""
    names = {name.strip() for name in text.split(",")}
    unknown = names - set(Device)
    if unknown:
        known = ", ".join(Device)
        raise UserError(f"--against: there is no device '{min(unknown)}'; choose from {known}, separated by commas")
    return tuple(device for device in Device if device in names)


def read_points(path: Path) -> dict[str, Array]:
    """Read a CSV with the columns phi_deg, beta_deg, n and lambda_deg, in any order and among others.

    Blank lines are passed over. `UserError` names the file, the line, the column and the value that is wrong.
    """
    separator = check_table(path)
    try:
        with open_table(path) as file:
            lines = numbered_rows(file, separator)
            header = [name.strip().lower() for name in next(lines, (1, []))[1]]
            if not header:
                raise UserError(
                    f"points file {path} is empty: name a CSV file with the columns {','.join(POINT_COLUMNS)}"
                )
            missing = [name for name in POINT_COLUMNS if name not in header]
            if missing:
                raise UserError(f"points file {path} has no column {missing[0]}; found: {', '.join(header)}")
            check_unique_columns(f"points file {path}", header, POINT_COLUMNS)
            rows = [_row(path, line, header, cells, separator) for line, cells in lines if any(map(str.strip, cells))]
    except FileNotFoundError:
        raise UserError(f"there is no points file at {path}") from None
    except UnicodeDecodeError:
        raise not_utf8_error(f"points file {path}") from None
    except CellError as error:
        raise UserError(f"points file {path}, {error}") from None
    except (OSError, EOFError, zlib.error) as error:
        raise UserError(f"points file {path} cannot be read: {read_error_text(error)}") from None
    if not rows:
        raise UserError(f"points file {path} has a header and no data: write a row for each case below it")
    columns = np.array(rows).T
    return dict(zip(POINT_COLUMNS, columns, strict=True))


def _row(path: Path, line: int, header: list[str], cells: list[str], separator: str) -> list[float]:
    # Where commas separate cells, a decimal comma splits a number in two and shifts all cells behind it.
    if len(cells) > len(header):
        raise UserError(
            f"points file {path}, line {line}: there are {len(cells)} cells where the header has {len(header)}; write"
            " numbers with a point"
        )
    told = dict(zip(header, cells, strict=False))
    return [_cell(path, line, name, with_decimal_point(told.get(name, ""), separator)) for name in POINT_COLUMNS]


def _cell(path: Path, line: int, name: str, text: str) -> float:
    low, high = POINT_COLUMNS[name]
    try:
        value = read_number(text)
    except ValueError:
        value = float("nan")
    if not (low <= value <= high) or (name == "n" and value != round(value)):
        kind = "a whole number" if name == "n" else "a number"
        raise UserError(f"points file {path}, line {line}: {name} is '{text}', not {kind} in {low:g}..{high:g}")
    return value
