"""The sites on a map, coloured by what the laws gain there."""

from collections.abc import Sequence
from importlib.resources import files
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from matplotlib.ticker import MultipleLocator

from daemon.config.plugin_sections import FALLBACK_LAW
from daemon.studies.energy.names import BOUND, FIXED
from daemon.studies.picture_file import save_picture
from daemon.studies.sites.output import is_simulated
from daemon.studies.sites.study import SiteOutcome
from daemon.studies.stamp import stamp_simulated
from solar.frames import Array

MOST_MAPS = 4
_FLAT_LAW = "flat"
_LEAST_SPAN_DEG, _MARGIN = 4.0, 0.08
_STEPS_DEG = (1, 2, 5, 10, 15, 30, 60)
_LINES = 7
_CROWDED = 200


def draw_map(outcomes: Sequence[SiteOutcome], path: Path) -> None:
    """Draw to a PNG file where the sites are and what each law gains there, the mean of a site's years.

    Planes that hardly move and the bound are left out, unless there is nothing else; so are laws after the fourth.
    Longitude and latitude are in equal steps, the coasts are those of Natural Earth at 1:110 million. Raises
    `UserError`.
    """
    used = [outcome for outcome in outcomes if outcome.rows]
    sky = used[0].rows[0].sky
    laws = shown_laws(used)
    columns = min(len(laws), 2)
    lines = -(-len(laws) // columns)
    extent = _extent(used)
    height = 6.0 * (extent[3] - extent[2]) / (extent[1] - extent[0]) + 0.6
    figure = Figure(figsize=(6.0 * columns + 1.2, min(max(height, 2.5), 7.0) * lines + 0.6), layout="constrained")
    FigureCanvasAgg(figure)
    panels = figure.subplots(lines, columns, squeeze=False).ravel()
    values = [_gains(used, sky, law) for law in laws]
    known = np.concatenate([gains for _, gains in values])
    scale = Normalize(float(known.min()), float(known.max()))
    coast = _coast()
    for panel, law, (places, gains) in zip(panels, laws, values, strict=False):
        panel.plot(*coast, color="0.55", linewidth=0.6, zorder=1)
        size = 14.0 if len(gains) > _CROWDED else 34.0
        # No clipping: at a pole, or where east meets west, half of a mark lies beyond the frame.
        shown = panel.scatter(
            *places.T, c=gains, norm=scale, cmap="viridis", s=size, edgecolors="black", linewidths=0.3, zorder=3,
            clip_on=False,
        )  # fmt: skip
        _frame(panel, extent)
        panel.set_title(f"{law}, sky {sky}: {gains.min():+z.2f}..{gains.max():+z.2f} %")
    for panel in panels[len(laws) :]:
        panel.set_visible(False)
    figure.colorbar(shown, ax=list(panels[: len(laws)]), label="gain over ideal chronometric [%]", shrink=0.8)
    stamp_simulated(figure, is_simulated(used), "SIMULATED WEATHER")
    save_picture(figure, path)


def shown_laws(outcomes: Sequence[SiteOutcome]) -> list[str]:
    """Return the laws that get a map."""
    laws = list(dict.fromkeys(row.law for outcome in outcomes for row in outcome.rows))
    moving = [law for law in laws if law not in (BOUND, FALLBACK_LAW, _FLAT_LAW) and not law.startswith(FIXED)]
    return (moving or laws)[:MOST_MAPS]


def _gains(outcomes: Sequence[SiteOutcome], sky: str, law: str) -> tuple[Array, Array]:
    """Return longitudes and latitudes, shape (sites, 2), and gains [%], shape (sites,)."""
    by_site: dict[tuple[float, float], list[float]] = {}
    for outcome in outcomes:
        for row in outcome.rows:
            if row.sky == sky and row.law == law:
                place = outcome.site.longitude_deg, outcome.site.latitude_deg
                by_site.setdefault(place, []).append(row.gain_pct)
    return np.array(list(by_site)), np.array([np.mean(gains) for gains in by_site.values()])


def _extent(outcomes: Sequence[SiteOutcome]) -> tuple[float, float, float, float]:
    """Return the map's west, east, south and north [deg]."""
    places = np.array([(outcome.site.longitude_deg, outcome.site.latitude_deg) for outcome in outcomes])
    low, high = places.min(axis=0), places.max(axis=0)
    span = np.maximum((high - low) * (1.0 + 2.0 * _MARGIN), _LEAST_SPAN_DEG)
    # A map that is far wider than high, or far higher than wide, would show a line of dots.
    span = np.maximum(span, span[::-1] * (0.5, 0.4))
    west_south = np.maximum((low + high - span) / 2.0, (-180.0, -90.0))
    east_north = np.minimum((low + high + span) / 2.0, (180.0, 90.0))
    return float(west_south[0]), float(east_north[0]), float(west_south[1]), float(east_north[1])


def _frame(axes: Axes, extent: tuple[float, float, float, float]) -> None:
    west, east, south, north = extent
    axes.set_xlim(west, east)
    axes.set_ylim(south, north)
    axes.set_aspect("equal")
    for axis, span in ((axes.xaxis, east - west), (axes.yaxis, north - south)):
        step = next((step for step in _STEPS_DEG if span / step <= _LINES), _STEPS_DEG[-1])
        axis.set_major_locator(MultipleLocator(step))
    axes.grid(alpha=0.4, linewidth=0.5)
    axes.set_xlabel("longitude [deg east]")
    axes.set_ylabel("latitude [deg north]")


def _coast() -> tuple[Array, Array]:
    """Return longitudes and latitudes [deg] of all coasts, NaN between one and the next."""
    with (files("daemon.studies.sites") / "coastline.csv").open(encoding="ascii") as file:
        points = np.genfromtxt(file, delimiter=",", skip_header=1)
    return points[:, 0], points[:, 1]
