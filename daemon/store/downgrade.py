"""The way back of a store to the version before: the copy in its place again, with the records that came since."""

import sqlite3
from contextlib import closing
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path

from daemon.store.schema import StoreError, check_is_store, columns_of, open_for_reading
from daemon.store.tables import COLUMNS
from daemon.store.unusable_store import sidecar_files


@dataclass(frozen=True, slots=True)
class DowngradeResult:
    """What became of a store.

    Attributes
    ----------
    records
        How many of the records that came since the copy are in it now.
    newer
        Where the newer release's store lies now.
    left_out
        Why none or not all of them could be taken over; empty where they were.
    """

    records: int
    newer: Path
    left_out: str = ""


def version_in(path: Path) -> int:
    """Return the version of a store that is there; raises `StoreError` where it cannot be read."""
    with closing(open_for_reading(path)) as connection:
        found: int = connection.execute("PRAGMA user_version").fetchone()[0]
    return found


def set_aside(path: Path, utc_s: float) -> Path:
    """Give a store that an older release cannot use another name in its folder, and return that; raises `OSError`."""
    stamp = datetime.fromtimestamp(utc_s, UTC).strftime("%Y%m%dT%H%M%SZ")
    newer = path.with_name(f"{path.stem}.newer-{stamp}{path.suffix}")
    for beside in sidecar_files(path):
        beside.rename(f"{newer}{str(beside).removeprefix(str(path))}")
    path.rename(newer)
    return newer


def downgrade_store(path: Path, copy: Path, utc_s: float) -> DowngradeResult:
    """Put the copy of an older version in a store's place; the newer one stays in the folder under another name.

    Both have the same runs up to the copy. So a record that came since is known by the number of its run or, in a run
    that went on, by its own number: a service that shares the store may not have been restarted. Tables and columns of
    the newer version only stay behind in its store. After an interruption, do it again.

    Parameters
    ----------
    path
        The store, which is there; no service may be at work on it.
    copy
        Of an older version, as `daemon.store.copies` keeps it.
    utc_s
        Now [s].

    Raises
    ------
    StoreError
        The copy cannot be used; everything is as it was.
    OSError
        The disk refuses it.
    """
    try:
        with closing(sqlite3.connect(copy, isolation_level=None)) as connection:
            check_is_store(connection, copy)
            records, left_out = _take_over_records(connection, path)
    except sqlite3.Error as error:
        raise StoreError(f"the copy {copy} cannot be used: {error}; the store {path} is as it was") from None
    newer = set_aside(path, utc_s)
    copy.rename(path)
    return DowngradeResult(records, newer, left_out)


def _take_over_records(connection: sqlite3.Connection, path: Path) -> tuple[int, str]:
    before = connection.total_changes
    try:
        connection.execute("ATTACH DATABASE ? AS newer", (str(path),))
        connection.execute("BEGIN IMMEDIATE")
        last = _last_numbers(connection)
        for name, _ in COLUMNS.values():
            _copy_missing_rows(connection, name, "run > ?", (max(last, default=0),))
            for run, number in last.items():
                _copy_missing_rows(connection, name, "run = ? AND number > ?", (run, number))
        records = connection.total_changes - before
        _copy_missing_rows(connection, "runs", "run > ?", (max(last, default=0),))
        connection.execute("INSERT OR IGNORE INTO main.days SELECT day FROM newer.days")
        connection.execute("COMMIT")
    except sqlite3.Error as error:
        if connection.in_transaction:
            connection.execute("ROLLBACK")
        return 0, str(error)
    connection.execute("DETACH DATABASE newer")
    return records, ""


def _last_numbers(connection: sqlite3.Connection) -> dict[int, int]:
    """Return for each run of the copy the number of its last record there, which counts over all kinds."""
    last = {run: -1 for (run,) in connection.execute("SELECT run FROM main.runs")}
    for name, _ in COLUMNS.values():
        if columns_of(connection, name):
            for run, number in last.items():
                query = f"SELECT COALESCE(MAX(number), -1) FROM main.{name} WHERE run = ?"  # noqa: S608 - our own
                last[run] = max(number, connection.execute(query, (run,)).fetchone()[0])
    return last


def _copy_missing_rows(connection: sqlite3.Connection, name: str, which: str, values: tuple[int, ...]) -> None:
    """Copy those rows of one table that the copy has not; the runs themselves come last."""
    there, here = (columns_of(connection, name, schema) for schema in ("newer", "main"))
    columns = ", ".join(sorted(there & here))
    if columns:
        connection.execute(
            f"INSERT OR IGNORE INTO main.{name} ({columns}) SELECT {columns} FROM newer.{name} WHERE {which}",  # noqa: S608 - our own
            values,
        )
