"""The picture of where the law `optimal` loses energy against the bound."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.patches import Patch

from daemon.studies.energy.losses import CAUSES, Losses
from daemon.studies.picture_file import save_picture
from daemon.studies.stamp import stamp_simulated
from solar.energy import DAY_TYPES

# From bright to dull days; told apart in grey by brightness and by hatches.
_COLOURS = ("#f0e442", "#56b4e9", "#0072b2", "#3a3a3a")
_HATCHES = ("", "//", "", "..")
_IN_A_ROW = 3


def plot(found: Sequence[Losses], path: Path, *, simulated: bool) -> None:
    """Draw a panel for each sky and law to a PNG file, a bar for each cause, by type of day; raises `UserError`."""
    across = min(len(found), _IN_A_ROW)
    down = -(-len(found) // across)
    figure = Figure(figsize=(max(4.2 * across, 6.0), 2.9 * down + 0.9), layout="constrained")
    stamp_simulated(figure, simulated, "SIMULATED WEATHER")
    FigureCanvasAgg(figure)
    panels = figure.subplots(down, across, squeeze=False, sharex=True, sharey=True).ravel()
    for axes, each in zip(panels, found, strict=False):
        _draw(axes, each)
    for axes in panels[len(found) :]:
        axes.set_visible(False)
    for index, axes in enumerate(panels[: len(found)]):
        if index + across >= len(found):
            axes.tick_params(labelbottom=True)
            axes.set_xlabel("lost, % of what the bound gains")
    shown = [
        Patch(facecolor=colour, hatch=hatch, edgecolor="white", label=f"{name} days")
        for name, colour, hatch in zip(DAY_TYPES, _COLOURS, _HATCHES, strict=True)
    ]
    figure.legend(handles=shown, loc="outside lower center", ncols=len(shown), frameon=False)
    save_picture(figure, path)


def _draw(axes: Axes, each: Losses) -> None:
    points = each.points(each.lost_kwh_m2)
    places = np.arange(len(CAUSES))[::-1]
    # A type of day on which a burden gains energy goes to the left of zero, those that lose to the right.
    right, left = np.zeros(len(CAUSES)), np.zeros(len(CAUSES))
    for kind, (colour, hatch) in enumerate(zip(_COLOURS, _HATCHES, strict=True)):
        width = points[:, kind]
        begins = np.where(width > 0.0, right, left)
        axes.barh(places, width, left=begins, color=colour, hatch=hatch, edgecolor="white", linewidth=0.4)
        right, left = right + np.maximum(width, 0.0), left + np.minimum(width, 0.0)
    for place, end, total in zip(places, right, points.sum(axis=1), strict=True):
        axes.annotate(f"{total:z.1f}", (end, place), xytext=(4, 0), textcoords="offset points", va="center")
    axes.set_yticks(places, CAUSES)
    axes.axvline(0.0, color="black", linewidth=0.8)
    axes.margins(x=0.15)
    axes.set_title(f"{each.law}, sky {each.sky}: {each.points(each.kept_kwh_m2).sum():z.1f} % kept", fontsize="medium")
    axes.grid(axis="x", alpha=0.3)
    axes.set_axisbelow(True)
