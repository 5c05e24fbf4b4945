"""`heliocube compare` on tables made by hand."""

import csv
import json
import shutil
import sqlite3
import sys
from contextlib import closing
from datetime import UTC, datetime

import numpy as np
import pandas as pd
import pytest

from daemon.commands.main import main
from daemon.store.schema import open_for_writing

pytestmark = pytest.mark.slow

SITE = "48.7176,2.2090,156"
NOON = datetime(2022, 10, 12, 10, tzinfo=UTC).timestamp()


@pytest.fixture
def compare(monkeypatch, capsys):
    """Runs the command; returns its exit code and what it wrote to either stream."""

    def run(*arguments):
        monkeypatch.setattr(sys, "argv", ["heliocube", "compare", *map(str, arguments)])
        with pytest.raises(SystemExit) as ended:
            main()
        written = capsys.readouterr()
        return ended.value.code or 0, written.out, written.err

    return run


def table(path, rows, columns="time,tracker,pmpp_w,a_deg,b_deg"):
    path.write_text("\n".join([columns, *rows]) + "\n")
    return path


def stamp(utc_s):
    return datetime.fromtimestamp(utc_s, UTC).isoformat()


@pytest.fixture
def flat(tmp_path):
    """An hour with both trackers flat, from 50 to 200 W; T-Cube's measuring chain reads 2 W and 1 % low."""
    rows = []
    for place, power in enumerate(np.linspace(50.0, 200.0, 720)):
        when = NOON - 86400 + 5.0 * place
        rows.append(f"{stamp(when)},T-Cube,{0.99 * power - 2.0},0,90")
        rows.append(f"{stamp(when + 1.0)},T-Chrono,{power},0.5,89.5")
    return table(tmp_path / "flat.csv", rows)


@pytest.fixture
def day(tmp_path):
    """Two hours: T-Cube's chain shows 97 W for 100 W, T-Chrono's 98 W in the first and 102 W in the second."""
    rows = []
    for place in range(1440):
        when = NOON + 5.0 * place
        rows.append(f"{stamp(when)},T-Cube,97,0,80,300,{90 if place < 720 else 300}")
        rows.append(f"{stamp(when)},T-Chrono,{98 if place < 720 else 102},-20,40,300,{90 if place < 720 else 300}")
    return table(tmp_path / "day.csv", rows, "time,tracker,pmpp_w,a_deg,b_deg,ghi_w_m2,dhi_w_m2")


@pytest.fixture
def powers(day, tmp_path):
    """The same two hours without poses: a report then draws no movement, which is the larger of its figures."""
    pd.read_csv(day).drop(columns=["a_deg", "b_deg"]).to_csv(tmp_path / "powers.csv", index=False)
    return tmp_path / "powers.csv"


def test_fit_finds_the_bias_of_the_measuring_chains_and_report_corrects_it(compare, flat, day, tmp_path):
    code, out, err = compare("fit", flat, "--out", tmp_path / "bias.json")
    assert (code, err) == (0, "")
    assert "720 pairs" in out
    assert out.endswith(f"written to {tmp_path / 'bias.json'}; figure: bias.png and bias.svg\n")
    found = json.loads((tmp_path / "bias.json").read_text())
    assert found["linear"] == pytest.approx(1 / 0.99)
    assert found["constant_w"] == pytest.approx(2 / 0.99)
    assert found["before"]["mbe_w"] == pytest.approx(-2.0 - 0.01 * 125.0)
    assert found["after"]["mae_w"] == pytest.approx(0.0, abs=1e-9)
    assert (tmp_path / "bias.png").read_bytes().startswith(b"\x89PNG")
    assert "<svg" in (tmp_path / "bias.svg").read_text()

    asked = ("report", day, flat, "--bias", tmp_path / "bias.json", "--site", SITE, "--out")
    code, _, err = compare(*asked, tmp_path)
    assert code == 2
    assert err == f"heliocube: {tmp_path}/bias.png is there already: --force overwrites it, or name another --out\n"
    assert not (tmp_path / "gains.csv").exists()
    tmp_path /= "result"
    code, out, err = compare(*asked, tmp_path)
    assert (code, err) == (0, "")
    rows = list(csv.DictReader((tmp_path / "gains.csv").read_text().splitlines()))
    # By the correction 97 W of T-Cube are 100 W: 100 against 98, and then against 102.
    first, overcast = (row for row in rows if row["period"] in ("clear", "overcast") and row["date"] == "2022-10-12")
    assert (first["period"], overcast["period"]) == ("clear", "overcast")
    assert float(first["gain_pct"]) == pytest.approx(100 * 2 / 98, abs=1e-3)
    assert float(overcast["gain_pct"]) == pytest.approx(-100 * 2 / 102, abs=1e-3)
    assert float(first["uncorrected_pct"]) == pytest.approx(-100 / 98, abs=1e-3)
    assert float(first["cube_wh"]) == pytest.approx(100 * 3595 / 3600, abs=0.01)
    for name in ("bias", "power-2022-10-12", "movement-2022-10-12"):
        assert (tmp_path / f"{name}.png").read_bytes().startswith(b"\x89PNG")
        assert "<svg" in (tmp_path / f"{name}.svg").read_text()
    page = (tmp_path / "report.html").read_text()
    assert page.count("data:image/png;base64,") == 5
    assert "SIMULATED" not in page
    assert "http" not in page.replace("http-equiv", "")
    assert "2022-10-12" in out
    assert "overcast" in out


def test_report_warns_when_a_bias_corrects_powers_outside_those_of_its_fit(compare, flat, powers, tmp_path):
    _, out, _ = compare("fit", flat, "--out", tmp_path / "bias.json", "--json")
    fitted = json.loads(out)["bias"] | {"lowest_w": 98.0}
    whole = json.loads((tmp_path / "bias.json").read_text())
    (tmp_path / "bias.json").write_text(json.dumps(whole | fitted))
    code, out, err = compare(
        "report", powers, "--bias", tmp_path / "bias.json", "--site", SITE, "--out", tmp_path / "o", "--json"
    )
    assert code == 0
    # All powers of T-Cube on this day, 97 W, are below the fit's lowest.
    assert {round(gain["extrapolated_pct"]) for gain in json.loads(out)["gains"]} == {100}
    assert "2022-10-12 day (100 %)" in err
    assert "measured mostly at powers outside those of the fit" in (tmp_path / "o" / "report.html").read_text()


def test_the_same_measurements_are_the_same_bytes_from_csv_gzip_and_parquet(compare, day, tmp_path):
    frame = pd.read_csv(day)
    frame.to_csv(tmp_path / "day.csv.gz", index=False)
    frame["time"] = pd.to_datetime(frame["time"])
    frame.set_index("time").to_parquet(tmp_path / "day.parquet")
    out, found = tmp_path / "out", []
    for name in ("day.csv", "day.csv.gz", "day.parquet"):
        _, told, err = compare("report", tmp_path / name, "--site", SITE, "--out", out, "--force")
        assert err == ""
        found.append({"told": told.encode()} | {path.name: path.read_bytes() for path in out.iterdir()})
    first, *others = found
    assert "report.html" in first
    for other in others:
        assert [name for name in first.keys() | other.keys() if first.get(name) != other.get(name)] == []


# The tables of the other tests have a row every 5 s.
@pytest.mark.parametrize("step_s", [60.0, 61.0, 300.0])
def test_powers_measured_only_every_1_to_5_minutes_are_compared_without_gaps(compare, tmp_path, step_s):
    # A clock that is read every minute is a little late now and then.
    times = NOON + np.arange(0.0, 7201.0, step_s)
    times[1:] += 0.3 * (np.arange(times.size - 1) % 2)
    lines = [f"{stamp(when)},{name},100" for when in times for name in ("T-Cube", "T-Chrono")]
    # The flat days beside it are sampled faster; they do not turn the slow steps into gaps.
    lines += [f"{stamp(NOON - 86400 + 5 * n)},{name},9" for n in range(2000) for name in ("T-Cube", "T-Chrono")]
    path = table(tmp_path / "powers.csv", lines, "time,tracker,pmpp_w")
    code, out, _ = compare("report", path, "--site", SITE, "--out", tmp_path / "o", "--json")
    assert code == 0
    (day,) = (gain for gain in json.loads(out)["gains"] if gain["date"] == "2022-10-12")
    assert day["hours"] == pytest.approx((times[-1] - times[0]) / 3600)
    assert (day["cube_wh"], day["chrono_wh"]) == pytest.approx((100 * day["hours"],) * 2)
    assert f"<td>{day['hours']:.2f}</td>" in (tmp_path / "o" / "report.html").read_text()


def test_periods_by_the_clock_take_the_place_of_those_by_the_sky(compare, powers, tmp_path):
    # The second period begins on a day without measurements.
    periods = ("coffee=2022-10-12T10:00/2022-10-12T11:00", "since=2022-10-11T20:00/2022-10-12T11:00")
    asked = (word for period in periods for word in ("--period", period))
    code, out, _ = compare("report", powers, "--site", SITE, "--out", tmp_path, *asked, "--json")
    assert code == 0
    hours = {gain["period"]: gain["hours"] for gain in json.loads(out)["gains"]}
    assert hours["coffee"] == hours["since"] == pytest.approx(3595 / 3600)
    assert "overcast" not in out
    assert json.loads(out)["corrected"] is False


def test_a_day_of_the_report_is_a_day_at_the_site_and_not_a_day_of_utc(compare, powers, tmp_path):
    # In Hawaii the two hours from 10:00 UTC on are around midnight.
    code, out, _ = compare("report", powers, "--site", "20,-165", "--out", tmp_path, "--json")
    assert code == 0
    days = [(gain["date"], gain["start"][:16]) for gain in json.loads(out)["gains"] if gain["period"] == "day"]
    assert days == [("2022-10-11", "2022-10-12T10:00"), ("2022-10-12", "2022-10-12T11:00")]
    assert (tmp_path / "power-2022-10-11.png").exists()


def test_fit_without_poses_needs_from_and_to_as_the_time_when_both_trackers_lay_flat(compare, flat, tmp_path):
    lines = [",".join(line.split(",")[:3]) for line in flat.read_text().splitlines()]
    bare = table(tmp_path / "bare.csv", lines[1:], lines[0])
    code, _, err = compare("fit", bare, "--out", tmp_path / "b.json")
    assert code == 2
    assert "name the time at which both lay flat with --from and --to" in err
    code, out, _ = compare(
        "fit", bare, "--out", tmp_path / "b.json", "--from", "2022-10-11", "--to", "2022-10-11T10:30", "--json"
    )
    assert code == 0
    assert json.loads(out)["before"]["pairs"] == 360


ROW = "2022-10-12T10:00:00Z,{},50"


@pytest.mark.parametrize(
    ("columns", "rows", "message"),
    [
        ("time,tracker,power", [ROW.format("T-Cube")], "lacks the column pmpp_w"),
        ("time,tracker,pmpp_w,colour", [ROW.format("T-Cube") + ",red"], "unknown column colour"),
        ("time,tracker,pmpp_w", [], "there is nothing below its header; name one that has some"),
        ("", [], "is empty: name a table with the columns time and pmpp_w"),
        ("time,tracker,pmpp_w", [ROW.format("T-Cube")], "no powers of 'T-Chrono', only of 'T-Cube'"),
        ("time,tracker,pmpp_w", ["2022-10-12T10:00:00Z,T-Cube,fifty"], "row 1: pmpp_w is 'fifty'"),
        ("time,tracker,pmpp_w", ["noon,T-Cube,50"], "row 1: 'noon' is not a time"),
        (
            "time,tracker,pmpp_w,simulated",
            ["2022-10-12T10:00:00Z,T-Cube,50,perhaps"],
            "row 1: simulated is 'perhaps'; write true or false",
        ),
        ("time,tracker,pmpp_w", ["2022-10-12T10:00:00Z,T-Cube,50000"], "which no module of a tracker gives"),
        (
            "time,tracker,pmpp_w",
            [ROW.format("T-Chrono"), ROW.format("T-Cube"), ROW.format("T-Chrono"), "2022-10-12T10:00Z,T-Cube,25"],
            "'T-Cube' has two different measurements at 2022-10-12T10:00:00.000Z, the first of 1 such",
        ),
        (
            "time,tracker,pmpp_w",
            [ROW.format("T-Cube"), "2022-10-13T10:00:00Z,T-Chrono,50"],
            "no two measurements are within 5 s of each other (T-Cube 2022-10-12T10:00:00Z..2022-10-12T10:00:00Z",
        ),
    ],
)
def test_a_bad_table_is_refused_with_the_reason_and_without_a_traceback(compare, tmp_path, columns, rows, message):
    path = table(tmp_path / "bad.csv", rows, columns)
    code, _, err = compare("report", path, "--site", SITE, "--out", tmp_path / "out")
    assert code == 2
    assert message in err
    assert "Traceback" not in err


@pytest.mark.parametrize(("column", "wrong"), [("dhi_w_m2", -9999.0), ("ghi_w_m2", 1e9)])
def test_an_impossible_irradiance_counts_as_missing_and_defines_no_period(compare, powers, tmp_path, column, wrong):
    frame = pd.read_csv(powers)
    frame.loc[720:, column] = wrong
    frame.to_csv(powers, index=False)
    code, out, err = compare("report", powers, "--site", SITE, "--out", tmp_path / "o", "--json")
    assert code == 0
    spans = [(gain["period"], gain["end"][11:16]) for gain in json.loads(out)["gains"]]
    assert spans == [("day", "11:59"), ("variable", "10:29")]
    told = f"has 2160 impossible values, taken as missing; first in row 721: {column} {wrong:g}, not in -50..2500"
    assert told in " ".join(err.split())


@pytest.mark.parametrize(("missing", "gain"), [(1, 2.0), (60, 2.0), (200, None)])
def test_the_gain_in_irradiation_uses_only_pairs_with_both_irradiances(compare, powers, tmp_path, missing, gain):
    frame = pd.read_csv(powers)
    cube = frame["tracker"] == "T-Cube"
    frame["irradiance_w_m2"] = np.where(cube, 510.0, 500.0)
    frame.loc[900 + np.arange(missing), "irradiance_w_m2"] = np.nan
    frame.to_csv(powers, index=False)
    code, out, _ = compare("report", powers, "--site", SITE, "--out", tmp_path / "o", "--json")
    assert code == 0
    whole_day = json.loads(out)["gains"][0]
    assert (whole_day["irradiation_pct"], whole_day["hours"]) == (pytest.approx(gain), pytest.approx(7195 / 3600))


def test_fit_is_refused_without_a_period_in_which_both_trackers_lay_flat(compare, day, tmp_path):
    code, _, err = compare("fit", day, "--out", tmp_path / "bias.json")
    assert code == 2
    assert "there is no period in which T-Cube and T-Chrono both lay flat" in err
    assert not (tmp_path / "bias.json").exists()


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("--bias", "none.json"), "there is no file none.json"),
        (("--bias", "."), "--bias: . is a folder: name the file in it that 'heliocube compare fit' wrote"),
        (("--bias", __file__), ".py was not written by 'heliocube compare fit': name the file that it wrote"),
        (("--period", "noon"), "is not NAME=FROM/TO"),
        (("--period", "x=2022-10-12T11:00/2022-10-12T10:00"), "ends before it begins"),
        (("--period", "x=now/then"), "'now' is not a date or time"),
        (
            ("--period", "x=2023-10-12T10:00/2023-10-12T11:00"),
            (
                "in 'x', 2023-10-12T10:00Z to 2023-10-12T11:00Z, the two trackers were not measured together; they were"
                " from 2022-10-12T10:00Z to 2022-10-12T11:59Z"
            ),
        ),
        (("--cube", "T-Chrono"), "two trackers are needed"),
        (("--site", "here"), "is not LAT,LON"),
    ],
)
def test_a_mistaken_report_option_is_refused_with_the_reason(compare, day, tmp_path, arguments, message):
    site = () if arguments[0] == "--site" else ("--site", SITE)
    code, _, err = compare("report", day, *site, "--out", tmp_path / "out", *arguments)
    assert code == 2
    assert message in err


def test_a_bias_file_of_other_trackers_or_without_a_bias_is_refused(compare, flat, day, tmp_path):
    compare("fit", flat, "--out", tmp_path / "bias.json", "--cube", "T-Chrono", "--chrono", "T-Cube")
    code, _, err = compare("report", day, "--site", SITE, "--out", tmp_path / "o", "--bias", tmp_path / "bias.json")
    assert code == 2
    assert "corrects T-Chrono to T-Cube, not T-Cube to T-Chrono" in err
    (tmp_path / "bias.json").write_text("{}")
    code, _, err = compare("report", day, "--site", SITE, "--out", tmp_path / "o", "--bias", tmp_path / "bias.json")
    assert code == 2
    assert "was not written by 'heliocube compare fit'" in err
    assert compare("report", tmp_path / "none.csv", "--site", SITE, "--out", tmp_path / "o")[0] == 2


def test_one_store_keeps_laws_curves_and_poses_of_both_trackers_for_fit_and_report(compare, few_curves, tmp_path):
    arguments = ("--start", "2022-10-12T10:00", "--days", "0.02", "--weather", "overcast", "--laws", "flat,flat")
    code, out, err = compare("simulate", *arguments, *few_curves, "--store", tmp_path / "store")
    assert (code, err) == (0, "")
    assert "all records of both trackers" in out
    arguments = ("--start", "2022-10-12T11:00", "--days", "0.02", "--weather", "overcast")
    assert compare("simulate", *arguments, *few_curves, "--store", tmp_path / "store")[0] == 0
    with closing(sqlite3.connect(tmp_path / "store" / "heliocube.sqlite")) as store:
        runs = store.execute("SELECT run, tracker, simulated FROM runs ORDER BY run").fetchall()
        laws = store.execute("SELECT DISTINCT run, law FROM decisions WHERE moved ORDER BY run").fetchall()
        counts = dict(store.execute("SELECT run, count(*) FROM curves WHERE quality = 'ok' GROUP BY run"))
        (scans,) = store.execute("SELECT count(*) FROM scans").fetchone()
    assert sorted(tracker for _, tracker, _ in runs) == ["T-Chrono"] * 2 + ["T-Cube"] * 2
    assert all(simulated for _, _, simulated in runs)
    law_of = {tracker: dict(laws).get(run) for run, tracker, _ in runs[2:]}
    assert law_of["T-Chrono"] == "chronometric"
    assert [counts[run] for run, _, _ in runs] == pytest.approx([115, 115, 115, 115], abs=1)
    assert scans == pytest.approx(345 + 345, abs=3), "both trackers hear the same scans, and the store keeps each once"

    store = ("--store", tmp_path / "store")
    code, out, err = compare("fit", *store, "--out", tmp_path / "bias.json", "--to", "2022-10-12T10:29")
    assert (code, err) == (0, "")
    assert json.loads((tmp_path / "bias.json").read_text())["before"]["rmbe_pct"] == pytest.approx(-1.7, abs=0.2)
    overcast = "overcast=2022-10-12T11:18/2022-10-12T11:28"
    code, out, err = compare(
        "report", *store, "--bias", tmp_path / "bias.json", "--period", overcast, "--out", tmp_path / "out"
    )
    assert code == 0, err
    # The fit saw half an hour of sun, and no power as under an overcast sky.
    assert err.startswith("heliocube: warning: T-Cube's energy was measured mostly at powers outside those of the fit")
    (row,) = (
        row
        for row in csv.DictReader((tmp_path / "out" / "gains.csv").read_text().splitlines())
        if row["period"] == "overcast"
    )
    # The isotropic sky at a tilt of 57 deg gives 22 %; the module's higher efficiency in brighter light adds a little.
    assert float(row["gain_pct"]) == pytest.approx(22.5, abs=1.5)
    page = (tmp_path / "out" / "report.html").read_text()
    assert "<h1>SIMULATED: " in page
    assert "module as simulated" in page


def test_two_stores_are_told_apart_by_the_names_they_are_given(compare, few_curves, tmp_path):
    arguments = ("--start", "2022-10-12T10:00", "--days", "0.01", "--weather", "clear")
    compare("simulate", *arguments, *few_curves, "--store", tmp_path / "one")
    shutil.copytree(tmp_path / "one", tmp_path / "two")
    for name in ("one", "two"):
        with closing(sqlite3.connect(tmp_path / name / "heliocube.sqlite")) as store, store:
            store.execute("DELETE FROM curves WHERE run = 2")
    stores = ("--store", f"A={tmp_path / 'one'}", "--store", f"B={tmp_path / 'two'}")
    code, out, _ = compare("report", *stores, "--cube", "A", "--chrono", "B", "--out", tmp_path / "out")
    assert code == 0
    assert "A/Wh" in out


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ((), "either from tables, POWERS..., or from --store DIR"),
        (("--store", "nowhere"), "there is no store at nowhere"),
    ],
)
def test_a_report_without_tables_and_without_an_existing_store_is_refused(compare, tmp_path, arguments, message):
    code, _, err = compare("report", "--site", SITE, "--out", tmp_path / "o", *arguments)
    assert code == 2
    assert message in err


def test_a_store_without_i_v_curves_is_refused(compare, tmp_path):
    open_for_writing(tmp_path / "heliocube.sqlite").close()
    code, _, err = compare("report", "--store", tmp_path, "--out", tmp_path / "o")
    assert code == 2
    assert "holds no I-V curves" in err


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("--laws", "mu-prime"), "is not two laws"),
        (("--laws", "mu-prime,fastest"), "there is no 'fastest'"),
        (("--start", "soon"), "'soon' is not a date or time"),
        (("--start", "2022-10-14T22:00"), "there was no light"),
    ],
)
def test_an_impossible_simulated_comparison_is_refused_with_the_reason(compare, tmp_path, arguments, message):
    given = {"--start": "2022-10-14", "--days": "0.01", "--weather": "clear", "--out": str(tmp_path / "o")}
    given |= {arguments[0]: arguments[1]}
    code, _, err = compare("simulate", *(word for pair in given.items() for word in pair))
    assert code == 2
    assert message in err
