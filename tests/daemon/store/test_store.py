import csv
import logging
import math
import queue
import re
import sqlite3
import subprocess
import sys
import threading
import time
from contextlib import closing
from dataclasses import replace
from datetime import UTC, datetime
from hashlib import sha256

import numpy as np
import pandas as pd
import pvlib
import pytest

from daemon.base.clock import SystemClock
from daemon.base.errors import UserError
from daemon.base.records import Estimate, Event, Pose
from daemon.store.export import export
from daemon.store.schema import FILE_NAME, VERSION, open_for_reading, schema
from daemon.store.store import Origin, Store
from daemon.store.tables import TableWriter
from solar.frames import angles_from_direction, direction_from_azimuth
from tests.daemon.store.test_tables import ALL, CURVE, T0, decision, scan
from tests.support import DOCS

ORIGIN = Origin(T0, "both", "0.1.0", True, "SIRTA", 48.7, 2.2, 156.0)
DAY_S = 86400.0


@pytest.fixture
def keep(tmp_path):
    """Keep records in a store and close it; returns its folder."""

    def run(*records, folder=tmp_path / "store", keep_days=400, origin=ORIGIN):
        store = Store(folder, 60.0, keep_days, origin, SystemClock(), lambda event: None)
        for record in records:
            store.keep(record)
        store.close()
        assert store.status.waiting == 0
        return folder

    return run


def rows(path):
    with path.open(newline="") as file:
        return list(csv.DictReader(file))


def count(folder, table):
    with closing(open_for_reading(folder / FILE_NAME)) as connection:
        return connection.execute(f"SELECT count(*) FROM {table}").fetchone()[0]


def test_an_export_is_what_the_tables_of_the_same_records_are_and_more(keep, tmp_path):
    with TableWriter(tmp_path / "tables") as tables:
        for record in ALL:
            tables.write(record)
    written = export(keep(*ALL), tmp_path / "out", "csv", None, None, ())
    assert written == {"scans": 2, "decisions": 2, "moves": 1, "poses": 1, "modes": 1, "events": 1, "curves": 1}
    for name in written:
        exported, direct = rows(tmp_path / "out" / f"{name}.csv"), rows(tmp_path / "tables" / f"{name}.csv")
        assert [{key: row[key] for key in direct[0]} for row in exported] == direct
        assert all(row["run"] == "1" and row["simulated"] == "true" for row in exported)


def test_parquet_opens_in_pandas_with_a_utc_index_and_the_names_of_pvlib(keep, tmp_path):
    export(keep(*ALL), tmp_path / "out", "parquet", None, None, ())
    scans = pd.read_parquet(tmp_path / "out" / "scans.parquet")
    assert isinstance(scans.index, pd.DatetimeIndex)
    assert str(scans.index.tz) == "UTC"
    assert list(scans.index) == [pd.Timestamp(T0 + 1.25 + 5 * n, unit="s", tz="UTC") for n in (0, 1)]
    assert scans["ghi"].tolist() == scans["zenith_w_m2"].tolist() == [1 / 3, 1 / 3]
    assert np.isnan(scans["south_w_m2"]).all()
    assert scans["simulated"].dtype == bool
    decisions = pd.read_parquet(tmp_path / "out" / "decisions.parquet")
    assert decisions["solar_azimuth"].tolist() == [120.5, 120.5]
    assert decisions["apparent_elevation"].tolist() == [30.0, 30.0]
    assert decisions["apparent_zenith"].tolist() == [60.0, 60.0]


def test_half_a_letter_in_one_text_keeps_no_other_record_out(keep, tmp_path):
    events = [Event(T0 + n, n, "test", text) for n, text in enumerate(("before", "half \ud800", "after"))]
    export(keep(*events), tmp_path / "out", "csv", None, None, ())
    assert [row["text"] for row in rows(tmp_path / "out" / "events.csv")] == ["before", "half ?", "after"]


@pytest.mark.parametrize("latitude_deg", [48.7, -33.9])
def test_a_pose_means_to_pvlib_what_it_means_here(keep, tmp_path, latitude_deg):
    """Facing the sun by our angles, pvlib sees an angle of incidence of zero."""
    azimuth_deg, elevation_deg = (150.0, 40.0) if latitude_deg > 0 else (20.0, 40.0)
    a_deg, b_deg = angles_from_direction(direction_from_azimuth(azimuth_deg, elevation_deg, latitude_deg))
    pose = Pose(T0, 1.0, float(a_deg), float(b_deg), moving=False)
    folder = keep(pose, origin=replace(ORIGIN, latitude_deg=latitude_deg))
    export(folder, tmp_path / "out", "parquet", None, None, ["poses"])
    seen = pd.read_parquet(tmp_path / "out" / "poses.parquet").iloc[0]
    aoi = pvlib.irradiance.aoi(seen.surface_tilt, seen.surface_azimuth, 90 - elevation_deg, azimuth_deg)
    assert float(aoi) == pytest.approx(0, abs=1e-5)


def test_a_bad_zenith_reading_is_no_ghi(keep, tmp_path):
    good = scan(0)
    bad = replace(good, sequence=1, zenith=good.zenith._replace(quality="implausible"))
    export(keep(good, bad), tmp_path / "out", "csv", None, None, ["scans"])
    assert [row["ghi"] != "" for row in rows(tmp_path / "out" / "scans.csv")] == [True, False]


def test_from_is_included_and_to_is_not(keep, tmp_path):
    folder = keep(*[Event(T0 + n, n, "test", str(n)) for n in range(10)])
    start, end = (datetime.fromtimestamp(T0 + n, UTC) for n in (3, 6))
    assert export(folder, tmp_path / "out", "csv", start, end, ["events"]) == {"events": 3}
    assert [row["text"] for row in rows(tmp_path / "out" / "events.csv")] == ["3", "4", "5"]


def test_rows_are_in_the_order_of_time_over_all_runs(keep, tmp_path):
    keep(Event(T0 + 5, 1, "test", "later"))
    folder = keep(Event(T0, 1, "test", "earlier"))
    export(folder, tmp_path / "out", "csv", None, None, ["events"])
    assert [(row["text"], row["run"]) for row in rows(tmp_path / "out" / "events.csv")] == [
        ("earlier", "2"),
        ("later", "1"),
    ]


def test_a_scan_that_comes_twice_is_kept_once(keep):
    keep(scan(0), scan(1), scan(1))
    assert count(keep(scan(1), scan(2)), "scans") == 3


def test_the_oldest_days_give_way(keep):
    records = [Event(T0 + n * DAY_S, n, "test", str(n)) for n in range(5)]
    folder = keep(*records, keep_days=3)
    folder = keep(Event(T0 + 4 * DAY_S, 0, "test", "again"), keep_days=3)
    with closing(open_for_reading(folder / FILE_NAME)) as connection:
        assert connection.execute("SELECT text FROM events ORDER BY time").fetchall() == [
            ("2",),
            ("3",),
            ("4",),
            ("again",),
        ]


def test_a_clock_set_far_ahead_costs_one_day_and_not_all(keep):
    records = [Event(T0 + n * DAY_S, n, "test", str(n)) for n in range(3)]
    folder = keep(*records, Event(T0 + 9000 * DAY_S, 3, "test", "wrong clock"), keep_days=3)
    assert count(folder, "events") == 3


def test_after_one_record_from_the_future_the_oldest_days_still_give_way(tmp_path):
    store = Store(tmp_path, 0.01, 3, ORIGIN, SystemClock(), print)
    for number, day in enumerate((0, 9000, 1, 2, 3, 4)):
        store.keep(Event(T0 + day * DAY_S, number, "test", str(day)))
        deadline_s = time.monotonic() + 60.0
        while store.status.waiting:
            assert time.monotonic() < deadline_s
            time.sleep(0.005)
    store.close()
    # The day of the future is one of the three.
    assert count(tmp_path, "events") == 3


def test_the_file_of_this_version_is_what_it_was():
    """Whoever changes a column makes a new version of the store, with a way from the old one."""
    text = ";".join(re.sub(r"\s+", " ", statement) for statement in schema())
    assert text.count("CREATE TABLE") == 9
    assert (
        "CREATE TABLE poses ( run INTEGER NOT NULL, number INTEGER NOT NULL, time REAL, time_monotonic_s REAL,"
        " a_deg REAL, b_deg REAL, moving INTEGER, tracker TEXT, wind_m_s REAL, PRIMARY KEY (run, number) )"
        " WITHOUT ROWID" in text
    )
    assert sha256(text.encode()).hexdigest()[:12] == "8d471587843a"


def test_the_tables_of_a_run_name_its_tracker_or_each_record_its_own(keep, tmp_path):
    east, west = replace(decision(), tracker="east"), replace(decision(), time_utc_s=T0 + 60, tracker="west")
    folder = keep(east, west)
    keep(replace(east, time_utc_s=T0 + 120), origin=replace(ORIGIN, tracker="roof"))
    export(folder, tmp_path / "out", "csv", None, None, ())
    assert [row["tracker"] for row in rows(tmp_path / "out" / "decisions.csv")] == ["east", "west", "roof"]


def test_a_store_of_the_version_before_gets_the_wind_from_now_on(keep, tmp_path):
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


def test_a_store_of_the_version_two_before_gets_the_names_from_now_on(keep, tmp_path):
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


def test_a_store_that_has_no_curves_yet_is_read_as_it_is_and_given_their_table_by_the_service(keep, tmp_path):
    folder = keep(decision())
    with closing(sqlite3.connect(folder / FILE_NAME)) as connection:
        connection.execute("DROP TABLE curves")
        connection.execute("PRAGMA user_version = 3")
    assert export(folder, tmp_path / "old", "csv", None, None, ())["curves"] == 0
    assert rows(tmp_path / "old" / "curves.csv") == []
    keep(CURVE)
    assert export(folder, tmp_path / "new", "csv", None, None, ["curves"]) == {"curves": 1}
    assert rows(tmp_path / "new" / "curves.csv")[0]["pmpp_w"] == "274.25"
    with closing(sqlite3.connect(folder / FILE_NAME)) as connection:
        assert "curves_time" in {row[1] for row in connection.execute("PRAGMA index_list(curves)")}


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


# What cannot be used


def test_a_store_of_a_newer_version_is_refused_by_an_export(keep, tmp_path):
    folder = keep(scan(0))
    with closing(sqlite3.connect(folder / FILE_NAME)) as connection:
        connection.execute(f"PRAGMA user_version = {VERSION + 1}")
    sentence = re.escape(
        f"the store {folder / FILE_NAME} is of version {VERSION + 1} and this program knows version {VERSION}: it was"
        " written by a newer heliocube; update this one, or name another folder"
    )
    with pytest.raises(UserError, match=sentence):
        export(folder, tmp_path / "out", "csv", None, None, ())
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        (
            ["--from", "2022-10-14", "--to", "2022-10-13"],
            "--from 2022-10-14T00:00:00.000Z is not before --to 2022-10-13T00:00:00.000Z: exchange them",
        ),
        (["--from", "noon"], "--from: 'noon' is not a date or time; write 2022-10-14 or 2022-10-14T08:00Z"),
        ([], "there is no store at {store}/heliocube.sqlite; name its folder with --store, or the service's --config"),
    ],
)
def test_an_export_that_cannot_be_meant_is_one_sentence_and_code_2(heliocube, tmp_path, arguments, sentence):
    code, out, err = heliocube("export", "--store", tmp_path, "--out", tmp_path / "out", *arguments)
    assert (code, out) == (2, "")
    assert err == f"heliocube: {sentence.format(store=tmp_path)}\n"
    assert not (tmp_path / "out").exists()


def test_an_export_finds_the_store_by_the_configuration(heliocube, keep, tmp_path, monkeypatch):
    monkeypatch.delenv("HELIOCUBE_CONFIG", raising=False)
    keep(*ALL, folder=tmp_path / "records")
    config = tmp_path / "heliocube.toml"
    config.write_text("[store]\ndirectory = 'records'\n")
    code, out, _ = heliocube("export", "-c", config, "--out", tmp_path / "out", "--kind", "poses")
    assert (code, out) == (0, f"written to {tmp_path / 'out'}: 1 poses\n")
    assert [path.name for path in (tmp_path / "out").iterdir()] == ["poses.csv"]
    config.write_text("")
    code, _, err = heliocube("export", "-c", config, "--out", tmp_path / "out2")
    assert (code, err) == (
        2,
        f"heliocube: {config} sets no store.directory, and its rig is simulated: its service keeps no records\n",
    )
    code, _, err = heliocube("export", "--out", tmp_path / "out2")
    assert (code, err.count("export needs either --store DIR or --config FILE to find the store")) == (2, 1)
    config.write_text("[store]\ndirectory = 'records'\n")
    monkeypatch.setenv("HELIOCUBE_CONFIG", str(config))
    assert heliocube("export", "--out", tmp_path / "out2")[0] == 0
    assert heliocube("export", "--store", tmp_path / "records", "--out", tmp_path / "out3")[0] == 0


# A full disk


@pytest.fixture
def small_disk(tmp_path):
    """A file system of 512 kB."""
    disk = tmp_path / "disk"
    disk.mkdir()
    made = subprocess.run(["mount", "-t", "tmpfs", "-o", "size=512k", "tmpfs", disk], capture_output=True)
    if made.returncode:
        pytest.skip("mounting a small file system needs root")
    yield disk
    subprocess.run(["umount", "--lazy", disk], check=True)


class CountedClock(SystemClock):
    """Knows when it has been asked often enough: the store asks it at each failure."""

    def __init__(self, enough):
        self.left, self.enough = enough, threading.Event()

    def monotonic(self):
        self.left -= 1
        if self.left <= 0:
            self.enough.set()
        return super().monotonic()


def test_a_full_disk_is_told_once_costs_nothing_and_is_over_by_itself(small_disk, caplog, tmp_path):
    caplog.set_level(logging.INFO)
    told, clock = queue.Queue(), CountedClock(5)
    store = Store(small_disk, 0.1, 400, ORIGIN, clock, told.put)
    store.keep(scan(0))
    filler = small_disk / "filler"
    fill(filler)
    for n in range(1, 3000):
        store.keep(scan(n))
    assert clock.enough.wait(20)
    event = told.get(timeout=20)
    full = f"the disk of {small_disk} is full"
    assert (event.subject, event.text) == ("store", f"cannot write: {full}; records wait in memory")
    assert store.status.down_why == full
    filler.unlink()
    # The disk is still too small for everything: what fits is written, the rest waits.
    subprocess.run(["mount", "-o", "remount,size=8m", small_disk], check=True)
    assert told.get(timeout=20).text == "writes again; nothing was lost"
    store.close()
    assert told.empty()
    assert store.status.written == 3000
    assert store.status.lost == 0
    assert [record.message for record in caplog.records] == [
        f"the store is down: {full}",
        "the store is back",
    ]
    assert export(small_disk, tmp_path / "out", "csv", None, None, ["scans"]) == {"scans": 3000}


def test_a_service_starts_on_a_full_disk_and_writes_when_there_is_room(small_disk, tmp_path):
    filler = small_disk / "filler"
    fill(filler)
    told = queue.Queue()
    store = Store(small_disk, 0.1, 400, ORIGIN, SystemClock(), told.put)
    store.keep(scan(0))
    assert "cannot write" in told.get(timeout=20).text
    filler.unlink()
    assert told.get(timeout=20).text == "writes again; nothing was lost"
    store.close()
    assert count(small_disk, "scans") == 1


def fill(path):
    with path.open("wb", buffering=0) as file:
        try:
            while True:
                file.write(bytes(4096))
        except OSError:
            pass


# The document


def test_the_documented_snippet_reads_a_day(keep, tmp_path):
    poses = [Pose(T0 + 600 * n, n, 20 * math.sin(n / 20), 60.0, moving=False) for n in range(144)]
    folder = keep(*[scan(n) for n in range(200)], *poses)
    export(folder, tmp_path / "day", "parquet", None, None, ())
    snippet = re.search(r"```python\n(.*?)```", (DOCS / "data.md").read_text(), re.DOTALL)[1]
    look = "print(len(scans), len(poses), *{(frame.index.name, str(frame.index.tz)) for frame in (scans, poses)})"
    command = [sys.executable, "-W", "error", "-c", f"{snippet}\n{look}"]
    done = subprocess.run(command, cwd=tmp_path, check=True, capture_output=True, text=True)
    assert done.stdout == "200 144 ('time', 'UTC')\n"
