"""`heliocube energy`."""

import csv
import json
import re
import sys
from datetime import UTC, datetime, timedelta

import pytest

from daemon.commands.main import main
from daemon.studies.energy.benchmark import read_minute_weather
from solar.ephemeris import Site

pytestmark = pytest.mark.slow

SITE = "55.79,12.53,50"


def written(path, minutes):
    """Write minutes of a winter day whose beam comes and goes: a summer day has over twice as many sunny minutes."""
    lines = ["time,ghi,dni,dhi"]
    for minute in minutes:
        dni = 700 * (minute // 30 % 2)
        lines.append(f"2016-12-05T{minute // 60:02d}:{minute % 60:02d}:00Z,{150 + dni / 2},{dni},150")
    path.write_text("\n".join(lines))
    return path


@pytest.fixture
def weather(tmp_path):
    return written(tmp_path / "weather.csv", range(1440))


@pytest.fixture
def short_weather(tmp_path):
    """Two hours, for tests in which the figures do not matter."""
    return written(tmp_path / "weather.csv", range(600, 720))


def energy(monkeypatch, *arguments):
    monkeypatch.setattr(sys, "argv", ["heliocube", "energy", *map(str, arguments)])
    with pytest.raises(SystemExit) as ended:
        main()
    return ended.value.code


def test_the_share_of_the_bound_is_blank_when_the_bound_gains_nothing(monkeypatch, tmp_path, capsys):
    sunny = tmp_path / "weather.csv"
    sunny.write_text("time,ghi,dni,dhi\n2016-06-05T11:00Z,400,500,0\n2016-06-05T12:00Z,400,500,0\n")
    asked = ("--site", SITE, "--albedo", 0, "--ideal", "--laws", "flat,bound", "--out", tmp_path / "o")
    assert energy(monkeypatch, sunny, *asked) == 0
    flat = next(line for line in capsys.readouterr().out.splitlines() if line.startswith("flat"))
    assert flat.split()[7] == "-"
    rows = csv.DictReader((tmp_path / "o" / "energy.csv").read_text().splitlines())
    assert [row["share_pct"] for row in rows] == ["", ""]


def test_energy_writes_a_text_table_a_csv_table_and_a_picture(monkeypatch, short_weather, tmp_path, capsys):
    laws = "flat,fixed:35,mu-prime,optimal,optimal:4,bound"
    asked = ("--laws", laws, "--sky", "isotropic,perez1993", "--out", tmp_path / "o")
    assert energy(monkeypatch, short_weather, "--site", SITE, *asked) == 0
    out = capsys.readouterr().out
    assert "sky perez1993" in out
    assert "There is no daily budget of moves and travel here: the service follows" in " ".join(out.split())
    written_to = f"\nwritten to {tmp_path / 'o'}: energy.txt, energy.csv, energy.png\n"
    assert (tmp_path / "o" / "energy.txt").read_text() + written_to == out
    rows = list(csv.DictReader((tmp_path / "o" / "energy.csv").read_text().splitlines()))
    assert [row["law"] for row in rows[:6]] == laws.split(",")
    assert float(rows[5]["share_pct"]) == pytest.approx(100.0)
    assert (tmp_path / "o" / "energy.png").read_bytes().startswith(b"\x89PNG")


def test_moves_and_travel_are_blank_for_a_fixed_plane_and_zero_for_the_law_flat(monkeypatch, short_weather, tmp_path):
    asked = ("--laws", "flat,fixed:35", "--out", tmp_path / "o")
    assert energy(monkeypatch, short_weather, "--site", SITE, *asked) == 0
    flat, fixed = csv.DictReader((tmp_path / "o" / "energy.csv").read_text().splitlines())
    columns = ("travel_deg_per_day", "return_deg_per_day", "moves_per_day")
    assert [(flat[name], fixed[name]) for name in columns] == [("0.0000", "")] * 3
    *_, told = (tmp_path / "o" / "energy.txt").read_text().splitlines()
    assert told.split()[-3:] == ["-", "-", "-"]


def test_results_from_simulated_weather_are_marked_in_text_csv_json_and_picture(
    monkeypatch, short_weather, tmp_path, capsys
):
    measured = short_weather.read_text()
    head, *lines = measured.splitlines()
    short_weather.write_text("\n".join([f"{head},simulated", *(f"{line},true" for line in lines)]))
    out = tmp_path / "o"
    given = (short_weather, "--site", SITE, "--laws", "flat", "--out", out)
    assert energy(monkeypatch, *given, "--json") == 0
    assert json.loads(capsys.readouterr().out)["simulated"] is True
    assert (out / "energy.txt").read_text().startswith("SIMULATED: ")
    (row,) = csv.DictReader((out / "energy.csv").read_text().splitlines())
    assert row["simulated"] == "true"
    marked = (out / "energy.png").read_bytes()
    short_weather.write_text(measured)
    energy(monkeypatch, *given, "--force")
    assert (out / "energy.png").read_bytes() != marked
    assert "SIMULATED" not in (out / "energy.txt").read_text()


def test_the_time_between_two_weather_files_is_bridged_as_within_one_file(tmp_path):
    hours = [f"2016-06-05T{hour:02d}:00:00Z,450,500,150" for hour in range(24)]
    found = []
    for parts in ([hours], [hours[:12], hours[12:]], [hours[:10], hours[12:]]):
        files = [tmp_path / f"{part[0][:13]}.csv" for part in parts]
        for file, part in zip(files, parts, strict=True):
            file.write_text("\n".join(["time,ghi,dni,dhi", *part]))
        found.append(read_minute_weather(files, Site(55.79, 12.53, 50.0)))
    whole, halves, with_a_gap = found
    for name in ("utc_s", "dni_w_m2", "dhi_w_m2"):
        assert (getattr(halves, name) == getattr(whole, name)).all()
    assert with_a_gap.utc_s.size == whole.utc_s.size - 179


@pytest.mark.parametrize("hours", [(10,), (10, 12, 14)], ids=["one record", "hours between them"])
def test_weather_with_only_single_minutes_is_refused(monkeypatch, tmp_path, capsys, hours):
    file = tmp_path / "one.csv"
    file.write_text("\n".join(["time,ghi,dni,dhi", *(f"2016-06-05T{hour}:00:00Z,450,500,150" for hour in hours)]))
    assert energy(monkeypatch, file, "--site", SITE, "--laws", "flat", "--out", tmp_path / "o") == 2
    told = f"weather file {file} has only single minutes: name a file with at least two records within an hour"
    assert capsys.readouterr().err == f"heliocube: {told}\n"


PRICES = ("--peak-kw", 2, "--price", 0.25, "--drive-price", 600, "--drive-life-deg", 300000)


def test_daylight_missing_between_two_weather_files_gives_a_warning(monkeypatch, weather, tmp_path, capsys):
    head, *lines = weather.read_text().splitlines()
    halves = tmp_path / "morning.csv", tmp_path / "evening.csv"
    for half, some in zip(halves, (lines[:600], lines[780:]), strict=True):
        half.write_text("\n".join([head, *some]))
    assert energy(monkeypatch, *halves, "--site", SITE, "--laws", "flat", "--out", tmp_path / "o", "--json") == 0
    page = json.loads(capsys.readouterr().out)
    (told,) = [warning for warning in page["warnings"] if "gaps of more than 60 min" in warning]
    assert told.endswith("3.0 h of daylight are missing, the first after 2016-12-05 09:59Z, until 2016-12-05 13:00Z")


def test_the_worth_of_a_law_is_its_energy_less_the_wear_of_its_travel(monkeypatch, weather, tmp_path, capsys):
    given = (weather, "--site", SITE, "--laws", "flat,mu-prime,optimal,bound", "--out", tmp_path / "o")
    assert energy(monkeypatch, *given, *PRICES, "--json") == 0
    page = json.loads(capsys.readouterr().out)
    rows, worth = {row["law"]: row for row in page["rows"]}, {row["law"]: row for row in page["worth"]["rows"]}
    assert list(worth) == ["flat", "mu-prime", "optimal"]
    for law, found in worth.items():
        assert found["energy"] == pytest.approx(rows[law]["energy_kwh_m2"] * 2 * 0.25 * 365.25)
        travel_deg = (rows[law]["travel_deg_per_day"] + rows[law]["return_deg_per_day"]) * 365.25
        assert found["wear"] == pytest.approx(travel_deg / 300000 * 600)
        assert found["left"] == pytest.approx(found["energy"] - found["wear"])
    assert worth["mu-prime"]["wear"] > worth["optimal"]["wear"] > worth["flat"]["wear"] == 0.0
    most = max(worth.values(), key=lambda row: row["left"])["law"]
    text = (tmp_path / "o" / "energy.txt").read_text()
    assert f"sky perez1990: most is left by {most}\n" in text
    assert "In money, scaled to a year from 1.0 days of records, whatever their season: 2 kW" in " ".join(text.split())
    assert all(len(line) <= 80 for line in text.splitlines())


def test_the_table_says_that_daily_travel_from_a_few_hours_is_more_than_that_of_whole_days(
    monkeypatch, weather, tmp_path, capsys
):
    head, *lines = weather.read_text().splitlines()
    given = (weather, "--site", SITE, "--laws", "chronometric", "--out", tmp_path / "o", "--force", "--json")
    found = {}
    for name, some in {"day": lines, "hours": lines[660:780]}.items():
        weather.write_text("\n".join([head, *some]))
        assert energy(monkeypatch, *given) == 0
        page = json.loads(capsys.readouterr().out)
        text = " ".join((tmp_path / "o" / "energy.txt").read_text().split())
        found[name] = (page["whole_days"], page["rows"][0]["travel_deg_per_day"], "more than those of whole" in text)
    assert found["day"][0] == pytest.approx(1.0)
    assert found["hours"][0] == pytest.approx(2 / 7.2, rel=0.02)
    assert found["hours"][1] > found["day"][1], "what the text tells of"
    assert (found["day"][2], found["hours"][2]) == (False, True)


def test_half_days_of_weather_count_half_in_travel_moves_and_worth(monkeypatch, tmp_path, capsys):
    # Midnight of UTC is noon at 180 E: a file's day is the afternoon of one solar day and the morning of the next.
    pages = {}
    for longitude_deg in (0, 180):
        path = tmp_path / f"{longitude_deg}.csv"
        minutes = [datetime(2016, 6, 5, tzinfo=UTC) + timedelta(minutes=minute) for minute in range(1440)]
        path.write_text("\n".join(["time,ghi,dni,dhi", *(f"{at:%Y-%m-%dT%H:%M:%SZ},450,500,150" for at in minutes)]))
        given = (path, "--site", f"40,{longitude_deg}", "--laws", "chronometric", "--out", tmp_path, "--force")
        assert energy(monkeypatch, *given, *PRICES, "--json") == 0
        pages[longitude_deg] = json.loads(capsys.readouterr().out)
        assert "A day of which half is missing counts half." in " ".join((tmp_path / "energy.txt").read_text().split())
    assert [sum(page["days"].values()) for page in pages.values()] == [1, 2]
    (whole,), (halves,) = (page["rows"] for page in pages.values())
    for name in ("travel_deg_per_day", "moves_per_day"):
        assert halves[name] == pytest.approx(whole[name], rel=0.12)
    (worth,) = pages[180]["worth"]["rows"]
    assert worth["energy"] == pytest.approx(halves["energy_kwh_m2"] * 2 * 0.25 * 365.25, rel=0.01)
    travel_deg = (halves["travel_deg_per_day"] + halves["return_deg_per_day"]) * 365.25
    assert worth["wear"] == pytest.approx(travel_deg / 300000 * 600)


def test_the_worth_of_a_year_counts_days_without_sun_but_not_years_without_records(monkeypatch, tmp_path, capsys):
    # At 78 N, where the sun returns in mid-February.
    starts = [datetime(year, 2, 9, tzinfo=UTC) for year in (2023, 2026)]
    hours = [start + timedelta(hours=hour) for start in starts for hour in range(12 * 24)]
    path = tmp_path / "spitsbergen.csv"
    path.write_text("\n".join(["time,ghi,dni,dhi", *(f"{hour:%Y-%m-%dT%H:%M:%SZ},20,0,20" for hour in hours)]))
    given = (path, "--site", "78.2,15.6", "--laws", "chronometric", "--out", tmp_path / "o", "--force")
    assert energy(monkeypatch, *given, *PRICES, "--json") == 0
    page = json.loads(capsys.readouterr().out)
    (row,), (worth,) = page["rows"], page["worth"]["rows"]
    assert 6 < sum(page["days"].values()) < 18
    assert worth["energy"] == pytest.approx(row["energy_kwh_m2"] * 2 * 0.25 * 365.25 / 24)


@pytest.mark.parametrize("prices", [(), PRICES])
def test_weather_without_light_while_the_sun_is_up_is_refused(monkeypatch, weather, tmp_path, capsys, prices):
    lines = weather.read_text().splitlines()
    weather.write_text("\n".join([lines[0], *(f"{line.split(',')[0]},0,0,0" for line in lines[1:])]))
    assert energy(monkeypatch, weather, "--site", SITE, "--out", tmp_path / "o", *prices) == 2
    err = capsys.readouterr().err
    assert "no record has any light while the sun is above the horizon" in err
    assert "Traceback" not in err


@pytest.mark.parametrize("left_out", range(4))
def test_a_worth_without_one_of_its_prices_is_refused(monkeypatch, weather, tmp_path, capsys, left_out):
    some = PRICES[: 2 * left_out] + PRICES[2 * left_out + 2 :]
    assert energy(monkeypatch, weather, "--site", SITE, "--out", tmp_path / "o", *some) == 2
    assert "needs all of --peak-kw, --price, --drive-price and --drive-life-deg" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("--laws", "fastest"), "there is no law 'fastest'"),
        (("--laws", "fixed:95"), "there is no law 'fixed:95'"),
        (("--laws", "optimal:nan"), "there is no law 'optimal:nan'"),
        (("--laws", "optimal:0"), "optimal:0: 0.0 is not a number from 0.1 up"),
        (("--sky", "green"), "there is no sky 'green'"),
        (("--laws", ","), "--laws: name at least one of fixed:35, "),
        (("--sky", ""), "--sky: name at least one of isotropic, "),
        (("--site", "91,0"), "is not on Earth"),
    ],
)
def test_a_mistaken_option_is_refused_with_the_reason_and_exit_code_2(
    monkeypatch, weather, tmp_path, capsys, arguments, message
):
    given = {"--site": SITE, "--out": str(tmp_path / "o")} | {arguments[0]: arguments[1]}
    code = energy(monkeypatch, weather, *(word for pair in given.items() for word in pair))
    assert code == 2
    error = capsys.readouterr().err
    assert message in error
    assert "Traceback" not in error


def test_a_missing_weather_file_is_refused_by_its_name(monkeypatch, tmp_path, capsys):
    assert energy(monkeypatch, tmp_path / "none.csv", "--site", SITE, "--out", tmp_path) == 2
    assert f"no weather file at {tmp_path / 'none.csv'}" in " ".join(capsys.readouterr().err.split())


def test_weather_that_does_not_fit_the_site_gives_a_warning(monkeypatch, weather, tmp_path, capsys):
    assert energy(monkeypatch, weather, "--site", "55.79,120", "--out", tmp_path / "o", "--laws", "flat", "--json") == 0
    written = capsys.readouterr()
    assert "does not fit" in " ".join(written.err.split())
    page = json.loads(written.out)
    assert any("does not fit" in warning for warning in page["warnings"])
    (row,) = (row for row in page["rows"] if row["law"] == "flat")
    assert f"  {row['energy_kwh_m2']:.1f} " in (tmp_path / "o" / "energy.txt").read_text()


def test_ctrl_c_keeps_the_results_of_the_laws_that_were_done(monkeypatch, weather, tmp_path, capsys):
    def interrupted(*_weather):
        raise KeyboardInterrupt

    monkeypatch.setattr("solar.laws.flat.steer", interrupted)
    code = energy(monkeypatch, weather, "--site", SITE, "--laws", "fixed:35,flat,bound", "--out", tmp_path / "o")
    assert code == 130
    assert capsys.readouterr().err.endswith(f"heliocube: interrupted: {tmp_path / 'o'} has 1 of 3 laws\n")
    assert [row["law"] for row in csv.DictReader((tmp_path / "o" / "energy.csv").read_text().splitlines())] == [
        "fixed:35"
    ]


def fails(*_):
    raise ZeroDivisionError("no such sky")


@pytest.mark.parametrize(("answer", "words"), [
    (fails, r"on 2016-12-05: ZeroDivisionError: no such sky \(test_energy\.py, line \d+\)"),
    (lambda *_: None, r"on 2016-12-05: TypeError: NoneType is not an Aim \(answers\.py, line \d+\)"),
])  # fmt: skip
def test_a_law_that_fails_is_reported_with_its_day_and_the_laws_done_before_are_kept(
    monkeypatch, short_weather, tmp_path, capsys, answer, words
):
    monkeypatch.delattr("solar.laws.flat.steer")
    monkeypatch.setattr("solar.laws.flat.FlatLaw.aim", answer)
    out = tmp_path / "o"
    code = energy(monkeypatch, short_weather, "--site", SITE, "--laws", "fixed:35,flat,bound", "--out", out)
    assert code == 2
    said = capsys.readouterr().err.splitlines()[-1]
    assert re.fullmatch(rf"heliocube: the law flat has failed {words}: {out} has 1 of 3 laws", said)
    assert [row["law"] for row in csv.DictReader((out / "energy.csv").read_text().splitlines())] == ["fixed:35"]


def test_a_failure_of_the_first_law_is_reported_with_the_law_and_the_error(
    monkeypatch, short_weather, tmp_path, capsys
):
    monkeypatch.setattr("solar.laws.flat.steer", fails)
    assert energy(monkeypatch, short_weather, "--site", SITE, "--laws", "flat,bound", "--out", tmp_path / "o") == 2
    assert "heliocube: the law flat has failed: ZeroDivisionError: no such sky (test_energy.py, line" in (
        capsys.readouterr().err
    )


def test_a_law_that_fails_at_one_site_does_not_stop_the_others(monkeypatch, short_weather, tmp_path, capsys):
    from solar.laws import flat  # noqa: PLC0415

    steer = flat.steer
    monkeypatch.setattr(flat, "steer", lambda settings, days, *rest: (steer if days.site[0] > 0 else fails)(
        settings, days, *rest
    ))  # fmt: skip
    table = tmp_path / "sites.csv"
    lines = [f"{name},{latitude},12.5,{short_weather.name}" for name, latitude in (("north", 55.8), ("south", -20.0))]
    table.write_text("\n".join(["name,latitude,longitude,weather", *lines]))
    assert energy(monkeypatch, "--sites", table, "--laws", "flat", "--out", tmp_path / "o") == 2
    assert "1 of 2 sites could not be used" in capsys.readouterr().err
    assert "the law flat has failed: ZeroDivisionError: no such sky" in (tmp_path / "o/energy-sites.txt").read_text()


def test_a_site_that_cannot_be_used_is_listed_and_does_not_stop_the_others(monkeypatch, weather, tmp_path, capsys):
    (tmp_path / "bad.csv").write_text("nothing\n")
    table = tmp_path / "sites.csv"
    table.write_text(f"name,latitude,longitude,weather\ngood,55.7906412,12.5250501,{weather.name}\nbad,1,2,bad.csv\n")
    assert energy(monkeypatch, "--sites", table, "--out", tmp_path / "o", "--laws", "flat") == 2
    assert capsys.readouterr().err.endswith(f"heliocube: 1 of 2 sites could not be used: {tmp_path / 'o'} says why\n")
    written = (tmp_path / "o" / "energy-sites.csv").read_bytes()
    assert b"\r" not in written
    good, bad = csv.DictReader(written.decode().splitlines())
    assert (good["name"], good["law"], good["refused"], good["simulated"]) == ("good", "flat", "", "false")
    assert (good["latitude_deg"], good["longitude_deg"]) == ("55.7906412", "12.5250501"), "as the table has them"
    assert bad["name"] == "bad"
    assert "bad.csv" in bad["refused"]
    assert (tmp_path / "o" / "energy-sites.png").read_bytes().startswith(b"\x89PNG")
    assert "There is no daily budget" in (tmp_path / "o" / "energy-sites.txt").read_text()


def test_a_site_far_from_greenwich_has_no_day_more_than_its_file(monkeypatch, tmp_path, capsys):
    # Midnight of UTC is noon at 180 E: of three solar days the first and the last are halves.
    hours = [datetime(2016, 6, 5, tzinfo=UTC) + timedelta(hours=hour) for hour in range(48)]
    records = [f"{hour:%Y-%m-%dT%H:%M:%SZ},450,500,150" for hour in hours]
    (tmp_path / "weather.csv").write_text("\n".join(["time,ghi,dni,dhi", *records]))
    table = tmp_path / "sites.csv"
    table.write_text("name,latitude,longitude,weather\nfar,40,180,weather.csv\n")
    assert energy(monkeypatch, "--sites", table, "--out", tmp_path / "o", "--laws", "flat") == 0
    told = capsys.readouterr().out
    assert ", 2 days. Gains are" in " ".join(told.split())
    assert told.endswith(f"written to {tmp_path / 'o'}: energy-sites.txt, energy-sites.csv, energy-sites.png\n")
    (row,) = csv.DictReader((tmp_path / "o" / "energy-sites.csv").read_text().splitlines())
    assert row["days"] == "2"


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (("w.csv", "--sites", "s.csv"), "leave out WEATHER and --site"),
        (("--sites", "s.csv", "--model", "fog"), "--model: there is no 'fog'"),
        (("w.csv", "--site", "1,2", "--jobs", "2"), "are for many sites"),
        (("w.csv",), "needs weather files and their --site"),
        (("--sites", "none.csv"), "none.csv cannot be read"),
    ],
)
def test_mixed_or_incomplete_options_for_one_site_and_many_sites_are_refused_with_the_reason(
    monkeypatch, tmp_path, capsys, words, message
):
    assert energy(monkeypatch, *words, "--out", tmp_path / "o") == 2
    assert message in capsys.readouterr().err
