"""What the plane of a simulated tracker received, and where it faces in pvlib's terms."""

import tracemalloc
from datetime import UTC, datetime
from typing import get_args

import numpy as np
import pandas as pd
import pytest

from daemon.base.records import Event, Mode, ModeChange, Pose
from daemon.config.settings import Settings
from daemon.rigs.simulated import build_weather
from daemon.store.tables import TableWriter
from daemon.studies.simulated_day import SIMULATED_COLUMNS, Poses, with_plane_orientation
from solar.ephemeris import DAY_S, sun_direction
from solar.frames import Limits, angles_within
from solar.skies.sky import SkyModel

NOON = datetime(2022, 6, 14, 12, tzinfo=UTC).timestamp()
BEGIN, END = NOON - 0.5 * DAY_S, NOON + 0.5 * DAY_S


@pytest.mark.parametrize(
    ("a_deg", "b_deg", "latitude_deg", "tilt", "azimuth"),
    [(0.0, 90.0, 48.0, 0.0, None), (0.0, 30.0, 48.0, 60.0, 180.0), (0.0, 30.0, -33.0, 60.0, 0.0)],
)
def test_a_pose_gets_the_tilt_and_the_azimuth_of_its_plane(a_deg, b_deg, latitude_deg, tilt, azimuth):
    found = with_plane_orientation(Pose(NOON, 0.0, a_deg, b_deg, False, "roof"), latitude_deg)
    assert found.surface_tilt == pytest.approx(tilt)
    if azimuth is not None:
        assert np.cos(np.radians(found.surface_azimuth - azimuth)) == pytest.approx(1.0)
    assert (found.time_utc_s, found.a_deg, found.b_deg, found.tracker) == (NOON, a_deg, b_deg, "roof")
    west = with_plane_orientation(Pose(NOON, 0.0, 40.0, 60.0, False), 48.0)
    assert 180.0 < west.surface_azimuth < 270.0


@pytest.mark.parametrize("form", ["csv", "parquet"])
def test_every_row_of_every_table_says_that_it_is_simulated(tmp_path, form):
    records = [
        with_plane_orientation(Pose(NOON, 0.0, -0.0, 90.0, False, "roof"), 48.0),
        Event(time_utc_s=NOON, time_monotonic_s=0.0, subject="clock", text="set", tracker="roof"),
        ModeChange(
            time_utc_s=NOON, time_monotonic_s=0.0, before=Mode.STARTING, after=Mode.NIGHT, why="dark", tracker="roof"
        ),
    ]
    with TableWriter(tmp_path, form, SIMULATED_COLUMNS) as tables:
        for record in records:
            tables.write(record)
    for name, _ in SIMULATED_COLUMNS.values():
        path = tmp_path / f"{name}.{form}"
        table = pd.read_csv(path) if form == "csv" else pd.read_parquet(path)
        assert "simulated" in table, name
        assert table["simulated"].all(), name
    if form == "csv":
        assert "-0.0" not in (tmp_path / "poses.csv").read_text()


def received(poses, end=END, sky="haydavies"):
    settings = Settings.model_validate({"simulation": {"weather": "clear", "sky": sky}})
    weather, _ = build_weather(settings, BEGIN, end)
    stood = Poses()
    for utc_s, (a_deg, b_deg) in poses:
        stood.note(Pose(utc_s, 0.0, float(a_deg), float(b_deg), False, "tracker"))
    (found,) = stood.insolation(settings, weather, BEGIN, end)
    return found, weather


def test_20000_poses_of_a_resting_tracker_take_less_than_100_kb_of_memory():
    stood = Poses()
    tracemalloc.start()
    try:
        for number in range(20_000):
            stood.note(Pose(BEGIN + 5.0 * number, 0.0, 0.0, 90.0, False, "tracker"))
        assert tracemalloc.get_traced_memory()[0] < 100_000
    finally:
        tracemalloc.stop()


def test_a_flat_plane_receives_the_global_horizontal_irradiation():
    found, weather = received([(BEGIN, (0.0, 90.0))])
    utc_s = np.arange(BEGIN, END, 60.0)
    ghi = float(weather.at(utc_s).ghi_w_m2.sum()) * 60.0 / 3.6e6
    assert found.received_kwh_m2 == pytest.approx(ghi, rel=2e-3)
    assert (found.tracker, found.law) == ("tracker", "mu-prime")
    assert found.gain_pct < -15.0


def test_a_tracker_that_follows_the_sun_receives_what_chronometric_does():
    utc_s = np.arange(BEGIN, END, 60.0)
    angles = np.transpose(angles_within(sun_direction(utc_s, *Settings().site.place()), Limits()))
    found, _ = received(list(zip(utc_s.tolist(), angles.tolist(), strict=True)))
    assert found.gain_pct == pytest.approx(0.0, abs=0.02)
    half, _ = received([pose for pose in zip(utc_s.tolist(), angles.tolist(), strict=True) if pose[0] >= NOON])
    assert half.chronometric_kwh_m2 == pytest.approx(0.5 * found.chronometric_kwh_m2, rel=0.05)
    assert half.gain_pct == pytest.approx(0.0, abs=0.02), "time without a pose counts in neither"


@pytest.mark.parametrize("sky", get_args(SkyModel))
def test_a_span_without_sun_has_received_nothing(sky):
    found, _ = received([(BEGIN, (0.0, 90.0))], BEGIN + 900.0, sky)
    assert (found.received_kwh_m2, found.chronometric_kwh_m2) == (0.0, 0.0)
    assert np.isnan(found.gain_pct)
