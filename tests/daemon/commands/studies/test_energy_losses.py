"""`heliocube energy --losses`."""

import csv
import json
import sys

import pytest

from daemon.commands.main import main
from solar.laws import optimal_live

pytestmark = pytest.mark.slow

SITE = "55.79,12.53,50"
CAUSES = ["structure", "delay", "price", "motion", "noise", "gaps"]


def written(path, minutes=range(540, 660)):
    """Write the middle of a day whose beam comes and goes, and of an overcast day."""
    lines = ["time,ghi,dni,dhi"]
    for day, minute in ((day, minute) for day in (5, 6) for minute in minutes):
        dni = 700 if day == 5 and minute % 60 < 25 else 0
        lines.append(f"2016-06-{day:02d}T{minute // 60:02d}:{minute % 60:02d}:00Z,{150 + dni / 2},{dni},150")
    path.write_text("\n".join(lines))
    return path


@pytest.fixture
def weather(tmp_path):
    return written(tmp_path / "weather.csv")


@pytest.fixture
def short_weather(tmp_path):
    """Half an hour of each day, for tests in which the figures do not matter."""
    return written(tmp_path / "weather.csv", range(600, 630))


def energy(monkeypatch, *arguments):
    monkeypatch.setattr(sys, "argv", ["heliocube", "energy", *map(str, arguments)])
    with pytest.raises(SystemExit) as ended:
        main()
    return ended.value.code


def points_in(out):
    """Return the CSV's points by sky, law, cause and type of day."""
    table = (out / "energy-losses.csv").read_bytes()
    assert b"\r" not in table
    rows = list(csv.DictReader(table.decode().splitlines()))
    points = {(row["sky"], row["law"], row["cause"], row["day_type"]): float(row["points"]) for row in rows}
    assert len(points) == len(rows)
    return points


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """The folder with what the command writes for two skies and two thrifts."""
    folder = tmp_path_factory.mktemp("losses")
    asked = ("--losses", "--sky", "perez1990,cie", "--laws", "optimal,optimal:8")
    with pytest.MonkeyPatch.context() as patch:
        assert energy(patch, written(folder / "weather.csv"), "--site", SITE, "--out", folder, *asked) == 0
    return folder


@pytest.fixture(scope="module")
def points(folder):
    return points_in(folder)


def of(points, cause, sky="perez1990", law="optimal"):
    return sum(value for key, value in points.items() if key[:3] == (sky, law, cause))


def test_the_losses_by_cause_and_the_kept_share_add_up_to_the_gain_of_the_bound(folder, points):
    text = (folder / "energy-losses.txt").read_text()
    assert all(len(line) <= 80 for line in text.splitlines())
    assert "sky cie, optimal:8: the bound gains" in text
    assert (folder / "energy-losses.png").read_bytes().startswith(b"\x89PNG")
    assert "-0.0000" not in (folder / "energy-losses.csv").read_text()
    for sky in ("perez1990", "cie"):
        assert sum(of(points, cause, sky) for cause in (*CAUSES, "kept")) == pytest.approx(100.0, abs=0.01)
        assert of(points, "delay", sky) > 10.0
        assert of(points, "kept", sky) > 40.0
    # The law assumes the first sky, and not the other.
    assert abs(of(points, "structure")) < 0.05
    assert of(points, "structure", "cie") > 0.2


def test_the_loss_by_delay_is_large_on_days_of_variable_light_only(points):
    assert points["perez1990", "optimal", "delay", "variable"] > 10.0
    assert abs(points["perez1990", "optimal", "delay", "overcast"]) < 4.0
    assert points["perez1990", "optimal", "delay", "clear"] == 0.0


def test_a_higher_thrift_raises_the_loss_by_price_and_not_the_loss_by_delay(points):
    assert of(points, "price", law="optimal:8") > of(points, "price") + 3.0
    assert of(points, "delay", law="optimal:8") == pytest.approx(of(points, "delay"), abs=0.01)


def test_the_kept_share_plus_noise_and_gaps_equals_the_share_of_the_energy_benchmark(
    monkeypatch, weather, tmp_path, points
):
    assert energy(monkeypatch, weather, "--site", SITE, "--laws", "optimal", "--out", tmp_path / "b") == 0
    table = (tmp_path / "b" / "energy.csv").read_bytes()
    assert b"\r" not in table
    (row,) = csv.DictReader(table.decode().splitlines())
    kept = of(points, "kept") + of(points, "noise") + of(points, "gaps")
    assert kept == pytest.approx(float(row["share_pct"]), abs=0.01)


def test_only_the_losses_by_noise_and_gaps_depend_on_the_seed_and_ideal_moves_lose_no_motion(
    monkeypatch, weather, tmp_path, points, capsys
):
    def rows(name, seed):
        asked = ("--site", SITE, "--losses", "--ideal", "--json", "--force", "--out", tmp_path / name, "--seed", seed)
        assert energy(monkeypatch, weather, *asked) == 0
        return json.loads(capsys.readouterr().out)["rows"]

    assert of(points, "motion") > 0.05
    (row,), (otherwise,) = rows("a", 1), rows("b", 2)
    written(weather, range(600, 630))
    assert rows("a", 1) == rows("b", 1)
    assert (row["sky"], row["law"]) == ("perez1990", "optimal")
    assert set(row["lost_kwh_m2"]["motion"].values()) == {0.0}
    for cause in CAUSES:
        alike = row["lost_kwh_m2"][cause] == otherwise["lost_kwh_m2"][cause]
        assert alike is (cause not in {"noise", "gaps"})
    room = sum(row["bound_gains_kwh_m2"].values())
    for cause in ("structure", "delay", "price"):
        lost = sum(row["lost_kwh_m2"][cause].values())
        assert 100.0 * lost / room == pytest.approx(of(points, cause), abs=0.05)


def test_an_interrupted_run_keeps_the_losses_of_the_laws_that_are_done(monkeypatch, short_weather, tmp_path, capsys):
    steer = optimal_live.steer

    def interrupted(settings, *more):
        if settings.thrift == 8.0:
            raise KeyboardInterrupt
        return steer(settings, *more)

    monkeypatch.setattr(optimal_live, "steer", interrupted)
    asked = ("--losses", "--laws", "optimal,optimal:8", "--out", tmp_path / "o")
    assert energy(monkeypatch, short_weather, "--site", SITE, *asked) == 130
    said = f"heliocube: interrupted: the losses in {tmp_path / 'o'} are those of 1 of 2 laws\n"
    assert capsys.readouterr().err.endswith(said)
    assert {law for _, law, _, _ in points_in(tmp_path / "o")} == {"optimal"}


def test_losses_from_simulated_weather_are_marked_as_simulated(monkeypatch, short_weather, tmp_path, capsys):
    lines = short_weather.read_text().splitlines()
    short_weather.write_text("\n".join([f"{lines[0]},simulated", *(f"{line},true" for line in lines[1:])]))
    assert energy(monkeypatch, short_weather, "--site", SITE, "--losses", "--out", tmp_path / "o") == 0
    told, names = capsys.readouterr().out, "energy-losses.txt, energy-losses.csv, energy-losses.png"
    assert told.startswith("SIMULATED: ")
    assert told.endswith(f"written to {tmp_path / 'o'}: {names}\n")
    rows = csv.DictReader((tmp_path / "o" / "energy-losses.csv").read_text().splitlines())
    assert {row["simulated"] for row in rows} == {"true"}


@pytest.mark.parametrize(
    ("more", "reason"),
    [
        (("--laws", "optimal,mu-prime"), "--losses is for optimal and optimal:THRIFT only, not for mu-prime"),
        (("--laws", "bound"), "not for bound"),
        (
            ("--peak-kw", 1, "--price", 1, "--drive-price", 1, "--drive-life-deg", 9),
            "--losses gives no amounts of money",
        ),
        (("--sky", "rainbow"), "there is no sky 'rainbow'"),
    ],
)
def test_laws_skies_and_prices_that_losses_cannot_handle_are_refused_before_the_work(
    monkeypatch, weather, tmp_path, capsys, more, reason
):
    assert energy(monkeypatch, weather, "--site", SITE, "--losses", "--out", tmp_path / "o", *more) == 2
    assert reason in capsys.readouterr().err
    assert not (tmp_path / "o").exists()


def test_losses_for_many_sites_are_refused(monkeypatch, tmp_path, capsys):
    assert energy(monkeypatch, "--sites", tmp_path / "sites.csv", "--losses", "--out", tmp_path / "o") == 2
    assert "for the weather of one site" in capsys.readouterr().err


def test_an_existing_losses_file_is_not_overwritten_unasked(monkeypatch, weather, tmp_path, capsys):
    out = tmp_path / "o"
    out.mkdir()
    (out / "energy-losses.csv").write_text("mine")
    assert energy(monkeypatch, weather, "--site", SITE, "--losses", "--out", out) == 2
    assert "is there already" in capsys.readouterr().err
    assert (out / "energy-losses.csv").read_text() == "mine"
