"""Holes in measured weather: an hour is bridged, a night is dark, and longer holes by day are missing data."""

import csv
import math
from datetime import UTC, datetime

import numpy as np
import pytest

from daemon.base.clock import LoopClock
from daemon.base.errors import UserError
from daemon.config.settings import Settings
from daemon.rigs.measured import gap_note, missing_by_day, weather_notes
from daemon.rigs.simulated import build_simulated_pair, build_weather
from daemon.rigs.simulated_cube import build_cube_cores
from daemon.studies.compare.side_by_side import MODULES, run_side_by_side, two_trackers
from daemon.studies.simulate import simulate
from sim_drivers.scene import Scene
from sim_drivers.weather_files import load_weather
from solar.ephemeris import DAY_S, Site

SITE = Site(48.7176, 2.209, 156.0)
MIDNIGHT = datetime(2022, 6, 14, tzinfo=UTC).timestamp()


@pytest.fixture
def gaps(tmp_path):
    """A day without its night, with a hole of 55 min, one of 77 min, and an impossible value."""
    path, lines = tmp_path / "gaps.csv", ["time,ghi,dni,dhi"]
    for minute in range(3 * 60, 21 * 60):
        if not (7 * 60 < minute < 7 * 60 + 55 or 11 * 60 < minute < 12 * 60 + 17):
            dhi = 13949 if minute == 9 * 60 else 100
            lines.append(f"2022-06-14T{minute // 60:02d}:{minute % 60:02d}Z,500,450,{dhi}")
    path.write_text("\n".join(lines))
    return path


def settings_under(path):
    return Settings.model_validate(
        {
            "simulation": {"weather": path},
            "cube": {"scan_every_s": 20},
            "safety": {"scan_stale_s": 40.0},
            "law": {"driver": "flat"},
        }
    )


def test_only_daylight_in_long_gaps_is_missing(gaps):
    weather = load_weather(gaps)
    minutes = MIDNIGHT + np.arange(0.0, DAY_S, 60.0)
    missing = (missing_by_day(weather, SITE, minutes) - MIDNIGHT) / 3600.0
    assert (missing.min(), missing.max()) == (11.0 + 1 / 60, 12.0 + 16 / 60)
    assert missing.size == 76


def test_missing_daylight_and_impossible_values_in_the_weather_are_counted_and_reported(gaps):
    weather = load_weather(gaps)
    impossible, gap, *_ = weather_notes(weather, SITE)
    assert "has 1 impossible value, taken as missing; first in line 308: dhi 13949" in impossible
    assert "1.3 h of daylight are missing, the first after 2022-06-14 11:00Z, until 2022-06-14 12:17Z" in gap
    assert gap_note(weather, SITE, MIDNIGHT + 13 * 3600, MIDNIGHT + DAY_S) is None


def test_a_day_with_gaps_is_simulated_and_the_cube_reads_nothing_in_them(gaps, tmp_path):
    start = datetime(2022, 6, 14, 10, 50, tzinfo=UTC)
    summary = simulate(settings_under(gaps), start, 1.7 / 24, tmp_path / "out", "csv", lambda _share: None)
    assert "1.3 h of daylight are missing" in summary.warnings[0]
    with (tmp_path / "out" / "scans.csv").open(newline="") as file:
        times = [datetime.fromisoformat(row["time"]).timestamp() - MIDNIGHT for row in csv.DictReader(file)]
    steps = np.diff(times)
    (longest,) = np.flatnonzero(steps > 300.0)
    assert (times[longest] / 3600, times[longest + 1] / 3600) == pytest.approx((11.0, 12.3), abs=0.05)
    assert 0.9 * 3600 < summary.mode_s["fallback"] < 1.5 * 3600


def test_a_comparison_measures_nothing_while_the_weather_is_missing(gaps):
    settings = settings_under(gaps)
    begin_s = MIDNIGHT + 10.9 * 3600
    weather, told = build_weather(settings, begin_s, begin_s + 1.6 * 3600, with_gaps=True)
    assert "1.3 h of daylight are missing" in told
    powers = run_side_by_side(
        settings,
        two_trackers("flat", "flat"),
        lambda clock: build_simulated_pair(settings, clock, weather, MODULES),
        begin_s,
        1.6 / 24,
        lambda _name, _record: None,
        lambda _share: None,
    )
    hours = np.unique([(power.time - MIDNIGHT) / 3600 for power in powers])
    (longest,) = np.flatnonzero(np.diff(hours) > 0.1)
    assert (hours[longest], hours[longest + 1]) == pytest.approx((11.0, 12.3), abs=0.05)
    assert hours[-1] > 12.45


@pytest.mark.parametrize("bridged", [True, False])
def test_the_cube_voltage_on_the_bench_overflows_in_a_long_weather_gap_and_not_in_a_bridged_one(gaps, bridged):
    at_s = MIDNIGHT + (7.5 if bridged else 11.5) * 3600
    weather = load_weather(gaps)
    clock = LoopClock(lambda: 0.0, at_s)
    switch, _ = build_cube_cores(settings_under(gaps), clock, Scene(SITE, weather), weather)
    for face in range(4):
        switch.write(0b1000 | face, 0.0)
        assert np.isfinite(switch.output_voltage(1.0)) == bridged, face


def test_a_daytime_outside_the_weather_file_is_refused_and_one_in_its_gap_unless_gaps_are_allowed(gaps):
    for begin_h, end_h in ((1.0, 10.0), (12.5, 21.5)):
        build_weather(settings_under(gaps), MIDNIGHT + begin_h * 3600, MIDNIGHT + end_h * 3600, with_gaps=True)
    for end_s in (math.inf, 1e12):
        with pytest.raises(UserError, match="it runs from"):
            build_weather(settings_under(gaps), MIDNIGHT + 3600, MIDNIGHT + end_s, with_gaps=True)
    with pytest.raises(UserError, match="it runs from"):
        build_weather(settings_under(gaps), MIDNIGHT + DAY_S, MIDNIGHT + 1.5 * DAY_S, with_gaps=True)
    with pytest.raises(UserError, match="it has a gap from"):
        build_weather(settings_under(gaps), MIDNIGHT + 10 * 3600, MIDNIGHT + 13 * 3600)


@pytest.mark.parametrize("hours", [12, 24, 24 * 365])
def test_weather_that_has_ended_is_refused_by_night_too(gaps, hours):
    now_s = MIDNIGHT + DAY_S + hours * 3600
    with pytest.raises(UserError, match=r"has no weather for 202.*; add --start 2022-06-14T03:00:00Z, or another"):
        build_weather(settings_under(gaps), now_s, now_s, with_gaps=True)


def test_weather_that_does_not_reach_to_now_is_refused_with_a_start_that_does(heliocube, tmp_path):
    lines = [f"2022-10-12T{hour:02d}:00:00.5Z,300,400,100" for hour in (8, 9, 10)]
    (tmp_path / "weather.csv").write_text("\n".join(["time,ghi,dni,dhi", *lines]) + "\n")
    asked = ("--weather", tmp_path / "weather.csv", "--site", "48.7,2.2")
    code, _, told = heliocube("run", *asked, "--speed", 1)
    assert (code, told.count("\n")) == (2, 1)
    start = told.partition("add --start ")[2].partition(",")[0]
    assert start == "2022-10-12T08:00:01Z"
    assert heliocube("simulate", *asked, "--start", start, "--days", 0.01, "--out", tmp_path / "out")[0] == 0
