"""A span of the store for charts: numbers as packed columns, and records in words as rows."""

import json
import math
import sqlite3
import zlib
from collections.abc import Iterator, Sequence
from contextlib import closing, contextmanager
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np

from daemon.base.clock import iso_utc
from daemon.base.errors import UserError
from daemon.store.schema import columns_of, open_for_reading

MOST_ROWS = 40_000
"""Most rows of numbers in one page: more than two days of scans."""
MOST_LINES = 2000
"""Most rows of words in one page."""

_DAY_S = 86400.0
# Few enough that other threads do not wait long for the interpreter.
_ROWS_AT_ONCE = 500
_FACES = ("east", "south", "west", "zenith")
# By kind, which is the table's name: its numbers, and the SQL that gives each, or NULL where it does not count.
_NUMBERS = {
    "scans": {f"{face}_w_m2": f"CASE {face}_quality WHEN 'ok' THEN {face}_w_m2 END" for face in _FACES},
    "poses": {name: name for name in ("a_deg", "b_deg", "moving", "wind_m_s")},
    "decisions": {
        name: name
        for name in ("target_a_deg", "target_b_deg", "moved", "dni_est", "dhi_est", "albedo_est", "zenith_w_m2")
    },
    "curves": {"pmpp_w": "CASE quality WHEN 'ok' THEN pmpp_w END"},
}
_LINES = {
    "modes": ("before", "after", "why"),
    "moves": ("duration_s", "from_a_deg", "from_b_deg", "end_a_deg", "end_b_deg", "outcome", "why"),
    "events": ("subject", "text"),
}
KINDS_OF_NUMBERS = tuple(_NUMBERS)
KINDS_OF_LINES = tuple(_LINES)


def stored_days(path: Path, longitude_deg: float) -> list[str]:
    """Return the solar days of a site that have records, such as ``2022-10-14``, the oldest first.

    Parameters
    ----------
    longitude_deg
        Of the site, east positive.

    Raises
    ------
    UserError
        The store cannot be read.
    """
    ahead_s = longitude_deg * 240.0
    with closing(open_for_reading(path)) as connection, _as_user_errors(path):
        utc_days = connection.execute("SELECT day FROM days").fetchall()
        # Away from the prime meridian a UTC day has parts of two solar days.
        near = {(day * _DAY_S + ahead_s) // _DAY_S + more for (day,) in utc_days for more in (0, 1)}
        kinds = [kind for kind in (*_NUMBERS, *_LINES) if columns_of(connection, kind)]
        days = [day for day in sorted(near) if _any_record(connection, kinds, day * _DAY_S - ahead_s)]
    return [datetime.fromtimestamp(day * _DAY_S, UTC).date().isoformat() for day in days]


def packed_numbers(path: Path, kind: str, start_s: float, end_s: float, tracker: str) -> bytes:
    """Return one kind of a span as packed columns, compressed by gzip.

    Parameters
    ----------
    kind
        Of `KINDS_OF_NUMBERS`.
    start_s, end_s
        UTC [s]; the start is included, the end is not.
    tracker
        The tracker whose records these are; scans belong to every tracker.

    Returns
    -------
    bytes
        A line of JSON: ``rows``, ``columns``, ``start`` [s UTC] and ``more``; then for each column ``rows`` floats of
        32 bits, little-endian, times as seconds from the start, NaN for what is not known.

    Raises
    ------
    UserError
        The store cannot be read.
    """
    columns = _NUMBERS[kind]
    with closing(open_for_reading(path)) as connection, _as_user_errors(path):
        known = columns_of(connection, kind)
        wanted = [sql if name in known else "NULL" for name, sql in columns.items()]
        blocks = [
            np.array(block, dtype=np.float64).reshape(-1, len(wanted) + 1)
            for block in _blocks(connection, kind, wanted, start_s, end_s, tracker, MOST_ROWS + 1)
        ]
    found = np.concatenate([np.empty((0, len(columns) + 1)), *blocks])
    more, found = len(found) > MOST_ROWS, found[:MOST_ROWS]
    found[:, 0] -= start_s
    head = {"rows": len(found), "columns": ["time_s", *columns], "start": start_s, "more": more}
    content = json.dumps(head).encode() + b"\n" + found.T.astype("<f4").tobytes()
    # A higher level of compression saves a hundredth, and takes a quarter more time.
    packer = zlib.compressobj(1, zlib.DEFLATED, 31)
    return packer.compress(content) + packer.flush()


def lines_of(path: Path, kind: str, start_s: float, end_s: float, tracker: str) -> dict[str, Any]:
    """Return the rows of a kind of `KINDS_OF_LINES`, oldest first, at most `MOST_LINES`; arguments as for numbers."""
    names = _LINES[kind]
    with closing(open_for_reading(path)) as connection, _as_user_errors(path):
        blocks = _blocks(connection, kind, names, start_s, end_s, tracker, MOST_LINES + 1)
        rows = [row for block in blocks for row in block]
    found = [{"time": iso_utc(row[0])} | dict(zip(names, row[1:], strict=True)) for row in rows[:MOST_LINES]]
    return {"rows": found, "more": len(rows) > MOST_LINES}


def _any_record(connection: sqlite3.Connection, kinds: Sequence[str], start_s: float) -> bool:
    """Whether there is a record of any of these kinds in the day that begins then."""
    within = (start_s, start_s + _DAY_S)
    return any(
        connection.execute(f"SELECT 1 FROM {kind} WHERE time >= ? AND time < ? LIMIT 1", within).fetchone()  # noqa: S608 - our own names
        for kind in kinds
    )


def _blocks(
    connection: sqlite3.Connection,
    kind: str,
    wanted: Sequence[str],
    start_s: float,
    end_s: float,
    tracker: str,
    most: int,
) -> list[list[tuple[Any, ...]]]:
    whose = ""
    if "tracker" in columns_of(connection, kind):
        # A record without a tracker, such as an event of the cube or a record of an older store, belongs to all.
        whose = "AND COALESCE(kept.tracker, '') IN (?, '')"
    query = (
        f"SELECT kept.time, {', '.join(wanted)} FROM {kind} AS kept "  # noqa: S608 - our own names
        f"WHERE kept.time >= ? AND kept.time < ? {whose} ORDER BY kept.time, kept.run, kept.number LIMIT ?"
    )
    cursor = connection.execute(query, (start_s, end_s, *([tracker] if whose else []), most))
    return list(iter(lambda: cursor.fetchmany(_ROWS_AT_ONCE), []))


@contextmanager
def _as_user_errors(path: Path) -> Iterator[None]:
    """Turn what SQLite raises into a sentence."""
    try:
        yield
    except sqlite3.Error as error:
        raise UserError(f"the store {path} cannot be read: {error}") from None


def is_span(start_s: float, end_s: float) -> bool:
    """Whether two instants are a span that may be asked for: not longer than a week."""
    return math.isfinite(start_s) and 0 < end_s - start_s <= 7 * _DAY_S
