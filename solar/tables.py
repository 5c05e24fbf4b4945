"""Tables of measurements as people save them: separators, missing values, cut-off lines and times."""

import csv
import gzip
import re
import zlib
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from datetime import UTC, datetime
from itertools import chain
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, NamedTuple, TextIO, cast

if TYPE_CHECKING:
    # The command line imports this module to show its help, which must not wait for pandas.
    import pandas as pd

MISSING_VALUES = frozenset({"", "nan", "na", "n/a", "null"})
"""How tables write a value that is missing, in small letters."""
# No text file contains this: a cell that ends with it was not closed before the end of the file.
_END_MARK = "\0end\0"
_OFFSET = re.compile(r":\d\d.*(Z|[+-]\d\d:?\d*)\s*$", re.IGNORECASE)
# Clocks go back in April in the south, in October or November in the north.
_CLOCK_BACK_MONTHS = (4, 10, 11)
_LATEST_HOUR = 3
_LEAST_TIMES = 3
_LAST_BYTES = 65536
_DECIMALS = re.compile(r"(?=\S)[+-]?\d*(?:[.,](\d*))?", re.ASCII)
# Without trailing zeros every tenth number has a decimal fewer. If none of so many does, their decimals are fixed.
_LEAST_NUMBERS = 30


class CellError(ValueError):
    """A row of a table cannot be split into its cells; the text names the line and says what to do."""


def separator_of(header: str) -> str:
    """Return what stands between the cells of a CSV file: a comma, or the semicolon or the tab of a spreadsheet.

    Between semicolons numbers may have a decimal comma, as a spreadsheet writes them.
    """
    return next((found for found in ";\t" if found in header and "," not in header), ",")


def open_table(path: Path) -> TextIO:
    """Open a CSV file, plain or ``.gz``, for `csv`; raises `OSError`."""
    if path.suffix.lower() == ".gz":
        return cast("TextIO", gzip.open(path, "rt", encoding="utf-8-sig", newline=""))
    return path.open(encoding="utf-8-sig", newline="")


def numbered_rows(lines: Iterable[str], separator: str) -> Iterator[tuple[int, list[str]]]:
    """Yield the cells of each row of a CSV file, the header's too, each behind the number of its first line.

    Raises `CellError`, for example for a quoted cell that is never closed.
    """
    reader = csv.reader(chain(lines, (_END_MARK,)), delimiter=separator, skipinitialspace=True)
    line = 1
    while True:
        try:
            cells = next(reader)
        except csv.Error as error:
            # A cell that is never closed takes in line after line until it is longer than csv allows.
            unclosed = reader.line_num > line
            raise _unclosed_cell_error(line) if unclosed else CellError(f"line {line}: not CSV ({error})") from None
        if cells == [_END_MARK]:
            return
        if cells and cells[-1].endswith(_END_MARK):
            raise _unclosed_cell_error(line)
        yield line, cells
        line = reader.line_num + 1


class BrokenLine(NamedTuple):
    """The last line of a table that was cut off while it was written: its number, its cells, and the cells due."""

    number: int
    cells: int
    due: int

    def note(self) -> str:
        """Return the end of a sentence that begins with the file."""
        return f"the last line, {self.number}, breaks off at cell {self.cells} of {self.due} and is left out"


def broken_line(path: Path, separator: str) -> BrokenLine | None:
    """Return the last line of a CSV file, plain or ``.gz``, if it has no line end and is incomplete; else None.

    It is incomplete if it has fewer cells than the header, or if its last number has fewer decimals than every number
    above it, of which there must be 30 or more. A logger that loses its power leaves such a line, and perhaps only the
    first digit of its last number. A line with all its cells is valid without a line end, for many programs write none
    after the last line. None also for a cell that is never closed, which the reader reports, and for a pipe, which can
    be read only once. Raises `OSError`, `UnicodeDecodeError`, and for a damaged ``.gz`` `EOFError` or `zlib.error`.
    """
    if not path.is_file() or not _last_line(path).strip(f"{separator} \t".encode()):
        return None
    try:
        with open_table(path) as file:
            rows = numbered_rows(file, separator)
            due = len(next(rows, (1, []))[1])
            number, cells, decimals = 0, due, []
            for line, found in rows:
                number, cells = line, len(found)
                decimals.append(_decimals(found[-1]) if found else None)
    except CellError:
        return None
    return BrokenLine(number, cells, due) if cells < due or _lacks_decimals(decimals) else None


def _decimals(cell: str) -> int | None:
    """Return how many decimals a number has, whole or cut off; None for other text and an empty cell."""
    found = _DECIMALS.fullmatch(cell.strip())
    return None if found is None else len(found[1] or "")


def _lacks_decimals(column: Sequence[int | None]) -> bool:
    """Tell whether the last number of a column has fewer decimals than all those above it."""
    above = [known for known in column[:-1] if known is not None]
    return len(above) >= _LEAST_NUMBERS and column[-1] is not None and column[-1] < min(above)


def _last_line(path: Path) -> bytes:
    """Return what follows the last line end, or its last 64 KiB: nothing in most files."""
    with gzip.open(path) if path.suffix.lower() == ".gz" else path.open("rb") as file:
        if not isinstance(file, gzip.GzipFile):
            file.seek(max(path.stat().st_size - _LAST_BYTES, 0))
        end = b""
        while part := file.read(_LAST_BYTES):
            end = part if len(part) == _LAST_BYTES else (end + part)[-_LAST_BYTES:]
    return re.split(rb"[\r\n]", end)[-1]


@contextmanager
def without_broken_line(path: Path, separator: str | None, apart: int = 1) -> Iterator[tuple[Path, BrokenLine | None]]:
    """Yield the path of a table, unpacked and without a last line that breaks off, and that line or None.

    The last line breaks off if it has no line end, and has fewer cells than the line `apart` lines before it or too few
    decimals, as for `broken_line`. `apart` is the number of lines of a record: its first line is no measure for its
    second. With `separator` None blanks separate the cells. Raises as `broken_line`.
    """
    packed = path.suffix.lower() == ".gz"
    if not packed and not _last_line(path).strip():
        yield path, None
        return
    with gzip.open(path) if packed else path.open("rb") as file:
        lines = file.read().splitlines(keepends=True)
    broken = None
    if len(lines) > apart and not lines[-1].endswith((b"\r", b"\n")) and lines[-1].strip():
        between = None if separator is None else separator.encode()
        cells, due = (len(line.split(between)) for line in (lines[-1], lines[-1 - apart]))
        last_cells = [line.split(between)[-1].decode("latin-1") for line in reversed(lines[::-apart]) if line.strip()]
        if cells < due or _lacks_decimals([*map(_decimals, last_cells)]):
            broken = BrokenLine(len(lines), cells, due)
            lines.pop()
    with TemporaryDirectory(prefix="heliocube-") as folder:
        whole = Path(folder) / path.stem
        whole.write_bytes(b"".join(lines))
        yield whole, broken


def read_error_text(error: Exception) -> str:
    """Return in words why a file could not be read, for a damaged ``.gz`` with a remedy."""
    if isinstance(error, EOFError | zlib.error | gzip.BadGzipFile):
        return "it is cut off or damaged; copy it anew, or unpack what is left: zcat FILE > NEW.csv"
    return getattr(error, "strerror", None) or " ".join(str(error).split())


def unreadable(path: Path, separator: str, error: Exception) -> str:
    """Return a sentence, path first, that says what is wrong with a CSV file, plain or ``.gz``, on which pandas raised.

    It names the line of a cell too many or of a cell that is never closed; pandas gives its parser's words only.
    """
    with open_table(path) as file:
        rows = numbered_rows(file, separator)
        try:
            width = len(next(rows)[1])
            for line, cells in rows:
                if len(cells) > width:
                    return f"{path}, line {line}: there are {len(cells)} cells where the header has {width}"
        except CellError as fault:
            return f"{path}, {fault}"
    return f"{path} cannot be read: {' '.join(str(error).split())}"


def summer_time_hint(text: str, seconds: Sequence[float]) -> str:
    """Return the end of a sentence that refuses a time because it goes back, or nothing.

    `text` is the time's cell, `seconds` [s UTC] are the times up to it. It is the hour that clocks repeat at the end of
    summer time if the step to it, with an hour added, is like the step before. In Europe, America and Australia that
    hour is at night.
    """
    if len(seconds) < _LEAST_TIMES or _OFFSET.search(text):
        return ""
    earlier, before, after = seconds[-_LEAST_TIMES:]
    usual_s, step_s = before - earlier, after + 3600.0 - before
    when = datetime.fromtimestamp(after, UTC)
    if not (
        0.5 * usual_s <= step_s <= 1.5 * usual_s and when.month in _CLOCK_BACK_MONTHS and when.hour <= _LATEST_HOUR
    ):
        return ""
    return (
        "; these look like local times at the end of summer time: write UTC, or add to each time its offset, such as"
        " +01:00"
    )


def zone_note(texts: Iterable[str]) -> str:
    """Return a sentence that says how ISO 8601 times that name no zone are read, or nothing where each names one."""
    return "" if all(map(_OFFSET.search, texts)) else "times that name no zone are taken as UTC"


def second_header_hint(text: str, row: int) -> str:
    """Return the end of a sentence that refuses a time, if it has no digit and is in row 0, the first; else nothing."""
    units = row == 0 and not any(map(str.isdigit, text))
    return "; remove a second line of the header, such as units" if units else ""


def _unclosed_cell_error(line: int) -> CellError:
    return CellError(
        f"line {line}: a cell begins with a quotation mark and no mark ends it: take the mark out, or close it"
    )


def utc_times(column: "pd.Series[str]") -> "pd.Series[pd.Timestamp]":
    """Return the UTC times of a column of ISO 8601 texts; NaT for a text that is no time in the years 1900 to 2199."""
    import pandas as pd  # noqa: PLC0415 - as above

    # pandas takes 'now' and 'today' for times as well.
    dated = column.where(column.str.match(r"\s*\d{4}"))
    times = pd.to_datetime(dated, format="ISO8601", utc=True, errors="coerce")
    return times.where(times.dt.year.between(1900, 2199))
