"""Days of an archive as Parquet: a file for each kind of record and UTC day, which DuckDB reads as one table."""

import contextlib
import os
import re
from collections.abc import Iterator
from contextlib import closing
from datetime import UTC, date, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from daemon.archive.address import ArchiveAddress, connect_to_archive, translate_database_errors
from daemon.archive.tables import COLUMNS_OF, SCHEMA, check_is_archive, identity_of, part_name
from daemon.base.errors import UserError
from daemon.base.files import sync_directory
from daemon.store.batches import KINDS
from daemon.store.outputs import check_folder

if TYPE_CHECKING:
    import psycopg

_ROWS_PER_GROUP = 100_000
_PART = re.compile(rf"({'|'.join(KINDS)})_(\d{{8}})")
_PART_KEY = b"heliocube.part"
_EPOCH = date(1970, 1, 1)
_RUN_COLUMNS = ("installation", "site", "simulated", "tracker")


class ArchivedDay(NamedTuple):
    """One kind and day: its file, its rows, and whether it was written now."""

    kind: str
    day: date
    path: Path
    rows: int
    written: bool


def write_days(address: ArchiveAddress, out: Path, today: date, wanted: date | None = None) -> Iterator[ArchivedDay]:
    """Write each day before today whose file is missing, or has fewer rows than the archive; yield all.

    Records that come late, after a night has written their day's file, get into it the next night. Records that a
    database has lost, because it was restored from a backup, are in the file alone.

    Parameters
    ----------
    out
        Folder; files are ``KIND/day=2026-11-22/records.parquet``, as DuckDB and others know a folder of parts.
    today
        In UTC; it is not over yet.
    wanted
        Only this day, whether its file is there or not.

    Raises
    ------
    UserError
        The archive cannot be read, or the folder not written.
    """
    check_folder(out, "--out")
    with closing(connect_to_archive(address, "heliocube parquet")) as connection, translate_database_errors(address):
        connection.execute("SET TRANSACTION ISOLATION LEVEL REPEATABLE READ READ ONLY")
        check_is_archive(connection, address)
        for kind, day in days_of(connection):
            if day < today and wanted in (None, day):
                try:
                    written = _write_day(connection, kind, day, out, again=wanted is not None)
                except OSError as error:
                    path = file_of(out, kind, day)
                    raise UserError(f"--out: {path} cannot be written: {error.strerror or error}") from None
                yield written


def drop_days(address: ArchiveAddress, out: Path, before: date) -> Iterator[ArchivedDay]:
    """Drop each day before another one from the archive, if its file has all its rows, and yield it.

    Raises
    ------
    UserError
        The archive cannot be read, or this user may not, or a file not be renamed; its day is not dropped.
    """
    with closing(connect_to_archive(address, "heliocube parquet")) as connection, translate_database_errors(address):
        connection.autocommit = True
        check_is_archive(connection, address)
        for kind, day in days_of(connection):
            if day >= before:
                continue
            try:
                dropped = _drop_day(connection, kind, day, out)
            except OSError as error:
                path = file_of(out, kind, day)
                raise UserError(f"--out: {path} cannot get its final name: {error.strerror or error}") from None
            if dropped is not None:
                yield dropped


def days_of(connection: "psycopg.Connection") -> list[tuple[str, date]]:
    """Return the kinds and days that the archive has parts for, the oldest first."""
    rows = connection.execute(
        "SELECT relname FROM pg_class WHERE relnamespace = %s::regnamespace AND relispartition AND relkind = 'r'",
        (SCHEMA,),
    )
    found = (_PART.fullmatch(row[0]) for row in rows)
    known = [(match[1], datetime.strptime(match[2], "%Y%m%d").replace(tzinfo=UTC).date()) for match in found if match]
    return sorted(known, key=lambda each: (each[1], each[0]))


def file_of(out: Path, kind: str, day: date) -> Path:
    """Return where a kind's records of a day are."""
    return out / kind / f"day={day.isoformat()}" / "records.parquet"


def rows_in(path: Path) -> int | None:
    """Return how many rows a file has, None if it is missing or not whole."""
    footer = _footer(path)
    return None if footer is None else int(footer.num_rows)


def _drop_day(connection: "psycopg.Connection", kind: str, day: date, out: Path) -> ArchivedDay | None:
    path, table = file_of(out, kind, day), _table(kind, day)
    with connection.transaction():
        # Late records wait for the lock, and then go into a part that is made anew.
        connection.execute(f"LOCK TABLE {table} IN ACCESS EXCLUSIVE MODE")
        count = _count(connection, table)
        if rows_in(path) != count:
            return None
        # This file is never written again: late records get a file of their own beside it.
        final = _final_path(connection, table, path)
        path.rename(final)
        # A power cut after the drop must not lose a name on the way to the file; its content was synced when written.
        for folder in final.parents[:4]:
            sync_directory(folder)
        try:
            connection.execute(f"DROP TABLE {table}")
        except BaseException:
            final.rename(path)
            raise
    return ArchivedDay(kind, day, final, count, written=False)


def _final_path(connection: "psycopg.Connection", table: str, path: Path) -> Path:
    """Return the name that the file of a part has once the part is gone; each part of a day has a different one."""
    return path.with_name(f"final-{identity_of(connection, table)}.parquet")


def _write_day(connection: "psycopg.Connection", kind: str, day: date, out: Path, *, again: bool) -> ArchivedDay:
    path = file_of(out, kind, day)
    table = _table(kind, day)
    final = _final_path(connection, table, path)
    if final.exists():
        # The drop of this same part was broken off, or the server was restored to a time before it.
        _keep_file_of_other_part(path, final)
        final.replace(path)
    count, there = _count(connection, table), rows_in(path)
    if not again and there == count:
        return ArchivedDay(kind, day, path, count, written=False)
    # A file of another part is kept: that part was dropped by hand, and late records have begun this one.
    if not _keep_file_of_other_part(path, final) and not again and there is not None and there > count:
        return ArchivedDay(kind, day, path, there, written=False)
    part = path.with_name(path.name + ".part")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        _write(connection, kind, table, part, final.stem)
        with part.open("r+b") as file:
            os.fsync(file.fileno())
        part.replace(path)
    except OSError:
        # The unfinished file would take up room on a full disk.
        with contextlib.suppress(OSError):
            part.unlink()
        raise
    return ArchivedDay(kind, day, path, count, written=True)


def _table(kind: str, day: date) -> str:
    return f"{SCHEMA}.{part_name(kind, (day - _EPOCH).days)}"


def _count(connection: "psycopg.Connection", table: str) -> int:
    row = connection.execute(f"SELECT count(*) FROM {table}").fetchone()  # noqa: S608 - our own names
    return int(row[0]) if row else 0


def _keep_file_of_other_part(path: Path, final: Path) -> bool:
    """If a file is of another part than `final`, one that is gone, give it its lasting name; tell whether it is."""
    footer = _footer(path)
    # An older file does not name its part.
    other = ((footer.metadata if footer else None) or {}).get(_PART_KEY, b"").decode()
    if other in ("", final.stem):
        return False
    path.rename(path.with_name(f"{other}.parquet"))
    return True


def _footer(path: Path) -> Any:
    """Return the metadata at the end of a file, None if it is missing or not whole."""
    import pyarrow as pa  # noqa: PLC0415 - half a second that other commands have no use for
    from pyarrow import parquet  # noqa: PLC0415 - as above

    try:
        return parquet.read_metadata(path)
    except (FileNotFoundError, pa.ArrowInvalid):
        return None
    except OSError as error:
        # An error without a number does not come from the disk: Arrow cannot make sense of the footer.
        if error.errno is not None or not path.is_file():
            raise
        return None


def _write(connection: "psycopg.Connection", kind: str, table: str, path: Path, part: str) -> None:
    import pyarrow as pa  # noqa: PLC0415 - as above
    from pyarrow import parquet  # noqa: PLC0415 - as above

    types = {
        "time": pa.timestamp("us", tz="UTC"),
        "float": pa.float64(),
        "int": pa.int64(),
        "bool": pa.bool_(),
        "text": pa.string(),
    }
    own = [column for column in COLUMNS_OF[kind] if column.name not in _RUN_COLUMNS]
    fields = [("installation", pa.string()), ("run", pa.string()), ("number", pa.int64())]
    fields += [(column.name, types[column.holds]) for column in own]
    fields += [("site", pa.string()), ("simulated", pa.bool_()), ("tracker", pa.string())]
    schema = pa.schema(fields, metadata={_PART_KEY: part})
    named = any(column.name == "tracker" for column in COLUMNS_OF[kind])
    tracker = "COALESCE(NULLIF(runs.tracker, ''), kept.tracker, '')" if named else "runs.tracker"
    query = (
        f"SELECT runs.installation, runs.id, kept.number, {', '.join(f'kept.{column.name}' for column in own)},"  # noqa: S608 - our own names
        f" runs.site, runs.simulated, {tracker} FROM {table} AS kept JOIN {SCHEMA}.runs USING (run)"
        " ORDER BY runs.installation, kept.time, kept.run, kept.number"
    )
    with (
        connection.cursor(f"of_{kind}", binary=True) as cursor,
        parquet.ParquetWriter(path, schema, compression="zstd") as writer,
    ):
        cursor.execute(query)
        while rows := cursor.fetchmany(_ROWS_PER_GROUP):
            writer.write_table(_arrow(pa, rows, schema))


def _arrow(pa: Any, rows: list[tuple[Any, ...]], schema: Any) -> Any:
    arrays = [pa.array(values, type=field.type) for values, field in zip(zip(*rows, strict=True), schema, strict=True)]
    return pa.Table.from_arrays(arrays, schema=schema)
