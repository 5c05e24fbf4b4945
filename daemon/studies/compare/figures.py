"""The paper's figures 3, 4, 11, 12 and 13, drawn from measurements of two trackers."""

from datetime import UTC, datetime
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.dates import DateFormatter
from matplotlib.figure import Figure
from numpy.typing import NDArray

from daemon.studies.compare.fit import Fit
from daemon.studies.compare.gains import corrected_power
from daemon.studies.compare.pairs import Pairs, TrackerSeries
from daemon.studies.picture_file import save_picture
from solar.compare import ChainBias, longest_gap_s
from solar.ephemeris import Site, sun_position
from solar.frames import Array, azimuth_from_direction, equator_azimuth_deg, normal_from_angles

# Okabe & Ito's colours, which the colour-blind can tell apart.
_CUBE, _CHRONO, _SUN, _SKY = "#D55E00", "#0072B2", "#E69F00", "0.55"
# It tells curves apart where all is printed in grey.
_CHRONO_LINE = (0, (4.0, 1.5))
_SIZE = (9.0, 4.6)
_MOST_POINTS = 4000
# A plane this near to horizontal has no clear azimuth.
_FLAT_DEG = 2.0


def curve_figure(voltage_v: Array, current_a: Array, title: str) -> Figure:
    """Draw I(V) and P(V) of one curve with its maximum power point, as Figure 3."""
    figure = Figure(figsize=(6.4, 4.4), layout="constrained")
    left = figure.subplots()
    right = left.twinx()
    power = voltage_v * current_a
    best = int(np.argmax(power))
    (current,) = left.plot(voltage_v, current_a, "o-", color=_CHRONO, markersize=3)
    (watts,) = right.plot(voltage_v, power, "x--", color=_CUBE, markersize=4)
    right.plot(voltage_v[best], power[best], "o", color="black", markersize=6, fillstyle="none")
    right.annotate(
        f"Pmpp {power[best]:.1f} W at {voltage_v[best]:.1f} V",
        (voltage_v[best], power[best]),
        (0.62, 0.1),
        textcoords="axes fraction",
        ha="center",
        arrowprops={"arrowstyle": "-", "linewidth": 0.6},
    )
    left.set(xlabel="voltage [V]", ylabel="current [A]", title=title)
    right.set_ylabel("power [W]")
    for axes in (left, right):
        axes.set_ylim(bottom=0.0)
    left.set_xlim(left=0.0)
    for line in (*left.lines, *right.lines):
        line.set_clip_on(False)
    figure.legend([current, watts], ["I(V)", "P(V)"], frameon=False, loc="outside lower center", ncols=2)
    return figure


def bias_figure(flat: Pairs, found: Fit) -> Figure:
    """Draw one chain against the other while both lay flat, before and after correction, as Figure 4."""
    figure = Figure(figsize=(9.0, 5.2), layout="constrained")
    before, after = figure.subplots(1, 2, sharex=True, sharey=True)
    some = np.unique(np.linspace(0, flat.utc_s.size - 1, _MOST_POINTS).astype(int))
    reference = flat.chrono.pmpp_w[some]
    top = 1.05 * float(max(flat.chrono.pmpp_w.max(), flat.cube.pmpp_w.max()))
    cube, chrono = flat.names
    panels = (
        (before, flat.cube.pmpp_w[some], found.before, "uncorrected"),
        (after, found.bias.corrected(flat.cube.pmpp_w[some]), found.after, "corrected"),
    )
    for axes, power, how, what in panels:
        axes.plot(reference, power, ".", color=_CUBE, markersize=2, alpha=0.4, rasterized=True)
        axes.plot([0.0, top], [0.0, top], color="black", linewidth=0.8)
        axes.set(xlabel=f"Pmpp of {chrono} [W]", ylabel=f"Pmpp of {cube} [W]", xlim=(0.0, top), ylim=(0.0, top))
        axes.set_title(f"{what}: rMBE {how.rmbe_percent:+z.2f} %, rMAE {how.rmae_percent:.2f} %", fontsize=10)
        axes.set_aspect("equal")
    return figure


def power_figure(day: Pairs, bias: ChainBias | None, title: str) -> Figure:
    """Draw both powers and the diffuse fraction over a day, as Figures 11 and 13."""
    figure = Figure(figsize=_SIZE, layout="constrained")
    left = figure.subplots()
    cube, chrono = day.names
    left.plot(
        *_break_at_gaps(day.utc_s, day.chrono.pmpp_w),
        color=_CHRONO,
        linewidth=0.9,
        linestyle=_CHRONO_LINE,
        label=chrono,
    )
    left.plot(*_break_at_gaps(day.utc_s, corrected_power(day, bias)), color=_CUBE, linewidth=0.9, label=cube)
    left.set(ylabel="Pmpp [W]", title=title)
    left.set_ylim(bottom=0.0)
    if np.isfinite(day.diffuse_fraction).any():
        right = left.twinx()
        fraction = _break_at_gaps(day.utc_s, day.diffuse_fraction)
        right.plot(*fraction, color=_SKY, linewidth=0.8, linestyle="-.", label="diffuse fraction")
        right.set(ylabel="diffuse fraction [-]", ylim=(0.0, 1.05))
    _label_time_axis(left, day.utc_s)
    figure.legend(frameon=False, loc="outside lower center", ncols=3)
    return figure


def movement_figure(day: Pairs, site: Site, title: str) -> Figure:
    """Draw inclination and azimuth of both trackers with the sun's zenith angle and azimuth, as Figure 12."""
    figure = Figure(figsize=(9.0, 7.0), layout="constrained")
    upper, lower = figure.subplots(2, 1, sharex=True)
    sun = sun_position(day.utc_s, *site)
    path = (90.0 - sun.elevation_deg, _about_equator(sun.azimuth_deg, site))
    for axes, angle in zip((upper, lower), path, strict=True):
        axes.plot(*_break_at_gaps(day.utc_s, angle), color=_SUN, linewidth=1.6, linestyle=":", label="sun")
    sides = zip(day.names, (day.cube, day.chrono), (_CUBE, _CHRONO), ("-", _CHRONO_LINE), strict=True)
    for name, side, colour, line in sides:
        for axes, angle in zip((upper, lower), _inclination_and_azimuth(side, site), strict=True):
            axes.plot(*_break_at_gaps(day.utc_s, angle), color=colour, linewidth=1.0, linestyle=line, label=name)
    upper.set(ylabel="inclination, zenith angle [deg]", ylim=(-3.0, 95.0), title=title)
    lower.set(ylabel="azimuth [deg]" if site.latitude_deg >= 0.0 else "azimuth [deg]\nwest of north below 0")
    lower.set_title(f"no azimuth while a tracker lies flat within {_FLAT_DEG:g} deg", fontsize=9)
    _label_time_axis(lower, day.utc_s)
    figure.legend(*upper.get_legend_handles_labels(), frameon=False, loc="outside lower center", ncols=3)
    return figure


def save(figure: Figure, folder: Path, name: str) -> Path:
    """Write the figure as PNG and SVG and return the PNG's path; raises `UserError`."""
    path = folder / f"{name}.png"
    save_picture(figure, path, dpi=110)
    # Fix the layout that has been found: to find it again takes longer than to draw.
    figure.set_layout_engine("none")
    save_picture(figure, folder / f"{name}.svg")
    return path


def _inclination_and_azimuth(side: TrackerSeries, site: Site) -> tuple[Array, Array]:
    azimuth, elevation = azimuth_from_direction(normal_from_angles(side.a_deg, side.b_deg), site.latitude_deg)
    return 90.0 - elevation, np.where(90.0 - elevation > _FLAT_DEG, _about_equator(azimuth, site), np.nan)


def _about_equator(azimuth_deg: Array, site: Site) -> Array:
    """Return azimuths within half a turn of the equator's, NaN where the next one is a jump across the pole."""
    middle_deg = equator_azimuth_deg(site.latitude_deg)
    about = (azimuth_deg - middle_deg + 180.0) % 360.0 - 180.0 + middle_deg
    leaps = np.abs(np.diff(about, append=about[-1:])) > 180.0
    return np.where(leaps, np.nan, about)


def _break_at_gaps(utc_s: Array, values: Array) -> tuple[NDArray[np.datetime64], Array]:
    """Return a line with NaN in each gap over which no energy is counted, so that no line is drawn across it."""
    behind = np.flatnonzero(np.diff(utc_s) > longest_gap_s(utc_s)) + 1
    time = (np.insert(utc_s, behind, utc_s[behind]) * 1e3).astype("datetime64[ms]")
    return time, np.insert(values, behind, np.nan)


def _label_time_axis(axes: Axes, utc_s: Array) -> None:
    axes.xaxis.set_major_formatter(DateFormatter("%H:%M"))  # type: ignore[no-untyped-call]  # matplotlib has no type there
    first, last = (datetime.fromtimestamp(at, UTC) for at in utc_s[[0, -1]].tolist())
    # A day of the site may consist of parts of two days in UTC.
    begun = "" if first.date() == last.date() else f"{first:%d %B} to "
    axes.set_xlabel(f"{begun}{last:%d %B %Y}, UTC")
