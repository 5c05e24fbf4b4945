"""Equation (16) on measured powers: night readings and the site's hemisphere must not change it."""

import math
from dataclasses import replace

import numpy as np
import pytest

from daemon.studies.compare.figures import movement_figure, power_figure
from daemon.studies.compare.gains import as_text, gains
from daemon.studies.compare.measurements import Measurement
from daemon.studies.compare.pairs import frame_of, pair
from daemon.studies.compare.report import gain_table
from solar.compare import ChainBias
from solar.ephemeris import DAY_S, Site, sun_direction, sun_position
from solar.frames import Limits, angles_within

T0 = 1665705600.0
"""2022-10-14T00:00Z."""
GREENWICH, SYDNEY, QUITO = Site(51.5, 0.0, 0.0), Site(-33.9, 151.2, 0.0), Site(0.0, -78.5, 0.0)
BIAS = ChainBias(0.0, 1.0, 0.0, 1.0, 300.0)
NAN = math.nan


def measured(utc_s, power_w, a_deg=NAN, b_deg=NAN):
    """Return the pairs of two trackers that gave the same power in the same pose."""
    columns = np.broadcast_arrays(utc_s, power_w, a_deg, b_deg)
    rows = [
        Measurement(time, name, power, NAN, a, b, NAN, NAN, NAN)
        for time, power, a, b in np.stack(columns, axis=-1).tolist()
        for name in ("one", "other")
    ]
    return pair(frame_of(rows), ("one", "other"))


def day_of_power(offset_w):
    utc_s = T0 + np.arange(0.0, DAY_S, 60.0)
    hours = (utc_s - T0) / 3600.0
    return utc_s, np.where((hours > 6) & (hours < 18), 300.0 * np.sin(np.pi * (hours - 6) / 12), 0.0) + offset_w


@pytest.mark.parametrize("bias", [None, BIAS])
@pytest.mark.parametrize("offset_w", [0.0, -1.0, -5.0])
def test_two_wattmeters_that_read_below_zero_at_night_make_no_gain(offset_w, bias):
    (whole,) = gains(measured(*day_of_power(offset_w)), bias, [], GREENWICH)
    assert (whole.gain_pct, whole.uncorrected_pct) == (0.0, 0.0)
    assert bias is None or 0.0 <= whole.extrapolated_pct < 0.1


def longest_step_deg(line):
    values = np.asarray(line.get_ydata(), dtype=np.float64)
    return float(np.nanmax(np.abs(np.diff(values))))


@pytest.mark.parametrize(
    ("site", "begins_s", "unit"),
    [
        (GREENWICH, T0, "azimuth [deg]"),
        (SYDNEY, T0, "azimuth [deg]\nwest of north below 0"),
        # In June the sun passes north of the equator.
        (QUITO, T0 - 120 * DAY_S, "azimuth [deg]"),
    ],
)
def test_no_line_of_an_azimuth_runs_across_the_picture_where_it_passes_north(site, begins_s, unit):
    utc_s = begins_s - site.longitude_deg * 240.0 + np.arange(0.0, DAY_S, 60.0)
    sun = sun_direction(utc_s, *site)
    utc_s, sun = utc_s[sun[:, 2] > 0.0], sun[sun[:, 2] > 0.0]
    pairs = measured(utc_s, 100.0, *angles_within(sun, Limits()))
    figure = movement_figure(pairs, site, "")
    _, lower = figure.axes
    assert all(longest_step_deg(line) < 180.0 for line in lower.lines)
    assert lower.get_ylabel() == unit
    drawn = np.asarray(lower.lines[0].get_ydata())
    known = np.isfinite(drawn)
    assert known.sum() >= drawn.size - 1
    assert (drawn[known] % 360.0) == pytest.approx(sun_position(utc_s, *site).azimuth_deg[known])


@pytest.mark.parametrize(("site", "label"), [
    (GREENWICH, "14 October 2022, UTC"), (SYDNEY, "13 October to 14 October 2022, UTC"),
])  # fmt: skip
def test_gains_and_figures_name_the_utc_days_that_a_day_of_the_site_covers(site, label):
    utc_s = T0 - site.longitude_deg * 240.0 + np.arange(6 * 3600.0, 18 * 3600.0, 60.0)
    pairs = measured(utc_s, 100.0)
    rows = gains(pairs, None, [], site)
    assert [row.date for row in rows] == ["2022-10-14"]
    assert "from UTC  to UTC" in as_text(rows, ("one", "other"))
    assert "irradiation" not in as_text(rows, ("one", "other")), "nobody has measured it"
    known = [replace(rows[0], irradiation_pct=2.0), *rows]
    assert "irradiation/%" in as_text(known, ("one", "other"))
    assert gain_table(rows, ("one", "other")).columns[2:4] == ("from UTC", "to UTC")
    assert power_figure(pairs, None, "").axes[0].get_xlabel() == label


def test_no_line_of_a_figure_of_powers_or_movements_crosses_a_gap_in_the_measurements():
    utc_s = T0 + np.concatenate([np.arange(8.0, 9.0, 1 / 720), np.arange(12.0, 13.0, 1 / 720)]) * 3600.0
    pairs = measured(
        utc_s, np.linspace(50.0, 250.0, utc_s.size), *angles_within(sun_direction(utc_s, *GREENWICH), Limits())
    )
    figures = (power_figure(pairs, None, ""), movement_figure(pairs, GREENWICH, ""))
    lines = [line for figure in figures for axes in figure.axes for line in axes.lines]
    assert len(lines) == 2 + 3 + 3
    for line in lines:
        at, values = (np.asarray(column) for column in line.get_data(orig=True))
        drawn = np.isfinite(np.asarray(values, dtype=np.float64))
        across = drawn[1:] & drawn[:-1] & (np.diff(at) > np.timedelta64(60, "s"))
        assert drawn.sum() == utc_s.size
        assert not across.any()
