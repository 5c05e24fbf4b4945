"""`heliocube plot`: pictures of a store and of exported tables."""

import json
from unittest.mock import ANY

import pytest

from tests.daemon.commands.studies.test_report import heliocube, store

__all__ = ["heliocube", "store"]

pytestmark = pytest.mark.slow

PICTURES = ("angles", "light", "motion")


def test_plot_draws_a_store_and_exported_tables_and_refuses_a_day_without_records(heliocube, store, tmp_path):
    day = ("--store", store, "--day", "2022-10-14")
    assert heliocube("plot", "light", "motion", *day, "--out", tmp_path / "new" / "day.png")[0] == 0
    for name in ("day-light.png", "day-motion.png"):
        assert (tmp_path / "new" / name).read_bytes().startswith(b"\x89PNG")
    assert heliocube("export", "--store", store, "--out", tmp_path / "tables")[0] == 0
    tables = ("--tables", tmp_path / "tables", "--site", "48.7,0,156")
    assert heliocube("plot", "angles", *tables, "--out", tmp_path / "angles.svg")[0] == 0
    assert "SIMULATED" in (tmp_path / "angles.svg").read_text()
    for day in ("today", "yesterday"):
        code, _, said = heliocube("plot", "angles", *tables, "--day", day, "--out", tmp_path / f"{day}.svg")
        assert (code, said.count("\n")) == (2, 1)
        assert "no record from " in said


@pytest.fixture
def tables(heliocube, store, tmp_path):
    """A folder of exported tables, and the options that ask for pictures of them, without names."""
    folder = tmp_path / "tables"
    assert heliocube("export", "--store", store, "--out", folder)[0] == 0
    asked = ("--tables", folder, "--site", "48.7,0", "--out", tmp_path / "a.svg")
    return folder, asked


@pytest.mark.parametrize(
    ("name", "picture"),
    [("scans", "light"), ("decisions", "angles"), ("moves", "motion"), ("poses", "angles"), ("modes", "angles")],
)
def test_a_last_line_that_breaks_off_is_left_out_of_a_picture_with_a_warning(heliocube, tables, name, picture):
    folder, asked = tables
    path = folder / f"{name}.csv"
    head, *rows, last = path.read_text().splitlines()
    for end in ("2022-1", last[:24], last.rsplit(",", 2)[0]):
        path.write_text("\n".join([head, *rows, end]))
        code, said, warned = heliocube("plot", picture, *asked, "--force")
        assert (code, said.count("written: ")) == (0, 1), warned
        at = f"at cell {end.count(',') + 1} of {head.count(',') + 1}"
        assert (
            warned == f"heliocube: warning: {path}: the last line, {len(rows) + 2}, breaks off {at} and is left out\n"
        )


@pytest.mark.parametrize(
    ("name", "spoil", "sentence"),
    [
        ("scans", lambda _: b"", " is empty: export it anew, or take the file away"),
        ("scans", lambda text: text.replace(b"time,", b"when,", 1), " has no column time: "),
        ("scans", lambda text: text.replace(b"east_quality", b"east", 1), " has no column east_quality: "),
        ("modes", lambda text: text.replace(b"after", b"then", 1), " has no column after: "),
        ("moves", lambda text: text.replace(b"outcome", b"end", 1), " has no column outcome: "),
        ("poses", lambda text: text.replace(b"b_deg", b"a_deg", 1), " has two columns a_deg: "),
        ("scans", lambda text: first_cell(text, 0, b"noon"), ", row 1: time is 'noon', not such as 2022-10-14T08:00Z"),
        ("scans", lambda text: first_cell(text, 0, b""), ", row 1: time is '', not such as 2022-10-14T08:00Z"),
        ("poses", lambda text: first_cell(text, 2, b"flat"), ", row 1: a_deg is 'flat', which is not a number"),
        ("poses", lambda text: first_cell(text, 4, b"perhaps"), ", row 1: moving is 'perhaps'; write true or false"),
        ("scans", lambda text: text.replace(b"\n", b"\n\xff", 1), " is not text in UTF-8: save it as such"),
        (
            "scans",
            lambda text: text.replace(b"\n", b'\n"', 1),
            ", line 2: a cell begins with a quotation mark and no mark",
        ),
        ("scans", lambda text: text.replace(b"\n", b"\n,", 1), " has more cells in its lines than names in its header"),
        ("scans", lambda text: text[:-1] + b",\n", ": there are 23 cells where the header has 22"),
        ("scans", lambda _: b"PAR1", " is a Parquet file: a CSV file is needed"),
    ],
)
def test_a_damaged_csv_table_is_refused_in_one_sentence_that_names_the_file_and_the_damage(
    heliocube, tables, name, spoil, sentence
):
    folder, asked = tables
    path = folder / f"{name}.csv"
    path.write_bytes(spoil(path.read_bytes()))
    code, _, said = heliocube("plot", *PICTURES, *asked)
    assert (code, said.count("\n")) == (2, 1)
    assert said.startswith(f"heliocube: {path}")
    assert sentence in said


@pytest.mark.parametrize("name", ["roof", "01", "NA"])
def test_an_event_without_a_tracker_does_not_count_as_a_second_tracker_of_the_tables(heliocube, tables, tmp_path, name):
    folder, asked = tables
    drawn = []
    for event in ("", "2022-10-14T09:00:00Z,1.0,cube,the cube is back,,true,1\n"):
        for path in folder.glob("*.csv"):
            path.write_text(path.read_text().replace(",roof", f",{name}"))
        (folder / "events.csv").write_text(f"time,time_monotonic_s,subject,text,tracker,simulated,run\n{event}")
        assert heliocube("plot", "angles", *asked, "--tracker", name, "--force") == (0, ANY, "")
        assert heliocube("plot", "angles", *asked, "--force") == (0, ANY, "")
        drawn.append({path: path.read_bytes() for path in tmp_path.glob("*.svg")})
    assert drawn[0] == drawn[1]


def first_cell(text, column, content):
    """Return a table with other content in one cell of its first row."""
    head, row, rest = text.split(b"\n", 2)
    cells = row.split(b",")
    cells[column] = content
    return b"\n".join([head, b",".join(cells), rest])


def test_a_damaged_parquet_table_is_refused_in_one_sentence_that_names_the_file(heliocube, store, tmp_path):
    folder = tmp_path / "tables"
    assert heliocube("export", "--store", store, "--out", folder, "--format", "parquet")[0] == 0
    path = folder / "scans.parquet"
    path.write_bytes(path.read_bytes()[:-8])
    code, _, said = heliocube("plot", "light", "--tables", folder, "--site", "48.7,0", "--out", tmp_path / "a.svg")
    assert (code, said.count("\n")) == (2, 1)
    assert f"heliocube: {path} is not a table that can be read: it is damaged or cut off; export it anew" in said


def test_tables_with_rows_out_of_order_after_a_clock_was_set_back_are_drawn_in_order_of_time(
    heliocube, tables, tmp_path
):
    folder, asked = tables
    assert heliocube("plot", *PICTURES, *asked)[0] == 0
    drawn = {path: path.read_bytes() for path in tmp_path.glob("a-*.svg")}
    assert len(drawn) == 3
    for path in folder.glob("*.csv"):
        head, *rows = path.read_text().splitlines()
        path.write_text("\n".join([head, *rows[len(rows) // 2 :], *rows[: len(rows) // 2], ""]))
    assert heliocube("plot", *PICTURES, *asked, "--force")[0] == 0
    assert {path: path.read_bytes() for path in tmp_path.glob("a-*.svg")} == drawn


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (
            ("moon", "--out", "x.png"),
            "'moon'; choose from light, angles, received, motion, wind, power",
        ),
        (("light", "--out", "x.gif"), "must end in .png or .svg"),
        (("power", "--out", "new/x.png"), "power: no I-V curve from 2022-10-14 00:00 UTC to 2022-10-15 00:00 UTC in "),
    ],
)
def test_a_picture_that_cannot_be_drawn_is_refused_in_one_sentence(
    heliocube, store, tmp_path, monkeypatch, arguments, message
):
    monkeypatch.chdir(tmp_path)
    code, _, said = heliocube("plot", *arguments, "--store", store, "--day", "2022-10-14")
    assert (code, said.count("\n")) == (2, 1)
    assert message in said
    assert not list(tmp_path.iterdir())


def test_the_other_pictures_are_written_when_one_picture_has_no_data(heliocube, store, tmp_path):
    asked = ("--store", store, "--day", "2022-10-14", "--out", tmp_path / "day.png", "--json")
    code, out, said = heliocube("plot", "power", "motion", *asked)
    assert (code, said.count("\n"), json.loads(out)) == (
        2,
        1,
        {"simulated": True, "written": [str(tmp_path / "day-motion.png")]},
    )
    assert "power: no I-V curve from 2022-10-14 00:00 UTC" in said
    assert [path.name for path in tmp_path.iterdir()] == ["day-motion.png"]


def test_the_wind_picture_is_refused_when_no_wind_was_measured(heliocube, tmp_path):
    out = tmp_path / "tables"
    assert heliocube("simulate", "--start", "2022-06-21T11:00Z", "--days", "0.01", "--out", out)[0] == 0
    poses = (out / "poses.csv").read_text().splitlines()
    at = poses[0].split(",").index("wind_m_s")
    rows = [line.split(",") for line in poses[1:]]
    calm = [poses[0], *(",".join([*row[:at], "", *row[at + 1 :]]) for row in rows)]
    (out / "poses.csv").write_text("\n".join(calm))
    code, _, said = heliocube("plot", "wind", "--tables", out, "--site", "48.7,2.2", "--out", tmp_path / "wind.png")
    assert (code, said.count("\n")) == (2, 1)
    assert "wind: no reading of the wind from 2022-06-21 11:00 UTC" in said
