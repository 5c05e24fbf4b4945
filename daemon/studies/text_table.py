"""Tables for people: as many columns as fit a terminal; the rest go below, again beside the first columns."""

import math
from collections.abc import Iterator, Sequence

WIDTH = 80
_BETWEEN = "  "


def signed(value: float, digits: int, missing: str = "-") -> str:
    """Return a number with its sign, with no minus if it rounds to zero; `missing` for NaN."""
    if math.isnan(value):
        return missing
    return f"{value:+z.{digits}f}"


def table(rows: Sequence[Sequence[str]], *, keys: int = 1) -> list[str]:
    """Return the lines of a table, none longer than `WIDTH` if the columns allow it.

    Parameters
    ----------
    rows
        Cells, as many in each row; the heads are the first row.
    keys
        How many of the first columns, aligned to the left, are repeated in each part of a table that is too wide.
    """
    widths = [max(len(row[column]) for row in rows) for column in range(len(rows[0]))]
    lines: list[str] = []
    for part in _parts(widths, keys):
        if lines:
            lines.append("")
        for row in rows:
            cells = [row[key].ljust(widths[key]) for key in range(keys)]
            cells += [row[column].rjust(widths[column]) for column in part]
            lines.append(_BETWEEN.join(cells).rstrip())
    return lines


def _parts(widths: Sequence[int], keys: int) -> Iterator[list[int]]:
    """Yield, for each part of a table, its columns without the keys."""
    used = taken = sum(widths[:keys]) + len(_BETWEEN) * (keys - 1)
    part: list[int] = []
    for column in range(keys, len(widths)):
        needed = len(_BETWEEN) + widths[column]
        if part and taken + needed > WIDTH:
            yield part
            part, taken = [], used
        part.append(column)
        taken += needed
    yield part
