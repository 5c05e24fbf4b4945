"""What an export writes: the tables, in CSV and for pandas and pvlib, for which time, and from which store."""

import csv
import json
import math
import re
import sqlite3
import subprocess
import sys
from contextlib import closing
from dataclasses import replace
from datetime import UTC, datetime

import numpy as np
import pandas as pd
import pvlib
import pytest

from daemon.base.records import Event, Pose
from daemon.store.export import export
from daemon.store.schema import FILE_NAME
from daemon.store.tables import TableWriter
from solar.frames import angles_from_direction, direction_from_azimuth
from tests.daemon.store.test_store import ORIGIN, keep
from tests.daemon.store.test_tables import ALL, T0, decision, scan
from tests.support import DOCS
from tests.support.stored_day import stored_days

__all__ = ["keep"]


def rows(path):
    with path.open(newline="") as file:
        return list(csv.DictReader(file))


def test_an_export_has_the_values_of_directly_written_tables_plus_run_and_simulated(keep, tmp_path):
    with TableWriter(tmp_path / "tables") as tables:
        for record in ALL:
            tables.write(record)
    written = export(keep(*ALL), tmp_path / "out", "csv", None, None, ()).rows
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


def test_an_unpaired_surrogate_in_one_text_is_replaced_and_all_records_are_exported(keep, tmp_path):
    events = [Event(T0 + n, n, "test", text) for n, text in enumerate(("before", "half \ud800", "after"))]
    export(keep(*events), tmp_path / "out", "csv", None, None, ())
    assert [row["text"] for row in rows(tmp_path / "out" / "events.csv")] == ["before", "half ?", "after"]


@pytest.mark.parametrize("latitude_deg", [48.7, -33.9])
def test_an_exported_pose_means_the_same_to_pvlib_in_both_hemispheres(keep, tmp_path, latitude_deg):
    """If our angles face the sun, pvlib computes an angle of incidence of zero."""
    azimuth_deg, elevation_deg = (150.0, 40.0) if latitude_deg > 0 else (20.0, 40.0)
    a_deg, b_deg = angles_from_direction(direction_from_azimuth(azimuth_deg, elevation_deg, latitude_deg))
    pose = Pose(T0, 1.0, float(a_deg), float(b_deg), moving=False)
    folder = keep(pose, origin=replace(ORIGIN, latitude_deg=latitude_deg))
    export(folder, tmp_path / "out", "parquet", None, None, ["poses"])
    seen = pd.read_parquet(tmp_path / "out" / "poses.parquet").iloc[0]
    aoi = pvlib.irradiance.aoi(seen.surface_tilt, seen.surface_azimuth, 90 - elevation_deg, azimuth_deg)
    assert float(aoi) == pytest.approx(0, abs=1e-5)


def test_unknown_values_of_a_scan_are_exported_as_empty_cells(keep, tmp_path):
    folder = keep(scan(0))
    with closing(sqlite3.connect(folder / "heliocube.sqlite")) as store, store:
        # As an archive holds a face that was read before 1970, and a page without a number.
        store.execute("UPDATE scans SET east_time = NULL, sequence = NULL")
    for table_format in ("csv", "parquet"):
        export(folder, tmp_path / table_format, table_format, None, None, ["scans"])
    (row,) = rows(tmp_path / "csv" / "scans.csv")
    assert (row["east_time"], row["sequence"], row["south_time"] != "") == ("", "", True)
    seen = pd.read_parquet(tmp_path / "parquet" / "scans.parquet").iloc[0]
    assert (pd.isna(seen.east_time), pd.isna(seen.sequence), pd.isna(seen.south_time)) == (True, True, False)


def test_a_bad_zenith_reading_is_not_exported_as_ghi(keep, tmp_path):
    good = scan(0)
    bad = replace(good, sequence=1, zenith=good.zenith._replace(quality="implausible"))
    export(keep(good, bad), tmp_path / "out", "csv", None, None, ["scans"])
    assert [row["ghi"] != "" for row in rows(tmp_path / "out" / "scans.csv")] == [True, False]


def test_the_start_of_an_export_is_included_and_its_end_is_not(keep, tmp_path):
    folder = keep(*[Event(T0 + n, n, "test", str(n)) for n in range(10)])
    start, end = (datetime.fromtimestamp(T0 + n, UTC) for n in (3, 6))
    assert export(folder, tmp_path / "out", "csv", start, end, ["events"]).rows == {"events": 3}
    assert [row["text"] for row in rows(tmp_path / "out" / "events.csv")] == ["3", "4", "5"]


def test_rows_are_in_the_order_of_time_over_all_runs(keep, tmp_path):
    keep(Event(T0 + 5, 1, "test", "later"))
    folder = keep(Event(T0, 1, "test", "earlier"))
    export(folder, tmp_path / "out", "csv", None, None, ["events"])
    assert [(row["text"], row["run"]) for row in rows(tmp_path / "out" / "events.csv")] == [
        ("earlier", "2"),
        ("later", "1"),
    ]


def test_exported_rows_name_the_tracker_of_the_record_or_else_that_of_the_run(keep, tmp_path):
    east, west = replace(decision(), tracker="east"), replace(decision(), time_utc_s=T0 + 60, tracker="west")
    folder = keep(east, west)
    keep(replace(east, time_utc_s=T0 + 120), origin=replace(ORIGIN, tracker="roof"))
    export(folder, tmp_path / "out", "csv", None, None, ())
    assert [row["tracker"] for row in rows(tmp_path / "out" / "decisions.csv")] == ["east", "west", "roof"]


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        (
            ["--from", "2022-10-14", "--to", "2022-10-13"],
            "the first instant 2022-10-14T00:00:00.000Z is not before the end 2022-10-13T00:00:00.000Z: exchange them",
        ),
        (["--from", "noon"], "--from: 'noon' is not a date or time; write 2022-10-14 or 2022-10-14T08:00Z"),
        ([], "there is no store at {store}/heliocube.sqlite; name the folder that the service has as store.directory"),
    ],
)
def test_an_export_with_a_wrong_span_or_without_a_store_ends_with_one_sentence_and_code_2(
    heliocube, tmp_path, arguments, sentence
):
    code, out, err = heliocube("export", "--store", tmp_path, "--out", tmp_path / "out", *arguments)
    assert (code, out) == (2, "")
    assert err == f"heliocube: {sentence.format(store=tmp_path)}\n"
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("simulated", [True, False])
def test_the_json_answer_of_an_export_says_whether_the_records_are_of_simulated_instruments(
    heliocube, tmp_path, simulated
):
    store, out = stored_days(tmp_path / "store", simulated=simulated), tmp_path / "out"
    told = heliocube("export", "--store", store, "--out", out, "--kind", "moves", "--json")[1]
    assert json.loads(told)["simulated"] is simulated


def test_an_export_of_a_span_without_any_record_is_refused_and_nothing_is_written(heliocube, keep, tmp_path):
    folder, out = keep(Event(T0, 1, "test", "alone")), tmp_path / "out"
    asked = ("export", "--store", folder, "--out", out)
    day = f"{datetime.fromtimestamp(T0, UTC):%Y-%m-%d}"
    have = f"in {folder / FILE_NAME}; it has records from {day} to {day}"
    spans = {
        ("--to", "1999-01-02"): "to 1999-01-02 00:00 UTC",
        ("--from", "1999-01-01", "--to", "1999-01-02T12:30Z"): "from 1999-01-01 00:00 UTC to 1999-01-02 12:30 UTC",
    }
    for span, words in spans.items():
        code, _, err = heliocube(*asked, *span)
        assert (code, err) == (2, f"heliocube: no record {words} {have}\n")
    assert not out.exists()
    code, said, _ = heliocube(*asked, "--kind", "curves")
    assert (code, said) == (0, f"written to {out}: 0 curves\n"), "a kind without a record is an empty table"
    code, _, err = heliocube("export", "--store", keep(folder=tmp_path / "new"), "--out", tmp_path / "none")
    assert (code, err) == (2, f"heliocube: the store {tmp_path / 'new' / FILE_NAME} holds nothing yet\n")
    assert not (tmp_path / "none").exists()


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


def test_the_snippet_in_docs_data_md_reads_an_exported_day(keep, tmp_path):
    poses = [Pose(T0 + 600 * n, n, 20 * math.sin(n / 20), 60.0, moving=False) for n in range(144)]
    folder = keep(*[scan(n) for n in range(200)], *poses)
    export(folder, tmp_path / "day", "parquet", None, None, ())
    snippet = re.search(r"```python\n(.*?)```", (DOCS / "data.md").read_text(), re.DOTALL)[1]
    look = "print(len(scans), len(poses), *{(frame.index.name, str(frame.index.tz)) for frame in (scans, poses)})"
    command = [sys.executable, "-W", "error", "-c", f"{snippet}\n{look}"]
    done = subprocess.run(command, cwd=tmp_path, check=True, capture_output=True, text=True)
    assert done.stdout == "200 144 ('time', 'UTC')\n"
