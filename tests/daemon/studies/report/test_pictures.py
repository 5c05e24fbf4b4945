"""What the pictures of a report draw, and what they leave out."""

import math
import time
from dataclasses import replace
from datetime import UTC, datetime
from zoneinfo import ZoneInfo

import numpy as np
import pandas as pd
import pytest
from matplotlib.dates import date2num
from matplotlib.image import imread

from daemon.base.errors import UserError
from daemon.studies.report.material import split_by_tracker
from daemon.studies.report.motion import motion_of
from daemon.studies.report.pictures import PICTURES, PictureData
from daemon.studies.report.plot import draw
from daemon.studies.report.span import ReportSpan
from daemon.studies.report.yields import light_of
from solar.ephemeris import DAY_S, Site

T0 = 1665705600.0
"""2022-10-14T00:00Z."""
OUTAGE = (T0 + 10 * 3600.0, T0 + 14 * 3600.0)
EVERY_S = 8.0


def table(utc_s, **columns):
    index = pd.to_datetime(np.asarray(utc_s, dtype=np.float64), unit="s", utc=True).rename("time")
    return pd.DataFrame(columns, index=index)


def material(days=1):
    """A day from 6:00 to 18:00, with four hours unrecorded, and with more scans than a picture has points."""
    utc_s = np.arange(T0 + 6 * 3600.0, T0 + 18 * 3600.0, EVERY_S)
    utc_s = utc_s[(utc_s < OUTAGE[0]) | (utc_s >= OUTAGE[1])]
    moves = np.array([T0 + 7 * 3600.0, T0 + 15 * 3600.0])
    faces = {f"{face}_w_m2": 300.0 + number * 50.0 for number, face in enumerate(("east", "south", "west", "zenith"))}
    qualities = {name.replace("_w_m2", "_quality"): "ok" for name in faces}
    tables = {
        "scans": table(utc_s, **faces, **qualities),
        "poses": table(utc_s, a_deg=-10.0, b_deg=60.0, moving=False, wind_m_s=[4.0, math.nan] * (utc_s.size // 2)),
        "moves": table(
            moves, from_a_deg=0.0, from_b_deg=90.0, target_a_deg=-10.0, target_b_deg=60.0, end_a_deg=-10.0,
            end_b_deg=60.0, outcome="arrived",
        ),
        "curves": table(utc_s, quality="ok", pmpp_w=80.0),
        "decisions": table(moves, mode="tracking", albedo_est=math.nan),
        "modes": table(utc_s[:1], before="starting", after="tracking", why="light"),
        "events": table([], subject=[], text=[]),
    }  # fmt: skip
    (found,) = split_by_tracker(
        tables, ReportSpan(T0, T0 + days * DAY_S, "day"), Site(48.7, 0.0, 0.0), "here", "tables"
    )
    return found


def crossing(figure):
    """Return the labels of the lines that go on through the outage."""
    first, last = (date2num(np.datetime64(int(at), "s")) for at in OUTAGE)
    found = []
    for line in (line for axes in figure.axes for line in axes.lines):
        x = np.asarray(line.convert_xunits(line.get_xdata(orig=True)), dtype=np.float64)
        joined = np.isfinite(line.get_ydata()[:-1]) & np.isfinite(line.get_ydata()[1:])
        middle = (first + last) / 2.0
        if np.any(joined & (x[:-1] < middle) & (x[1:] > middle)):
            found.append(line.get_label())
    return found


@pytest.fixture(scope="module")
def drawing():
    day = material()
    return PictureData(day, light_of(day), motion_of(day), None)


@pytest.mark.parametrize("name", ["light", "angles", "received", "wind", "power"])
def test_no_line_is_drawn_where_nothing_was_recorded(drawing, name):
    figure = PICTURES[name].draw(drawing)
    drawn = [line for axes in figure.axes for line in axes.lines if np.isfinite(line.get_ydata()).sum() > 2]
    assert drawn
    assert [label for label in crossing(figure) if not label.startswith("sun")] == []


def test_the_line_of_the_set_point_ends_with_the_last_record(drawing):
    (line,) = (line for line in PICTURES["angles"].draw(drawing).axes[0].lines if line.get_label() == "set")
    x = np.asarray(line.convert_xunits(line.get_xdata(orig=True)), dtype=np.float64)
    shown = x[np.isfinite(line.get_ydata())]
    assert shown[0] == date2num(np.datetime64(int(T0 + 7 * 3600), "s"))
    last = np.flatnonzero(np.isnan(line.get_ydata()))[-1]
    assert x[last] == pytest.approx(date2num(np.datetime64(int(T0 + 18 * 3600 - EVERY_S), "s")), abs=1e-6)


@pytest.mark.parametrize("moved", [True, False])
def test_before_the_first_move_the_set_point_is_the_target_of_the_first_decision(moved):
    found = material()
    decided = T0 + np.array([6.5, 7.0, 15.0]) * 3600.0
    found.tables["decisions"] = table(decided, mode="tracking", target_a_deg=[-12.0, -10.0, -10.0], target_b_deg=60.0)
    if not moved:
        found.tables["moves"] = found.tables["moves"][:0]
    motion = motion_of(found)
    # From 6:30 to sunset at 17:11. The pose of 9:59 holds for a quarter of an hour; the next come from 14:00 on.
    known_min = 225 + 191
    assert motion.deviation_deg == pytest.approx(2.0 * 30 / known_min if moved else 2.0, rel=0.01)
    assert motion.available_pct == pytest.approx(100.0 * known_min / 641, rel=0.01)
    figure = PICTURES["angles"].draw(PictureData(found, light_of(found), motion, None))
    (line,) = (line for line in figure.axes[0].lines if line.get_label() == "set")
    first = np.flatnonzero(np.isfinite(line.get_ydata()))[0]
    assert line.get_ydata()[first] == -12.0
    assert line.convert_xunits(line.get_xdata(orig=True))[first] == date2num(np.datetime64(int(decided[0]), "s"))


def test_a_picture_in_a_file_has_a_white_ground(tmp_path):
    draw(material(), ["wind"], [tmp_path / "wind.png"], None)
    pixels = imread(tmp_path / "wind.png")
    assert pixels[..., 3].min() == 1.0
    assert pixels[0, 0].tolist() == [1.0, 1.0, 1.0, 1.0]


def test_a_picture_file_stays_as_it_was_when_the_new_one_does_not_fit_on_the_disk(tmp_path):
    path = tmp_path / "wind.png"
    path.write_text("of yesterday")
    (tmp_path / ".wind.png.part").symlink_to("/dev/full")
    with pytest.raises(UserError, match=r"wind\.png cannot be written: No space left on device"):
        draw(material(), ["wind"], [path], None)
    assert path.read_text() == "of yesterday"


@pytest.mark.parametrize(
    ("days", "words"), [(1, "14 October 2022, UTC; below it local time, CEST"), (2, "2022, UTC"), (30, "2022, UTC")]
)
def test_the_axis_of_time_names_the_date_and_the_zones_of_its_times(tmp_path, days, words):
    found = material(days)
    figure = PICTURES["wind"].draw(PictureData(found, light_of(found), motion_of(found), ZoneInfo("Europe/Paris")))
    assert figure.axes[-1].get_xlabel() == words


@pytest.mark.parametrize(
    ("day", "zone", "words"),
    [
        ("2022-11-06", "America/New_York", "; below it local time, EDT, then EST"),
        ("2022-10-30", "Europe/London", "; below it local time, BST, then GMT"),
        ("2022-10-31", "Europe/London", ""),
    ],
)
def test_on_the_day_on_which_the_clocks_change_both_local_times_are_named(day, zone, words):
    start_s = datetime.fromisoformat(f"{day}T00:00Z").timestamp()
    found = replace(material(), span=ReportSpan(start_s, start_s + 86400.0, "part"))
    axes = PICTURES["wind"].draw(PictureData(found, light_of(found), motion_of(found), ZoneInfo(zone))).axes[-1]
    assert axes.get_xlabel().partition(", UTC")[2] == words


@pytest.mark.parametrize(
    ("first", "last", "years"),
    [
        ("2022-12-30T12:00", "2023-01-02T12:00", "2022 to 2023"),
        # Days of a site where midnight is some minutes before midnight UTC.
        ("2022-12-31T23:51", "2023-01-02T23:51", "2023"),
        ("2022-12-29T23:51", "2022-12-31T23:51", "2022"),
    ],
)
def test_where_the_ticks_are_days_the_axis_names_their_years(first, last, years):
    start_s, end_s = (datetime.fromisoformat(f"{at}Z").timestamp() for at in (first, last))
    found = replace(material(), span=ReportSpan(start_s, end_s, "part"))
    axes = PICTURES["wind"].draw(PictureData(found, light_of(found), motion_of(found), UTC)).axes[-1]
    assert axes.get_xlabel() == f"{years}, UTC"


@pytest.mark.parametrize("minutes", [7, 15, 50, 110, 160, 400, 660, 1440])
def test_the_axis_of_time_of_a_short_span_has_ticks_to_read_it_by(minutes):
    begins_s = T0 + 6.17 * 3600.0
    found = replace(material(), span=ReportSpan(begins_s, begins_s + 60.0 * minutes, "part"))
    axes = PICTURES["wind"].draw(PictureData(found, light_of(found), motion_of(found), UTC)).axes[-1]
    low, high = axes.get_xlim()
    ticks = axes.get_xticks()
    inside = (low <= ticks) & (ticks <= high)
    assert 3 <= inside.sum() <= 8
    texts = axes.xaxis.get_major_formatter().format_ticks(ticks[inside])
    assert len(set(texts)) == len(texts)


def test_on_a_machine_with_an_invalid_time_zone_the_axis_of_time_is_in_utc(monkeypatch):
    monkeypatch.setenv("TZ", "UTC+25")
    time.tzset()
    try:
        found = material()
        figure = PICTURES["wind"].draw(PictureData(found, light_of(found), motion_of(found), None))
        figure.draw_without_rendering()
    finally:
        monkeypatch.undo()
        time.tzset()
    assert figure.axes[-1].get_xlabel() == "14 October 2022, UTC"
    assert [tick.get_text() for tick in figure.axes[-1].get_xticklabels()][1] == "03:00"
