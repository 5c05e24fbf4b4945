"""The store's file: a table for each kind of record, all made from the one list of columns."""

import os
import sqlite3
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager
from operator import attrgetter
from pathlib import Path
from typing import Any

from daemon.base.errors import UserError
from daemon.base.records import Record, Scan
from daemon.store.copies import keep_copy
from daemon.store.tables import COLUMNS, Row, with_irradiances
from daemon.store.unusable_store import sidecar_obstacles

FILE_NAME = "heliocube.sqlite"
VERSION = 8

# "helc": tells a store from any other SQLite file.
_APPLICATION = 0x68656C63
_BUSY_S = 10.0
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
  tracker TEXT NOT NULL DEFAULT '',
  id TEXT NOT NULL DEFAULT ''
)"""
RUN_COLUMNS = (
    "started",
    "role",
    "version",
    "simulated",
    "site",
    "latitude_deg",
    "longitude_deg",
    "altitude_m",
    "tracker",
    "id",
)
"""Columns of the table `runs` after its number, in the order of `daemon.store.store.Origin` and of an archive."""
_DAYS = "CREATE TABLE days (day INTEGER PRIMARY KEY)"


class StoreError(UserError):
    """The store cannot be used; the message is one sentence with the file and the remedy."""


class UnusableStoreError(StoreError):
    """What is in the store's place can never be one; `kind` is one of `daemon.store.unusable_store.KINDS`."""

    def __init__(self, message: str, kind: str) -> None:
        super().__init__(message)
        self.kind = kind


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
    UnusableStoreError
        The file is no store, or damaged, or of a newer program; or something else is in the place of its log.
    StoreError
        It is a link into a folder that is not there.
    sqlite3.Error
        The disk is full or fails.
    """
    require_link_target(path)
    if path.is_dir():
        raise UnusableStoreError(f"{path} is a folder: move it away", "folder")
    if path.exists() and not path.is_file():
        raise UnusableStoreError(f"{path} is a pipe or a device: move it away", "device")
    if Path(os.path.realpath(path)).is_symlink():
        raise UnusableStoreError(f"{path} is a link that leads back to itself: remove it", "link")
    for beside in sidecar_obstacles(path):
        raise UnusableStoreError(f"{beside} is not a file of SQLite's: move it away", "beside")
    # SQLite would remove the log that lies beside a file that it does not know.
    if path.exists() and not _is_database(path):
        raise UnusableStoreError(f"{path} is not a store of heliocube, or its beginning is damaged", "foreign")
    connection = sqlite3.connect(path, timeout=_BUSY_S, isolation_level=None)
    try:
        with _as_store_errors(path):
            if not _is_empty(connection):
                # Before anything is written: the file may be another program's.
                check_is_store(connection, path)
                version: int = connection.execute("PRAGMA user_version").fetchone()[0]
                if version < VERSION:
                    keep_copy(connection, path, version)
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
                _bring_up_to_date(connection)
            connection.execute("COMMIT")
    except BaseException:
        connection.close()
        raise
    return connection


def _is_database(path: Path) -> bool:
    """Whether a file begins as SQLite's do; an empty one may become a store.

    SQLite reads it: if we opened and closed the file ourselves, the locks that this process has on it would be gone.
    """
    with closing(sqlite3.connect(f"{path.absolute().as_uri()}?immutable=1", uri=True)) as connection:
        try:
            connection.execute("PRAGMA schema_version")
        except sqlite3.DatabaseError as error:
            return error.sqlite_errorcode != sqlite3.SQLITE_NOTADB
    return True


def require_link_target(path: Path) -> None:
    """Raise `StoreError` if the store is a link into a folder that is not there, such as one on an unmounted disk."""
    target = Path(os.path.realpath(path))
    try:
        lost = path.is_symlink() and not target.parent.is_dir()
    except PermissionError:
        # Opening the store will report it.
        return
    if lost:
        raise StoreError(f"{path} is a link to {target}, whose folder is not there: mount its disk, or remove the link")


def require_store(path: Path) -> None:
    """Raise `StoreError` where there is no file of a store."""
    require_link_target(path)
    try:
        there = path.is_file()
    except PermissionError:
        raise _no_permission_error(path) from None
    if not there:
        raise StoreError(f"there is no store at {path}; name the folder that the service has as store.directory")


def open_for_reading(path: Path) -> sqlite3.Connection:
    """Open a store that is there, also while the service writes to it; raises `StoreError`."""
    require_store(path)
    # We ask and do not try to open it: closing it again would release the locks that this process holds on the store.
    if not os.access(path, os.R_OK, effective_ids=os.access in os.supports_effective_ids):
        raise _no_permission_error(path)
    connection = sqlite3.connect(f"{path.resolve().as_uri()}?mode=ro", uri=True, timeout=_BUSY_S, isolation_level=None)
    try:
        with _as_store_errors(path):
            check_is_store(connection, path)
    except sqlite3.Error as error:
        connection.close()
        raise unreadable_store_error(path, error) from None
    except BaseException:
        connection.close()
        raise
    return connection


def _no_permission_error(path: Path) -> StoreError:
    return StoreError(
        f"the store {path} may not be read by this user: it belongs to the user of its service, so run the command as"
        " that user, such as 'sudo -u heliocube heliocube ...'"
    )


def unreadable_store_error(path: Path, error: sqlite3.Error) -> StoreError:
    """Return the error to raise if a store cannot be read."""
    remedy = ""
    if damage_kind(error) is not None:
        remedy = f"; 'heliocube store salvage {path} --into FOLDER' gets what can be read from it"
    elif not os.access(path.parent, os.W_OK | os.X_OK, effective_ids=os.access in os.supports_effective_ids):
        remedy = (
            f"; SQLite writes beside a store even to read it, and this user cannot write in {path.parent}: copy the"
            " store, with the -wal beside it if there is one, into a folder of your own"
        )
    return StoreError(f"the store {path} cannot be read: {error}{remedy}")


class RowConverter:
    """Turns records of one kind into rows, and names the statement that stores them."""

    def __init__(self, kind: type[Row]) -> None:
        name, columns = COLUMNS[kind]
        self._values: Callable[[Any], tuple[Any, ...]] = attrgetter(*[column.path for column in columns])
        names = ", ".join(["run", "number", *[column.name for column in columns]])
        marks = ", ".join("?" * (len(columns) + 2))
        self.insert = f"INSERT OR IGNORE INTO {name} ({names}) VALUES ({marks})"  # noqa: S608 - our own names

    def row(self, run: int, number: int, record: Record) -> tuple[Any, ...]:
        """Return the row of one record; SQLite itself stores NaN as NULL."""
        return run, number, *self._values(with_irradiances(record))


def _is_empty(connection: sqlite3.Connection) -> bool:
    return not connection.execute("SELECT 1 FROM sqlite_master LIMIT 1").fetchone()


def _bring_up_to_date(connection: sqlite3.Connection) -> None:
    """Give a store of an older version the tables and columns that it lacks; a column goes to the end of its table."""
    if connection.execute("PRAGMA user_version").fetchone()[0] == VERSION:
        return
    for kind, (name, columns) in COLUMNS.items():
        there = columns_of(connection, name)
        if not there:
            for statement in _table(kind):
                connection.execute(statement)
            continue
        for column in columns:
            if column.name not in there:
                connection.execute(f"ALTER TABLE {name} ADD COLUMN {column.name} {_TYPES[column.holds]}")
    for name in sorted({"tracker", "id"} - columns_of(connection, "runs")):
        connection.execute(f"ALTER TABLE runs ADD COLUMN {name} TEXT NOT NULL DEFAULT ''")
    connection.execute(f"PRAGMA user_version = {VERSION}")


def columns_of(connection: sqlite3.Connection, table: str, database: str = "main") -> set[str]:
    """Return the names of a table's columns, which in a store of an older version are fewer; none without the table."""
    return {row[1] for row in connection.execute(f"PRAGMA {database}.table_info({table})")}


def tracker_sql(connection: sqlite3.Connection, table: str, alias: str) -> str:
    """Return SQL for the name of a record's tracker, in a query that joins a table under an alias with `runs`.

    A run of one tracker has its name; in a run of several each record has it. Stores of older versions have neither.
    """
    known = [(alias_of, columns_of(connection, of)) for alias_of, of in (("runs", "runs"), (alias, table))]
    names = [f"NULLIF({alias_of}.tracker, '')" for alias_of, columns in known if "tracker" in columns]
    return f"COALESCE({', '.join([*names, *['NULL', repr('')]])})"


def check_is_store(connection: sqlite3.Connection, path: Path) -> None:
    """Raise `UnusableStoreError` for another program's database, and for the store of a newer version."""
    if connection.execute("PRAGMA application_id").fetchone()[0] != _APPLICATION:
        sentence = f"{path} is not a store of heliocube; name another folder, or move the file away"
        raise UnusableStoreError(sentence, "foreign")
    version = connection.execute("PRAGMA user_version").fetchone()[0]
    if version > VERSION:
        raise UnusableStoreError(
            f"the store {path} is of version {version} and this program knows version {VERSION}: it was written by a"
            " newer heliocube; update this program, or name another folder",
            "newer",
        )


@contextmanager
def _as_store_errors(path: Path) -> Iterator[None]:
    try:
        yield
    except sqlite3.Error as error:
        kind = damage_kind(error)
        if kind is None:
            raise
        remedy = f"'heliocube store salvage {path} --into FOLDER' gets what can be read from it"
        sentence = f"{path} is not a store of heliocube, or is damaged ({error}); {remedy}"
        raise UnusableStoreError(sentence, kind) from None


def damage_kind(error: sqlite3.Error) -> str | None:
    """Return what an error says about the file, ``damaged`` or ``foreign``; None for one that may go away by itself."""
    code = getattr(error, "sqlite_errorcode", None)
    if code is None:
        # Python raises this one without a code, for a text in the file that is not UTF-8.
        return "damaged" if isinstance(error, sqlite3.OperationalError) else None
    if code & 0xFF == sqlite3.SQLITE_NOTADB:
        return "foreign"
    # SQLITE_ERROR is for SQL that does not fit the tables, and ours fits every store that is whole.
    damaged = (sqlite3.SQLITE_CORRUPT, sqlite3.SQLITE_ERROR, sqlite3.SQLITE_MISMATCH, sqlite3.SQLITE_FORMAT)
    unreadable = (sqlite3.SQLITE_IOERR_READ, sqlite3.SQLITE_IOERR_SHORT_READ)
    return "damaged" if code & 0xFF in damaged or code in unreadable else None
