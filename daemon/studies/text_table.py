"""Tables for people: as many columns as a terminal has room for, the rest below, beside the same first ones."""

import math
from collections.abc import Iterator, Sequence

WIDTH = 80
_BETWEEN = "  "


def signed(value: float, digits: int, missing: str = "-") -> str:
    """Return a number with its sign, never a minus before what is rounded to nothing; `missing` for NaN."""
    if math.isnan(value):
        return missing
    return f"{value:+z.{digits}f}"


def table(rows: Sequence[Sequence[str]], *, keys: int = 1) -> list[str]:
    """Return the lines of a table, the heads its first row, no line longer than `WIDTH` if the columns let it.

    Parameters
    ----------
    rows
        Cells, as many in each row.
    keys
        How many columns, aligned to the left, stand before every part of a table that has to be continued below.
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
    """Yield the columns that stand beside one another, besides the keys."""
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
