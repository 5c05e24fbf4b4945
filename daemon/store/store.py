"""The store: every record of the service, kept in one SQLite file by a thread that nobody waits for."""

import contextlib
import logging
import math
import os
import shutil
import sqlite3
import threading
from collections import deque
from collections.abc import Callable
from contextlib import closing
from dataclasses import astuple, dataclass
from itertools import groupby
from pathlib import Path
from typing import Any
from uuid import uuid4

from daemon.base.clock import Clock
from daemon.base.reconnect import Outage
from daemon.base.records import Event, Record
from daemon.base.words import pluralise
from daemon.store.schema import (
    FILE_NAME,
    RUN_COLUMNS,
    RowConverter,
    StoreError,
    UnusableStoreError,
    damage_kind,
    open_for_writing,
)
from daemon.store.tables import COLUMNS
from daemon.store.unusable_store import aside_text, move_aside

log = logging.getLogger("heliocube.store")

_BATCH_ROWS = 1000
# About 25 MB, and several hours of records unless simulated time runs faster.
_MOST_WAITING = 50_000
_CLOSE_WITHIN_S = 10.0
_DELETE_ROWS = 5000
_DAY_S = 86400.0
_MOVE_AGAIN_S = 3600.0
# SQLite needs a few pages to begin anything at all.
_ROOM_BYTES = 65536


@dataclass(frozen=True, slots=True)
class Origin:
    """Which run of the service the records come from, the name of its tracker, and an identifier that no other run has.

    `id` is made anew at each start, by `new_run_id`; it is empty for runs from before there were identifiers.
    """

    started_utc_s: float
    role: str
    version: str
    simulated: bool
    site: str
    latitude_deg: float
    longitude_deg: float
    altitude_m: float
    tracker: str = ""
    id: str = ""


def new_run_id() -> str:
    """Return an identifier that no other run has, on this machine or another."""
    return uuid4().hex


@dataclass(frozen=True, slots=True)
class StoreStatus:
    """The state of the store.

    Attributes
    ----------
    path
        Its file.
    written, waiting, lost
        Records of this run that are in the file, that wait for the next batch, and that found no room to wait in.
    down_why
        Why it cannot write, or None.
    """

    path: Path
    written: int
    waiting: int
    lost: int
    down_why: str | None


class Store:
    """Keeps records; taking one never blocks and never fails.

    A batch is written after `batch_s` seconds of wall time at the latest, in one transaction. While the disk is full
    or fails, records wait in memory, the oldest giving way, and writing is tried again after the same time. If what is
    in the store's place cannot be a store, or is found damaged, it is moved aside, and a new store begun.

    Parameters
    ----------
    directory
        Of the file; made if it is missing.
    batch_s, keep_days
        Longest time until a record is written [s]; how many days with records are kept, None for all.
    origin
        This run of the service.
    clock
        The service's time.
    publish
        Called from the store's own thread with events about the store itself.
    alarm
        Called from the same thread with an alarm's name and its text, None at its end.
    """

    def __init__(
        self,
        directory: Path,
        batch_s: float,
        keep_days: int | None,
        origin: Origin,
        clock: Clock,
        publish: Callable[[Event], None],
        alarm: Callable[[str, str | None], None] = lambda _name, _text: None,
    ) -> None:
        self._path = directory / FILE_NAME
        self._batch_s = batch_s
        self._keep_days = keep_days
        self._origin = origin
        self._clock = clock
        self._publish = publish
        self._set_alarm = alarm
        self._outage = Outage(log, "the store")
        self._rows = {kind: RowConverter(kind) for kind in COLUMNS}
        self._waiting: deque[tuple[int, Record]] = deque(maxlen=_MOST_WAITING)
        self._changed = threading.Condition()
        self._closing = False
        self._next_number = 0
        self._written = 0
        self._lost = 0
        self._reported_lost = 0
        self._run: int | None = None
        self._days: set[int] = set()
        self._moved_s = -math.inf
        self._alarms: dict[str, str | None] = {}
        self._thread = threading.Thread(target=self._work, name="store", daemon=True)
        self._thread.start()

    def keep(self, record: Record) -> None:
        """Take one record; a subscriber of the bus."""
        with self._changed:
            if len(self._waiting) == _MOST_WAITING:
                self._lost += 1
            self._waiting.append((self._next_number, record))
            self._next_number += 1
            if len(self._waiting) == _BATCH_ROWS:
                self._changed.notify()

    @property
    def status(self) -> StoreStatus:
        """A snapshot for displays."""
        with self._changed:
            down_why = self._outage.reason if self._outage.is_down else None
            return StoreStatus(
                path=self._path, written=self._written, waiting=len(self._waiting), lost=self._lost, down_why=down_why
            )

    def close(self) -> None:
        """Write the records that wait, and end; after a few seconds give up, and log how many were lost."""
        with self._changed:
            self._closing = True
            self._changed.notify()
        self._thread.join(_CLOSE_WITHIN_S)
        waiting = self.status.waiting
        if waiting:
            log.error("the store is closed and %d records could not be written", waiting)

    def _work(self) -> None:
        """Write batch after batch, with a new connection after every failure."""
        while True:
            try:
                self._path.parent.mkdir(parents=True, exist_ok=True)
                with closing(open_for_writing(self._path)) as connection:
                    self._write_batches(connection)
            except (sqlite3.Error, OSError, StoreError) as error:
                if self._try_to_move_aside(error):
                    continue
                self._report_failure(self._reason(error))
            except Exception as error:
                log.exception("the store's thread has failed")
                self._report_failure(repr(error))
            else:
                return
            with self._changed:
                if self._closing:
                    return
                self._changed.wait_for(lambda: self._closing, self._batch_s)

    def _try_to_move_aside(self, error: Exception) -> bool:
        """Move an unusable store out of the way, if that caused the error; return whether a new store can begin."""
        try:
            kind = self._unusable_kind(error)
            # A disk that damages one store after the other must not fill up with them.
            if kind is None or not self._clock.monotonic() - self._moved_s >= _MOVE_AGAIN_S:
                return False
            aside = move_aside(self._path, kind, self._clock.utc())
        except OSError:
            return False
        self._moved_s = self._clock.monotonic()
        if kind == "beside":
            log.error("the store %s could not be used (%s): what was in the way is %s now", self._path, error, aside)
            return True
        self._forget_file()
        log.error("the store %s cannot be used (%s): it is %s now, and a new store begins", self._path, error, aside)
        return True

    def _forget_file(self) -> None:
        self._run = None
        self._days.clear()

    def _unusable_kind(self, error: Exception) -> str | None:
        """Return why the file in the store's place can never be used, of `KINDS`; None if the error may pass."""
        if isinstance(error, UnusableStoreError):
            return error.kind
        if not self._path.is_file():
            return None
        if not os.access(self._path, os.R_OK | os.W_OK) and os.access(self._path.parent, os.W_OK):
            return "locked"
        return damage_kind(error) if isinstance(error, sqlite3.Error) else None

    def _check_aside(self) -> None:
        self._alarm("store-aside", aside_text(self._path))

    def _alarm(self, name: str, text: str | None) -> None:
        if self._alarms.get(name) != text:
            self._alarms[name] = text
            self._set_alarm(name, text)

    def _write_batches(self, connection: sqlite3.Connection) -> None:
        opened = self._path.stat()
        while True:
            self._check_aside()
            with self._changed:
                self._changed.wait_for(lambda: self._closing or len(self._waiting) >= _BATCH_ROWS, self._batch_s)
                ended = self._closing
                batch = [self._waiting[index] for index in range(min(len(self._waiting), _BATCH_ROWS))]
            if batch:
                self._check_place(connection, opened)
                self._write(connection, batch)
                self._note_written(batch[-1][0], len(batch))
            if ended and len(batch) < _BATCH_ROWS:
                return

    def _check_place(self, connection: sqlite3.Connection, opened: os.stat_result) -> None:
        """Raise `StoreError` if another file is in the store's place, or none: SQLite would go on with the old one."""
        with contextlib.suppress(FileNotFoundError):
            if os.path.samestat(opened, self._path.stat()):
                return
        # The records in the log belong to the file that was moved, and not to the next one.
        with contextlib.suppress(sqlite3.Error):
            connection.execute("PRAGMA wal_checkpoint(TRUNCATE)")
        self._forget_file()
        raise StoreError(f"{self._path} was removed or replaced while it was in use")

    def _write(self, connection: sqlite3.Connection, batch: list[tuple[int, Record]]) -> None:
        days = {int(record.time_utc_s // _DAY_S) for _, record in batch}
        if self._run is None:
            self._run = self._begin_run(connection)
        connection.execute("BEGIN IMMEDIATE")
        try:
            by_kind = sorted(batch, key=lambda item: type(item[1]).__name__)
            for kind, items in groupby(by_kind, key=lambda item: type(item[1])):
                rows = self._rows[kind]
                _insert(connection, rows.insert, [rows.row(self._run, number, record) for number, record in items])
            connection.executemany("INSERT OR IGNORE INTO days VALUES (?)", [(day,) for day in days])
            connection.execute("COMMIT")
        except BaseException:
            with contextlib.suppress(sqlite3.Error):
                if connection.in_transaction:
                    connection.execute("ROLLBACK")
            raise
        if self._keep_days is not None and not days <= self._days:
            self._days |= days
            self._delete_oldest_days(connection, self._keep_days)

    def _begin_run(self, connection: sqlite3.Connection) -> int:
        marks = ", ".join("?" * len(RUN_COLUMNS))
        cursor = connection.execute(
            f"INSERT INTO runs ({', '.join(RUN_COLUMNS)}) VALUES ({marks})",  # noqa: S608 - our own names
            astuple(self._origin),
        )
        assert cursor.lastrowid is not None  # noqa: S101 - narrowing; an insertion has one
        return cursor.lastrowid

    def _delete_oldest_days(self, connection: sqlite3.Connection, keep_days: int) -> None:
        """Forget the oldest days. Days that have records are counted: a clock set wrong cannot empty the store."""
        last = connection.execute("SELECT day FROM days ORDER BY day DESC LIMIT 1 OFFSET ?", (keep_days,))
        found = last.fetchone()
        if found is None:
            return
        end_s = (found[0] + 1) * _DAY_S
        for name, _ in COLUMNS.values():
            which = f"SELECT run, number FROM {name} WHERE time < ? LIMIT ?"  # noqa: S608 - our own names
            delete = f"DELETE FROM {name} WHERE (run, number) IN ({which})"  # noqa: S608 - our own names
            while connection.execute(delete, (end_s, _DELETE_ROWS)).rowcount == _DELETE_ROWS:
                pass
        connection.execute("DELETE FROM days WHERE day <= ?", found)

    def _note_written(self, last: int, count: int) -> None:
        with self._changed:
            # If the queue was full meanwhile, the oldest of the batch have left it already. They are written, not lost.
            while self._waiting and self._waiting[0][0] <= last:
                self._waiting.popleft()
            self._written += count
            self._lost = self._next_number - self._written - len(self._waiting)
            lost = self._lost - self._reported_lost
            reported = self._outage.up(self._clock.monotonic())
            if reported:
                self._reported_lost = self._lost
        self._alarm("store-down", None)
        if reported:
            what = pluralise(lost, "record was", "records were") if lost else "nothing was"
            self._report(f"writes again; {what} lost")

    def _reason(self, error: Exception) -> str:
        """Return what is wrong in words; SQLite has several errors for a full disk, some of which do not say so."""
        full = f"the disk of {self._path.parent} is full"
        # First of all: the rollback of a batch may have left more room than the check below asks for.
        if getattr(error, "sqlite_errorcode", None) == sqlite3.SQLITE_FULL:
            return full
        with contextlib.suppress(OSError):
            if shutil.disk_usage(self._path.parent).free < _ROOM_BYTES:
                return full
        if isinstance(error, OSError) and error.strerror:
            return f"{error.filename or self._path.parent}: {error.strerror}"
        return str(error)

    def _report_failure(self, reason: str) -> None:
        with self._changed:
            first = not self._outage.is_down
            reported = self._outage.down(self._clock.monotonic(), reason)
        if first and reported:
            self._report(f"cannot write: {reason}; records wait in memory")
        self._alarm("store-down", f"the store cannot write: {reason}; records wait in memory")

    def _report(self, text: str) -> None:
        self._publish(Event(self._clock.utc(), self._clock.monotonic(), "store", text))


def _insert(connection: sqlite3.Connection, statement: str, rows: list[tuple[Any, ...]]) -> None:
    try:
        connection.executemany(statement, rows)
    except UnicodeEncodeError:
        # A lone surrogate in one text would keep out all rows after it. Rows that are in already are ignored.
        connection.executemany(statement, [tuple(map(_without_surrogates, row)) for row in rows])


def _without_surrogates(value: Any) -> Any:
    return value.encode("utf-8", "replace").decode() if isinstance(value, str) else value
