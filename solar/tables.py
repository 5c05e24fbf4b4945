"""Tables of measurements as people save them: what stands between their cells, what is missing, and when it was."""

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    # The command line imports this module to show its help, which must not wait for the science.
    import pandas as pd

NO_READING = frozenset({"", "nan", "na", "n/a", "null"})
"""How tables write a value that is missing, in small letters."""


def separator_of(header: str) -> str:
    """Return what stands between the cells of a CSV file: a comma, or the semicolon or the tab of a spreadsheet.

    Between semicolons numbers may have a decimal comma, as a spreadsheet writes them.
    """
    return next((found for found in ";\t" if found in header and "," not in header), ",")


def utc_times(column: "pd.Series[str]") -> "pd.Series[pd.Timestamp]":
    """Return the UTC times that a column of ISO 8601 texts gives; NaT for what is none of the years 1900 to 2199."""
    import pandas as pd  # noqa: PLC0415 - as above

    # pandas takes 'now' and 'today' for times as well.
    dated = column.where(column.str.match(r"\s*\d{4}"))
    times = pd.to_datetime(dated, format="ISO8601", utc=True, errors="coerce")
    return times.where(times.dt.year.between(1900, 2199))
