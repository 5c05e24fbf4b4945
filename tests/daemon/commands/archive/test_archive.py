"""`heliocube archive fill` and `parquet`, and the readers of archives and stores, against a real PostgreSQL."""

import json
import sqlite3
import subprocess
import sys
from contextlib import closing
from datetime import date
from pathlib import Path

import pytest

from daemon.archive.address import parse_archive
from daemon.archive.parquet import drop_days
from daemon.base.clock import SystemClock
from daemon.store.store import Store
from tests.support.archive import origin, pose

DAY = "2022-10-12"
HOW = "it is mqtt.prefix and mqtt.name of the service, such as plant/roof"
SPAN = ("--from", f"{DAY}T10:00", "--to", f"{DAY}T10:14")


@pytest.fixture
def store(tmp_path, heliocube, few_curves):
    """Some minutes of two trackers with loads."""
    folder = tmp_path / "store"
    simulate = ("compare", "simulate", "--start", f"{DAY}T10:00", "--days", "0.01", "--laws", "chronometric,flat")
    assert heliocube(*simulate, *few_curves, "--store", folder)[0] == 0
    return folder


def tables(folder):
    return {path.name: path.read_text() for path in sorted(Path(folder).glob("*.csv"))}


def in_duckdb(query):
    """Return DuckDB's answer, from a process of its own."""
    program = "import duckdb, json, sys; print(json.dumps(duckdb.sql(sys.argv[1]).fetchall()))"
    done = subprocess.run([sys.executable, "-c", program, query], capture_output=True, text=True, check=True)
    return [tuple(row) for row in json.loads(done.stdout)]


@pytest.mark.slow
def test_a_filled_archive_reads_the_same_as_its_store_and_its_days_move_to_parquet(
    store, postgres, database, heliocube, tmp_path
):
    archive = f"{database}#plant/both"
    code, out, err = heliocube("archive", "fill", store, "--to", database, "--name", "plant/both")
    assert (code, "records were read" in out) == (0, True), err
    is_read_as_a_store(store, archive, database, heliocube, tmp_path)
    cools_down(store, postgres, database, heliocube, tmp_path)


def is_read_as_a_store(store, archive, database, heliocube, tmp_path):
    again = json.loads(heliocube("archive", "fill", store, "--to", database, "--name", "plant/both", "--json")[1])
    assert (again["added"], again["read"] > 300) == (0, True)

    for place, out in ((store, "a"), (archive, "b")):
        assert heliocube("export", "--store", place, "--out", tmp_path / out)[0] == 0
    assert tables(tmp_path / "a") == tables(tmp_path / "b")

    pages = {}
    for place, out in ((store, "c"), (archive, "d")):
        code, _, err = heliocube("report", "--store", place, *SPAN, "--tracker", "T-Cube", "--out", tmp_path / out)
        assert code == 0, err
        pages[out] = next((tmp_path / out).glob("*.html")).read_text()
    called = f"the archive {database}, plant/both"
    assert pages["c"] == pages["d"].replace(called, f"the store {store / 'heliocube.sqlite'}")

    found = []
    for place, out in ((store, "e"), (archive, "f")):
        code, said, err = heliocube("compare", "report", "--store", place, "--out", tmp_path / out, "--json")
        found.append(json.loads(said)["gains"] if code == 0 else err)
    assert found[0] == found[1] != []

    heliocube("archive", "fill", store, "--to", database, "--name", "plant/roof")
    sentences = {
        database: f"{database} has plant/both, plant/roof: put one of them behind the address, after a #",
        f"{database}#plant/x": f"{database} knows no installation plant/x: it has plant/both, plant/roof",
    }
    for place, sentence in sentences.items():
        code, _, err = heliocube("export", "--store", place, "--out", tmp_path / "h")
        assert (code, err) == (2, f"heliocube: {sentence}\n")
    code, _, err = heliocube("export", "--store", archive, "--from", "2023-01-01", "--out", tmp_path / "h")
    assert (code, err) == (2, f"heliocube: {database} has no record of plant/both in that time\n")


def cools_down(store, postgres, database, heliocube, tmp_path):
    """Each day becomes Parquet once, and is dropped when its file has all of it."""
    out = tmp_path / "cold"
    run = ("archive", "parquet", "--to", database, "--out", out, "--json")
    first = json.loads(heliocube(*run)[1])
    assert {(one["kind"], one["written"]) for one in first["days"]} >= {("scans", True), ("curves", True)}
    assert not any(one["written"] for one in json.loads(heliocube(*run)[1])["days"])

    name = database.rpartition("/")[2]
    query = "SELECT count(*), sum(pmpp_w), max(number) FROM heliocube.curves"
    assert in_duckdb(query.replace("heliocube.curves", f"'{out}/curves/*/*.parquet'")) == [
        pytest.approx(row) for row in postgres.sql(query, name)
    ]
    query = f"SELECT DISTINCT installation, tracker, simulated, day::text FROM read_parquet('{out}/poses/*/*.parquet')"
    wanted = [(where, who, True, DAY) for where in ("plant/both", "plant/roof") for who in ("T-Chrono", "T-Cube")]
    assert sorted(in_duckdb(query)) == wanted

    # A drop that was interrupted after its file was renamed and before its end counts as not begun.
    query = "SELECT system_identifier, 'heliocube.poses_{}'::regclass::oid FROM pg_control_system()"
    ((server, part),) = postgres.sql(query.format(DAY.replace("-", "")), name)
    folder = out / "poses" / f"day={DAY}"
    (folder / "records.parquet").rename(folder / f"final-{server}-{part}.parquet")
    heliocube(*run)
    assert [path.name for path in folder.iterdir()] == ["records.parquet"]

    # A missing file is made anew, one with more rows stays; a day is dropped only when its file has all of it.
    (out / "poses" / f"day={DAY}" / "records.parquet").unlink()
    postgres.sql("DELETE FROM heliocube.scans WHERE number = (SELECT max(number) FROM heliocube.scans)", name)
    kinds = {one.kind for one in drop_days(parse_archive(database), out, date(2026, 1, 1))}
    assert "modes" in kinds
    assert not kinds & {"poses", "scans"}
    again = json.loads(heliocube(*run, "--drop-after", "30")[1])
    assert {one["kind"] for one in again["days"] if one["written"]} == {"poses"}
    assert {one["kind"] for one in again["dropped"]} == {"poses"}
    assert postgres.sql("SELECT count(*) FROM heliocube.poses", name) == [(0,)]

    # Records that come after the drop have a file of their own, and change no final one.
    heliocube("archive", "fill", store, "--to", database, "--name", "plant/late")
    heliocube(*run)
    query = f"SELECT installation, count(*) FROM '{out}/poses/*/*.parquet' GROUP BY 1"
    counts = dict(in_duckdb(query))
    assert counts["plant/both"] == counts["plant/roof"] == counts["plant/late"] > 0


def test_archive_fill_leaves_out_damaged_records_and_runs_of_a_store_and_takes_all_others(
    database, heliocube, tmp_path
):
    for known in (origin(), origin()):
        store = Store(tmp_path, 60.0, 400, known, SystemClock(), print)
        for number in range(3):
            store.keep(pose(number))
        store.close()
    with closing(sqlite3.connect(tmp_path / "heliocube.sqlite")) as store, store:
        store.execute("UPDATE poses SET tracker = x'ff' WHERE run = 1 AND number = 1")
        store.execute("UPDATE runs SET site = x'ff' WHERE run = 2")
    fill = ("archive", "fill", tmp_path, "--to", database, "--name", "plant/both")
    code, out, err = heliocube(*fill)
    assert (code, out) == (0, f"{tmp_path}: 2 records were read; 2 of them are new in {database}, as plant/both\n")
    assert err == (
        f"heliocube: warning: 1 record is damaged in {tmp_path} and left out\n"
        f"heliocube: warning: the entry of run 2 in {tmp_path} is damaged: the run's records are left out\n"
    )
    answer = json.loads(heliocube(*fill, "--json")[1])
    assert (answer["damaged"], answer["unsound"], answer["added"]) == (1, [2], 0)


def test_a_missing_broker_credentials_file_is_reported_before_the_database_is_asked(heliocube, tmp_path):
    config = tmp_path / "archive.toml"
    config.write_text("[mqtt]\ncredentials_file = 'none'\n[archive]\ndatabase = 'postgresql://a@127.0.0.1:1/x'\n")
    code, _, err = heliocube("archive", "--config", config)
    missing = f"there is no file {tmp_path / 'none'}: write user:password into it, mode 0600"
    assert (code, err) == (2, f"heliocube: mqtt.credentials_file: {missing}\n")


def test_archive_commands_refuse_a_wrong_database_day_age_or_name(database, heliocube, tmp_path):
    run = ("archive", "parquet", "--to", database, "--out", tmp_path)
    assert heliocube(*run)[::2] == (2, f"heliocube: {database} holds no archive: is it the right database?\n")
    assert heliocube(*run, "--day", "2999-01-01")[::2] == (2, "heliocube: --day 2999-01-01: that day is not over\n")
    code, _, err = heliocube(*run, "--drop-after", "1000000")
    assert (code, "Invalid value for '--drop-after': '1000000' is not a number up to" in err) == (2, True), err
    code, _, err = heliocube("archive", "fill", tmp_path, "--to", database, "--name", "a/+")
    assert (code, err) == (2, f"heliocube: --name: 'a/+' has a wildcard, and a topic has none; {HOW}\n")
