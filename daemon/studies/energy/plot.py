"""The benchmark's picture: gain by day type, and harvest against wear."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Literal

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from daemon.studies.energy.benchmark import EnergyRow
from daemon.studies.energy.names import FIXED
from daemon.studies.stamp import stamped
from solar.energy import DAY_TYPES

if TYPE_CHECKING:
    from matplotlib.artist import Artist

# Told apart by those who see no red or green, and in print without colour by their brightness (Okabe and Ito).
_COLOURS = ("#0072b2", "#e69f00", "#009e73", "#d55e00", "#56b4e9", "#cc79a7", "#000000")
# What is left of a colour in grey.
_HATCHES = ("", "//", "\\\\", "..", "xx", "++", "--")
_BOUND = "0.65"
_MARKERS = ("o", "s", "^", "D", "v")
_LINES: tuple[Literal["-", "--", ":", "-."], ...] = ("-", "--", ":", "-.")
_GAIN_TICKS = (-5, -2, -1, -0.5, 0, 0.5, 1, 2, 5, 10, 20, 50, 100)
_MOVING_WORST_PCT = -5.0
_LOWEST_SHARE_PCT = -60.0


def plot(rows: Sequence[EnergyRow], path: Path, *, simulated: bool = False) -> None:
    """Draw both panels to a PNG file; laws that lose more than 5 % (planes that never move) get no bars."""
    figure = Figure(figsize=(12.0, 5.6), layout="constrained")
    stamped(figure, simulated, "SIMULATED WEATHER")
    FigureCanvasAgg(figure)
    bars, wear = figure.subplots(1, 2)
    laws = list(dict.fromkeys(_law_of(row) for row in rows if _is_drawn(row)))
    colours = {law: _COLOURS[index % len(_COLOURS)] for index, law in enumerate(laws)} | {"bound": _BOUND}
    hatches = {law: _HATCHES[index % len(_HATCHES)] for index, law in enumerate(laws)} | {"bound": ""}
    _draw_bars(bars, [row for row in rows if row.sky == rows[0].sky], colours, hatches)
    left_out: list[str] = []
    skies = list(dict.fromkeys(row.sky for row in rows))
    for index, name in enumerate(skies):
        left_out += _draw_wear(wear, [row for row in rows if row.sky == name], colours, index)
    _name_laws(wear, [row for row in rows if _is_drawn(row) and not row.law.startswith(FIXED)])
    wear.axhline(100.0, color=_BOUND, linewidth=1.5)
    wear.axhline(0.0, color="black", linewidth=0.8)
    wear.margins(x=0.12, y=0.08)
    wear.set_xlim(left=0.0)
    wear.set_ylim(top=108.0)
    wear.annotate(
        "the bound", (0.02, 100.0), xycoords=("axes fraction", "data"), xytext=(0, 3), textcoords="offset points"
    )
    wear.set_xlabel("travel, A and B added [deg/day]")
    wear.set_ylabel("share of what the bound gains [%]")
    wear.set_title("Harvest against wear")
    wear.grid(alpha=0.3)
    if left_out:
        wear.annotate(
            f"below {_LOWEST_SHARE_PCT:g} %: {', '.join(dict.fromkeys(left_out))}",
            (0.02, 0.02),
            xycoords="axes fraction",
        )
    shown: list[Artist] = [
        Patch(facecolor=colours[law], hatch=hatches[law], edgecolor="white", label=law) for law in (*laws, "bound")
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
    figure.legend(handles=shown, loc="outside lower center", ncols=min(len(shown), 7), frameon=False)
    figure.savefig(path, dpi=120)


def _is_drawn(row: EnergyRow) -> bool:
    moves = np.isfinite(row.travel_deg_per_day) and not row.law.startswith(FIXED)
    return bool(
        row.law != "bound" and (row.gain_pct > _MOVING_WORST_PCT or (moves and row.share_pct > _LOWEST_SHARE_PCT))
    )


def _law_of(row: EnergyRow) -> str:
    """Return the name of a law without the parameter that was tried with it; a fixed plane is named by its tilt."""
    return row.law if row.law.startswith(FIXED) else row.law.partition(":")[0]


def _draw_bars(axes: Axes, rows: Sequence[EnergyRow], colours: Mapping[str, str], hatches: Mapping[str, str]) -> None:
    shown = [row for row in rows if row.gain_pct > _MOVING_WORST_PCT and ":" not in row.law]
    width = 0.8 / max(len(shown), 1)
    # A type of which there was no day has no gain.
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
    axes.set_title(f"Gain by type of day, sky {rows[0].sky}")
    axes.grid(axis="y", alpha=0.3)
    axes.set_axisbelow(True)


def _draw_wear(axes: Axes, rows: Sequence[EnergyRow], colours: Mapping[str, str], sky: int) -> list[str]:
    """Draw each law's point, or its line over the parameter that was tried; return the laws that lie too low."""
    lines: dict[str, list[tuple[float, float]]] = {}
    left_out = []
    for row in rows:
        if not np.isfinite(row.travel_deg_per_day) or row.law.startswith(FIXED):
            continue
        if row.share_pct < _LOWEST_SHARE_PCT:
            left_out.append(row.law)
        else:
            lines.setdefault(_law_of(row), []).append((row.travel_deg_per_day, row.share_pct))
    for law, points in lines.items():
        axes.plot(
            *zip(*sorted(points), strict=True),
            color=colours[law],
            marker=_MARKERS[sky % len(_MARKERS)],
            linestyle=_LINES[sky % len(_LINES)],
            markersize=6,
        )
    return left_out


def _name_laws(axes: Axes, rows: Sequence[EnergyRow]) -> None:
    """Write each law's name above its marks of all skies."""
    for law in dict.fromkeys(map(_law_of, rows)):
        points = [(row.travel_deg_per_day, row.share_pct) for row in rows if _law_of(row) == law]
        travel, share = np.nanmean([x for x, _ in points]), max(y for _, y in points)
        axes.annotate(law, (travel, share), xytext=(0, 8), textcoords="offset points", ha="center")
