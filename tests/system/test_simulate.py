"""`heliocube simulate`: whole days of the service, on built-in and on measured weather."""

import csv
import hashlib
import math
import signal
from datetime import UTC, datetime, timedelta

import pandas as pd
import pytest
from typer.testing import CliRunner

from daemon.base.errors import UserError
from daemon.commands.main import app
from daemon.config.settings import Settings
from daemon.studies.simulate import simulate
from solar.ephemeris import sun_direction
from solar.frames import direction_from_azimuth, normal_from_angles, separation_deg

pytestmark = [pytest.mark.computes, pytest.mark.slow]

LYNGBY = {"name": "Lyngby", "latitude_deg": 55.79064, "longitude_deg": 12.52505, "altitude_m": 50.0}


def day(out, start, weather, law, site=None, days=1.0, seed=1, table_format="csv", scan_every_s=20):
    """Simulate. With a quarter of the scans that are the service's default, a day takes half as long."""
    settings = Settings.model_validate(
        {
            "simulation": {"weather": weather, "seed": seed},
            "cube": {"scan_every_s": scan_every_s},
            "safety": {"scan_stale_s": max(20.0, 2.0 * scan_every_s)},
            "law": {"name": law},
            "site": site or {},
        }
    )
    return simulate(settings, datetime.fromisoformat(start), days, out, table_format, lambda _share: None)


def rows(path):
    with path.open(newline="") as file:
        return list(csv.DictReader(file))


def utc_s(row):
    return datetime.fromisoformat(row["time"]).timestamp()


def values(row, *names):
    return [float(row[name]) for name in names]


def plain_means(scans, decisions):
    """For each decision the mean of the scans of the last 120 s, computed from the tables alone."""
    times = [utc_s(scan) for scan in scans]
    faces = [values(scan, "east_w_m2", "south_w_m2", "west_w_m2", "zenith_w_m2") for scan in scans]
    end = 0
    for decision in decisions:
        now = utc_s(decision)
        while end < len(times) and times[end] <= now:
            end += 1
        begin = end
        while begin > 0 and times[begin - 1] > now - 120:
            begin -= 1
        yield [sum(column) / (end - begin) for column in zip(*faces[begin:end], strict=True)]


# A clear sky, and a closed one that opens.
@pytest.mark.parametrize("start", ["2016-06-05T09:00", "2016-03-15T12:00"])
def test_on_measured_days_the_tracker_stands_where_the_equations_of_mu_prime_say(measured, tmp_path, start):
    weather = measured / "dtu_lyngby_2016" / f"{start[:7]}.csv.gz"
    day(tmp_path, start, weather, "mu-prime", LYNGBY, days=0.08)
    decisions = [row for row in rows(tmp_path / "decisions.csv") if row["mode"] == "tracking"]
    assert len(decisions) > 20
    settled = 0
    poses = rows(tmp_path / "poses.csv")
    stood = iter(poses)
    pose = next(stood)
    scans = rows(tmp_path / "scans.csv")
    nexts = [utc_s(row) for row in decisions[1:]] + [math.inf]
    for decision, next_s, (east, south, west, zenith) in zip(
        decisions, nexts, plain_means(scans, decisions), strict=True
    ):
        equatorward = south - min(east, west)
        length = math.hypot(equatorward, east - west, zenith)
        a_deg = math.degrees(math.asin((west - east) / length))
        b_deg = math.degrees(math.atan2(zenith, equatorward)) if equatorward > 0 else 90.0
        target = values(decision, "target_a_deg", "target_b_deg")
        expected = (max(min(a_deg, 50), -50), max(min(b_deg, 90), 15))
        # In broken cloud the oldest sample of the window counts by the part of it that is inside; a low sun below B's
        # limit turns A a little further than (14), to stay nearest to it.
        assert separation_deg(normal_from_angles(*target), normal_from_angles(*expected)) < 1.5
        # It stands there when the next decision is due, unless the mode has changed meanwhile.
        if next_s - utc_s(decision) > 301:
            continue
        while utc_s(pose) < utc_s(decision) + 280:
            pose = next(stood)
        stands = values(pose, "a_deg", "b_deg")
        if pose["moving"] == "false":
            settled += 1
            assert separation_deg(normal_from_angles(*stands), normal_from_angles(*target)) < 1.5
    assert settled > 0.95 * len(decisions)


def test_on_the_measured_clear_day_the_sun_vector_points_within_3_degrees_of_the_sun(measured, tmp_path):
    weather = measured / "dtu_lyngby_2016" / "2016-06.csv.gz"
    day(tmp_path, "2016-06-05T10:30", weather, "sun-vector", LYNGBY, days=0.1, scan_every_s=30)
    high = [row for row in rows(tmp_path / "decisions.csv") if float(row["sun_elevation_deg"]) > 15]
    assert len(high) > 20
    for row in high:
        seen = direction_from_azimuth(*values(row, "direction_azimuth_deg", "direction_elevation_deg"), 55.8)
        sun = sun_direction(utc_s(row), 55.79064, 12.52505, 50.0)
        assert separation_deg(seen, sun) < 3.0, row["time"]


def test_on_the_measured_clear_day_chronometric_faces_the_sun_within_the_limits(measured, tmp_path):
    weather = measured / "dtu_lyngby_2016" / "2016-06.csv.gz"
    day(tmp_path, "2016-06-05T06:00", weather, "chronometric", LYNGBY, days=0.1, scan_every_s=60)
    reached = beyond = 0
    for row in rows(tmp_path / "decisions.csv"):
        sun = sun_direction(utc_s(row), 55.79064, 12.52505, 50.0)
        apart = separation_deg(normal_from_angles(*values(row, "target_a_deg", "target_b_deg")), sun)
        inside = abs(float(row["target_a_deg"])) < 50 and 15 < float(row["target_b_deg"]) < 90
        reached += inside
        beyond += not inside
        assert apart < 0.01 or not inside
    assert reached > 10
    assert beyond > 2


def test_on_the_built_in_overcast_day_the_tracker_lies_nearly_flat(tmp_path):
    day(tmp_path, "2022-10-14T10:00", "overcast", "mu-prime", days=0.1, scan_every_s=30)
    tilts = [
        separation_deg(normal_from_angles(*values(row, "target_a_deg", "target_b_deg")), [0, 0, 1])
        for row in rows(tmp_path / "decisions.csv")
        if float(row["sun_elevation_deg"]) > 5
    ]
    assert len(tilts) > 20
    assert sum(tilts) / len(tilts) < 10


def test_on_the_built_in_clear_day_mu_prime_follows_the_sun_within_its_over_tilt(tmp_path):
    summary = day(tmp_path, "2022-06-21T10:30", "clear", "mu-prime", days=0.12, scan_every_s=30)
    for row in rows(tmp_path / "decisions.csv"):
        sun_elevation = float(row["sun_elevation_deg"])
        if sun_elevation < 20 or not 90 < float(row["sun_azimuth_deg"]) < 270:
            continue
        elevation, azimuth = values(row, "direction_elevation_deg", "direction_azimuth_deg")
        # mu' adds 2 I_min (about the diffuse light) to the vertical component: it looks above the sun, never below.
        assert -0.5 < elevation - sun_elevation < 12
        assert abs(azimuth - float(row["sun_azimuth_deg"])) < 3
    assert 20 < summary.moves < 50


def test_the_same_seed_gives_the_same_bytes_and_another_seed_does_not(tmp_path):
    def digest(folder, seed):
        day(folder, "2022-10-12T08:00", "variable", "mu-prime", days=0.02, seed=seed)
        return {path.name: hashlib.sha256(path.read_bytes()).hexdigest() for path in sorted(folder.iterdir())}

    first, again, other = digest(tmp_path / "a", 1), digest(tmp_path / "b", 1), digest(tmp_path / "c", 2)
    assert first == again
    assert first["scans.csv"] != other["scans.csv"]


def test_parquet_tables_open_in_pandas(tmp_path):
    day(tmp_path, "2022-10-12T10:00", "clear", "flat", days=0.02, table_format="parquet", scan_every_s=5)
    scans = pd.read_parquet(tmp_path / "scans.parquet")
    assert len(scans) == pytest.approx(0.02 * 17280, abs=2)
    assert str(scans.index.tz) == "UTC"


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        (["--start", "2022-12-21", "--site", "80,10", "--weather", "clear"], "the sun does not rise"),
        (["--start", "2022-10-14", "--weather", "nowhere.csv"], "no weather file at nowhere.csv"),
        (["--start", "yesterday"], "is not a date or time"),
        (["--start", "2022-10-14", "--site", "91,0"], "is not on Earth: LAT is in -90..90"),
        (["--start", "2022-10-14", "--site", "here"], "LAT,LON"),
    ],
)
def test_a_wrong_argument_of_simulate_is_refused_with_a_sentence_and_nothing_is_written(tmp_path, arguments, sentence):
    result = CliRunner().invoke(app, ["simulate", "--out", str(tmp_path / "out"), *arguments])
    assert isinstance(result.exception, UserError)
    assert sentence in str(result.exception)
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("content", "sentence"),
    [
        ("time,ghi,dni\n2022-10-14T00:00Z,1,2\n", "has no column dhi"),
        ("time,ghi,dni,dhi\n2022-10-14T00:02Z,1,2,3\n2022-10-14T00:01Z,1,2,3\n", "line 3"),
        ("time,ghi,dni,dhi\n2022-10-14T00:02Z,1,2,3\n2022-10-14T00:03Z,1,x,3\n", "line 3"),
        ("", "empty"),
    ],
)
def test_a_bad_weather_file_is_refused_in_one_sentence_with_the_place_and_nothing_is_written(
    tmp_path, content, sentence
):
    weather = tmp_path / "weather.csv"
    weather.write_text(content)
    with pytest.raises(UserError, match=sentence) as caught:
        day(tmp_path / "out", "2022-10-14", weather, "flat")
    assert "\n" not in str(caught.value)
    assert not (tmp_path / "out").exists()


def test_a_weather_file_that_ends_before_the_simulation_is_refused_at_the_start(tmp_path):
    begin = datetime(2022, 10, 14, tzinfo=UTC)
    lines = [f"{(begin + timedelta(minutes=m)).isoformat()},0,0,0" for m in range(600)]
    weather = tmp_path / "weather.csv"
    weather.write_text("\n".join(["time,ghi,dni,dhi", *lines]))
    with pytest.raises(UserError, match="it runs from"):
        day(tmp_path / "out", "2022-10-14", weather, "flat")
    assert not (tmp_path / "out").exists()


def test_ctrl_c_leaves_complete_tables_of_what_was_simulated_until_then(tmp_path):
    def interrupt(share):
        if share > 0.3:
            signal.raise_signal(signal.SIGINT)

    settings = Settings.model_validate({"cube": {"scan_every_s": 10}, "safety": {"scan_stale_s": 20.0}})
    start = datetime(2022, 10, 14, 9, tzinfo=UTC)
    summary = simulate(settings, start, 0.04, tmp_path / "out", "csv", interrupt)
    assert start.timestamp() + 1000.0 < summary.interrupted_utc_s < start.timestamp() + 3000.0
    scans = rows(tmp_path / "out" / "scans.csv")
    assert len(scans) == summary.scans > 50
    assert 0.0 <= summary.interrupted_utc_s - utc_s(scans[-1]) < 30.0
    assert sum(summary.mode_s.values()) == pytest.approx(summary.interrupted_utc_s - start.timestamp())
    assert not list((tmp_path / "out").glob("*.part"))
