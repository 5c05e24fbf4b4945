"""The tables of an archive: those of a store, the run counted over all installations, and a part for each day."""

from datetime import UTC, datetime, timedelta
from typing import TYPE_CHECKING

from daemon.archive.address import ArchiveAddress, ArchiveError, one_line
from daemon.store.batches import KINDS
from daemon.store.tables import COLUMNS, Column

if TYPE_CHECKING:
    import psycopg

SCHEMA = "heliocube"
VERSION = 1
SET_ASIDE = "set_aside"
TYPES = {"time": "timestamptz", "float": "float8", "int": "int8", "bool": "bool", "text": "text"}
COLUMNS_OF: dict[str, list[Column]] = dict(COLUMNS.values())
# Chosen by chance, so that no other program has the same.
_LOCK = 0x68656C63_61726368
_DAYS_AT_ONCE = 100
_PART = "heliocube part"
_RUNS = f"""CREATE TABLE {SCHEMA}.runs (
  run int4 GENERATED ALWAYS AS IDENTITY PRIMARY KEY,
  installation text NOT NULL,
  started timestamptz NOT NULL,
  role text NOT NULL,
  version text NOT NULL,
  simulated bool NOT NULL,
  site text NOT NULL,
  latitude_deg float8 NOT NULL,
  longitude_deg float8 NOT NULL,
  altitude_m float8 NOT NULL,
  tracker text NOT NULL,
  id text NOT NULL,
  through int8 NOT NULL DEFAULT -1,
  heard timestamptz,
  UNIQUE (installation, id)
)"""
# Records that the tables do not take, as they came; so their times are seconds since 1970.
_SET_ASIDE = f"""CREATE TABLE {SCHEMA}.{SET_ASIDE} (
  run int4 NOT NULL,
  kind text NOT NULL,
  number int8 NOT NULL,
  record jsonb NOT NULL,
  why text NOT NULL,
  since timestamptz NOT NULL DEFAULT now(),
  PRIMARY KEY (run, kind, number)
)"""


def schema() -> list[str]:
    """Return the statements that make an empty archive.

    A record is known by installation, run and number; `runs` has one short number for the first two. The time is part
    of the key because the parts of a table are days.
    """
    made = [f"CREATE SCHEMA IF NOT EXISTS {SCHEMA}", _RUNS]
    for name in KINDS:
        columns = ",\n  ".join(columns_sql(name))
        made.append(
            f"CREATE TABLE {SCHEMA}.{name} (\n  {columns},\n  PRIMARY KEY (run, number, time)\n)"
            " PARTITION BY RANGE (time)"
        )
    return [*made, f"COMMENT ON SCHEMA {SCHEMA} IS 'heliocube archive {VERSION}'"]


def columns_sql(name: str) -> list[str]:
    """Return the columns of a table with their types."""
    own = [f"{column.name} {TYPES[column.holds]}" for column in COLUMNS_OF[name]]
    return ["run int4 NOT NULL", "number int8 NOT NULL", *own]


def ensure_tables(connection: "psycopg.Connection") -> None:
    """Make the tables if they are not there, and add columns that an older archive lacks.

    Raises
    ------
    ArchiveError
        This user may not make them, or not write into them, or they are of a newer program.
    """
    import psycopg  # noqa: PLC0415 - it is in an extra

    try:
        with connection.transaction():
            connection.execute("SELECT pg_advisory_xact_lock(%s)", (_LOCK,))
            if version_of(connection) is None:
                for statement in schema():
                    connection.execute(statement)
            if not _is_there(connection, SET_ASIDE):
                connection.execute(_SET_ASIDE)
            for name in KINDS:
                for column in missing_columns(connection, name):
                    connection.execute(f"ALTER TABLE {SCHEMA}.{name} ADD COLUMN {column.name} {TYPES[column.holds]}")
        _check_rights(connection)
    except psycopg.errors.InsufficientPrivilege as error:
        raise ArchiveError(
            f"this user may not make the archive's tables ({one_line(error)}): make this user the owner of the"
            " database, or grant it CREATE on it"
        ) from None


def _is_there(connection: "psycopg.Connection", name: str) -> bool:
    row = connection.execute("SELECT to_regclass(%s)", (f"{SCHEMA}.{name}",)).fetchone()
    return row is not None and row[0] is not None


def _check_rights(connection: "psycopg.Connection") -> None:
    """Raise `ArchiveError` for a user who may only read: it would take pages from processes that can write them."""
    row = connection.execute(
        # Only its owner can add a part to a table.
        "SELECT min(pg_get_userbyid(relowner)) FROM pg_class"
        " WHERE relnamespace = %s::regnamespace AND relname = ANY(%s) AND NOT"
        " (has_table_privilege(oid, 'INSERT') AND (relkind <> 'p' OR pg_has_role(relowner, 'USAGE')))",
        (SCHEMA, ["runs", SET_ASIDE, *KINDS]),
    ).fetchone()
    if row is not None and row[0] is not None:
        raise ArchiveError(f"this user may not write into the archive's tables: name their owner, {row[0]}, instead")


def version_of(connection: "psycopg.Connection") -> int | None:
    """Return the version of the archive's tables, None where there are none; raises `ArchiveError` for a newer one."""
    row = connection.execute(
        "SELECT obj_description(oid, 'pg_namespace') FROM pg_namespace WHERE nspname = %s", (SCHEMA,)
    ).fetchone()
    if row is None or not row[0]:
        return None
    words = str(row[0]).split()
    version = int(words[-1]) if words[:2] == ["heliocube", "archive"] and words[-1].isdecimal() else 0
    if not 1 <= version <= VERSION:
        raise ArchiveError(
            f"the schema {SCHEMA} of this database is '{row[0]}', and this program knows version {VERSION}: update the"
            " program, or name another database"
        )
    return version


def check_is_archive(connection: "psycopg.Connection", address: ArchiveAddress) -> None:
    """Raise `ArchiveError` where there is no archive, or a newer one."""
    if version_of(connection) is None:
        raise ArchiveError(f"{address.url} holds no archive: is it the right database?")


def missing_columns(connection: "psycopg.Connection", name: str) -> list[Column]:
    """Return the columns that a table of an older archive lacks."""
    rows = connection.execute(
        "SELECT column_name FROM information_schema.columns WHERE table_schema = %s AND table_name = %s", (SCHEMA, name)
    )
    there = {row[0] for row in rows}
    return [column for column in COLUMNS_OF[name] if there and column.name not in there]


def partitioned_tables(connection: "psycopg.Connection") -> set[str]:
    """Return the tables whose parts, one a day, are made here; another engine may divide a table by itself."""
    rows = connection.execute(
        "SELECT relname FROM pg_class WHERE relnamespace = %s::regnamespace AND relkind = 'p'", (SCHEMA,)
    )
    return {row[0] for row in rows}


def create_day_partitions(connection: "psycopg.Connection", wanted: set[tuple[str, int]]) -> None:
    """Make the parts of tables for days that have none, a few at once: each is locked until the transaction ends.

    Parameters
    ----------
    wanted
        Tables, and days since 1970 [UTC].
    """
    ordered = sorted(wanted)
    for first in range(0, len(ordered), _DAYS_AT_ONCE):
        with connection.transaction():
            connection.execute("SELECT pg_advisory_xact_lock(%s)", (_LOCK,))
            for name, day in ordered[first : first + _DAYS_AT_ONCE]:
                _make_day(connection, name, day)


def _make_day(connection: "psycopg.Connection", name: str, day: int) -> None:
    part, begin = f"{SCHEMA}.{part_name(name, day)}", datetime.fromtimestamp(day * 86400, UTC)
    if connection.execute("SELECT to_regclass(%s) IS NOT NULL", (part,)).fetchone() == (True,):
        return
    connection.execute(
        f"CREATE TABLE {part} PARTITION OF {SCHEMA}.{name}"
        f" FOR VALUES FROM ('{begin.isoformat()}') TO ('{(begin + timedelta(days=1)).isoformat()}')"
    )
    # Restored from a dump, the part has another number, but still this comment.
    connection.execute(f"COMMENT ON TABLE {part} IS '{_PART} {identity_of(connection, part)}'")


def identity_of(connection: "psycopg.Connection", part: str) -> str:
    """Return a text that a part keeps for good and no other part has, on this server or on one that is set up anew."""
    row = connection.execute(
        f"SELECT coalesce(substring(obj_description(oid, 'pg_class') FROM '^{_PART} ([0-9]+-[0-9]+)$'),"  # noqa: S608 - ours
        " system_identifier || '-' || oid) FROM pg_control_system(), (SELECT %s::regclass::oid AS oid) AS part",
        (part,),
    ).fetchone()
    assert row is not None  # noqa: S101 - narrowing; it is there
    return str(row[0])


def part_name(name: str, day: int) -> str:
    """Return what the table of one kind and day is called, such as ``poses_20221014``."""
    return f"{name}_{datetime.fromtimestamp(day * 86400, UTC):%Y%m%d}"
