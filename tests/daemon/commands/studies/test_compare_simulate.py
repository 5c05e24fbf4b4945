"""`heliocube compare simulate`: two trackers under one sky."""

import csv
import json
import signal

import numpy as np
import pandas as pd
import pytest

from tests.daemon.commands.studies.test_compare import SITE, compare, day, flat, powers, table
from tests.support.stored_day import stored_days

__all__ = ["compare", "day", "flat", "powers"]

pytestmark = pytest.mark.slow


def test_two_trackers_under_one_sky_follow_their_own_laws(compare, tmp_path):
    arguments = ("--start", "2022-10-14T11:00", "--days", "0.012", "--weather", "overcast")
    code, out, err = compare("simulate", *arguments, "--out", tmp_path, "--json")
    assert (code, err) == (0, "")
    assert json.loads(out)["powers"] == 2 * 208
    rows = list(csv.DictReader((tmp_path / "powers.csv").read_text().splitlines()))
    cube, chrono = ([row for row in rows if row["tracker"] == name] for name in ("T-Cube", "T-Chrono"))
    assert len(cube) == len(chrono) == 208
    assert [row["time"] for row in cube] == [row["time"] for row in chrono]
    assert {row["simulated"] for row in rows} == {"true"}
    code, out, err = compare("report", tmp_path / "powers.csv", "--site", SITE, "--out", tmp_path)
    assert (code, err) == (0, "")
    assert "<h1>SIMULATED: " in (tmp_path / "report.html").read_text()
    # The cube's law lies flat under cloud; the other stands at a sun 33 deg high.
    assert float(cube[-1]["b_deg"]) == pytest.approx(90.0, abs=1.5)
    assert float(chrono[-1]["b_deg"]) == pytest.approx(33.0, abs=2.0)
    ratio = float(cube[-1]["irradiance_w_m2"]) / float(chrono[-1]["irradiance_w_m2"])
    tilt = np.radians(57.0)
    assert ratio == pytest.approx(1 / ((1 + np.cos(tilt)) / 2 + 0.2 * (1 - np.cos(tilt)) / 2), abs=0.02)


def test_a_simulated_comparison_ended_by_sigterm_leaves_no_file(compare, tmp_path, signal_at_first_progress):
    signal_at_first_progress(signal.SIGTERM)
    code, _, err = compare("simulate", "--start", "2022-10-14T11:00", "--days", "0.02", "--out", tmp_path)
    assert (code, err) == (130, "heliocube: interrupted before its end; no whole result was written\n")
    assert list(tmp_path.iterdir()) == []


def test_a_law_that_fails_ends_the_simulated_comparison_with_a_sentence_that_names_the_law(
    compare, tmp_path, monkeypatch
):
    def fails(*_):
        raise ZeroDivisionError("no such sky")

    monkeypatch.setattr("solar.laws.flat.FlatLaw.aim", fails)
    arguments = (
        "--start",
        "2022-10-14T11:00",
        "--days",
        "0.02",
        "--weather",
        "overcast",
        "--laws",
        "flat,chronometric",
    )
    code, _, err = compare("simulate", *arguments, "--out", tmp_path)
    assert code == 2
    assert err.endswith(
        "the law flat has failed (ZeroDivisionError: no such sky), and chronometric points instead, so"
        " nothing can be compared (before 2022-10-14T11:15Z)\n"
    )
    assert list(tmp_path.iterdir()) == []


def test_the_daily_budget_of_moves_and_travel_does_not_limit_the_trackers_of_a_comparison(compare, tmp_path):
    (tmp_path / "thrifty.toml").write_text("[motion]\nmoves_per_day = 2\ntravel_per_day_deg = 50.0\n")
    arguments = ("--start", "2022-10-14T08:00", "--days", "0.02", "--weather", "clear", "--laws", "chronometric,flat")
    code, _, _ = compare("simulate", *arguments, "--config", tmp_path / "thrifty.toml", "--out", tmp_path)
    assert code == 0
    rows = pd.read_csv(tmp_path / "powers.csv")
    later = rows[(rows["tracker"] == "T-Cube") & (rows["time"] >= "2022-10-14T08:08")]
    assert np.ptp(later["a_deg"]) > 2.0, "it follows the sun on"


def test_a_simulation_is_not_written_into_a_store_with_records_of_real_instruments(compare, tmp_path):
    file = stored_days(tmp_path / "real", simulated=False) / "heliocube.sqlite"
    before = file.read_bytes()
    code, _, err = compare("simulate", "--start", "2022-10-12T10:00", "--days", "0.02", "--store", tmp_path / "real")
    assert (code, file.read_bytes() == before) == (2, True)
    assert "has records of real instruments: name another folder" in " ".join(err.split())


def test_a_bias_fitted_to_simulated_powers_is_refused_for_measured_powers(compare, flat, powers, tmp_path):
    pd.read_csv(flat).assign(simulated=True).to_csv(tmp_path / "made.csv", index=False)
    bias = tmp_path / "bias.json"
    assert compare("fit", tmp_path / "made.csv", "--out", bias)[0] == 0
    assert json.loads(bias.read_text())["simulated"] is True
    code, _, err = compare("report", powers, "--bias", bias, "--site", SITE, "--out", tmp_path / "result")
    assert code == 2
    assert err.startswith(f"heliocube: --bias: {bias} was fitted to simulated powers and cannot correct measured ones")


def test_a_modelled_curve_in_a_report_of_measured_powers_is_labelled_as_modelled(compare, tmp_path):
    rows = [f"2022-10-12T10:00:0{second}Z,{name},97,1000,30" for second in (0, 5) for name in ("T-Cube", "T-Chrono")]
    warm = table(tmp_path / "warm.csv", rows, "time,tracker,pmpp_w,irradiance_w_m2,module_temp_degc")
    assert compare("report", warm, "--site", SITE, "--out", tmp_path / "result")[0] == 0
    assert "T-Cube, 2022-10-12T10:00:00Z, by the model of the module" in (tmp_path / "result" / "curve.svg").read_text()
