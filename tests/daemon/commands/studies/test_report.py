"""`heliocube report`, as the command line has it."""

import csv
import json
import os
import re
import signal
import sys
from html.parser import HTMLParser

import pytest

from daemon.base.clock import LoopClock
from daemon.base.records import Pose
from daemon.commands.main import main
from daemon.config.settings import Settings
from daemon.store.settings_kept import publish_changes
from tests.support.stored_day import FLAGGED, GAP, HOSTILE_NAME, T0, faces_of, instants, open_store, stored_days

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def store(tmp_path_factory):
    return stored_days(tmp_path_factory.mktemp("store"))


def call(patch, *arguments):
    patch.setattr(sys, "argv", ["heliocube", *map(str, arguments)])
    with pytest.raises(SystemExit) as ended:
        main()
    return ended.value.code


@pytest.fixture
def heliocube(monkeypatch, capsys):
    """Run the command line: returns its exit code, its output and its errors."""

    def run(*arguments):
        code = call(monkeypatch, *arguments)
        said = capsys.readouterr()
        return code, said.out, said.err

    return run


@pytest.fixture(scope="module")
def the_page(store, tmp_path_factory):
    """The page of the day, written once."""
    out = tmp_path_factory.mktemp("report")
    with pytest.MonkeyPatch.context() as patch:
        day = ("--store", store, "--day", "2022-10-14", "--zone", "Europe/Paris")
        assert call(patch, "report", *day, "--out", out) == 0
    return (out / "2022-10-14-roof.html").read_text(encoding="utf-8")


class Rows(HTMLParser):
    """The rows of all tables, by their first cell."""

    def __init__(self, text):
        super().__init__()
        self.rows, self._cells, self._inside = [], [], False
        self.feed(text)

    def handle_starttag(self, tag, _attributes):
        if tag == "tr":
            self._cells = []
        self._inside = tag in ("td", "th")
        if self._inside:
            self._cells.append("")

    def handle_endtag(self, tag):
        if tag == "tr":
            self.rows.append(self._cells)
        self._inside = False

    def handle_data(self, data):
        if self._inside:
            self._cells[-1] += data


def row(page, first):
    found = [cells for cells in Rows(page).rows if cells[0] == first]
    assert found, f"no row {first}"
    return found[0]


def figure(text):
    return float(re.match(r"[+−]?[\d.]+", text)[0].replace("−", "-"))


def exported(heliocube, store, out, kind):
    code, _, _ = heliocube("export", "--store", store, "--out", out, "--kind", kind)
    assert code == 0
    return list(csv.DictReader((out / f"{kind}.csv").read_text().splitlines()))


def test_the_figures_of_the_page_are_those_of_the_export(heliocube, store, the_page, tmp_path):
    scans = exported(heliocube, store, tmp_path / "scans", "scans")
    moves = exported(heliocube, store, tmp_path / "moves", "moves")
    # A scan a minute; the gap of half an hour counts as one minute only.
    zenith = sum(float(scan["zenith_w_m2"]) for scan in scans) * 60.0 / 3.6e6
    assert figure(row(the_page, "zenith")[1]) == pytest.approx(zenith, abs=0.0006)
    good = [scan for scan in scans if scan["east_quality"] == "ok"]
    east = sum(float(scan["east_w_m2"]) for scan in good) * 60.0 / 3.6e6
    assert figure(row(the_page, "east")[1]) == pytest.approx(east, abs=0.0006)
    assert row(the_page, "Moves")[1:] == [str(len(moves)), "1 arrived"]
    travel = sum(abs(float(move["end_b_deg"]) - float(move["from_b_deg"])) for move in moves)
    assert row(the_page, "Travel of B")[1] == f"{travel:.1f} deg"
    poses = exported(heliocube, store, tmp_path / "poses", "poses")
    wind = max(float(pose["wind_m_s"]) for pose in poses if pose["wind_m_s"])
    assert row(the_page, "Strongest wind")[1] == f"{wind:.1f} m/s"
    missing = (GAP[1] - GAP[0]) / 60.0
    flagged = (FLAGGED[1] - FLAGGED[0]) / 60.0
    assert row(the_page, "Reporting period")[1:] == [
        "1440",
        f"{100 * len(scans) / 1440:.2f} %",
        f"{100 * len(good) / 1440:.2f} %",
        f"{flagged:.0f}",
        f"{missing:.0f}",
    ]


def test_the_page_compares_the_energy_of_the_tracker_with_the_chronometric_pose_and_the_bound(the_page):
    # Until noon the tracker lies flat and receives what the zenith face reads.
    utc_s = instants(1)
    zenith = faces_of(utc_s)[:, 3]
    flat = zenith[utc_s < T0 + 43200].sum() * 60.0 / 3.6e6
    actual = figure(row(the_page, "Tracker, as it stood")[1])
    chronometric = figure(row(the_page, "Chronometric, within the limits")[1])
    best = figure(row(the_page, "Best pose at every instant: the bound")[1])
    assert flat < actual < chronometric <= best
    gain = figure(row(the_page, "Tracker, as it stood")[2])
    assert gain == pytest.approx(100.0 * (actual / chronometric - 1.0), abs=0.03)


def test_the_page_lists_modes_gaps_and_alarms_with_their_utc_and_local_times(the_page):
    rows = Rows(the_page).rows
    assert ["stow", "13:00:00", "15:00:00", "60 min", "wind 17.2 m/s"] in rows
    assert figure(row(the_page, "tracking")[1]) == pytest.approx(9.5)
    assert ["14:59:00", "16:59:00", "31 min"] in rows
    cube = "the cube is silent: look at its PC"
    assert ["09:00:00", "11:00:00", "60 min", cube, HOSTILE_NAME] in rows
    assert ["16:00:00", "18:00:00", "8 h 00 min, still on", "the day's moves are used up", "–"] in rows


def test_markup_in_texts_from_outside_is_escaped_on_the_page(the_page):
    assert "<script" not in the_page
    assert "&lt;script&gt;alert('x')&lt;/script&gt;" in the_page
    assert "Greenwich &amp; Sons" in the_page


def test_the_page_and_every_picture_are_marked_simulated_for_simulated_records_only(the_page, heliocube, tmp_path):
    assert "<title>SIMULATED " in the_page
    assert "SIMULATED: no hardware is behind these figures." in the_page
    pictures = re.findall(r"<svg .*?</svg>", the_page, re.DOTALL)
    assert len(pictures) == 5
    assert all("SIMULATED" in picture for picture in pictures)
    real = stored_days(tmp_path / "store", simulated=False)
    told = heliocube("report", "--store", real, "--day", "2022-10-14", "--out", tmp_path, "--json")[1]
    assert json.loads(told)["simulated"] is False
    assert "SIMULATED" not in (tmp_path / "2022-10-14-roof.html").read_text(encoding="utf-8")


def test_an_existing_page_is_not_overwritten_without_force(heliocube, store, tmp_path):
    page = tmp_path / "2022-10-14-roof.html"
    page.write_text("mine")
    code, _, said = heliocube("report", "--store", store, "--day", "2022-10-14", "--out", tmp_path)
    assert (code, page.read_text()) == (2, "mine")
    assert said == f"heliocube: {page} is there already: --force overwrites it, or name another --out\n"
    _, told, _ = heliocube("report", "--store", store, "--day", "2022-10-14", "--out", tmp_path, "--force", "--json")
    assert json.loads(told) == {"simulated": True, "written": [str(page)]}
    assert page.read_text(encoding="utf-8").startswith("<!doctype html>")
    assert [path.name for path in tmp_path.iterdir()] == [page.name]


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ((), "name either --day DAY, or --from and --to"),
        (("--day", "2022-10-14", "--to", "2022-10-15"), "name either --day DAY, or --from and --to"),
        (("--from", "2022-10-14"), "--from and --to belong together"),
        (("--day", "14 October"), "--day: '14 October' is not a day; write 2022-10-14, yesterday or today"),
        (("--day", "2022-13-14"), "--day: '2022-13-14' is not a day"),
        (("--day", "0001-01-01"), "--day: '0001-01-01' is not a day"),
        (("--day", "9999-12-31"), "--day: '9999-12-31' is not a day"),
        (("--from", "0001-01-01T00:00+01:00", "--to", "2022-10-14"), "'0001-01-01T00:00+01:00' is not a date or time"),
        (("--from", "2022-10-14", "--to", "noon"), "--to: 'noon' is not a date or time"),
        (("--from", "2022-10-15", "--to", "2022-10-14"), "--from 2022-10-15 is not before --to 2022-10-14"),
        (("--from", "2021-10-15", "--to", "2022-10-14"), "that is 364 days and a report has 62 at most"),
        (("--day", "2922-10-14"), "2922-10-14 is in the future"),
        (("--day", "2022-10-12"), "no record from 2022-10-12 00:00 UTC to 2022-10-13 00:00 UTC in "),
        (("--day", "2022-10-14", "--tracker", "cellar"), "--tracker 'cellar': that store has roof in that time"),
        (("--day", "2022-10-14", "--tracker", "**"), "--tracker '**': that store has roof in that time"),
        (("--day", "2022-10-14", "--zone", "Moon/Base"), "there is no time zone 'Moon/Base'"),
        (("--day", "2022-10-14", "--out", "/dev/null/x"), "--out: /dev/null/x cannot be a folder"),
    ],
)
def test_a_mistaken_request_for_a_report_is_refused_in_one_sentence(heliocube, store, tmp_path, arguments, message):
    code, out, said = heliocube("report", "--store", store, "--out", tmp_path / "new", *arguments)
    assert (code, out) == (2, "")
    assert message in said
    assert said.count("\n") == 1
    assert not list(tmp_path.iterdir())


def test_several_days_are_one_page_and_several_trackers_several(heliocube, tmp_path):
    directory = stored_days(tmp_path / "store", days=2, trackers=("east", "west"))
    span = ("--from", "2022-10-14", "--to", "2022-10-16")
    assert heliocube("report", "--store", directory, *span, "--out", tmp_path / "out")[0] == 0
    assert sorted(path.name for path in (tmp_path / "out").iterdir()) == [
        "2022-10-14_2022-10-16-east.html",
        "2022-10-14_2022-10-16-west.html",
    ]
    page = (tmp_path / "out" / "2022-10-14_2022-10-16-east.html").read_text(encoding="utf-8")
    first, second = row(page, "2022-10-14"), row(page, "2022-10-15")
    assert first[5:] == second[5:] == ["1", "50"]
    whole = figure(row(page, "Tracker, as it stood")[1])
    assert figure(first[1]) + figure(second[1]) == pytest.approx(whole, abs=0.011)


def test_the_page_takes_limits_and_daily_budget_from_the_configuration(heliocube, store, tmp_path):
    config = tmp_path / "heliocube.toml"
    config.write_text(
        f'[store]\ndirectory = "{store}"\n[motion]\ntravel_per_day_deg = 500.0\n[limits]\nb_min_deg = 89.0\n'
    )
    assert heliocube("report", "--config", config, "--day", "2022-10-14", "--out", tmp_path)[0] == 0
    page = (tmp_path / "2022-10-14-roof.html").read_text(encoding="utf-8")
    assert row(page, "Most in a day")[1:] == ["50.0 deg", "10.0 % of the 500 deg of a day"]
    # With such limits for its tilt, the best pose is little better than flat.
    assert figure(row(page, "Best pose at every instant: the bound")[2]) < 60.0


def test_the_page_lists_the_changes_of_the_configuration(heliocube, tmp_path):
    kept = open_store(tmp_path / "store")
    for wind in (15.0, 15.0, 12.5):
        settings = Settings.model_validate({"safety": {"stow_wind_m_s": wind}}).model_dump(mode="json")
        publish_changes(settings, tmp_path / "store", LoopClock(lambda: 60.0, T0), kept.keep)
    kept.keep(Pose(T0, 0.0, 0.0, 90.0, False, "roof"))
    kept.close()
    arguments = ("--store", tmp_path / "store", "--day", "2022-10-14", "--out", tmp_path)
    assert heliocube("report", *arguments)[0] == 0
    page = (tmp_path / "2022-10-14-roof.html").read_text(encoding="utf-8")
    changes = [cells[2] for cells in Rows(page).rows if len(cells) == 3 and "stow_wind" in cells[2]]
    assert changes == ["safety.stow_wind_m_s was 15.0 and is 12.5"]


def test_a_page_is_written_for_a_store_in_a_folder_whose_name_is_not_utf_8(heliocube, store, tmp_path):
    folder = tmp_path / os.fsdecode(b"caf\xe9")
    folder.symlink_to(store)
    asked = ("--store", folder, "--day", "2022-10-14", "--out", tmp_path, "--json")
    code, told, _ = heliocube("report", *asked)
    assert (code, json.loads(told)["written"]) == (0, [str(tmp_path / "2022-10-14-roof.html")])
    assert "caf\\udce9" in (tmp_path / "2022-10-14-roof.html").read_text(encoding="utf-8")


def test_the_pages_of_simulate_and_of_its_replay_agree_and_are_marked_simulated(heliocube, tmp_path):
    start = ("--start", "2022-06-21T11:00Z", "--days", "0.01")
    out = tmp_path / "tables"
    code, told, err = heliocube("simulate", *start, "--out", out, "--report", tmp_path / "pages", "--json")
    assert (code, err, json.loads(told)["scans"]) == (0, "", 173)
    simulated = (tmp_path / "pages" / "20220621T1100Z_20220621T1114Z-tracker.html").read_text(encoding="utf-8")
    faces = tmp_path / "faces.csv"
    with (out / "scans.csv").open(newline="") as file:
        scans = list(csv.DictReader(file))
    names = ("east", "south", "west", "zenith")
    lines = [",".join([scan["time"], *(scan[f"{name}_w_m2"] for name in names)]) for scan in scans]
    faces.write_text("\n".join(["time,east,south,west,zenith", *lines]))
    site = ("--site", "48.717607,2.209002,156")
    _, told, _ = heliocube(
        "replay", faces, *site, "--out", tmp_path / "p.csv", "--report", tmp_path / "again", "--json"
    )
    (again,) = (tmp_path / "again").iterdir()
    assert json.loads(told)["reports"] == [str(again)]
    replayed = again.read_text(encoding="utf-8")
    assert figure(row(replayed, "zenith")[1]) == pytest.approx(figure(row(simulated, "zenith")[1]), abs=0.002)
    assert "SIMULATED" in simulated
    assert "SIMULATED" in replayed
    before = again.stat().st_mtime_ns
    assert heliocube("replay", faces, *site, "--out", tmp_path / "q.csv", "--report", tmp_path / "again")[0] == 2
    assert again.stat().st_mtime_ns == before
    assert not (tmp_path / "q.csv").exists(), "it was refused before the work"


@pytest.mark.parametrize(
    ("command", "number"), [("simulate", signal.SIGINT), ("simulate", signal.SIGTERM), ("replay", signal.SIGTERM)]
)
def test_an_interrupted_simulate_or_replay_writes_no_page_and_makes_no_folder_for_it(
    heliocube, tmp_path, signal_at_first_progress, command, number
):
    signal_at_first_progress(number)
    faces = tmp_path / "faces.csv"
    faces.write_text(
        "time,east,south,west,zenith\n2022-10-12T11:00Z,220,300,210,510\n2022-10-12T11:01Z,220,300,210,510"
    )
    asked = {
        "simulate": ("--start", "2022-06-21T11:00Z", "--days", "0.02", "--out", tmp_path / "tables"),
        "replay": (faces, "--site", "48.7176,2.2090,156", "--out", tmp_path / "p.csv"),
    }
    code, _, said = heliocube(command, *asked[command], "--report", tmp_path / "pages")
    assert code == 130
    assert said.splitlines()[-1].startswith("heliocube: interrupted: ")
    assert said.endswith(", and no page was written\n")
    assert not (tmp_path / "pages").exists()
    assert not list(tmp_path.rglob("*.part"))


@pytest.mark.parametrize("command", ["simulate", "replay"])
def test_sigterm_keeps_what_is_done_also_in_a_background_process_that_ignores_sigint(
    heliocube, tmp_path, signal_at_first_progress, command
):
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal_at_first_progress(signal.SIGTERM)
    faces, out = tmp_path / "faces.csv", tmp_path / "p.csv"
    faces.write_text(
        "time,east,south,west,zenith\n2022-10-12T11:00Z,220,300,210,510\n2022-10-12T11:01Z,220,300,210,510"
    )
    asked = {
        "simulate": ("--start", "2022-06-21T11:00Z", "--days", "0.02", "--out", out),
        "replay": (faces, "--site", "48.7176,2.2090,156", "--out", out),
    }
    code, _, said = heliocube(command, *asked[command])
    assert (code, out.exists()) == (130, True)
    assert said.splitlines()[-1].startswith("heliocube: interrupted: ")
    assert "Traceback" not in said
    assert signal.getsignal(signal.SIGINT) is signal.SIG_IGN


def test_the_page_of_a_replay_counts_readings_that_the_service_rejected_as_flagged(heliocube, tmp_path):
    minutes = [f"2022-10-12T{11 + minute // 60}:{minute % 60:02d}Z" for minute in range(70)]
    faces = tmp_path / "faces.csv"
    lines = [f"{at},{220 + count % 3},0.3,{210 + count % 2},{510 + count % 5}" for count, at in enumerate(minutes)]
    faces.write_text("\n".join(["time,east,south,west,zenith", *lines]))
    out = ("--out", tmp_path / "p.csv", "--report", tmp_path / "pages")
    assert heliocube("replay", faces, "--site", "48.7176,2.2090,156", "--law", "optimal", *out)[0] == 0
    page = next((tmp_path / "pages").iterdir()).read_text(encoding="utf-8")
    assert "south face reads next to nothing" in page
    assert "the records have 1 alarm, no stows" in page
    _, expected, _, _, flagged, missing = row(page, "Daylight")
    assert int(expected) == 70
    assert 50 < int(flagged) < 70
    assert int(missing) == 0
