"""Records of one installation out of an archive, as a store: every program that reads a store can read them."""

import math
import sqlite3
from collections.abc import Iterator
from contextlib import closing, contextmanager
from datetime import UTC, datetime
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any, NamedTuple

from daemon.archive.address import ArchiveAddress, ArchiveError, connect_to_archive, translate_database_errors
from daemon.archive.tables import COLUMNS_OF, SCHEMA, check_is_archive, missing_columns
from daemon.store.batches import KINDS
from daemon.store.schema import FILE_NAME, RUN_COLUMNS, open_for_writing

if TYPE_CHECKING:
    import psycopg

_ROWS_AT_ONCE = 5000
_DAY_S = 86400.0
_MOST_NAMES = 8
# In a run's row, which begins with its number.
_LONGITUDE = 1 + RUN_COLUMNS.index("longitude_deg")


class ArchivedRun(NamedTuple):
    """A run's row for a store, and where its site is [degrees east]."""

    row: tuple[Any, ...]
    longitude_deg: float


class ArchiveReader:
    """One installation of an archive, all as it was at one instant.

    Parameters
    ----------
    address
        Of the database; without an installation it is the only one there.

    Raises
    ------
    ArchiveError
        There is no archive, or no such installation, or there are several.
    """

    def __init__(self, address: ArchiveAddress) -> None:
        self.address = address
        self._connection = connect_to_archive(address, "heliocube reader")
        try:
            with translate_database_errors(address):
                self._connection.execute("SET TRANSACTION ISOLATION LEVEL REPEATABLE READ READ ONLY")
                check_is_archive(self._connection, address)
                self.installation = self._choose_installation()
                self.runs = self._runs()
        except BaseException:
            self.close()
            raise

    def close(self) -> None:
        """End the connection."""
        self._connection.close()

    @property
    def longitude_deg(self) -> float:
        """Where the installation is, by its last run."""
        return self.runs[-1].longitude_deg

    def copy(self, directory: Path, start_utc_s: float = -math.inf, end_utc_s: float = math.inf) -> int:
        """Make a store of the records from `start_utc_s` up to, not including, `end_utc_s`; return how many there are.

        Runs keep the number that they have in the archive.
        """
        count = 0
        with translate_database_errors(self.address), closing(open_for_writing(directory / FILE_NAME)) as store:
            store.execute("PRAGMA synchronous = OFF")
            store.execute("BEGIN")
            marks = ", ".join("?" * (1 + len(RUN_COLUMNS)))
            store.executemany(f"INSERT INTO runs VALUES ({marks})", [run.row for run in self.runs])  # noqa: S608 - marks
            days: set[int] = set()
            for name in KINDS:
                marks = ", ".join("?" * (len(COLUMNS_OF[name]) + 2))
                for rows in self._rows(name, start_utc_s, end_utc_s):
                    store.executemany(f"INSERT OR IGNORE INTO {name} VALUES ({marks})", rows)  # noqa: S608 - our own
                    days |= {int(row[2] // _DAY_S) for row in rows}
                    count += len(rows)
            store.executemany("INSERT INTO days VALUES (?)", [(day,) for day in sorted(days)])
            store.execute("COMMIT")
        return count

    def _choose_installation(self) -> str:
        rows = self._connection.execute(f"SELECT DISTINCT installation FROM {SCHEMA}.runs ORDER BY 1").fetchall()  # noqa: S608 - ours
        names = [row[0] for row in rows]
        wanted = self.address.installation
        if wanted in names or (not wanted and len(names) == 1):
            return wanted or names[0]
        known = ", ".join(names[:_MOST_NAMES]) + (f" and {len(names) - _MOST_NAMES} more" * (len(names) > _MOST_NAMES))
        if not names:
            raise ArchiveError(f"{self.address.url} holds nothing yet")
        if wanted:
            raise ArchiveError(f"{self.address.url} knows no installation {wanted}: it has {known}")
        raise ArchiveError(f"{self.address.url} has {known}: put one of them behind the address, after a #")

    def _runs(self) -> list[ArchivedRun]:
        wanted = ", ".join(["run", "extract(epoch FROM started)::float8", *RUN_COLUMNS[1:]])
        rows = self._connection.execute(
            f"SELECT {wanted} FROM {SCHEMA}.runs WHERE installation = %s ORDER BY started, run",  # noqa: S608 - ours
            (self.installation,),
        ).fetchall()
        return [ArchivedRun(tuple(row), row[_LONGITUDE]) for row in rows]

    def _rows(self, name: str, start_utc_s: float, end_utc_s: float) -> "Iterator[list[tuple[Any, ...]]]":
        lacking = {column.name for column in missing_columns(self._connection, name)}
        wanted = ", ".join(
            "NULL"
            if column.name in lacking
            else f"extract(epoch FROM {column.name})::float8"
            if column.holds == "time"
            else column.name
            for column in COLUMNS_OF[name]
        )
        query = (
            f"SELECT run, number, {wanted} FROM {SCHEMA}.{name}"  # noqa: S608 - our own names
            " WHERE run = ANY(%s) AND time >= %s AND time < %s ORDER BY run, number"
        )
        values = ([run.row[0] for run in self.runs], _bound(start_utc_s), _bound(end_utc_s))
        with self._cursor(f"of_{name}") as cursor:
            cursor.execute(query, values)
            while rows := cursor.fetchmany(_ROWS_AT_ONCE):
                yield rows

    def _cursor(self, name: str) -> "psycopg.ServerCursor[tuple[Any, ...]]":
        return self._connection.cursor(name, binary=True)


def _bound(utc_s: float) -> datetime | str:
    return datetime.fromtimestamp(utc_s, UTC) if math.isfinite(utc_s) else f"{'-' * (utc_s < 0)}infinity"


@contextmanager
def temporary_store(reader: ArchiveReader, start_utc_s: float, end_utc_s: float) -> Iterator[Path]:
    """Give a temporary folder with the records of a span as a store; raises `ArchiveError` if there are none."""
    with TemporaryDirectory(prefix="heliocube-archive-") as folder:
        try:
            count = reader.copy(Path(folder), start_utc_s, end_utc_s)
        except sqlite3.Error as error:
            raise ArchiveError(
                f"{folder} cannot take the records of {reader.installation} ({error}): make room there, name another"
                " folder with TMPDIR, or ask for a shorter time"
            ) from None
        if not count:
            raise ArchiveError(f"{reader.address.url} has no record of {reader.installation} in that time")
        yield Path(folder)
