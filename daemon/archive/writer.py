"""Writes pages of records into the tables: binary, and each record once, however often it comes."""

import contextlib
import json
import os
import socket
from collections import defaultdict
from collections.abc import Iterator, Sequence
from dataclasses import astuple
from datetime import UTC, datetime
from itertools import groupby
from typing import Any, NamedTuple

from daemon.archive.address import ArchiveAddress, connect_to_archive, translate_database_errors
from daemon.archive.tables import (
    COLUMNS_OF,
    SCHEMA,
    SET_ASIDE,
    TYPES,
    columns_sql,
    create_day_partitions,
    ensure_tables,
    partitioned_tables,
)
from daemon.store.batches import KINDS, MOST_ROWS, Batch
from daemon.store.schema import RUN_COLUMNS
from daemon.store.store import Origin

_EPOCH = datetime(1970, 1, 1, tzinfo=UTC)
# Within this time two services that send in turns are noticed.
_RIVALS_WITHIN = "10 min"


class SentPage(NamedTuple):
    """A page and its installation; `live` if it came over a broker."""

    installation: str
    batch: Batch
    live: bool = True


class WriteResult(NamedTuple):
    """What came of pages: how many records were new, and sentences about two services that send under one name."""

    added: int
    name_conflicts: list[str]


class RefusedRecord(NamedTuple):
    """A record that the database does not take: its kind, its number with the values of its columns, and why."""

    kind: str
    row: tuple[Any, ...]
    why: str


class ArchiveWriter:
    """One connection that writes, `prepare` first; not for several threads at once.

    Parameters
    ----------
    address
        Of the database.

    Raises
    ------
    ArchiveError
        It cannot be used as it is; `ArchiveUnreachableError` while it does not answer.
    """

    def __init__(self, address: ArchiveAddress) -> None:
        self._address = address
        self._runs: dict[tuple[str, str], int] = {}
        self._days: set[tuple[str, int]] = set()
        self._partitioned_tables: set[str] = set()
        self._connection = connect_to_archive(address, "heliocube archive")
        self._connection.autocommit = True

    def prepare(self) -> None:
        """Make the tables if they are not there; raises as the constructor does."""
        with translate_database_errors(self._address):
            ensure_tables(self._connection)
            self._partitioned_tables = partitioned_tables(self._connection)
            for name in KINDS:
                # With the types that are sent: if somebody has changed a column's type, the server converts them.
                columns = ", ".join(columns_sql(name))
                self._connection.execute(f"CREATE TEMP TABLE new_{name} ({columns}) ON COMMIT DELETE ROWS")

    def abort_call(self) -> None:
        """End from another thread a call to a database that hangs; the call raises `ArchiveUnreachableError`."""
        import psycopg  # noqa: PLC0415 - it is in an extra

        with (
            contextlib.suppress(OSError, psycopg.Error),
            socket.socket(fileno=os.dup(self._connection.fileno())) as own,
        ):
            own.shutdown(socket.SHUT_RDWR)

    def close(self) -> None:
        """End the connection."""
        self._connection.close()

    def write(self, pages: Sequence[SentPage]) -> WriteResult:
        """Write pages in one transaction: when this returns, the database has them.

        Raises
        ------
        ArchiveError
            The database refuses something; nothing of the pages is in it then.
        """
        import psycopg  # noqa: PLC0415 - it is in an extra

        with translate_database_errors(self._address):
            try:
                return self._write_pages(pages)
            except psycopg.errors.CheckViolation as error:
                if error.diag.constraint_name is not None:
                    raise
                # The part of a day that was made here has been dropped since, as Parquet. Late records begin it anew.
                self._days.clear()
                return self._write_pages(pages)

    def set_aside(self, page: SentPage, refused: Sequence[RefusedRecord]) -> None:
        """Keep records of a page that the database does not take, and note that the whole page is here.

        Raises
        ------
        ArchiveError
            The database refuses something; nothing is kept then.
        """
        known = dict(self._runs)
        with (
            translate_database_errors(self._address),
            self._connection.transaction(),
            self._connection.cursor() as cursor,
        ):
            run = self._run_of(page, known)
            cursor.executemany(
                f"INSERT INTO {SCHEMA}.{SET_ASIDE} (run, kind, number, record, why) VALUES (%s, %s, %s, %s, %s)"  # noqa: S608 - our own names
                " ON CONFLICT (run, kind, number) DO UPDATE SET why = EXCLUDED.why",
                [(run, each.kind, each.row[0], _as_json(each), each.why) for each in refused],
            )
            self._note_progress([page], [run])
        self._runs = known

    def pages_aside(self) -> Iterator[SentPage]:
        """Yield the records that are set aside, in pages."""
        after = (-1, "", -1)
        while rows := self._aside_after(after):
            after = rows[-1][:3]
            for run, of_run in groupby(rows, lambda row: row[0]):
                installation, origin = self._known_run(run)
                found: dict[str, list[tuple[Any, ...]]] = {}
                for _, kind, number, record in of_run:
                    if kind in COLUMNS_OF:
                        values = (record.get(column.name) for column in COLUMNS_OF[kind])
                        found.setdefault(kind, []).append((number, *values))
                yield SentPage(installation, Batch(origin, -1, found), live=False)

    def forget_aside(self, page: SentPage, but: Sequence[RefusedRecord]) -> None:
        """Remove the set-aside records of a page, which are in their tables by now, `but` those still refused."""
        kept = {(each.kind, each.row[0]) for each in but}
        gone = [(kind, row[0]) for kind, rows in page.batch.rows.items() for row in rows if (kind, row[0]) not in kept]
        with (
            translate_database_errors(self._address),
            self._connection.transaction(),
            self._connection.cursor() as cursor,
        ):
            run = self._run_of(page, self._runs)
            cursor.executemany(
                f"DELETE FROM {SCHEMA}.{SET_ASIDE} WHERE run = %s AND kind = %s AND number = %s",  # noqa: S608 - our own names
                [(run, kind, number) for kind, number in gone],
            )

    def _aside_after(self, place: tuple[int, str, int]) -> list[tuple[Any, ...]]:
        with translate_database_errors(self._address):
            return self._connection.execute(
                f"SELECT run, kind, number, record FROM {SCHEMA}.{SET_ASIDE} WHERE (run, kind, number) > (%s, %s, %s)"  # noqa: S608 - our own names
                " ORDER BY run, kind, number LIMIT %s",
                (*place, MOST_ROWS),
            ).fetchall()

    def _known_run(self, run: int) -> tuple[str, Origin]:
        columns = ", ".join(("installation", "extract(epoch FROM started)::float8", *RUN_COLUMNS[1:]))
        with translate_database_errors(self._address):
            row = self._connection.execute(f"SELECT {columns} FROM {SCHEMA}.runs WHERE run = %s", (run,)).fetchone()  # noqa: S608 - our own names
        assert row is not None  # noqa: S101 - narrowing; a run is never deleted
        return row[0], Origin(*row[1:])

    def _write_pages(self, pages: Sequence[SentPage]) -> WriteResult:
        self._make_days(pages)
        known = dict(self._runs)
        with self._connection.transaction():
            runs = [self._run_of(page, known) for page in pages]
            added = sum(self._insert(name, pages, runs) for name in KINDS)
            self._note_progress(pages, runs)
            rivals = self._rival_sentences(pages, runs) if added else []
        self._runs = known
        return WriteResult(added, rivals)

    def _make_days(self, pages: Sequence[SentPage]) -> None:
        wanted = {
            # The day of the instant as it is written: rounded, a time just before midnight is of the next day.
            (name, (_instant(row[1]) - _EPOCH).days)
            for page in pages
            for name, rows in page.batch.rows.items()
            if name in self._partitioned_tables
            for row in rows
        } - self._days
        if wanted:
            create_day_partitions(self._connection, wanted)
            self._days |= wanted

    def _run_of(self, page: SentPage, known: dict[tuple[str, str], int]) -> int:
        key = (page.installation, page.batch.origin.id)
        if key not in known:
            known[key] = self._new_run(page.installation, page.batch.origin)
        return known[key]

    def _new_run(self, installation: str, origin: Origin) -> int:
        started_utc_s, *others = astuple(origin)
        columns = ("installation", *RUN_COLUMNS)
        row = self._connection.execute(
            f"INSERT INTO {SCHEMA}.runs ({', '.join(columns)}) VALUES ({', '.join(['%s'] * len(columns))})"  # noqa: S608 - our own names
            # An update that changes nothing returns the run that is there.
            " ON CONFLICT (installation, id) DO UPDATE SET id = EXCLUDED.id RETURNING run",
            (installation, _instant(started_utc_s), *others),
        ).fetchone()
        assert row is not None  # noqa: S101 - narrowing; this statement returns a row
        return int(row[0])

    def _insert(self, name: str, pages: Sequence[SentPage], runs: Sequence[int]) -> int:
        columns = COLUMNS_OF[name]
        times = [place + 1 for place, column in enumerate(columns) if column.holds == "time"]
        rows = [(run, row) for run, page in zip(runs, pages, strict=True) for row in page.batch.rows.get(name, ())]
        if not rows:
            return 0
        names = ", ".join(["run", "number", *(column.name for column in columns)])
        with (
            self._connection.cursor() as cursor,
            cursor.copy(f"COPY new_{name} ({names}) FROM STDIN (FORMAT BINARY)") as copy,
        ):
            copy.set_types(["int4", "int8", *(TYPES[column.holds] for column in columns)])
            for run, row in rows:
                copy.write_row((run, *_with_instants(row, times)))
        done = self._connection.execute(
            f"INSERT INTO {SCHEMA}.{name} ({names}) SELECT {names} FROM new_{name}"  # noqa: S608 - our own names
            # By this key only: a conflict with another key, which somebody has added, is no record that came twice.
            " ON CONFLICT (run, number, time) DO NOTHING"
        )
        return done.rowcount

    def _note_progress(self, pages: Sequence[SentPage], runs: Sequence[int]) -> None:
        """Note how far each run has come; in the order of the runs, so that two writers do not wait for each other."""
        ends: dict[int, int] = defaultdict(lambda: -1)
        for run, page in zip(runs, pages, strict=True):
            ends[run] = max(ends[run], page.batch.through)
        live = {run for run, page in zip(runs, pages, strict=True) if page.live}
        with self._connection.cursor() as cursor:
            cursor.executemany(
                f"UPDATE {SCHEMA}.runs SET through = GREATEST(through, %s),"  # noqa: S608 - our own names
                " heard = CASE WHEN %s THEN now() ELSE heard END WHERE run = %s",
                [(ends[run], run in live, run) for run in sorted(ends)],
            )

    def _rival_sentences(self, pages: Sequence[SentPage], runs: Sequence[int]) -> list[str]:
        """Return a sentence for each installation whose earlier run sends records from after a later run's start.

        A service sends its runs one after the other: records of an earlier run, made after the start of a later one
        that is heard too, come from another service.
        """
        latest = {run: page.batch.last_utc_s for run, page in zip(runs, pages, strict=True) if page.live}
        if not latest:
            return []
        found = self._connection.execute(
            "SELECT DISTINCT earlier.installation, earlier.site, later.site"  # noqa: S608 - our own names
            " FROM unnest(%s::int4[], %s::timestamptz[]) AS sent (run, latest)"
            f" JOIN {SCHEMA}.runs AS earlier USING (run)"
            f" JOIN {SCHEMA}.runs AS later ON later.installation = earlier.installation AND later.run > earlier.run"
            f" WHERE later.heard > now() - interval '{_RIVALS_WITHIN}' AND later.started < sent.latest",
            (list(latest), [_instant(latest_s) for latest_s in latest.values()]),
        )
        return [
            f"two services send under the name {installation} (sites {site} and {other}): give one of them another"
            " mqtt.name or mqtt.prefix; all their records are kept, as runs of one installation"
            for installation, site, other in found
        ]


def _as_json(refused: RefusedRecord) -> str:
    columns = COLUMNS_OF[refused.kind]
    return json.dumps(dict(zip((column.name for column in columns), refused.row[1:], strict=True)))


def _instant(utc_s: float) -> datetime:
    return datetime.fromtimestamp(utc_s, UTC)


def _with_instants(row: tuple[Any, ...], times: Sequence[int]) -> list[Any]:
    values = list(row)
    for place in times:
        if values[place] is not None:
            values[place] = _instant(values[place])
    return values
