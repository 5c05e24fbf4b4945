"""Recorded readings through the code that runs live."""

import csv
import gzip
import re
import signal
from datetime import UTC, datetime

import numpy as np
import pytest

from daemon.base.clock import SystemClock, iso_utc
from daemon.base.records import FaceReading, Pose, Quality, Scan
from daemon.commands.main import main
from daemon.store.store import Origin, Store
from daemon.studies.inputs import settings_for, site_values
from daemon.studies.recorded import read_csv
from daemon.studies.replay import COLUMNS, replay
from solar.ephemeris import sun_direction
from solar.frames import normal_from_angles, separation_deg
from solar.skies.sky import sky
from tests.daemon.tracker.test_optimal import Blinking, half_an_hour
from tests.support.rig import SITE

pytestmark = pytest.mark.slow

PLACE = ",".join(str(value) for value in SITE)
NORMALS = ([0.0, 1, 0], [1.0, 0, 0], [0.0, -1, 0], [0.0, 0, 1])
NOON = datetime(2022, 10, 12, 12, tzinfo=UTC).timestamp()


def readings(times, dni=700.0, dhi=90.0):
    """Return the lines of a file with the faces' readings at these times."""
    light = sky("isotropic", sun_direction(np.array(times), *SITE), dni, dhi, 1360.0)
    faces = np.stack([light.irradiance_on(np.array(normal)) for normal in NORMALS], axis=-1)
    return [[iso_utc(at), *(f"{value:.2f}" for value in row)] for at, row in zip(times, faces, strict=True)]


def write(path, lines, header="time,east,south,west,zenith"):
    text = "\n".join([header, *(",".join(line) for line in lines)]) + "\n"
    path.write_bytes(gzip.compress(text.encode()) if path.suffix.lower() == ".gz" else text.encode())
    return path


@pytest.fixture
def heliocube(monkeypatch, capsys):
    """Run the command in this process; returns its exit code and its output."""

    def run(*arguments):
        monkeypatch.setattr("sys.argv", ["heliocube", *map(str, arguments)])
        with pytest.raises(SystemExit) as end:
            main()
        said = capsys.readouterr()
        return end.value.code or 0, said.out + said.err

    return run


@pytest.fixture
def replayed(heliocube, tmp_path):
    """Replay lines by a law; returns the rows of the result."""

    def run(lines, law, *more, name="faces.csv"):
        source, out = write(tmp_path / name, lines), tmp_path / "positions.csv"
        code, said = heliocube("replay", source, "--site", PLACE, "--law", law, "--out", out, "--force", *more)
        assert code == 0, said
        with out.open(newline="") as file:
            reader = csv.DictReader(file)
            found = list(reader)
        assert tuple(reader.fieldnames) == COLUMNS
        assert [row["time"] for row in found] == [line[0] for line in lines]
        return found

    return run


def off_sun_deg(row):
    utc_s = datetime.fromisoformat(row["time"]).timestamp()
    normal = normal_from_angles(float(row["a"]), float(row["b"]))
    return float(separation_deg(normal, sun_direction(utc_s, *SITE)))


@pytest.mark.parametrize("every_s", [1, 5, 60])
@pytest.mark.parametrize("law", ["mu-prime", "optimal"])
def test_a_replay_follows_the_sun_through_a_clear_hour_at_any_cadence(replayed, law, every_s):
    found = replayed(readings(NOON - 1800 + np.arange(0, 3600, every_s)), law)
    last = found[-1]
    assert (last["mode"], last["law"]) == ("tracking", law)
    assert off_sun_deg(last) < (4.0 if law == "optimal" else 8.0)
    assert float(last["a"]) == pytest.approx(float(last["a_set"]), abs=1.0)
    assert {row["simulated"] for row in found} == {"true"}
    if law == "optimal":
        assert float(last["dni_est"]) == pytest.approx(700.0, rel=0.02)
        assert float(last["dhi_est"]) == pytest.approx(90.0, rel=0.05)
        assert float(last["albedo_est"]) == 0.2
    else:
        assert (last["dni_est"], last["dhi_est"], last["albedo_est"]) == ("", "", "")


@pytest.mark.parametrize("law", ["mu-prime", "optimal"])
def test_a_replayed_tracker_stands_where_the_live_tracker_stood(run_rig, replayed, law):
    # Decisions lie well away from the edges of the clouds, where one scan more would turn the mean by degrees.
    rig = run_rig(half_an_hour, law={"name": law}, weather=Blinking(), start="2022-10-12T10:02")
    scans = rig.records_of(Scan)
    lines = [[iso_utc(scan.time_utc_s), *(f"{face.irradiance_w_m2}" for face in scan.faces)] for scan in scans]
    found = replayed(lines, law)
    poses = rig.records_of(Pose)
    times = np.array([pose.time_utc_s for pose in poses])
    moving = np.array([pose.time_utc_s for pose in poses if pose.moving])
    compared = 0
    for scan, row in zip(scans, found, strict=True):
        # A decision may come a scan earlier or later: only the pose of a tracker at rest is compared.
        if scan.time_utc_s < times[0] + 420 or (np.abs(moving - scan.time_utc_s) < 12).any():
            continue
        live = poses[int(np.searchsorted(times, scan.time_utc_s, side="right")) - 1]
        assert float(row["a"]) == pytest.approx(live.a_deg, abs=1.5), row["time"]
        assert float(row["b"]) == pytest.approx(live.b_deg, abs=1.5), row["time"]
        compared += 1
    assert compared > 150


def test_a_row_names_the_law_that_decided_and_not_the_one_that_was_chosen(replayed, tmp_path):
    config = tmp_path / "heliocube.toml"
    config.write_text("[motion]\ntravel_per_day_deg = 80.0\n")
    rows = replayed(readings(NOON + np.arange(0, 3600, 30.0)), "sun-vector", "--config", config)
    laws = [row["law"] for row in rows if row["mode"] == "tracking"]
    assert list(dict.fromkeys(laws)) == ["sun-vector", "chronometric"], "the last of the travel is the clock's"


def test_a_replay_warns_of_readings_in_kilowatts_by_day_and_not_by_night(heliocube, tmp_path):
    times, out = NOON + np.arange(0, 300, 60.0), tmp_path / "positions.csv"
    told = []
    for at in (times, times + 43200.0):
        kilowatts = [(time, *(str(float(value) / 1000.0) for value in faces)) for time, *faces in readings(at)]
        source = write(tmp_path / "faces.csv", kilowatts)
        told += [heliocube("replay", source, "--site", PLACE, "--law", "flat", "--out", out, "--force")]
    warning = rf"warning: {source} has at most 0.\d+ W/m2 on any face by day: if it is in kW/m2, multiply it by 1000\n"
    assert [code for code, _ in told] == [0, 0]
    assert [bool(re.search(warning, said)) for _, said in told] == [True, False]


def test_after_a_gap_a_replayed_tracker_faces_the_sun_by_day_and_is_at_the_night_position_at_night(replayed):
    before = NOON + np.arange(0, 1800, 5.0)
    after = NOON + 3 * 3600 + np.arange(0, 600, 5.0)
    at_night = NOON + 11 * 3600 + np.arange(0, 600, 5.0)
    tomorrow = NOON + 86400.0 + np.arange(0, 600, 5.0)
    times = np.concatenate([before, after, at_night, tomorrow])
    day = (times < at_night[0]) | (times >= tomorrow[0])
    found = replayed(readings(times, dni=700.0 * day, dhi=90.0 * day), "optimal")
    modes = [row["mode"] for row in found]
    at = len(before)
    assert off_sun_deg(found[at]) < 3.0, "it followed the sun through the gap"
    assert modes[at] == "fallback"
    night = at + len(after)
    assert modes[night] == "night"
    assert (float(found[night]["a"]), float(found[night]["b"])) == (pytest.approx(0, abs=1), pytest.approx(90, abs=1))
    first = night + len(at_night)
    assert modes[first] in ("fallback", "tracking")
    assert off_sun_deg(found[first]) < 3.0, "after the night the gap went on by day"
    assert modes[first + 100] == "tracking"


def test_a_gap_of_years_that_ends_in_another_season_is_replayed(replayed):
    before = NOON + 3 * 3600 + np.arange(0, 900, 5.0)
    after = NOON + 961 * 86400.0 - 4 * 3600 + np.arange(0, 900, 5.0)
    found = replayed(readings(np.concatenate([before, after])), "optimal")
    assert off_sun_deg(found[len(before)]) < 3.0, "it followed the sun at the end of the gap"
    for last in (found[len(before) - 1], found[-1]):
        assert last["mode"] == "tracking"
        assert off_sun_deg(last) < 6.0


def test_an_impossible_value_is_a_missing_reading_and_is_counted(heliocube, tmp_path):
    lines = readings(NOON + np.arange(0, 600, 5.0))
    lines[60][2] = "13949"
    source, out = write(tmp_path / "faces.csv", lines), tmp_path / "positions.csv"
    code, said = heliocube("replay", source, "--site", PLACE, "--law", "optimal", "--out", out)
    assert code == 0
    assert "1 of 480 readings are missing" in said
    assert "the first at line 62: south 13949" in said
    assert out.read_text().count("tracking") > 100


def test_a_night_in_the_readings_is_replayed_in_mode_night_at_the_night_position(replayed):
    dusk = datetime(2022, 10, 12, 17, tzinfo=UTC).timestamp()
    times = dusk + np.arange(0, 7200, 30.0)
    up = sun_direction(times, *SITE)[:, 2]
    found = replayed(readings(times, dni=np.where(up > 0, 300.0, 0.0), dhi=np.maximum(up, 0.0) * 100), "optimal")
    last = found[-1]
    assert last["mode"] == "night"
    assert last["law"] == ""
    assert (float(last["a"]), float(last["b"])) == (pytest.approx(0, abs=1), pytest.approx(90, abs=1))


def test_an_implausible_or_missing_face_is_left_out(replayed):
    lines = readings(NOON + np.arange(0, 1800, 5.0))
    for number, line in enumerate(lines):
        line[1] = "" if number % 2 else "1900"
    assert replayed(lines, "mu-prime")[-1]["mode"] == "tracking"
    *_, implausible, last = replayed(lines, "optimal")
    assert last["mode"] == "tracking"
    assert off_sun_deg(last) < 6.0
    assert float(implausible["dni_est"]) == pytest.approx(float(last["dni_est"]), rel=0.01)


@pytest.mark.parametrize("law", ["mu-prime", "optimal"])
def test_a_replay_with_a_dead_face_tracks_without_it(replayed, law):
    lines = readings(NOON - 3600 + np.arange(0, 7200, 15.0))
    for line in lines:
        line[2] = "0.3"
    last = replayed(lines, law)[-1]
    assert last["mode"] == "tracking"
    # Under a clear sky mu' looks higher than the sun.
    assert off_sun_deg(last) < (6.0 if law == "optimal" else 8.0)


@pytest.mark.parametrize("ending", ["gz", "GZ"])
def test_a_replay_reads_and_writes_gzip_files(heliocube, tmp_path, ending):
    source, out = (tmp_path / f"{name}.csv.{ending}" for name in ("faces", "positions"))
    write(source, readings(NOON + np.arange(0, 600, 5.0)))
    assert heliocube("replay", source, "--site", PLACE, "--out", out)[0] == 0
    assert gzip.decompress(out.read_bytes()).startswith(",".join(COLUMNS).encode())


def test_the_store_of_a_tracker_can_be_replayed(heliocube, tmp_path):

    store = Store(tmp_path / "store", 60.0, 400, Origin(NOON, "both", "0", True, "x", *SITE), SystemClock(), print)
    for number, (_, *values) in enumerate(readings(NOON + np.arange(0, 900, 5.0))):
        utc_s = NOON + 5.0 * number
        faces = [FaceReading(float(value), Quality.OK, utc_s, 5.0 * number) for value in values]
        store.keep(Scan("cube", "s", number, utc_s, 5.0 * number, *faces))
    store.close()
    out = tmp_path / "positions.csv"
    code, said = heliocube("replay", "--store", tmp_path / "store", "--site", PLACE, "--law", "optimal", "--out", out)
    assert code == 0, said
    with out.open(newline="") as file:
        found = list(csv.DictReader(file))
    assert len(found) == 180
    assert found[-1]["mode"] == "tracking"


GOOD = readings(NOON + np.arange(0, 60, 5.0))


@pytest.mark.parametrize(
    ("lines", "options", "sentence"),
    [
        ([], {}, "has no readings below its header: name a file that has some"),
        (GOOD[:1], {}, "faces.csv: a replay needs two rows at least"),
        ([GOOD[1], GOOD[0]], {}, "not later than that of the line before"),
        ([["yesterday", "1", "1", "1", "1"]], {}, "'yesterday' is not ISO 8601"),
        ([["2022-10-12T12:00:00Z", "x", "1", "1", "1"]], {}, "east is 'x'"),
        ([["2022-10-12T12:00:00Z", "1", "1"]], {}, "3 cells where the header has 5"),
        (readings(NOON + np.arange(0, 3600, 600.0)), {}, "faces.csv: the rows are 600 s apart"),
        (
            [["1970-01-01T00:00:01Z", *GOOD[0][1:]], *GOOD],
            {},
            "faces.csv: the times must be within the years 1979 to 2099; these begin at 1970-01-01T00:00:01Z",
        ),
        ([*GOOD, ["9999-12-31T12:00:00Z", *GOOD[0][1:]]], {}, "and end at 9999-12-31T12:00:00Z: put them right"),
        (GOOD, {"--law": "best"}, "law.driver"),
        (GOOD, {"--site": "here"}, "--site"),
        (GOOD, {"--store": "x"}, "either FACES.csv or --store"),
        (GOOD, {"--config": "missing.toml"}, "missing.toml"),
    ],
)
def test_bad_input_of_a_replay_is_refused_with_a_sentence_and_nothing_is_written(
    heliocube, tmp_path, lines, options, sentence
):
    source, out = write(tmp_path / "faces.csv", lines), tmp_path / "out" / "positions.csv"
    out.parent.mkdir()
    asked = {"--site": PLACE, "--law": "optimal", "--out": out} | options
    code, said = heliocube("replay", source, *(word for option in asked.items() for word in option))
    assert code == 2
    assert sentence in said
    assert "Traceback" not in said
    assert list(out.parent.iterdir()) == []


def test_a_replay_refuses_a_missing_input_file_and_an_output_file_that_cannot_be_written(heliocube, tmp_path):
    out = tmp_path / "positions.csv"
    code, said = heliocube("replay", tmp_path / "no.csv", "--site", PLACE, "--law", "flat", "--out", out)
    assert code == 2
    assert "there is no file" in said
    assert "no.csv: name a CSV file" in said
    source = write(tmp_path / "faces.csv", GOOD)
    code, said = heliocube("replay", source, "--site", PLACE, "--law", "flat", "--out", source / "x.csv")
    assert code == 2
    assert "faces.csv is a file" in said
    code, said = heliocube("replay", source, "--site", PLACE, "--law", "flat", "--out", source)
    assert code == 2
    assert "name another" in said


def test_ctrl_c_leaves_the_rows_that_were_done(tmp_path):
    source = read_csv(write(tmp_path / "faces.csv", readings(NOON + np.arange(0, 20000, 5.0)))).rows
    asked = iter([False, False, True])

    def interrupt(_share):
        if next(asked, False):
            signal.raise_signal(signal.SIGINT)

    settings = settings_for(None, law="flat", site=site_values(PLACE))
    done = len(replay(settings, source, "faces.csv", tmp_path / "out.csv", interrupt).qualities)
    assert 2000 < done < len(source)
    lines = (tmp_path / "out.csv").read_text().splitlines()
    assert (len(lines), lines[-1].split(",")[0]) == (done + 1, iso_utc(source.utc_s[done - 1]))
