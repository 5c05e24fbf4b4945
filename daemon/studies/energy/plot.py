"""The benchmark's picture: gain by day type, and harvest against wear."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from textwrap import fill
from typing import TYPE_CHECKING, Literal

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.text import Text
from matplotlib.transforms import Bbox, BboxBase

from daemon.studies.energy.benchmark import EnergyRow
from daemon.studies.energy.names import BOUND, FIXED, parse_law
from daemon.studies.picture_file import save_picture
from daemon.studies.stamp import stamp_simulated
from solar.energy import DAY_TYPES
from solar.frames import Array

if TYPE_CHECKING:
    from matplotlib.artist import Artist

# The colour-blind can tell these colours apart; in print without colour their brightness does it (Okabe and Ito).
_COLOURS = ("#0072b2", "#e69f00", "#009e73", "#d55e00", "#56b4e9", "#cc79a7", "#000000")
# They tell bars apart where all is printed in grey.
_HATCHES = ("", "//", "\\\\", "..", "xx", "++", "--")
_GREY = "0.65"
_MARKERS = ("o", "s", "^", "D", "v")
_LINES: tuple[Literal["-", "--", ":", "-."], ...] = ("-", "--", ":", "-.")
_GAIN_TICKS = (-5, -2, -1, -0.5, 0, 0.5, 1, 2, 5, 10, 20, 50, 100)
_WORST_BAR_PCT = -5.0
_LOWEST_SHARE_PCT = -60.0
# The panel's least width: in a narrower one hundredths of a degree would look like wear.
_NARROWEST_DEG = 50.0
_MARK_PX = 6.0
_LINE_STEP_PX = 4.0
_NOTE_LETTERS = 80


def plot(rows: Sequence[EnergyRow], path: Path, *, simulated: bool = False) -> None:
    """Draw both panels to a PNG file; raises `UserError`."""
    save_picture(picture(rows, simulated=simulated), path)


def picture(rows: Sequence[EnergyRow], *, simulated: bool = False) -> Figure:
    """Return both panels.

    A law that loses 5 % or more is named without a bar, and so is one that was tried only with a parameter. A plane
    that never moves has no mark.
    """
    figure = Figure(figsize=(12.0, 5.6), dpi=120, layout="constrained")
    stamp_simulated(figure, simulated, "SIMULATED WEATHER")
    FigureCanvasAgg(figure)
    bars, wear = figure.subplots(1, 2)
    skies = list(dict.fromkeys(row.sky for row in rows))
    of_first = [row for row in rows if row.sky == skies[0]]
    with_bar = [row for row in of_first if _is_compared(row) and row.gain_pct > _WORST_BAR_PCT]
    with_mark = [row for row in rows if _has_mark(row)]
    drawn = {_law_of(row) for row in (*with_bar, *with_mark)}
    laws = [law for law in dict.fromkeys(map(_law_of, rows)) if law in drawn and law != BOUND]
    colours = {law: _COLOURS[index % len(_COLOURS)] for index, law in enumerate(laws)} | {BOUND: _GREY}
    hatches = {law: _HATCHES[index % len(_HATCHES)] for index, law in enumerate(laws)} | {BOUND: ""}
    _draw_bars(bars, skies[0], with_bar, colours, hatches)
    named_by_bar = {_law_of(row) for row in with_bar}
    _name_without_bar(bars, [row for row in of_first if _law_of(row) not in named_by_bar and np.isfinite(row.gain_pct)])
    for index, name in enumerate(skies):
        _draw_marks(wear, [row for row in with_mark if row.sky == name], colours, index)
    _finish_wear(wear, with_mark, rows)
    named = [law for law in (*laws, BOUND) if law in drawn]
    shown: list[Artist] = [
        Patch(facecolor=colours[law], hatch=hatches[law], edgecolor="white", label=law) for law in named
    ]
    if len(skies) > 1:
        shown += [
            Line2D(
                [],
                [],
                color="0.3",
                marker=_MARKERS[index % len(_MARKERS)],
                linestyle=_LINES[index % len(_LINES)],
                label=f"sky {name}",
            )
            for index, name in enumerate(skies)
        ]
    if shown:
        figure.legend(handles=shown, loc="outside lower center", ncols=min(len(shown), 7), frameon=False)
    # Names can be placed only after the layout has placed the panel.
    figure.draw_without_rendering()
    _name_laws(wear, with_mark)
    return figure


def _is_compared(row: EnergyRow) -> bool:
    return ":" not in row.law or row.law.startswith(FIXED)


def _has_mark(row: EnergyRow) -> bool:
    moves = np.isfinite(row.travel_deg_per_day) and not row.law.startswith(FIXED)
    return bool(moves and row.share_pct >= _LOWEST_SHARE_PCT)


def _law_of(row: EnergyRow) -> str:
    """Return the name of a law without the parameter that was tried with it; a fixed plane is named by its tilt."""
    return row.law if row.law.startswith(FIXED) else row.law.partition(":")[0]


def _draw_bars(
    axes: Axes, sky: str, shown: Sequence[EnergyRow], colours: Mapping[str, str], hatches: Mapping[str, str]
) -> None:
    width = 0.8 / max(len(shown), 1)
    # A type of day that did not occur has no gain.
    heights = np.array([(*row.gain_by_type_pct, row.gain_pct) for row in shown]).reshape(-1, len(DAY_TYPES) + 1)
    there = np.isfinite(heights).any(axis=0)
    places = np.arange(np.count_nonzero(there))
    for index, (row, own) in enumerate(zip(shown, heights[:, there], strict=True)):
        axes.bar(
            places + (index - (len(shown) - 1) / 2) * width, own, width, color=colours[row.law],
            hatch=hatches[row.law], edgecolor="white", linewidth=0.0,
        )  # fmt: skip
    axes.set_xticks(places, [name for name, known in zip((*DAY_TYPES, "all days"), there, strict=True) if known])
    axes.set_yscale("symlog", linthresh=1.0)
    lowest, highest = np.nanmin(heights, initial=0.0), np.nanmax(heights, initial=1.0)
    axes.set_ylim(1.3 * lowest if lowest < 0.0 else -0.1, 1.4 * highest)
    low, high = axes.get_ylim()
    ticks = [tick for tick in _GAIN_TICKS if low <= tick <= high]
    axes.set_yticks(ticks, [f"{tick:g}" for tick in ticks])
    axes.minorticks_off()
    axes.axhline(0.0, color="black", linewidth=0.8)
    axes.set_ylabel("gain over ideal chronometric [%]\n(linear up to 1, logarithmic beyond)")
    axes.set_title(f"Gain by type of day, sky {sky}")
    axes.grid(axis="y", alpha=0.3)
    axes.set_axisbelow(True)


def _name_without_bar(axes: Axes, rows: Sequence[EnergyRow]) -> None:
    """Name under the panel the laws without a bar: their bars would make all others small, or be too many."""
    if rows:
        gains = ", ".join(f"{row.law} {row.gain_pct:+z.1f} %" for row in rows)
        axes.set_xlabel(fill(f"without a bar, on all days: {gains}", _NOTE_LETTERS), fontsize="small", color="0.3")


def _draw_marks(axes: Axes, rows: Sequence[EnergyRow], colours: Mapping[str, str], sky: int) -> None:
    """Draw each law's point, or its line over the parameter that was tried."""
    for law in dict.fromkeys(map(_law_of, rows)):
        points = [(row.travel_deg_per_day, row.share_pct) for row in rows if _law_of(row) == law]
        axes.plot(
            *zip(*sorted(points), strict=True),
            color=colours[law],
            marker=_MARKERS[sky % len(_MARKERS)],
            linestyle=_LINES[sky % len(_LINES)],
            markersize=6,
        )


def _finish_wear(axes: Axes, with_mark: Sequence[EnergyRow], rows: Sequence[EnergyRow]) -> None:
    """Give the panel its lines, limits and labels, and name below it the laws without a mark."""
    axes.axhline(100.0, color=_GREY, linewidth=1.5, zorder=1)
    axes.axhline(0.0, color="black", linewidth=0.8, zorder=1)
    axes.margins(y=0.08)
    right = max(1.12 * max((row.travel_deg_per_day for row in with_mark), default=0.0), _NARROWEST_DEG)
    axes.set_xlim(-0.04 * right, right)
    axes.set_ylim(top=108.0)
    axes.annotate(
        "the bound", (0.02, 100.0), xycoords=("axes fraction", "data"), xytext=(0, 3), textcoords="offset points"
    )
    low = dict.fromkeys(row.law for row in rows if row.share_pct < _LOWEST_SHARE_PCT)
    still = dict.fromkeys(row.law for row in rows if row.law.startswith(FIXED) and row.law not in low)
    unknown = dict.fromkeys(row.law for row in rows if np.isnan(row.share_pct) and row.law not in (*still, BOUND))
    without = [
        f"{why}: {', '.join(laws)}"
        for why, laws in (
            (f"below {_LOWEST_SHARE_PCT:g} %", low),
            ("never moves", still),
            ("without a share, as the bound gains next to nothing", unknown),
        )
        if laws
    ]
    axes.set_xlabel("\n".join(["travel, A and B added [deg/day]", *(["; ".join(without)] if without else [])]))
    axes.set_ylabel("share of what the bound gains [%]")
    axes.set_title("Harvest against wear")
    axes.grid(alpha=0.3)


def _name_laws(axes: Axes, rows: Sequence[EnergyRow]) -> None:
    """Write each law's name above or below its marks, and the parameters that were tried along its highest line."""
    frame = axes.get_window_extent()
    marks = axes.transData.transform(np.reshape([(row.travel_deg_per_day, row.share_pct) for row in rows], (-1, 2)))
    taken = [Bbox([mark - _MARK_PX, mark + _MARK_PX]) for mark in marks]
    taken += [text.get_window_extent() for text in axes.texts]
    taken += [Bbox([point, point + 1.0]) for line in axes.lines for point in _points_along(line)]
    laws = np.array([_law_of(row) for row in rows])
    highest = {_law_of(row): row.sky for row in sorted(rows, key=lambda row: row.share_pct)}
    tried = {_law_of(row) for row in rows if ":" in row.law}
    for row, mark in zip(rows, marks, strict=True):
        if _law_of(row) in tried and row.sky == highest[_law_of(row)]:
            number = axes.text(0.0, 0.0, _tried_parameter(row.law)[1], ha="center", va="center", fontsize="small")
            _put(number, _places_around_mark(mark, number.get_window_extent(), frame), taken)
    for law in dict.fromkeys(laws.tolist()):
        called = f"{law}, by {_tried_parameter(law)[0]}" if law in tried else law
        name = axes.text(0.0, 0.0, called, ha="center", va="center")
        _put(name, _places_beside_marks(marks[laws == law], name.get_window_extent(), frame, len(rows)), taken)


def _tried_parameter(name: str) -> tuple[str, str]:
    """Return the name of a law's one parameter, and its value in this name of the command line."""
    settings = parse_law(name).settings
    assert settings is not None and settings.knob is not None  # noqa: S101, PT018 - nothing else has two values
    return settings.knob, f"{getattr(settings, settings.knob):g}"


def _points_along(line: Line2D) -> Array:
    """Return points along a drawn line, one every few pixels [pixels]."""
    corners = np.asarray(line.get_transform().transform(line.get_xydata()))
    reached = np.concatenate(([0.0], np.cumsum(np.hypot(*np.diff(corners, axis=0).T))))
    steps = np.arange(0.0, reached[-1], _LINE_STEP_PX)
    return np.column_stack([np.interp(steps, reached, corners[:, axis]) for axis in (0, 1)])


def _put(text: Text, places: Sequence[Bbox], taken: list[Bbox]) -> None:
    """Move a text to the first place that overlaps nothing, else to the first of all, and mark that place as taken."""
    free = (box for box in places if not any(box.overlaps(other) for other in taken))
    taken.append(next(free, places[0]))
    assert text.axes is not None  # noqa: S101 - narrowing; it was made in some
    x, y = text.axes.transData.inverted().transform(taken[-1].corners().mean(axis=0))
    text.set_position((x, y))


def _places_around_mark(mark: Array, size: BboxBase, frame: BboxBase) -> list[Bbox]:
    """Return the places of a text of some size around a mark [pixels], inside the frame, nearest first."""
    reach = np.array([size.width, size.height]) / 2.0 + _MARK_PX
    ways = np.array([(0, 1), (0, -1), (1, 0), (-1, 0), (1, 1), (1, -1), (-1, 1), (-1, -1)])
    found = [mark + far * reach * way for far in (1.1, 1.7, 2.5) for way in ways]
    boxes = [Bbox.from_bounds(x - size.width / 2.0, y - size.height / 2.0, size.width, size.height) for x, y in found]
    return [box for box in boxes if frame.contains(box.x0, box.y0) and frame.contains(box.x1, box.y1)] or boxes


def _places_beside_marks(marks: Array, size: BboxBase, frame: BboxBase, lines: int) -> list[Bbox]:
    """Return the places of a name of some size above and below its marks [pixels], inside the frame, nearest first."""
    width, height = size.width, size.height
    x = np.clip(marks[:, 0].mean(), frame.x0 + 0.55 * width, frame.x1 - 0.55 * width)
    away = height * (1.1 + np.arange(lines + 1))
    found = [y for step in away for y in (marks[:, 1].max() + step, marks[:, 1].min() - step)]
    inside = [y for y in found if frame.y0 + 0.55 * height < y < frame.y1 - 0.55 * height]
    return [Bbox.from_bounds(x - width / 2.0, y - height / 2.0, width, height) for y in inside or found]
