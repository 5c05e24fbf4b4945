"""The store's file: a table for each kind of record, all made from the one list of columns."""

import errno
import sqlite3
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager
from operator import attrgetter
from pathlib import Path
from typing import Any

from daemon.base.errors import UserError
from daemon.base.records import Record, Scan
from daemon.store.tables import COLUMNS, Row, with_irradiances

FILE_NAME = "heliocube.sqlite"
VERSION = 6

# "helc": tells a store from any other SQLite file.
_APPLICATION = 0x68656C63
_BUSY_S = 10.0
_FAILING_DISK = (errno.ENOSPC, errno.EDQUOT, errno.EROFS, errno.EIO)
_TYPES = {"time": "REAL", "float": "REAL", "int": "INTEGER", "bool": "INTEGER", "text": "TEXT"}

_RUNS = """CREATE TABLE runs (
  run INTEGER PRIMARY KEY,
  started REAL NOT NULL,
  role TEXT NOT NULL,
  version TEXT NOT NULL,
  simulated INTEGER NOT NULL,
  site TEXT NOT NULL,
  latitude_deg REAL NOT NULL,
  longitude_deg REAL NOT NULL,
  altitude_m REAL NOT NULL,
  tracker TEXT NOT NULL DEFAULT ''
)"""
_DAYS = "CREATE TABLE days (day INTEGER PRIMARY KEY)"


class StoreError(UserError):
    """The store cannot be used; the message is one sentence with the file and the remedy."""


def schema() -> list[str]:
    """Return the statements that make an empty store.

    A record is known by the run of the service that kept it and its number in that run, over all kinds, from 0: a
    number that is missing is a record that was lost. A scan is known by its cube's own count as well, so that one that
    arrives twice is kept once.
    """
    return [_RUNS, _DAYS, *[statement for kind in COLUMNS for statement in _table(kind)]]


def _table(kind: type[Row]) -> list[str]:
    name, columns = COLUMNS[kind]
    lines = ["run INTEGER NOT NULL", "number INTEGER NOT NULL"]
    lines += [f"{column.name} {_TYPES[column.holds]}" for column in columns]
    lines.append("PRIMARY KEY (run, number)")
    if kind is Scan:
        lines.append("UNIQUE (source, session, sequence)")
    body = ",\n  ".join(lines)
    return [
        f"CREATE TABLE {name} (\n  {body}\n) WITHOUT ROWID",
        f"CREATE INDEX {name}_time ON {name} (time)",
    ]


def open_for_writing(path: Path) -> sqlite3.Connection:
    """Open a store, made if it is missing.

    Raises
    ------
    StoreError
        The file is no store, or that of a newer program.
    sqlite3.Error
        The disk is full or fails.
    """
    connection = sqlite3.connect(path, timeout=_BUSY_S, isolation_level=None)
    try:
        with _naming(path):
            connection.execute("PRAGMA journal_mode = WAL")
            # A commit then survives the end of the process, and a power cut costs the last seconds but never the file.
            connection.execute("PRAGMA synchronous = NORMAL")
            connection.execute("PRAGMA journal_size_limit = 16777216")
            connection.execute("BEGIN IMMEDIATE")
            if _is_empty(connection):
                for statement in schema():
                    connection.execute(statement)
                connection.execute(f"PRAGMA application_id = {_APPLICATION}")
                connection.execute(f"PRAGMA user_version = {VERSION}")
            else:
                _check(connection, path)
                _bring_up_to_date(connection)
            connection.execute("COMMIT")
    except BaseException:
        connection.close()
        raise
    return connection


def open_for_reading(path: Path) -> sqlite3.Connection:
    """Open a store that is there, also while the service writes to it; raises `StoreError`."""
    if not path.is_file():
        raise StoreError(f"there is no store at {path}; name its folder with --store, or the service's --config")
    connection = sqlite3.connect(f"{path.resolve().as_uri()}?mode=ro", uri=True, timeout=_BUSY_S, isolation_level=None)
    try:
        with _naming(path):
            _check(connection, path)
    except sqlite3.Error as error:
        connection.close()
        raise StoreError(f"the store {path} cannot be read: {error}") from None
    except BaseException:
        connection.close()
        raise
    return connection


def check_store(directory: Path) -> None:
    """Make sure that a folder can take the store, before the service starts; a full disk is no reason not to.

    Raises
    ------
    StoreError
        The folder cannot be written to, or what is there is no store of this program.
    """
    path = directory / FILE_NAME
    try:
        directory.mkdir(parents=True, exist_ok=True)
        with path.open("ab"):
            pass
    except OSError as error:
        if error.errno in _FAILING_DISK:
            return
        raise StoreError(f"store.directory: {path} cannot be written: {error.strerror}") from None
    try:
        with closing(open_for_writing(path)):
            pass
    except sqlite3.Error as error:
        if not is_passing(error):
            raise StoreError(f"the store {path} cannot be opened: {error}; move it away to begin a new one") from None


def is_passing(error: sqlite3.Error) -> bool:
    """Whether an error may go away by itself: a full disk, a failing one, another program's lock."""
    codes = (sqlite3.SQLITE_FULL, sqlite3.SQLITE_IOERR, sqlite3.SQLITE_BUSY, sqlite3.SQLITE_CANTOPEN)
    return getattr(error, "sqlite_errorcode", 0) & 0xFF in codes


class Rows:
    """Turns records of one kind into rows, and names the statement that stores them."""

    def __init__(self, kind: type[Row]) -> None:
        name, columns = COLUMNS[kind]
        self._values: Callable[[Any], tuple[Any, ...]] = attrgetter(*[column.path for column in columns])
        names = ", ".join(["run", "number", *[column.name for column in columns]])
        marks = ", ".join("?" * (len(columns) + 2))
        self.insert = f"INSERT OR IGNORE INTO {name} ({names}) VALUES ({marks})"  # noqa: S608 - our own names

    def row(self, run: int, number: int, record: Record) -> tuple[Any, ...]:
        """Return the row of one record; what is not a number becomes NULL in SQLite's own hands."""
        return run, number, *self._values(with_irradiances(record))


def _is_empty(connection: sqlite3.Connection) -> bool:
    return not connection.execute("SELECT 1 FROM sqlite_master LIMIT 1").fetchone()


def _bring_up_to_date(connection: sqlite3.Connection) -> None:
    """Give a store of an older version the tables and columns it lacks; these are new at the end of their tables."""
    for kind, (name, columns) in COLUMNS.items():
        there = columns_of(connection, name)
        if not there:
            for statement in _table(kind):
                connection.execute(statement)
            continue
        for column in columns:
            if column.name not in there:
                connection.execute(f"ALTER TABLE {name} ADD COLUMN {column.name} {_TYPES[column.holds]}")
    if "tracker" not in columns_of(connection, "runs"):
        connection.execute("ALTER TABLE runs ADD COLUMN tracker TEXT NOT NULL DEFAULT ''")
    connection.execute(f"PRAGMA user_version = {VERSION}")


def columns_of(connection: sqlite3.Connection, table: str) -> set[str]:
    """Return the names of a table's columns, which in a store of an older version are fewer; none without the table."""
    return {row[1] for row in connection.execute(f"PRAGMA table_info({table})")}


def tracker_sql(connection: sqlite3.Connection, table: str, alias: str) -> str:
    """Return SQL for the name of a record's tracker, in a query that joins a table under an alias with `runs`.

    A run of one tracker bears its name; in a run of several each record does. Stores of older versions know neither.
    """
    known = [(alias_of, columns_of(connection, of)) for alias_of, of in (("runs", "runs"), (alias, table))]
    names = [f"NULLIF({alias_of}.tracker, '')" for alias_of, columns in known if "tracker" in columns]
    return f"COALESCE({', '.join([*names, *['NULL', repr('')]])})"


def _check(connection: sqlite3.Connection, path: Path) -> None:
    if connection.execute("PRAGMA application_id").fetchone()[0] != _APPLICATION:
        raise StoreError(f"{path} is no store of heliocube; name another folder, or move the file away")
    version = connection.execute("PRAGMA user_version").fetchone()[0]
    if version > VERSION:
        raise StoreError(
            f"the store {path} is of version {version} and this program knows version {VERSION}: it was written by a"
            " newer heliocube; update this one, or name another folder"
        )


@contextmanager
def _naming(path: Path) -> Iterator[None]:
    try:
        yield
    except sqlite3.DatabaseError as error:
        if getattr(error, "sqlite_errorcode", 0) & 0xFF not in (sqlite3.SQLITE_NOTADB, sqlite3.SQLITE_CORRUPT):
            raise
        raise StoreError(f"{path} is no store of heliocube, or is damaged ({error}); move it away") from None
