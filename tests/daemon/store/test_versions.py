"""Stores of other versions: an older one is read and brought up to date, a newer one is refused."""

import re
import sqlite3
from contextlib import closing
from dataclasses import replace
from hashlib import sha256

import pytest

from daemon.base.errors import UserError
from daemon.base.records import Estimate
from daemon.store.export import export
from daemon.store.schema import FILE_NAME, VERSION, schema
from tests.daemon.store.test_export import rows
from tests.daemon.store.test_store import ORIGIN, keep
from tests.daemon.store.test_tables import CHANGE, CURVE, EVENT, KINDS, MOVE, POSE, T0, decision, scan

__all__ = ["keep"]


def test_the_schema_of_the_present_store_version_is_unchanged():
    """Whoever changes a column makes a new version of the store, with a way from the old one."""
    text = ";".join(re.sub(r"\s+", " ", statement) for statement in schema())
    assert text.count("CREATE TABLE") == 9
    assert (
        "CREATE TABLE poses ( run INTEGER NOT NULL, number INTEGER NOT NULL, time REAL, time_monotonic_s REAL,"
        " a_deg REAL, b_deg REAL, moving INTEGER, tracker TEXT, wind_m_s REAL, PRIMARY KEY (run, number) )"
        " WITHOUT ROWID" in text
    )
    assert sha256(text.encode()).hexdigest()[:12] == "8d471587843a"


# What each version has that the one before it had not: a table without columns here is new as a whole.
NEW = {
    2: {"decisions": ("dni_est", "dhi_est", "albedo_est")},
    3: {"scans": ("calibration",)},
    4: {"curves": ()},
    5: {"runs": ("tracker",)},
    6: dict.fromkeys(("decisions", "moves", "poses", "modes", "events", "curves"), ("tracker",)),
    7: {"poses": ("wind_m_s",)},
    8: {"runs": ("id",)},
}


def records(sequence, tracker):
    """Return a record of each kind, with a value in every column that came with a later version."""
    later = {"time_utc_s": T0 + 60.0 * sequence, "tracker": tracker}
    return [
        replace(scan(sequence), calibration="20220320-abcdef01"),
        replace(decision(), estimate=Estimate(800.0, 90.0, 0.25), **later),
        replace(POSE, wind_m_s=12.5, **later),
        *(replace(record, **later) for record in (MOVE, CHANGE, EVENT, CURVE)),
    ]


def taken_back_to(version, folder):
    """Make a store what the program of an earlier version would have left."""
    with closing(sqlite3.connect(folder / FILE_NAME)) as connection:
        for later in range(VERSION, version, -1):
            for table, columns in NEW[later].items():
                for column in columns:
                    connection.execute(f"ALTER TABLE {table} DROP COLUMN {column}")
                if not columns:
                    connection.execute(f"DROP TABLE {table}")
        connection.execute(f"PRAGMA user_version = {version}")


def contents(folder):
    """Return the rows of every table by the names of its columns."""
    with closing(sqlite3.connect(folder / FILE_NAME)) as connection:
        connection.row_factory = sqlite3.Row
        names = [row["name"] for row in connection.execute("SELECT name FROM sqlite_master WHERE type = 'table'")]
        return {name: [dict(row) for row in connection.execute(f"SELECT * FROM {name}")] for name in names}


def exported(folder, out):
    export(folder, out, "csv", None, None, ())
    return {kind: rows(out / f"{kind}.csv") for kind in KINDS}


@pytest.mark.parametrize("version", range(1, VERSION))
def test_a_store_of_an_earlier_version_is_read_with_the_new_columns_blank(keep, tmp_path, version):
    folder = keep(*records(0, "west"))
    whole = exported(folder, tmp_path / "whole")
    taken_back_to(version, folder)
    old = exported(folder, tmp_path / "old")
    for kind in KINDS:
        columns = [column for later in range(version + 1, VERSION + 1) for column in NEW[later].get(kind, ())]
        blank = dict.fromkeys(columns, "")
        assert old[kind] == ([] if kind == "curves" and version < 4 else [row | blank for row in whole[kind]])


@pytest.mark.parametrize("version", range(1, VERSION))
def test_a_store_of_an_earlier_version_is_brought_up_to_date_and_keeps_its_records(keep, tmp_path, version):
    folder = keep(*records(0, "west"))
    taken_back_to(version, folder)
    old = contents(folder)
    later, origin = records(1, "east"), replace(ORIGIN, tracker="roof", id="0123")
    keep(*later, origin=origin)
    fresh = contents(keep(*later, folder=tmp_path / "fresh", origin=origin))
    upgraded = contents(folder)
    assert upgraded.keys() == fresh.keys()
    for table, new in fresh.items():
        # Columns that are new in the old rows are empty, whatever the new rows have.
        expected = [dict.fromkeys(new[0], "" if table == "runs" else None) | row for row in old.get(table, [])]
        if table != "days":
            expected += [row | {"run": 2} for row in new]
        assert upgraded[table] == expected
    with closing(sqlite3.connect(folder / FILE_NAME)) as connection:
        assert connection.execute("PRAGMA user_version").fetchone() == (VERSION,)
        assert {row[1] for row in connection.execute("PRAGMA index_list(curves)")} >= {"curves_time"}


def test_a_store_of_a_newer_version_is_refused_by_an_export(keep, tmp_path):
    folder = keep(scan(0))
    with closing(sqlite3.connect(folder / FILE_NAME)) as connection:
        connection.execute(f"PRAGMA user_version = {VERSION + 1}")
    sentence = re.escape(
        f"the store {folder / FILE_NAME} is of version {VERSION + 1} and this program knows version {VERSION}: it was"
        " written by a newer heliocube; update this program, or name another folder"
    )
    with pytest.raises(UserError, match=sentence):
        export(folder, tmp_path / "out", "csv", None, None, ())
    assert not (tmp_path / "out").exists()
