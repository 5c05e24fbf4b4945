"""What can be read from a damaged store, or one of another version, written into a store that is whole."""

import contextlib
import math
import os
import shutil
import sqlite3
import struct
import tempfile
from collections.abc import Callable, Iterator
from contextlib import closing
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from daemon.base.errors import UserError
from daemon.base.files import give_to_folder_owner, make_folder
from daemon.store.copies import copies_of
from daemon.store.schema import FILE_NAME, RUN_COLUMNS, UnusableStoreError, check_is_store, columns_of, open_for_writing
from daemon.store.tables import COLUMNS, Column
from daemon.store.unusable_store import sidecar_files

_ROWS_AT_ONCE = 1000
_DAY_S = 86400.0
# After a number that was read, a gap is searched no further than this.
_WIDEST_GAP = 1 << 24
# Runs after the last one in the list of runs are tried too, because the list may be damaged.
_MORE_RUNS = 100
_HEADER_BYTES = 100
_MAGIC = b"SQLite format 3\0"
_HOLDS: dict[str, tuple[type, ...]] = {
    "time": (float, int),
    "float": (float, int),
    "int": (int,),
    "bool": (int,),
    "text": (str,),
}
_Row = tuple[Any, ...]


@dataclass
class Salvaged:
    """The result: records by kind that were read, and those of them that the store did not have; how the file was.

    Attributes
    ----------
    damaged
        Whether SQLite says that the file is.
    missing
        Numbers between those that were read, per run: records that cannot be read, or were lost before.
    simulated
        Whether simulated instruments are behind any of them.
    """

    damaged: bool
    read: dict[str, int] = field(default_factory=dict)
    added: dict[str, int] = field(default_factory=dict)
    missing: int = 0
    simulated: bool = False


def salvage(file: Path, into: Path, progress: Callable[[float], None] = lambda _share: None) -> Salvaged:
    """Write what can be read from a store's file into the store of a folder, made if it is missing.

    The file itself is never opened, only a copy in `into`, which is removed again. A second salvage adds nothing.

    Parameters
    ----------
    file
        The store, with what SQLite left beside it.
    into
        Folder of the other store; a service may be writing to it.
    progress
        Told which share of the records has been read, 0..1, as far as the runs' numbers can be known.

    Raises
    ------
    UserError
        There is nothing of a store in the file; or the folder cannot take the copy or the records.
    """
    if not file.is_file():
        raise UserError(f"there is no file {file} to salvage: name a store, such as one that was moved aside")
    target = into / FILE_NAME
    if target.exists() and target.samefile(file):
        raise UserError(f"{file} is the store of {into} itself: name another folder with --into")
    is_new = not into.exists()
    try:
        make_folder(into)
        with tempfile.TemporaryDirectory(prefix=".salvage-", dir=into) as scratch:
            copy = _copy(file, Path(scratch))
            with closing(_open(copy, file)) as source, closing(_open_for_owner(target)) as store:
                return _Merge(source, store, progress).run()
    except sqlite3.Error as error:
        raise UserError(f"{target} cannot take the records: {error}") from None
    except OSError as error:
        raise UserError(f"{into} cannot take the records and a copy of {file}: {error.strerror}") from None
    finally:
        if is_new:
            # This removes it only if it is empty.
            with contextlib.suppress(OSError):
                into.rmdir()


def _open_for_owner(target: Path) -> sqlite3.Connection:
    """Open the store that takes the records, and give it to its folder's owner: a service cannot write to root's."""
    if not target.exists():
        target.touch(0o600)
        give_to_folder_owner(target)
    connection = open_for_writing(target)
    for copy in copies_of(target.parent):
        give_to_folder_owner(copy)
    return connection


def _copy(file: Path, scratch: Path) -> Path:
    copy = scratch / "copy.sqlite"
    shutil.copyfile(file, copy)
    for beside in sidecar_files(file):
        # SQLite makes -shm, its index of the log, anew. In the place of a log there may be a folder.
        if beside.is_file() and not beside.name.endswith("-shm"):
            shutil.copyfile(beside, f"{copy}{str(beside).removeprefix(str(file))}")
    _lengthen(copy)
    return copy


def _lengthen(copy: Path) -> None:
    """Give a truncated file the length that its header names: SQLite reads nothing from one that is shorter."""
    with copy.open("r+b") as file:
        header = file.read(_HEADER_BYTES)
        if len(header) < _HEADER_BYTES or not header.startswith(_MAGIC):
            return
        page_bytes, pages = struct.unpack(">H", header[16:18])[0], struct.unpack(">I", header[28:32])[0]
        page_bytes = 65536 if page_bytes == 1 else page_bytes
        # Zeros take no room on the disk; a header that names more than this is itself damaged.
        if file.seek(0, os.SEEK_END) < page_bytes * pages <= 1 << 40:
            file.truncate(page_bytes * pages)


def _open(copy: Path, file: Path) -> sqlite3.Connection:
    connection = _connect(copy)
    try:
        check_is_store(connection, file)
        if not columns_of(connection, "scans"):
            raise sqlite3.DatabaseError("no tables")
    except UnusableStoreError as error:
        # Tables and columns of a newer store that this version does not know stay in the file.
        if error.kind != "newer":
            connection.close()
            raise
    except sqlite3.Error:
        connection.close()
        _graft_first_page(copy, file)
        connection = _connect(copy)
    return connection


def _connect(copy: Path) -> sqlite3.Connection:
    connection = sqlite3.connect(copy, isolation_level=None)
    # So that SQLite reads on in spite of errors in the schema.
    connection.execute("PRAGMA writable_schema = ON")
    return connection


def _graft_first_page(copy: Path, file: Path) -> None:
    """Put the first page of a new store, which has the list of tables, before pages whose own is unreadable."""
    fresh = copy.with_name("fresh.sqlite")
    open_for_writing(fresh).close()
    page = bytearray(fresh.read_bytes())
    page_bytes = struct.unpack(">H", page[16:18])[0]
    del page[page_bytes:]
    pages = copy.stat().st_size // page_bytes
    if pages < 2:
        raise UserError(f"nothing of a store can be read from {file}")
    page[28:32] = struct.pack(">I", pages)
    page[92:96] = page[24:28]
    for beside in sidecar_files(copy):
        # A log without the page that it begins with says nothing.
        beside.unlink()
    with copy.open("r+b") as damaged:
        damaged.write(page)
        damaged.truncate(pages * page_bytes)


class _Merge:
    """One pass from a store that may be damaged to one that is not."""

    def __init__(
        self, source: sqlite3.Connection, store: sqlite3.Connection, progress: Callable[[float], None]
    ) -> None:
        self._source = source
        self._store = store
        self._progress = progress
        self._run_in_store: dict[int, int] = {}
        self._known = self._read_runs()
        self._expected = max(sum(self._last_number(run) + 1 for run in self._known), 1)
        self._number_ranges: dict[int, list[int]] = {}
        self._simulated = False

    def run(self) -> Salvaged:
        found = Salvaged(damaged=self._is_damaged())
        for name, columns in COLUMNS.values():
            found.read[name], found.added[name] = self._merge(name, columns)
        for first, last, count in self._number_ranges.values():
            found.missing += last - first + 1 - count
        found.simulated = self._simulated
        if not sum(found.read.values()):
            raise UserError("nothing can be read from the store to salvage: no record of any kind is whole")
        return found

    def _is_damaged(self) -> bool:
        try:
            return [row[0] for row in self._source.execute("PRAGMA quick_check(1)")] != ["ok"]
        except sqlite3.Error:
            return True

    def _read_runs(self) -> dict[int, _Row]:
        there = columns_of(self._source, "runs")
        names = ", ".join(name if name in there else "''" for name in RUN_COLUMNS)
        known: dict[int, _Row] = {}
        try:
            for run, *values in self._source.execute(f"SELECT run, {names} FROM runs ORDER BY run"):  # noqa: S608 - our own names
                if None not in values:
                    known[run] = tuple(values)
        except sqlite3.Error:
            # The runs that were read up to here count; records of other runs are salvaged all the same.
            pass
        return known

    def _last_number(self, run: int) -> int:
        """Return the highest number of a run, which counts over all kinds; -1 where none can be read."""
        last = -1
        for name, _ in COLUMNS.values():
            with contextlib.suppress(sqlite3.Error):
                found = self._source.execute(f"SELECT max(number) FROM {name} WHERE run = ?", (run,)).fetchone()[0]  # noqa: S608 - our own names
                last = max(last, found) if isinstance(found, int) else last
        return last

    def _merge(self, name: str, columns: list[Column]) -> tuple[int, int]:
        there = columns_of(self._source, name)
        if not there:
            return 0, 0
        wanted = ["run", "number", *(column.name if column.name in there else "NULL" for column in columns)]
        marks = ", ".join("?" * len(wanted))
        own = ", ".join(["run", "number", *(column.name for column in columns)])
        insert = f"INSERT OR IGNORE INTO {name} ({own}) VALUES ({marks})"  # noqa: S608 - our own names
        read = added = 0
        batch: list[_Row] = []
        for row in _Reader(self._source, name, ", ".join(wanted), columns, max(self._known, default=0) + _MORE_RUNS):
            self._count(row[0], row[1])
            batch.append(row)
            if len(batch) == _ROWS_AT_ONCE:
                read, added, batch = read + len(batch), added + self._write(insert, batch), []
                self._progress(min(sum(count for _, _, count in self._number_ranges.values()) / self._expected, 1.0))
        return read + len(batch), added + self._write(insert, batch)

    def _count(self, run: int, number: int) -> None:
        first, last, count = self._number_ranges.get(run, (number, number, 0))
        self._number_ranges[run] = [min(first, number), max(last, number), count + 1]

    def _write(self, insert: str, rows: list[_Row]) -> int:
        """Write rows in one transaction, so that a service that writes to the same store waits for moments only."""
        if not rows:
            return 0
        self._store.execute("BEGIN IMMEDIATE")
        try:
            moved = [(self._run_of(row), *row[1:]) for row in rows]
            count = self._store.executemany(insert, moved).rowcount
            days = {int(row[2] // _DAY_S) for row in rows}
            self._store.executemany("INSERT OR IGNORE INTO days VALUES (?)", [(day,) for day in days])
            self._store.execute("COMMIT")
        except BaseException:
            if self._store.in_transaction:
                self._store.execute("ROLLBACK")
            raise
        return max(count, 0)

    def _run_of(self, row: _Row) -> int:
        """Return the number that a row's run has in the store: that of the same run if it is there, else a new one."""
        if row[0] not in self._run_in_store:
            own = self._known.get(row[0]) or self._guess_run(row)
            self._simulated |= bool(own[RUN_COLUMNS.index("simulated")])
            same = " AND ".join(f"{name} = ?" for name in RUN_COLUMNS)
            found = self._store.execute(f"SELECT run FROM runs WHERE {same}", own).fetchone()  # noqa: S608 - our own names
            if found is None:
                marks = ", ".join("?" * len(RUN_COLUMNS))
                made = self._store.execute(f"INSERT INTO runs ({', '.join(RUN_COLUMNS)}) VALUES ({marks})", own)  # noqa: S608 - our own names
                found = (made.lastrowid,)
            self._run_in_store[row[0]] = found[0]
        return self._run_in_store[row[0]]

    def _guess_run(self, row: _Row) -> _Row:
        """Return values for a run of which nothing is known: the site of the nearest run, and an unknown role."""
        nearest = min(self._known, key=lambda run: abs(run - row[0]), default=None)
        like = (0.0, "", "", 1, "unknown", 0.0, 0.0, 0.0, "", "") if nearest is None else self._known[nearest]
        return (float(row[0]), "unknown", "salvaged", *like[3:-1], "")


class _Reader:
    """The rows of a table in the order of their key; the reading goes on after every place that cannot be read."""

    def __init__(
        self, source: sqlite3.Connection, name: str, wanted: str, columns: list[Column], last_run: int
    ) -> None:
        self._source = source
        self._query = f"SELECT {wanted} FROM {name} WHERE (run, number) > (?, ?) ORDER BY run, number LIMIT ?"  # noqa: S608 - our own names
        self._columns = columns
        self._last_run = last_run

    def __iter__(self) -> Iterator[_Row]:
        key: tuple[int, int] | None = (-1, -1)
        while key is not None:
            try:
                for row in self._source.execute(self._query, (*key, -1)):
                    after = row[:2]
                    # Pages that lead in a circle are damage as well.
                    if not self._is_key(after) or after <= key:
                        raise sqlite3.DatabaseError("keys out of order")
                    key = after
                    if self._is_whole(row):
                        yield row
            except sqlite3.Error:
                key = self._first_key_beyond_damage(key)
            else:
                return

    def _first_key_beyond_damage(self, key: tuple[int, int]) -> tuple[int, int] | None:
        """Return the least key after which rows can be read again beyond an unreadable place; None if there is none."""
        run, number = max(key[0], 0), max(key[1], -1)
        while True:
            step, unreadable = 1, 0
            while step <= _WIDEST_GAP:
                if self._is_readable_after((run, number + step)):
                    return self._bisect_readable(run, number + unreadable, number + step)
                step, unreadable = step * 2, step
            run, number = run + 1, -1
            if run > self._last_run:
                return None
            if self._is_readable_after((run, number)):
                return run, number

    def _bisect_readable(self, run: int, unreadable: int, readable: int) -> tuple[int, int]:
        while readable - unreadable > 1:
            middle = (unreadable + readable) // 2
            if self._is_readable_after((run, middle)):
                readable = middle
            else:
                unreadable = middle
        return run, readable

    def _is_readable_after(self, key: tuple[int, int]) -> bool:
        """Whether there is a row after a key, and it can be read."""
        try:
            found = self._source.execute(self._query, (*key, 1)).fetchone()
        except sqlite3.Error:
            return False
        return found is not None and self._is_key(found[:2]) and found[:2] > key

    def _is_key(self, key: _Row) -> bool:
        return all(isinstance(part, int) and 0 <= part < 1 << 53 for part in key)

    def _is_whole(self, row: _Row) -> bool:
        """Whether every value is of its column's kind: a page of rubbish may look like rows."""
        time_s = row[2]
        if not isinstance(time_s, float | int) or not -math.inf < time_s < math.inf:
            return False
        pairs = zip(row[2:], self._columns, strict=True)
        return all(value is None or isinstance(value, _HOLDS[column.holds]) for value, column in pairs)
