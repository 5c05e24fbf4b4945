import csv
import math
from dataclasses import fields, is_dataclass
from datetime import UTC, datetime

import pyarrow.parquet as pq
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from daemon.base.errors import UserError
from daemon.base.records import (
    CurveQuality,
    Decision,
    Event,
    FaceReading,
    Irradiances,
    IvCurve,
    Mode,
    ModeChange,
    Move,
    MoveOutcome,
    Pose,
    Quality,
    Scan,
    Target,
)
from daemon.store.tables import COLUMNS, TableWriter

T0 = datetime(2022, 10, 14, 6, 0, tzinfo=UTC).timestamp()
KINDS = ["curves", "decisions", "events", "modes", "moves", "poses", "scans"]


def face(value, quality=Quality.OK, at_s=0.0):
    return FaceReading(value, quality, T0 + at_s, at_s)


def scan(n=0):
    return Scan(
        "cube",
        "s1",
        n,
        T0 + 5 * n + 1.25,
        5 * n + 1.25,
        face(101.5, at_s=0.25),
        face(math.nan, Quality.OVER_RANGE, 0.5),
        face(-0.125, at_s=0.75),
        face(1 / 3, at_s=1.25),
        simulated=True,
    )


def decision(irradiances=None):
    nan = math.nan
    return Decision(
        T0,
        1.0,
        Mode.FALLBACK,
        "chronometric",
        irradiances,
        nan,
        nan,
        120.5,
        30.0,
        Target(-3.5, 60.0, "the sun, by ephemeris"),
        True,
    )


MOVE = Move(T0, 1.0, 12.5, 0.0, 90.0, -3.5, 60.0, -3.4, 60.1, MoveOutcome.ARRIVED, "decision")
POSE = Pose(T0 + 0.0004, 2.0, -3.4, 60.1, False)
CHANGE = ModeChange(T0, 1.0, Mode.STARTING, Mode.TRACKING, "first readings")
EVENT = Event(T0, 1.0, "positioner", 'said "no",\nthen nothing')
CURVE = IvCurve(
    T0,
    1.0,
    1.6,
    274.25,
    0.125,
    31.5,
    8.7,
    38.25,
    math.nan,
    640.5,
    math.nan,
    29,
    CurveQuality.STOPPED,
    "tripped",
    "AAAA",
)
ALL = [scan(0), scan(1), decision(), decision(Irradiances(1.0, 2.0, 3.0, 4.0, 0.9)), MOVE, POSE, CHANGE, EVENT, CURVE]


def write(directory, form="csv", records=ALL):
    with TableWriter(directory, form) as tables:
        for record in records:
            tables.write(record)
    return directory


def rows(directory, name):
    with (directory / f"{name}.csv").open(newline="") as file:
        return list(csv.DictReader(file))


def test_every_kind_has_a_table_of_its_own_even_when_it_stayed_empty(tmp_path):
    out = write(tmp_path / "out", records=[POSE])
    assert sorted(p.name for p in out.iterdir()) == [f"{kind}.csv" for kind in KINDS]
    assert rows(out, "moves") == []
    assert (out / "modes.csv").read_text() == "time,time_monotonic_s,before,after,why,tracker\n"


def test_a_scan_is_one_row_with_units_in_column_names_and_an_empty_cell_for_a_missing_number(tmp_path):
    row = rows(write(tmp_path / "out"), "scans")[0]
    assert row == {
        "time": "2022-10-14T06:00:01.250Z",
        "time_monotonic_s": "1.25",
        "source": "cube",
        "session": "s1",
        "sequence": "0",
        "simulated": "true",
        "east_w_m2": "101.5",
        "east_quality": "ok",
        "east_time": "2022-10-14T06:00:00.250Z",
        "south_w_m2": "",
        "south_quality": "over-range",
        "south_time": "2022-10-14T06:00:00.500Z",
        "west_w_m2": "-0.125",
        "west_quality": "ok",
        "west_time": "2022-10-14T06:00:00.750Z",
        "zenith_w_m2": "0.3333333333333333",
        "zenith_quality": "ok",
        "zenith_time": "2022-10-14T06:00:01.250Z",
        "calibration": "",
    }


def test_a_decision_without_irradiances_leaves_their_cells_empty(tmp_path):
    without, with_mean = rows(write(tmp_path / "out"), "decisions")
    assert (without["east_w_m2"], without["coverage"], without["direction_azimuth_deg"]) == ("", "", "")
    assert (without["mode"], without["target_b_deg"], without["why"]) == ("fallback", "60.0", "the sun, by ephemeris")
    assert (with_mean["zenith_w_m2"], with_mean["coverage"], with_mean["moved"]) == ("4.0", "0.9", "true")


def test_text_with_commas_quotes_and_line_ends_comes_back_as_it_was(tmp_path):
    assert rows(write(tmp_path / "out"), "events")[0]["text"] == EVENT.text


def test_parquet_holds_the_same_values_with_true_types(tmp_path):
    table = pq.read_table(write(tmp_path / "out", "parquet") / "scans.parquet")
    assert table.schema.names == [c.name for c in COLUMNS[Scan][1]]
    first = table.to_pylist()[0]
    assert first["time"] == datetime(2022, 10, 14, 6, 0, 1, 250_000, tzinfo=UTC)
    assert first["south_w_m2"] is None
    assert (first["zenith_w_m2"], first["sequence"], first["simulated"]) == (1 / 3, 0, True)
    assert first["east_quality"] == "ok"


def test_parquet_written_in_several_row_groups_keeps_every_row_in_order(tmp_path):
    poses = [Pose(T0 + n, float(n), 0.0, 90.0, False) for n in range(40_000)]
    file = pq.ParquetFile(write(tmp_path / "out", "parquet", poses) / "poses.parquet")
    assert file.metadata.num_row_groups > 1
    assert file.read(["time_monotonic_s"])["time_monotonic_s"].to_pylist() == [float(n) for n in range(40_000)]


@pytest.mark.parametrize("form", ["csv", "parquet"])
def test_the_same_records_give_the_same_bytes(tmp_path, form):
    first, second = write(tmp_path / "a", form), write(tmp_path / "b", form)
    for kind in KINDS:
        name = f"{kind}.{form}"
        assert (first / name).read_bytes() == (second / name).read_bytes()


@pytest.mark.parametrize("form", ["csv", "parquet"])
def test_table_files_get_their_final_names_only_when_the_writer_closes(tmp_path, form):
    tables = TableWriter(tmp_path, form)
    tables.write(POSE)
    assert all(path.suffix == ".part" for path in tmp_path.iterdir())
    tables.close()
    assert not list(tmp_path.glob("*.part"))
    assert len(list(tmp_path.iterdir())) == len(KINDS)


@pytest.mark.parametrize("form", ["csv", "parquet"])
def test_a_run_that_fails_leaves_no_tables_and_no_folder(tmp_path, form):
    def broken_run():
        with TableWriter(tmp_path / "out", form) as tables:
            tables.write(POSE)
            raise RuntimeError("power cut")

    with pytest.raises(RuntimeError, match="power cut"):
        broken_run()
    assert list(tmp_path.iterdir()) == []


def test_tables_are_added_to_a_directory_with_other_files_and_these_are_kept(tmp_path):
    (tmp_path / "notes.txt").write_text("mine")
    write(tmp_path)
    assert (tmp_path / "notes.txt").read_text() == "mine"
    assert (tmp_path / "scans.csv").exists()


def test_earlier_results_are_never_overwritten(tmp_path):
    write(tmp_path)
    before = (tmp_path / "scans.csv").read_bytes()
    with pytest.raises(UserError, match=r"scans\.csv is there already: --force overwrites it, or name another --out"):
        TableWriter(tmp_path)
    assert (tmp_path / "scans.csv").read_bytes() == before
    assert not list(tmp_path.glob("*.part"))


def test_an_output_folder_whose_path_is_a_file_is_refused_in_one_sentence(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(UserError, match=r"--out: .* cannot be a folder: .* is a file"):
        TableWriter(tmp_path / "file")


def test_every_field_of_every_kind_of_record_has_a_column_in_the_tables():
    """Only each face's own monotonic time is left out: it is the scan's, less the difference of the two UTC times."""
    left_out = {f"{name}.time_monotonic_s" for name in ("east", "south", "west", "zenith")}
    examples = {type(record): record for record in ALL}
    for kind, (_, columns) in COLUMNS.items():
        leaves = set()
        for field in fields(kind):
            value = getattr(examples[kind], field.name)
            inner = [f.name for f in fields(value)] if is_dataclass(value) else getattr(value, "_fields", ())
            leaves |= {f"{field.name}.{name}" for name in inner} or {field.name}
        assert leaves - left_out == {column.path for column in columns}


@settings(max_examples=25)
@given(times_s=st.lists(st.floats(0, 4e9), min_size=1, max_size=50))
def test_times_are_iso_8601_to_the_millisecond(times_s, tmp_path_factory):
    events = [Event(time_s, 0.0, "clock", "") for time_s in times_s]
    out = write(tmp_path_factory.mktemp("times") / "out", records=events)
    stamps = [datetime.fromtimestamp(time_s, UTC).isoformat(timespec="milliseconds") for time_s in times_s]
    assert [row["time"] for row in rows(out, "events")] == [stamp.replace("+00:00", "Z") for stamp in stamps]
