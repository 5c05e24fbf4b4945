import csv
import io
import json
import re

import numpy as np
import pytest
from pyarrow import parquet

from solar import gain
from solar.gain import printed

pytestmark = pytest.mark.slow

POINTS = "phi_deg,beta_deg,n,lambda_deg\n45,35,172,5\n-33.87,-30,10,15\n82,60,1,0\n10,60,172,90\n"


def rows(text):
    read = csv.DictReader(io.StringIO(text))
    return [{name: float(cell) for name, cell in row.items() if name != "simulated"} for row in read]


def test_one_latitude_and_a_range_are_answered_together(heliocube):
    code, out, _ = heliocube("gain", "--lat", "48.7", "--lat-range", "0:60:30", "--format", "csv")
    assert code == 0
    assert [row["phi_deg"] for row in rows(out)] == [0.0, 30.0, 48.7, 60.0]


def test_one_latitude_compares_the_devices_at_their_best_tilts(heliocube):
    code, out, err = heliocube("gain", "--lat", "48.7")
    assert (code, err) == (0, "")
    first, *lines = out.splitlines()
    assert first == "Latitude 48.7 deg, the year, in theory:"
    assert lines[1].split() == ["against", "tilt", "azimuth", "K", "dual", "gains", "over", "static"]
    assert lines[2].split() == ["static", "panel", "45.4", "0", "1.6875", "+68.7", "%"]
    assert lines[3].split() == ["vertical", "axis", "63.5", "sun", "1.0465", "+4.7", "%", "+61.2", "%"]
    assert lines[4].split()[:4] == ["horizontal", "axis", "37.5", "0"]


@pytest.mark.parametrize("asked", [("--lat", "-90"), ("--lat=-0", "--azimuth=-0"), ("--lat", "-0", "--day", "81")])
def test_no_table_has_a_negative_zero(heliocube, asked):
    code, out, _ = heliocube("gain", *asked)
    assert code == 0
    assert not re.search(r"(?<![\w.])-0(\.0+)?(?![\d.])", out), out


def test_a_grid_has_a_row_for_each_latitude_tilt_azimuth_and_day(heliocube):
    code, out, _ = heliocube(
        "gain", "--lat-range", "0:60:30", "--tilt", "10,40", "--azimuth=-20:20:20", "--day", "1:3", "--format", "csv"
    )
    found = rows(out)
    assert code == 0
    assert len(found) == 3 * 2 * 3 * 3
    assert [row["n"] for row in found[:4]] == [1, 2, 3, 1]
    for row in found:
        day = gain.daily(row["phi_deg"], row["beta_deg"], row["n"], row["lambda_deg"])
        assert row["K_DS_clip"] == day.k_ds_clip
        assert row["K_DV"] == day.k_dv
        assert row["eta_HS"] == pytest.approx(float(day.k_ds_clip / day.k_dh - 1.0))


def test_the_ratio_of_a_year_is_the_ratio_of_its_yearly_sums(heliocube):
    _, out, _ = heliocube("gain", "--lat", "-33.9", "--tilt=-30", "--year", "--format", "csv")
    (row,) = rows(out)
    year = gain.yearly(-33.9, -30.0)
    assert row["K_DS_abs"] == pytest.approx(float(year.k_ds_abs), rel=1e-13)
    assert row["K_DH"] == pytest.approx(float(year.k_dh), rel=1e-13)


def test_the_table_has_only_the_columns_of_the_device_named_by_against(heliocube):
    _, out, _ = heliocube("gain", "--lat", "30", "--against", "vertical", "--format", "csv")
    assert out.splitlines()[0] == "phi_deg,beta_vertical_deg,lambda_deg,K_DV"


def test_printed_adds_the_equations_of_the_paper_to_a_day_and_its_scripts_to_a_year(heliocube):
    _, out, _ = heliocube("gain", "--lat", "45", "--tilt", "35", "--azimuth", "5", "--day", "172", "--printed",
                          "--format", "csv")  # fmt: skip
    (row,) = rows(out)
    assert row["K_DS_eq11"] == pytest.approx(2.1, abs=0.2)
    assert {"K_DV_eq25", "K_DV_script2", "K_DH_eq49", "K_DH_script3"} < set(row)
    _, out, _ = heliocube("gain", "--lat", "45", "--tilt", "35", "--azimuth", "5", "--printed", "--format", "csv")
    (row,) = rows(out)
    days = printed.script1(45.0, 35.0, gain.DAYS, 5.0).k_ds
    assert row["eta_DS_script1_min"] == pytest.approx(float(days.min()) - 1.0)
    assert {"eta_DV_script2_min", "eta_DH_script3_min"} < set(row)


def test_points_are_answered_row_by_row_at_full_precision(heliocube, tmp_path):
    file = tmp_path / "points.csv"
    file.write_text("id," + POINTS.replace("\n", "\n7,").removesuffix("7,"))
    code, out, _ = heliocube("gain", "--points", file, "--printed")
    found = rows(out)
    assert code == 0
    assert list(found[0]) == [
        "phi_deg", "beta_deg", "n", "lambda_deg", "K_DS_abs", "K_DS_clip", "K_DV", "K_DH",
        "K_DS_eq11", "K_DV_eq25", "K_DV_script2", "K_DH_eq49", "K_DH_script3",
    ]  # fmt: skip
    assert found[1]["K_DV"] == gain.k_dv(-33.87, -30.0, 10)
    assert np.isnan(list(found[2].values())[4:]).all()
    assert np.isnan(found[3]["K_DS_eq11"])
    assert np.isfinite(found[3]["K_DS_clip"])


def test_points_agree_with_the_reference(heliocube, measured):
    file = measured / "theory" / "exact_points.csv"
    if not file.is_file():
        pytest.skip(f"the reference tables of the theory are not at {file.parent}")
    _, out, _ = heliocube("gain", "--points", file)
    for ours, expected in zip(rows(out), csv.DictReader(io.StringIO(file.read_text())), strict=True):
        for name, reference in {"K_DS_clip": "KDS_clip", "K_DV": "KDV", "K_DH": "KDH_day_signed"}.items():
            value = float(expected[reference] or "nan")
            assert ours[name] == pytest.approx(value if not value > 1e15 else np.inf, rel=1e-9, nan_ok=True)


def test_parquet_has_the_same_numbers(heliocube, tmp_path):
    out = tmp_path / "answer.parquet"
    assert heliocube("gain", "--lat", "30", "--day", "10", "--format", "parquet", "--out", out)[0] == 0
    table = parquet.read_table(out).to_pydict()
    assert table["n"] == [10]
    _, text, _ = heliocube("gain", "--lat", "30", "--day", "10", "--format", "csv")
    assert rows(text)[0]["K_DV"] == table["K_DV"][0]


def test_ratio_and_gain_of_a_polar_night_are_printed_as_dashes(heliocube):
    code, out, _ = heliocube("gain", "--lat", "90", "--day", "355")
    assert (code, out.splitlines()[3].split()) == (0, ["static", "panel", "65.0", "0", "-", "-"])
    assert "nan" not in out


def test_a_long_table_says_how_many_rows_it_left_out(heliocube):
    _, out, _ = heliocube("gain", "--lat", "30", "--day", "1:365")
    assert "and 165 rows more: --format csv writes them all" in out.splitlines()
    _, out, _ = heliocube("gain", "--lat", "30", "--day", "1:201")
    assert "and 1 row more: --format csv writes them all" in out.splitlines()


def test_a_table_printed_beside_a_figure_is_cut_to_a_dozen_rows(heliocube, tmp_path):
    _, out, _ = heliocube("gain", "--lat-range", "0:20", "--plot", tmp_path / "tilts.svg")
    tables, end = out.split("\nand 9 rows more: --format csv writes them all\n")
    assert all(len(part.splitlines()) == 13 for part in tables.split("\n\n"))
    assert end.startswith("\nK: the dual axis over a static panel")


def test_each_part_of_a_wide_table_repeats_the_column_of_the_day(heliocube):
    _, out, _ = heliocube("gain", "--lat", "48.7", "--printed", "--day", "1:10:3")
    parts = [part.splitlines() for part in out.split("\n\n")[:-1]]
    assert len(parts) > 1
    assert [[line.split()[0] for line in part] for part in parts] == [["n", "1", "4", "7", "10"]] * len(parts)
    assert "nan" not in out
    assert max(map(len, out.splitlines())) <= 80


def test_a_range_ends_at_its_end_in_spite_of_rounding(heliocube):
    code, out, _ = heliocube("gain", "--lat-range", "0:90:1.8367346939", "--format", "csv")
    assert code == 0
    last = list(csv.DictReader(out.splitlines()))[-1]
    assert "90" in last.values() or "90.0" in last.values(), last


def test_ratios_under_a_clear_sky_are_given_beside_those_of_the_theory(heliocube):
    _, out, _ = heliocube("gain", "--lat", "48.7", "--weather", "clear", "--format", "csv")
    (row,) = rows(out)
    # The atmosphere weakens mornings and evenings, when trackers gain most.
    assert 1.3 < row["K_DS_clip_sky"] < row["K_DS_clip"]
    assert 1.0 < row["K_DV_sky"] < row["K_DV"]
    assert row["eta_VS_sky"] == pytest.approx(row["K_DS_clip_sky"] / row["K_DV_sky"] - 1.0)


def test_simulated_weather_is_marked_as_simulated_in_every_table(heliocube, tmp_path):
    assert heliocube("samples", "--out", tmp_path)[0] == 0
    asked = ("gain", "--lat", 48.7176, "--lon", 2.2, "--weather", tmp_path / "clear.csv", "--day", "284:286")
    _, out, _ = heliocube(*asked)
    assert out.startswith("Under the sky: SIMULATED clear.csv, 2022-10-12")
    _, out, _ = heliocube(*asked, "--format", "csv")
    assert [row["simulated"] for row in csv.DictReader(io.StringIO(out))] == ["true"] * 3
    _, out, _ = heliocube(*asked[:-2], "--json")
    assert json.loads(out)["rows"][0]["simulated"] is True
    _, out, _ = heliocube(*asked[:-3], weather_file(tmp_path), "--json")
    assert json.loads(out)["rows"][0]["simulated"] is False


def weather_file(folder):
    """A day of thick cloud over Paris, brightest at noon."""
    hours = np.arange(0.0, 24.0, 0.5)
    diffuse = 150.0 * np.clip(np.cos((hours - 12.0) / 8.0 * np.pi / 2.0), 0.0, None) ** 1.5
    lines = [
        f"2016-06-05T{int(hour):02d}:{int(hour % 1 * 60):02d}:00Z,{dhi:.3f},0,{dhi:.3f}"
        for hour, dhi in zip(hours, diffuse, strict=True)
    ]
    file = folder / "weather.csv"
    file.write_text("time,ghi,dni,dhi\n" + "\n".join(lines) + "\n")
    return file


def test_under_measured_overcast_weather_a_tracker_receives_less_than_a_flat_panel(heliocube, tmp_path):
    file = weather_file(tmp_path)
    code, out, err = heliocube(
        "gain", "--lat", "48.7", "--lon", "2.2", "--weather", file, "--day", "157", "--tilt", "0", "--format", "csv"
    )
    assert (code, err) == (0, "")
    assert rows(out)[0]["K_DS_clip_sky"] < 0.95


def test_weather_of_a_day_or_two_beside_the_theory_of_a_whole_year_gives_a_warning(heliocube, tmp_path):
    file = weather_file(tmp_path)
    given = ("gain", "--lat", "48.7", "--lon", "2.2", "--weather", file)
    _, _, err = heliocube(*given)
    theory = "only, while the theory's are of a whole year"
    assert err == f"heliocube: warning: weather.csv has 1 day: the ratios under its sky are of that day {theory}\n"
    # That is said whatever else is wrong with the file.
    file.write_text(f"{file.read_text()}\n2022-06-07T00:00Z,9999,0,0\n")
    _, _, err = heliocube(*given)
    assert "1 impossible value" in err
    assert theory in err
    lines = file.read_text().split()[:-1]
    file.write_text("\n".join([*lines, *(line.replace("06-05", "06-06") for line in lines[1:])]))
    _, _, err = heliocube(*given)
    assert f"weather.csv has 2 days: the ratios under its sky are of those days {theory}" in err


@pytest.mark.parametrize(
    ("kind", "arguments", "suffix"),
    [
        ("map", ["--lat-range", "0:60:20", "--tilt", "0:90:30"], "png"),
        ("best-tilt", ["--lat-range", "0:60:20"], "svg"),
        ("daily", ["--lat", "70"], "png"),
        ("printed", ["--lat", "45", "--azimuth", "5", "--printed"], "png"),
    ],
)
def test_each_kind_of_request_gets_its_fitting_figure_by_default(heliocube, tmp_path, kind, arguments, suffix):
    fitting, named = tmp_path / f"fitting.{suffix}", tmp_path / f"named.{suffix}"
    assert heliocube("gain", *arguments, "--plot", fitting)[0] == 0
    code, _, err = heliocube("gain", *arguments, "--plot", named, "--plot-kind", kind)
    assert (code, err) == (0, f"figure in {named}\n")
    assert fitting.stat().st_size == pytest.approx(named.stat().st_size, rel=0.01)


def test_figures_also_show_the_ratios_under_the_weather(heliocube, tmp_path):
    for arguments in (["--lat-range", "0:60:60", "--tilt", "0:90:45"], ["--lat-range", "0:60:60"], ["--lat", "40"]):
        plain, sky = tmp_path / "plain.svg", tmp_path / "sky.svg"
        heliocube("gain", *arguments, "--against", "vertical", "--plot", plain, "--force")
        assert (
            heliocube("gain", *arguments, "--against", "vertical", "--weather", "clear", "--plot", sky, "--force")[0]
            == 0
        )
        assert sky.stat().st_size > 1.05 * plain.stat().st_size


def test_a_weather_file_of_one_day_is_one_dot_in_the_figure_of_days(heliocube, tmp_path):
    assert heliocube("samples", "--out", tmp_path)[0] == 0
    figure = tmp_path / "figure.svg"
    asked = ("--lat", 48.7176, "--day", "280:290", "--against", "vertical", "--weather", tmp_path / "clear.csv")
    assert heliocube("gain", *asked, "--lon", 2.2, "--plot", figure)[0] == 0
    assert len(re.findall("<use .*#d55e00", figure.read_text())) == 1


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        (["--lat", "91"], "--lat: 91 is not in -90..90"),
        (["--lat", "nan"], "--lat: nan is not in -90..90"),
        ([], "give --lat or --lat-range, such as --lat 48.7 or --lat-range 0:65:1"),
        (["--lat-range", "0:95"], "--lat-range: 95 is not in -90..90"),
        (["--lat-range", "50:40:1"], "--lat-range: the range '50:40:1' must rise by a step above 0"),
        (["--lat-range", "0:50:nan"], "--lat-range: '0:50:nan' is not a number, a list A,B,C or a range"),
        (["--lat-range", "0:5_0"], "--lat-range: '0:5_0' is not a number, a list A,B,C or a range"),
        (["--lat-range", "0:50:1e-9"], "--lat-range: the range '0:50:1e-9' has more than 20000000 values"),
        (["--lat-range", "a:b"], "--lat-range: 'a:b' is not a number, a list A,B,C or a range FROM:TO:STEP"),
        (["--lat", "1", "--tilt", "100"], "--tilt: 100 is not in -90..90"),
        (["--lat", "1", "--tilt", "1:2:3:4"], "--tilt: '1:2:3:4' is not a number"),
        (["--lat", "1", "--azimuth", "200"], "--azimuth: 200 is not in -180..180"),
        (["--lat", "1", "--day", "0"], "--day: 0 is not in 1..365"),
        (["--lat", "1", "--day", "1.5"], "--day: '1.5' must give whole days of the year, 1..365"),
        (["--lat", "1", "--day", "1", "--year"], "--day and --year exclude each other; give one of them"),
        (["--lat", "1", "--against", "static,moon"], "--against: there is no device 'moon'; choose from static, "),
        (["--lat-range", "0:90:0.01", "--tilt", "0:90:0.01"], "this asks for 81018001 rows, more than 20000000"),
        (["--lat", "1", "--weather", "none.csv"], "there is no weather file at none.csv"),
        (["--lat-range", "0:9", "--weather", "w.csv"], "a weather file belongs to one site; give its latitude"),
        (["--lat", "1", "--lon", "2"], "--lon and --altitude say where the weather was measured; add --weather"),
        (["--lat", "1", "--plot", "figure.doc"], "--plot: figure.doc must end in .png, .svg or .pdf"),
        (["--lat", "1", "--plot", "/dev/null/figure.png"], "--plot: /dev/null cannot be a folder: /dev/null is a file"),
        (["--lat", "1", "--plot", "f.png", "--plot-kind", "map"], "the map needs several latitudes and at least three"),
        (
            ["--lat", "1", "--plot", "f.png", "--plot-kind", "best-tilt"],
            "the best tilt is drawn by latitude: give seve",
        ),
        (
            ["--lat-range", "0:2", "--tilt", "0:9:3", "--azimuth", "0,30", "--plot", "f.png"],
            "the map is drawn for one azimuth and one day or the year; give one of each",
        ),
        (
            ["--lat-range", "0:2", "--tilt", "0:9:3", "--day", "1:9", "--plot", "f.png"],
            "the map is drawn for one azimuth and one day or the year; give one of each",
        ),
        (["--lat-range", "0:2", "--azimuth", "0,30", "--plot", "f.png"], "the best tilt is drawn for one azimuth"),
        (["--lat-range", "0:2", "--printed", "--plot", "f.png"], "the comparison with the paper is drawn for one lat"),
        (["--lat", "1", "--plot-kind", "map"], "--plot-kind needs a file to draw in; add --plot FILE"),
        (["--lat", "1", "--out", "x.csv"], "--out takes a CSV or a Parquet file; add --format csv or --format parquet"),
        (
            ["--lat", "1", "--format", "csv", "--out", "/dev/null/x.csv"],
            "--out: /dev/null cannot be a folder: /dev/null is a file",
        ),
        (["--points", "none.csv"], "there is no points file at none.csv"),
        (["--points", "none.csv", "--lat", "1"], "--points takes its cases from the file; leave out --lat"),
    ],
)
def test_a_mistaken_option_is_refused_in_one_sentence_with_exit_code_2(
    heliocube, tmp_path, monkeypatch, arguments, sentence
):
    monkeypatch.chdir(tmp_path)
    code, out, err = heliocube("gain", *arguments)
    assert (code, out) == (2, "")
    assert err.startswith(f"heliocube: {sentence}")
    assert err.count("\n") == 1
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        ("", "is empty: name a CSV file with the columns phi_deg,beta_deg,n,lambda_deg"),
        ("phi_deg,beta_deg,n\n", "has no column lambda_deg; found: phi_deg, beta_deg, n"),
        ("phi_deg,beta_deg,n,lambda_deg\n", "has a header and no data: write a row for each case below it"),
        (POINTS + "\n91,0,1,0\n", "line 7: phi_deg is '91', not a number in -90..90"),
        (POINTS.replace("172,5", "172,nan"), "line 2: lambda_deg is 'nan', not a number in -180..180"),
        (POINTS.replace(",10,15", ",1.5,15"), "line 3: n is '1.5', not a whole number in 1..365"),
        (POINTS.replace(",10,15", ""), "line 3: n is '', not a whole number in 1..365"),
        ("phi_deg,beta_deg,n,lambda_deg\n\xff".encode("latin-1"), "is not text in UTF-8"),
        (POINTS.replace("45,35", "45,5,35"), "line 2: there are 5 cells where the header has 4"),
        (
            POINTS.replace("82,", '"82,'),
            "line 4: a cell begins with a quotation mark and no mark ends it: take the mark out",
        ),
    ],
)
def test_a_bad_points_file_is_refused_naming_the_file_and_the_mistake(heliocube, tmp_path, text, sentence):
    file = tmp_path / "points.csv"
    file.write_bytes(text if isinstance(text, bytes) else text.encode())
    code, out, err = heliocube("gain", "--points", file)
    assert (code, out) == (2, "")
    assert err.startswith(f"heliocube: points file {file}")
    assert sentence in err
    assert err.count("\n") == 1


def test_weather_that_does_not_say_its_place_or_does_not_cover_the_day_is_refused(heliocube, tmp_path):
    file = weather_file(tmp_path)
    code, _, err = heliocube("gain", "--lat", "48.7", "--weather", file)
    assert (code, "give its longitude with --lon" in err) == (2, True)
    code, _, err = heliocube("gain", "--lat", "48.7", "--lon", "2.2", "--weather", file, "--day", "10")
    assert (code, "has no daylight on the days asked for with --day" in err) == (2, True)
