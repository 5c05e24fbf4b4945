"""`heliocube simulate` of many trackers, as a person asks for it."""

import csv
import json
import re

import pytest

from solar.laws.flat import FlatLaw
from tests.support import forks

NOON_UTC_S = 1665748800.0
FAILED = "the law flat has failed (ZeroDivisionError: no such sky), and chronometric points instead from 2022-10-14T"


@pytest.fixture
def fails_from_noon_on(monkeypatch):
    """Let the law flat raise an error from 2022-10-14T12:00:30Z on."""
    aim = FlatLaw.aim

    def fails(law, now):
        if now.utc_s > NOON_UTC_S + 30.0:
            raise ZeroDivisionError("no such sky")
        return aim(law, now)

    monkeypatch.setattr(FlatLaw, "aim", fails)


def test_simulate_with_many_trackers_numbers_them_and_sums_all_of_them_up_together(heliocube, tmp_path):
    out = tmp_path / "out"
    code, told, _ = heliocube(
        "simulate", "--trackers", 11, "--start", "2022-10-14T11:00Z", "--days", 0.01, "--out", out
    )
    assert code == 0
    assert "on the modules of 11 trackers, from the least to the most:" in told
    assert told.count("kWh/m2 by") == 2
    assert re.search(r"\n173 scans, of 11 trackers together \d+ decisions, \d+ moves, ", told)
    # A hundredth of a day each: 0.24 h.
    assert "\nmodes, together: starting 0.1 h, tracking 2.5 h\n" in told
    rows = csv.DictReader((out / "poses.csv").read_text().splitlines())
    assert {row["tracker"] for row in rows} == {f"t{place:02}" for place in range(1, 12)}
    code, told, _ = heliocube(
        "simulate", "--trackers", 2, "--start", "2022-10-14T11:00Z", "--days", 0.01, "--out", out, "--force", "--json"
    )
    assert code == 0
    assert [plane["tracker"] for plane in json.loads(told)["insolation"]] == ["t1", "t2"]


def warnings_of(*asked):
    # In a process of its own: here pytest's handlers take the lines of the log.
    done = forks.run(*asked)
    assert done.returncode == 0, done.stderr
    return done.stderr.splitlines()


def test_a_warning_about_one_of_several_trackers_names_the_tracker_after_the_time(tmp_path):
    file = tmp_path / "heliocube.toml"
    # A scan every 20 s: simulating an hour, in which the second move is due, then takes a third of the time.
    file.write_text(
        "[cube]\nscan_every_s = 20\n[safety]\nscan_stale_s = 60\n"
        '[motion]\nmoves_per_day = 1\n[[tracker]]\nname = "east"\n[[tracker]]\nname = "west"\n'
    )
    asked = ["simulate", "--config", file, "--start", "2022-10-14T08:00Z", "--days", "0.05", "--out", tmp_path / "out"]
    told = [line for line in warnings_of(*asked) if "the day's budget of motion" in line]
    assert sorted(re.sub(r"^2022-10-14T(08|09):\d\d:\d\dZ ", "", line)[:9] for line in told) == [
        "east: the",
        "west: the",
    ]


def test_a_warning_about_one_of_two_compared_trackers_names_the_tracker_after_the_time(tmp_path):
    weather = tmp_path / "weather.csv"
    days = [f"2022-10-13T{hour:02}:00Z,300,500,90,2" for hour in (6, 7, 8, 13, 14)]
    weather.write_text("\n".join(["time,ghi,dni,dhi,wind_speed", *days, ""]))
    asked = ["--start", "2022-10-13T07:30Z", "--days", "0.04", "--weather", weather, "--out", tmp_path / "out"]
    told = [line for line in warnings_of("compare", "simulate", *asked) if line.endswith(" wind is silent")]
    assert sorted(line[:14] + line[21:] for line in told) == [
        f"2022-10-13T08:T-{name}: wind is silent" for name in ("Chrono", "Cube")
    ]


def test_a_warning_of_a_replay_begins_with_its_time(tmp_path):
    faces = tmp_path / "faces.csv"
    rows = [f"2022-10-13T{hour:02}:{minute:02}Z,100,400,100,300" for hour in (8, 12) for minute in range(5)]
    faces.write_text("\n".join(["time,east,south,west,zenith", *rows, ""]))
    told = warnings_of("replay", faces, "--site", "48.7,2.2,156", "--out", tmp_path / "out.csv")
    assert [line[:14] for line in told if "no good scan" in line] == ["2022-10-13T08:"]


def test_the_option_trackers_is_refused_when_the_configuration_names_its_trackers(heliocube, tmp_path):
    file = tmp_path / "heliocube.toml"
    file.write_text('[[tracker]]\nname = "east"\n[[tracker]]\nname = "west"\n')
    code, _, told = heliocube(
        "simulate", "--trackers", 3, "--config", file, "--start", "2022-10-14", "--out", tmp_path / "out"
    )
    assert (code, told) == (
        2,
        "heliocube: --trackers: the configuration names its trackers already (east, west); leave the option out\n",
    )


def test_trackers_without_a_cube_are_refused_naming_the_missing_key_and_the_role_tracker(heliocube, tmp_path):
    file = tmp_path / "heliocube.toml"
    file.write_text('[instruments]\nkind = "real"\n[[tracker]]\nname = "east"\n[[tracker]]\nname = "west"\n')
    code, _, told = heliocube("run", "--config", file)
    assert code == 2
    assert told.count("\n") == 1
    assert "instruments.voltmeter.resource is missing" in told
    assert told.endswith("; if another process reads the cube, give --role tracker\n")


@pytest.mark.usefixtures("fails_from_noon_on")
def test_the_summary_says_that_a_law_has_failed_and_from_when_on_another_law_points(heliocube, tmp_path):
    asked = ("simulate", "--law", "flat", "--start", "2022-10-14T11:50Z", "--days", 0.01, "--out", tmp_path)
    code, told, _ = heliocube(*asked)
    assert (code, told.splitlines()[1]) == (0, f"{FAILED}12:00:31Z on")
    code, told, _ = heliocube(*asked, "--force", "--json")
    assert (code, json.loads(told)["warnings"]) == (0, [f"{FAILED}12:00:31Z on"])


@pytest.mark.usefixtures("fails_from_noon_on")
def test_a_replay_reports_a_failed_law_as_a_simulation_does(heliocube, tmp_path):
    faces = tmp_path / "faces.csv"
    minutes = "".join(
        f"2022-10-14T{11 + m // 60}:{m % 60:02}:00Z,30{m % 10},50{m % 9},10{m % 8},60{m % 7}\n" for m in range(50, 71)
    )
    faces.write_text("time,east,south,west,zenith\n" + minutes)
    asked = ("replay", faces, "--site", "48.7,2.2", "--law", "flat", "--out", tmp_path / "out.csv")
    code, told, _ = heliocube(*asked)
    assert (code, told.splitlines()[1]) == (0, f"{FAILED}12:05:05Z on")
    code, told, _ = heliocube(*asked, "--force", "--json")
    assert (code, json.loads(told)["warnings"]) == (0, [f"{FAILED}12:05:05Z on"])


def test_ctrl_c_while_pictures_are_drawn_says_that_the_tables_are_whole(heliocube, tmp_path, monkeypatch):
    def interrupted(*_, **_more):
        raise KeyboardInterrupt

    monkeypatch.setattr("matplotlib.figure.Figure.savefig", interrupted)
    asked = ("--start", "2022-10-14T11:50Z", "--days", 0.01, "--plot", tmp_path / "day.png")
    code, _, told = heliocube("simulate", *asked, "--out", tmp_path / "out")
    kept = f"the tables in {tmp_path / 'out'} are whole, but not all pictures and pages are"
    assert (code, told) == (130, f"heliocube: interrupted: {kept}\n")
    assert (tmp_path / "out" / "poses.csv").exists()


def test_pictures_without_a_page_have_the_local_times_of_the_zone_too(heliocube, tmp_path):
    asked = ("--start", "2022-10-14T11:50Z", "--days", 0.01, "--plot", tmp_path / "day.svg", "--zone", "Asia/Tokyo")
    assert heliocube("simulate", *asked, "--out", tmp_path / "out")[0] == 0
    assert "local time, JST" in (tmp_path / "day-angles.svg").read_text()


def test_the_summary_of_a_simulated_night_says_no_light_instead_of_a_gain(heliocube, tmp_path):
    _, told, _ = heliocube("simulate", "--start", "2022-10-14T00:00Z", "--days", 0.01, "--out", tmp_path / "out")
    assert "0.00 where an ideal chronometric tracker stands: no light" in told
    assert "- %" not in told
