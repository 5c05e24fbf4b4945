"""Stores of other versions: an older one is read and brought up to date, a newer one is refused."""

import re
import sqlite3
from contextlib import closing
from dataclasses import replace
from hashlib import sha256

import pytest

from daemon.base.errors import UserError
from daemon.base.records import Estimate, Pose
from daemon.store.export import export
from daemon.store.schema import FILE_NAME, VERSION, schema
from tests.daemon.store.test_export import rows
from tests.daemon.store.test_store import ORIGIN, keep
from tests.daemon.store.test_tables import CURVE, T0, decision, scan

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


def test_a_store_of_version_6_is_read_without_wind_and_keeps_the_wind_from_now_on(keep, tmp_path):
    pose = Pose(T0, 1.0, 10.0, 60.0, moving=False, tracker="roof")
    folder = keep(pose)
    with closing(sqlite3.connect(folder / FILE_NAME)) as connection:
        connection.execute("ALTER TABLE poses DROP COLUMN wind_m_s")
        connection.execute("PRAGMA user_version = 6")
    export(folder, tmp_path / "old", "csv", None, None, ["poses"])
    assert [row["wind_m_s"] for row in rows(tmp_path / "old" / "poses.csv")] == [""]
    keep(replace(pose, time_utc_s=T0 + 5, wind_m_s=12.5))
    export(folder, tmp_path / "new", "csv", None, None, ["poses"])
    assert [row["wind_m_s"] for row in rows(tmp_path / "new" / "poses.csv")] == ["", "12.5"]


def test_a_store_of_version_5_is_read_without_tracker_names_and_keeps_them_from_now_on(keep, tmp_path):
    folder = keep(decision())
    with closing(sqlite3.connect(folder / FILE_NAME)) as connection:
        for name in ("decisions", "moves", "poses", "modes", "events", "curves"):
            connection.execute(f"ALTER TABLE {name} DROP COLUMN tracker")
        connection.execute("PRAGMA user_version = 5")
    export(folder, tmp_path / "old", "csv", None, None, ())
    assert [row["tracker"] for row in rows(tmp_path / "old" / "decisions.csv")] == [""]
    keep(replace(decision(), time_utc_s=T0 + 60, tracker="west"))
    export(folder, tmp_path / "new", "csv", None, None, ())
    assert [row["tracker"] for row in rows(tmp_path / "new" / "decisions.csv")] == ["", "west"]


def test_a_store_whose_runs_do_not_name_their_tracker_is_read_as_it_is_and_can_name_it_from_then_on(keep, tmp_path):
    folder = keep(decision())
    with closing(sqlite3.connect(folder / FILE_NAME)) as connection:
        connection.execute("ALTER TABLE runs DROP COLUMN tracker")
        connection.execute("PRAGMA user_version = 4")
    export(folder, tmp_path / "old", "csv", None, None, ())
    assert [row["tracker"] for row in rows(tmp_path / "old" / "decisions.csv")] == [""]
    keep(replace(decision(), time_utc_s=T0 + 60), origin=replace(ORIGIN, tracker="roof"))
    export(folder, tmp_path / "new", "csv", None, None, ())
    assert [row["tracker"] for row in rows(tmp_path / "new" / "decisions.csv")] == ["", "roof"]


def test_a_store_that_has_no_curves_yet_is_read_as_it_is_and_given_their_table_by_the_service(keep, tmp_path):
    folder = keep(decision())
    with closing(sqlite3.connect(folder / FILE_NAME)) as connection:
        connection.execute("DROP TABLE curves")
        connection.execute("PRAGMA user_version = 3")
    assert export(folder, tmp_path / "old", "csv", None, None, ()).rows["curves"] == 0
    assert rows(tmp_path / "old" / "curves.csv") == []
    keep(CURVE)
    assert export(folder, tmp_path / "new", "csv", None, None, ["curves"]).rows == {"curves": 1}
    assert rows(tmp_path / "new" / "curves.csv")[0]["pmpp_w"] == "274.25"
    with closing(sqlite3.connect(folder / FILE_NAME)) as connection:
        assert "curves_time" in {row[1] for row in connection.execute("PRAGMA index_list(curves)")}


def test_a_store_of_version_1_is_read_as_it_is_and_brought_up_to_date_by_the_service(keep, tmp_path):
    folder = keep(decision())
    with closing(sqlite3.connect(folder / FILE_NAME)) as connection:
        for name in ("dni_est", "dhi_est", "albedo_est"):
            connection.execute(f"ALTER TABLE decisions DROP COLUMN {name}")
        connection.execute("PRAGMA user_version = 1")
    export(folder, tmp_path / "old", "csv", None, None, ())
    assert [row["dni_est"] for row in rows(tmp_path / "old" / "decisions.csv")] == [""]
    keep(replace(decision(), time_utc_s=T0 + 60, estimate=Estimate(800.0, 90.0, 0.25)))
    export(folder, tmp_path / "new", "csv", None, None, ())
    assert [(row["dni_est"], row["albedo_est"]) for row in rows(tmp_path / "new" / "decisions.csv")] == [
        ("", ""),
        ("800.0", "0.25"),
    ]


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
