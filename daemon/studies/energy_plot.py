"""The benchmark's picture: gain by day type, and harvest against wear."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from daemon.studies.energy import FIXED, EnergyRow
from solar.energy import DAY_TYPES

_MOVING_WORST_PCT = -5.0


def plot(rows: Sequence[EnergyRow], path: Path) -> None:
    """Draw both panels to a PNG file; laws that lose more than 5 % (planes that never move) get no bars."""
    figure = Figure(figsize=(12.0, 4.8), layout="constrained")
    FigureCanvasAgg(figure)
    bars, wear = figure.subplots(1, 2)
    sky_name = rows[0].sky
    shown = [row for row in rows if row.sky == sky_name and row.gain_pct > _MOVING_WORST_PCT and ":" not in row.law]
    width = 0.8 / max(len(shown), 1)
    places = np.arange(len(DAY_TYPES) + 1)
    for index, row in enumerate(shown):
        heights = (*row.gain_by_type_pct, row.gain_pct)
        colour = "0.6" if row.law == "bound" else f"C{index}"
        bars.bar(places + (index - (len(shown) - 1) / 2) * width, heights, width, label=row.law, color=colour)
    bars.set_xticks(places, [*DAY_TYPES, "all days"])
    bars.set_yscale("symlog", linthresh=1.0)
    bars.set_yticks([-1, -0.5, 0, 0.5, 1, 2, 5, 10, 20], ["-1", "-0.5", "0", "0.5", "1", "2", "5", "10", "20"])
    bars.axhline(0.0, color="black", linewidth=0.8)
    bars.set_ylabel("gain over ideal chronometric [%]")
    bars.set_title(f"Gain by type of day, sky {sky_name}")
    if shown:
        bars.legend(frameon=False)
    for index, name in enumerate(dict.fromkeys(row.sky for row in rows)):
        _draw_wear(wear, [row for row in rows if row.sky == name], name, f"C{index}")
    wear.axhline(100.0, color="0.6", linewidth=0.8)
    wear.set_xlim(left=0.0)
    wear.set_ylim(-5.0, 105.0)
    wear.set_xlabel("travel, A and B added [deg/day]")
    wear.set_ylabel("share of what the bound gains [%]")
    wear.set_title("Harvest against wear (line: one law's frontier; cross: a law as it is)")
    if wear.has_data() and wear.get_legend_handles_labels()[0]:
        wear.legend(frameon=False, loc="lower right")
    figure.savefig(path, dpi=120)


def _draw_wear(axes: Axes, rows: Sequence[EnergyRow], name: str, colour: str) -> None:
    lines: dict[str, list[tuple[float, float]]] = {}
    for row in rows:
        if np.isfinite(row.travel_deg_per_day) and not row.law.startswith(FIXED):
            lines.setdefault(row.law.partition(":")[0], []).append((row.travel_deg_per_day, row.share_pct))
    for law, points in lines.items():
        style = "x" if len(points) == 1 else "o-"
        axes.plot(*zip(*sorted(points), strict=True), style, color=colour, markersize=4, label=f"{law}, {name}")
