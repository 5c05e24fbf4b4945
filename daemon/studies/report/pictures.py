"""The pictures of a report and of `heliocube plot`, with units on every axis."""

from collections.abc import Callable, Sequence
from datetime import UTC, datetime, tzinfo
from typing import Any, NamedTuple

import numpy as np
from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.dates import AutoDateLocator, DayLocator, HourLocator, MinuteLocator, RRuleLocator, num2date
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, MaxNLocator
from numpy.typing import NDArray

from daemon.base.clock import local_time
from daemon.base.records import FACES
from daemon.studies.report.availability import longest_interval_s
from daemon.studies.report.choices import NAMES
from daemon.studies.report.material import Material
from daemon.studies.report.motion import NOT_RECORDED, SILENT_S, RecordedMotion, set_points_of
from daemon.studies.report.yields import RecordedLight, Yield, latest_values
from daemon.studies.stamp import stamp_simulated
from solar.ephemeris import DAY_S, sun_direction
from solar.frames import Array, angles_within

INK, FAINT, NIGHT = "#15191d", "#b9c0c7", "#3b4a63"
"""Colours of text and lines, of grids, and of the night; the page replaces them by its own."""

# Okabe & Ito's colours, which the colour-blind can tell apart. Each has its own line style, for prints in grey.
BLUE, ORANGE, GREEN, RED, PURPLE, SKY, GREY = (
    "#0072B2", "#E69F00", "#009E73", "#D55E00", "#CC79A7", "#56B4E9", "#7a828a",
)  # fmt: skip
# Sine of 2 deg: with a lower sun the diffuse fraction is a ratio of small numbers, and shows only noise.
_LOWEST_SUN = 0.035
_FACE_STYLES = dict(zip(FACES, ((BLUE, "-"), (RED, "--"), (GREEN, "-."), (INK, ":")), strict=True))
_MODE_STYLES = {
    "tracking": (GREEN, ""),
    "fallback": (ORANGE, "//"),
    "night": (NIGHT, ""),
    "hold": (PURPLE, "xx"),
    "stow": (BLUE, "\\\\"),
    "snow": (SKY, ".."),
    "fault": (RED, "++"),
    "maintenance": (GREY, "--"),
    "starting": ("#d9dde1", ""),
}
_WIDTH_IN = 9.0
_MOST_POINTS = 3000
# Minutes between ticks of the time axis, and the most steps, except for spans of more than a day.
_STEPS_MIN, _MOST_STEPS = (1, 2, 5, 10, 15, 30, 60, 180), 8
_RC: Any = {
    "svg.fonttype": "none",
    "path.simplify_threshold": 1.0,
    "font.family": "sans-serif",
    "font.size": 10.0,
    "axes.edgecolor": INK,
    "axes.labelcolor": INK,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "axes.axisbelow": True,
    "grid.color": FAINT,
    "grid.linewidth": 0.5,
    "text.color": INK,
    "xtick.color": INK,
    "ytick.color": INK,
    "lines.linewidth": 1.2,
    "hatch.linewidth": 0.6,
    "legend.frameon": False,
    "axes.titlesize": 10.0,
    "axes.titlelocation": "left",
}


class PictureKind(NamedTuple):
    """A picture by the name that the command line gives it: what it shows, and how it is drawn."""

    about: str
    draw: Callable[["PictureData"], Figure]


class PictureData(NamedTuple):
    """The data that pictures show."""

    material: Material
    light: RecordedLight
    motion: RecordedMotion
    zone: tzinfo | None


def light_picture(drawing: PictureData) -> Figure:
    """Draw the irradiance on the four faces and the diffuse fraction."""
    with rc_context(_RC):
        figure, (upper, lower) = _panels(2, 4.2, (2.4, 1.0))
        light = drawing.light
        pause_s = longest_interval_s(light.utc_s)
        for face, values in zip(FACES, light.faces.T, strict=True):
            colour, line = _FACE_STYLES[face]
            upper.plot(*_thinned(light.utc_s, values, pause_s), color=colour, linestyle=line, label=face)
        upper.set_ylabel("irradiance [W/m²]")
        fraction = np.where(light.sun[:, 2] > _LOWEST_SUN, light.diffuse_fraction, np.nan)
        lower.plot(*_thinned(light.utc_s, fraction, pause_s), color=GREY)
        lower.set(ylabel="diffuse\nfraction [-]", ylim=(0.0, 1.05))
        _legend(upper, 4)
        return _finish_time_axis(figure, lower, drawing)


def angles_picture(drawing: PictureData) -> Figure:
    """Draw A and B, where they were sent and where they stood, against the sun's own angles."""
    with rc_context(_RC):
        figure, panels = _panels(2, 4.6, (1.0, 1.0))
        material = drawing.material
        sun = _sun_angles(drawing)
        for axes, angle, path in zip(panels, ("a", "b"), sun[1:], strict=True):
            axes.plot(_dates(sun[0]), path, color=ORANGE, linestyle="--", label="sun, within the limits")
            if set_points_of(material, f"{angle}_deg")[0].size:
                axes.step(*_set_points(drawing, f"{angle}_deg"), where="post", color=SKY, linewidth=3.0, label="set")
            poses = material.column("poses", f"{angle}_deg")
            axes.plot(*_thinned(material.times_of("poses"), poses, SILENT_S), color=INK, label="actual")
            axes.margins(y=0.08)
        panels[0].set_ylabel("A [deg]\neast − , west +")
        panels[1].set_ylabel("B [deg]\n90 is flat")
        _legend(panels[0], 3)
        return _finish_time_axis(figure, panels[-1], drawing)


def received_picture(drawing: PictureData) -> Figure:
    """Draw what the three planes received, and what the tracker had gained over chronometric tracking by each time."""
    with rc_context(_RC):
        figure, (upper, lower) = _panels(2, 4.2, (2.0, 1.0))
        light = drawing.light
        actual, chronometric, best = light.received
        pause_s = longest_interval_s(light.utc_s)
        upper.plot(*_thinned(light.utc_s, best, pause_s), color=GREY, linewidth=2.6, alpha=0.6, label="best pose")
        upper.plot(*_thinned(light.utc_s, chronometric, pause_s), color=ORANGE, linestyle="--", label="chronometric")
        upper.plot(*_thinned(light.utc_s, actual, pause_s), color=BLUE, label="actual")
        upper.set_ylabel("estimated irradiance\nin the plane [W/m²]")
        steps = np.append(np.minimum(np.diff(light.utc_s), 60.0), 0.0) / 3600.0
        for plane, style in ((best, {"color": GREY, "linewidth": 2.6, "alpha": 0.6}), (actual, {"color": BLUE})):
            gained = np.cumsum(np.nan_to_num(plane - chronometric) * steps)
            lower.plot(*_thinned(light.utc_s, gained, pause_s), **style)
        lower.set_ylabel("gained over\nchronometric\n[Wh/m²]")
        lower.axhline(0.0, color=INK, linewidth=0.8)
        _legend(upper, 3)
        return _finish_time_axis(figure, lower, drawing)


def motion_picture(drawing: PictureData) -> Figure:
    """Draw the strip of modes with a tick for each move, and the accumulated travel."""
    with rc_context(_RC):
        figure, (strip, travel) = _panels(2, 3.0, (1.0, 1.8))
        material, motion = drawing.material, drawing.motion
        shown: list[str] = []
        for stretch in motion.mode_periods:
            if stretch.mode == NOT_RECORDED or stretch.duration_s < material.span.duration_s / 2000.0:
                continue
            colour, hatch = _MODE_STYLES.get(stretch.mode, (FAINT, "oo"))
            first, last = _dates(np.array([stretch.start_utc_s, stretch.end_utc_s]))
            label = "" if stretch.mode in shown else stretch.mode
            shown.append(stretch.mode)
            strip.axvspan(
                first, last, 0.0, 0.7, facecolor=colour, hatch=hatch, edgecolor="#ffffff", linewidth=0, label=label
            )
        moves = material.times_of("moves")
        strip.eventplot(_dates(moves), lineoffsets=0.87, linelengths=0.2, linewidths=0.8, colors=INK)
        strip.set(yticks=[0.35, 0.87], yticklabels=["mode", "moves"], ylim=(0.0, 1.0))
        strip.grid(visible=False)
        strip.spines["left"].set_visible(False)
        strip.tick_params(left=False)
        for angle, line, colour in (("a", "-", BLUE), ("b", "--", RED)):
            way = np.abs(material.column("moves", f"end_{angle}_deg") - material.column("moves", f"from_{angle}_deg"))
            so_far = np.cumsum(np.nan_to_num(way))
            at = np.concatenate([[material.span.start_utc_s], moves, [material.span.end_utc_s]])
            total = np.concatenate([[0.0], so_far, so_far[-1:] if so_far.size else [0.0]])
            travel.step(_dates(at), total, where="post", color=colour, linestyle=line, label=angle.upper())
        travel.set(ylabel="travel [deg]")
        travel.set_ylim(bottom=0.0)
        travel.legend(loc="upper left")
        _legend(strip, 5)
        return _finish_time_axis(figure, travel, drawing)


def power_picture(drawing: PictureData) -> Figure:
    """Draw the maximum power of the module by its I-V curves."""
    with rc_context(_RC):
        figure, (axes,) = _panels(1, 2.4, (1.0,))
        material = drawing.material
        good = material.tables["curves"]["quality"] == "ok"
        power = np.where(good, material.column("curves", "pmpp_w"), np.nan)
        utc_s = material.times_of("curves")
        axes.plot(*_thinned(utc_s, power, longest_interval_s(utc_s)), color=BLUE)
        axes.set_ylabel("maximum power\nof the module [W]")
        axes.set_ylim(bottom=0.0)
        return _finish_time_axis(figure, axes, drawing)


def wind_picture(drawing: PictureData) -> Figure:
    """Draw the wind, and the wind from which the tracker stows, where that is known."""
    with rc_context(_RC):
        figure, (axes,) = _panels(1, 2.2, (1.0,))
        material = drawing.material
        wind = material.column("poses", "wind_m_s")
        read = np.isfinite(wind)
        axes.plot(
            *_thinned(material.times_of("poses")[read], wind[read], SILENT_S),
            color=BLUE,
            label="strongest since the reading before",
        )
        if material.stow_wind_m_s is not None:
            axes.axhline(material.stow_wind_m_s, color=RED, linestyle="--", label="stows from here on")
        axes.set_ylabel("wind [m/s]")
        axes.set_ylim(bottom=0.0)
        _legend(axes, 2)
        return _finish_time_axis(figure, axes, drawing)


def days_picture(names: Sequence[str], yields: Sequence[Yield], simulated: bool) -> Figure:
    """Draw a bar a day: what the planes received, and the gain over chronometric tracking."""
    with rc_context(_RC):
        figure, (upper, lower) = _panels(2, 4.2, (1.4, 1.0))
        places = np.arange(len(names))
        planes = (
            ("chronometric", [day.chronometric_kwh_m2 for day in yields], ORANGE, "//"),
            ("actual", [day.actual_kwh_m2 for day in yields], BLUE, ""),
            ("best pose", [day.best_kwh_m2 for day in yields], GREY, ".."),
        )
        for number, (label, values, colour, hatch) in enumerate(planes):
            upper.bar(
                places + 0.27 * (number - 1), values, 0.26, color=colour, hatch=hatch, edgecolor="#ffffff", label=label
            )
        upper.set_ylabel("estimated insolation\nin the plane [kWh/m²]")
        lower.plot(places, [day.bound_pct for day in yields], color=GREY, linestyle="none", marker="_", markersize=14)
        lower.plot(places, [day.gain_pct for day in yields], color=BLUE, linestyle="none", marker="o")
        lower.axhline(0.0, color=INK, linewidth=0.8)
        lower.set_ylabel("gain [%]\n● actual\n— best")
        step = -(-len(names) // 16)
        lower.set_xticks(places[::step], [name[5:] for name in names[::step]])
        years = _years(names[0][:4], names[-1][:4])
        lower.set_xlabel(f"day of the site in {years}, from solar midnight (month-day)")
        _legend(upper, 3)
        return stamp_simulated(figure, simulated)


_ALL_SERIES = (
    PictureKind("irradiance of the faces and diffuse fraction", light_picture),
    PictureKind("A and B, set and actual, and the sun's path", angles_picture),
    PictureKind("estimated irradiance in the plane: actual, chronometric, best", received_picture),
    PictureKind("modes, moves and travel", motion_picture),
    PictureKind("wind and what it stows from", wind_picture),
    PictureKind("maximum power of the module by its I-V curves", power_picture),
)
PICTURES = dict(zip(NAMES, _ALL_SERIES, strict=True))
"""Each picture by the name that the command line gives it."""


def _panels(count: int, height_in: float, ratios: Sequence[float]) -> tuple[Figure, list[Axes]]:
    figure = Figure(figsize=(_WIDTH_IN, height_in), layout="constrained")
    figure.patch.set_alpha(0.0)
    found = figure.subplots(count, 1, sharex=True, height_ratios=ratios, squeeze=False)[:, 0]
    for axes in found:
        axes.patch.set_alpha(0.0)
        axes.yaxis.set_major_locator(MaxNLocator(5))
    return figure, list(found)


def _legend(axes: Axes, columns: int) -> None:
    """Put the legend above the panel, where no data can be."""
    if not axes.get_legend_handles_labels()[0]:
        return
    axes.legend(loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=columns, borderaxespad=0.2, handlelength=2.6)


def _finish_time_axis(figure: Figure, lowest: Axes, drawing: PictureData) -> Figure:
    """Give the axis of time its ticks, in UTC and by the local clock."""
    span = drawing.material.span
    first, last = _dates(np.array([span.start_utc_s, span.end_utc_s]))
    lowest.set_xlim(first, last)
    if span.duration_s <= 1.5 * DAY_S:
        step = next((step for step in _STEPS_MIN if span.duration_s <= _MOST_STEPS * 60.0 * step), _STEPS_MIN[-1])
        if step < 60:
            locator: RRuleLocator = MinuteLocator(byminute=range(0, 60, step))  # type: ignore[no-untyped-call]  # matplotlib has no type there
        else:
            locator = HourLocator(byhour=range(0, 24, step // 60))  # type: ignore[no-untyped-call]  # as above
        lowest.xaxis.set_major_locator(locator)
    elif span.duration_s <= 20 * DAY_S:
        lowest.xaxis.set_major_locator(DayLocator())  # type: ignore[no-untyped-call]  # as above
    else:
        lowest.xaxis.set_major_locator(AutoDateLocator(maxticks=12))  # type: ignore[no-untyped-call]  # as above
    lowest.xaxis.set_major_formatter(FuncFormatter(_tick_formatter(drawing)))
    if span.duration_s > 1.5 * DAY_S:
        # The ticks of a long span are days: the years of the first and the last of them.
        ticks = -(-span.start_utc_s // DAY_S) * DAY_S, span.end_utc_s // DAY_S * DAY_S
        lowest.set_xlabel(f"{_years(*(f'{datetime.fromtimestamp(at, UTC):%Y}' for at in ticks))}, UTC")
    else:
        here = local_time((span.start_utc_s + span.end_utc_s) / 2.0, drawing.zone)
        # On a day on which the clocks change there are two names. The end itself is not part of the span.
        edges = [local_time(at, drawing.zone) for at in (span.start_utc_s, span.end_utc_s - 1.0)]
        names = ", then ".join(dict.fromkeys(f"{at:%Z}" for at in edges))
        local = f"; below it local time, {names}" if any(at.utcoffset() for at in edges) else ""
        lowest.set_xlabel(f"{here:%d %B %Y}, UTC{local}".lstrip("0"))
    figure.align_ylabels()
    return stamp_simulated(figure, drawing.material.simulated)


def _years(first: str, last: str) -> str:
    return first if first == last else f"{first} to {last}"


def _tick_formatter(drawing: PictureData) -> Callable[[float, int], str]:
    """Return the function that writes the text of a tick."""
    long = drawing.material.span.duration_s > 1.5 * DAY_S

    def text(place: float, _number: int) -> str:
        there = num2date(place)  # type: ignore[no-untyped-call]  # as above
        here = local_time(there.timestamp(), drawing.zone)
        form = "%d %b" if long and not (there.hour or there.minute) else "%H:%M"
        return f"{there:{form}}" if not here.utcoffset() or long else f"{there:{form}}\n{here:{form}}"

    return text


def _dates(utc_s: Array) -> NDArray[np.datetime64]:
    return (utc_s * 1e3).astype("datetime64[ms]")


def _thinned(utc_s: Array, values: Array, pause_s: float) -> tuple[NDArray[np.datetime64], Array]:
    """Return a line thinned to some thousand points: the least and the greatest value of each stretch, with its gaps.

    The line does not cross a pause of more than `pause_s`.
    """
    last = np.flatnonzero(np.diff(utc_s) > pause_s)
    chosen = np.arange(utc_s.size)
    if utc_s.size > _MOST_POINTS:
        block = -(-2 * utc_s.size // _MOST_POINTS)
        whole = utc_s.size // block * block
        blocks = values[:whole].reshape(-1, block)
        filled = np.where(np.isfinite(blocks), blocks, np.inf), np.where(np.isfinite(blocks), blocks, -np.inf)
        places = np.concatenate([part.argmin(axis=1) for part in (filled[0], -filled[1])])
        places += np.tile(block * np.arange(len(blocks)), 2)
        chosen = np.unique(np.concatenate([places, np.arange(whole, utc_s.size)]))
    behind = np.searchsorted(chosen, last, side="right")
    middles = (utc_s[last] + utc_s[last + 1]) / 2.0
    return _dates(np.insert(utc_s[chosen], behind, middles)), np.insert(values[chosen], behind, np.nan)


def _set_points(drawing: PictureData, angle: str) -> tuple[NDArray[np.datetime64], Array]:
    """Return the set points of an angle; each holds until the next one, and is NaN while nothing was recorded."""
    material = drawing.material
    given_utc_s, set_points = set_points_of(material, angle)
    silent = [stretch for stretch in drawing.motion.mode_periods if stretch.mode == NOT_RECORDED]
    begins = np.array([stretch.start_utc_s for stretch in silent])
    ends = np.array([*(stretch.end_utc_s for stretch in silent), material.span.end_utc_s])
    utc_s = np.concatenate([given_utc_s, begins, ends])
    again = latest_values(given_utc_s, set_points, ends, np.inf)
    values = np.concatenate([set_points, np.full(begins.shape, np.nan), again])
    order = np.argsort(utc_s, kind="stable")
    return _dates(utc_s[order]), values[order]


def _sun_angles(drawing: PictureData) -> tuple[Array, Array, Array]:
    """Return instants, and A and B of a tracker that points at the sun within its limits; NaN while it is down."""
    span = drawing.material.span
    utc_s = np.arange(span.start_utc_s, span.end_utc_s, max(300.0, span.duration_s / 2000.0))
    sun = sun_direction(utc_s, *drawing.material.site)
    up = sun[:, 2] > 0.0
    a_deg, b_deg = angles_within(sun, drawing.material.limits)
    return utc_s, np.where(up, a_deg, np.nan), np.where(up, b_deg, np.nan)
