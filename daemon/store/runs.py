"""The runs of the service that a store has records of, and how far these reach."""

import math
import sqlite3
from contextlib import closing
from pathlib import Path
from typing import NamedTuple

from daemon.base.clock import iso_utc, minute_utc
from daemon.base.errors import UserError
from daemon.store.schema import RUN_COLUMNS, columns_of, open_for_reading, unreadable_store_error
from daemon.store.store import Origin
from daemon.store.tables import COLUMNS


class StoredRun(NamedTuple):
    """One run of the service, from its start to its end; `run` counts them within a store."""

    run: int
    origin: Origin


def runs_of(path: Path) -> list[StoredRun]:
    """Return the runs of a store, the oldest first; raises `StoreError`."""
    with closing(open_for_reading(path)) as connection:
        try:
            there = columns_of(connection, "runs")
            wanted = ", ".join(name if name in there else "''" for name in RUN_COLUMNS)
            rows = connection.execute(f"SELECT run, {wanted} FROM runs ORDER BY started, run").fetchall()  # noqa: S608 - our own names
        except sqlite3.Error as error:
            raise unreadable_store_error(path, error) from None
    return [
        StoredRun(
            run,
            Origin(
                started_utc_s=started,
                role=role,
                version=version,
                simulated=bool(simulated),
                site=site,
                latitude_deg=latitude,
                longitude_deg=longitude,
                altitude_m=altitude,
                tracker=name,
                id=run_id,
            ),
        )
        for run, started, role, version, simulated, site, latitude, longitude, altitude, name, run_id in rows
    ]


class PriorRecords(NamedTuple):
    """What a run of the service had recorded before an instant, each with its time [s UTC] and its tracker.

    Attributes
    ----------
    alarms
        The texts of the events of alarms, in their order.
    modes
        The modes that its trackers changed to, in their order.
    """

    alarms: tuple[tuple[float, str, str], ...] = ()
    modes: tuple[tuple[float, str, str], ...] = ()


def read_prior_records(path: Path, run: int, utc_s: float) -> PriorRecords:
    """Return what a run had recorded before an instant [s UTC]; raises `StoreError`."""
    found: list[tuple[tuple[float, str, str], ...]] = []
    with closing(open_for_reading(path)) as connection:
        try:
            for kind, word, which in (("events", "text", "AND subject = 'alarm'"), ("modes", "after", "")):
                whose = "COALESCE(tracker, '')" if "tracker" in columns_of(connection, kind) else "''"
                query = (
                    f"SELECT time, {whose}, {word} FROM {kind} "  # noqa: S608 - our own names
                    f"WHERE run = ? AND time < ? {which} ORDER BY time, number"
                )
                found.append(tuple(connection.execute(query, (run, utc_s)).fetchall()))
        except sqlite3.Error as error:
            raise unreadable_store_error(path, error) from None
    return PriorRecords(*found)


def record_time_range(path: Path) -> tuple[float, float] | None:
    """Return the times [s UTC] of a store's first and last record, None without one; raises `StoreError`."""
    ends: list[float] = []
    with closing(open_for_reading(path)) as connection:
        try:
            for name, _ in COLUMNS.values():
                if columns_of(connection, name):
                    first, last = connection.execute(f"SELECT MIN(time), MAX(time) FROM {name}").fetchone()  # noqa: S608 - as above
                    ends += [at for at in (first, last) if at is not None]
        except sqlite3.Error as error:
            raise unreadable_store_error(path, error) from None
    return (min(ends), max(ends)) if ends else None


def require_records(path: Path, start_utc_s: float, end_utc_s: float) -> None:
    """Raise `UserError` for a store without a record of any kind in a span, whose ends [s UTC] may be infinite."""
    reach = record_time_range(path)
    if reach is None:
        raise UserError(f"the store {path} holds nothing yet")
    with closing(open_for_reading(path)) as connection:
        try:
            for name, _ in COLUMNS.values():
                query = f"SELECT 1 FROM {name} WHERE time >= ? AND time < ? LIMIT 1"  # noqa: S608 - as above
                if columns_of(connection, name) and connection.execute(query, (start_utc_s, end_utc_s)).fetchone():
                    return
        except sqlite3.Error as error:
            raise unreadable_store_error(path, error) from None
    raise UserError(no_records_text(start_utc_s, end_utc_s, str(path), reach))


def no_records_text(
    start_utc_s: float, end_utc_s: float, source: str, reach: tuple[float, float] | None, record: str = "record"
) -> str:
    """Return the sentence for a span, whose ends [s UTC] may be infinite, of which `source` has no `record`."""
    ends = (("from", start_utc_s), ("to", end_utc_s))
    span = "".join(f" {word} {minute_utc(at)}" for word, at in ends if math.isfinite(at))
    have = ""
    if reach is not None:
        have = "; it has records from {} to {}".format(*(iso_utc(at)[:10] for at in reach))
    return f"no {record}{span} in {source}{have}"
