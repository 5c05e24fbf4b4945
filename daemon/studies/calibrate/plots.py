"""Figures of `heliocube calibrate`."""

from pathlib import Path

import numpy as np
from matplotlib.dates import AutoDateLocator, ConciseDateFormatter
from matplotlib.figure import Figure

from daemon.studies.calibrate.reference_comparison import Comparison
from daemon.studies.picture_file import save_picture
from daemon.studies.stamp import stamp_simulated

# Okabe & Ito's colours, which the colour-blind can tell apart.
_BEFORE, _AFTER, _LINE = "#D55E00", "#0072B2", "#555555"


def draw_comparison(found: Comparison, path: Path, *, simulated: bool) -> None:
    """Draw to a file of the kind that its ending names; raises `UserError`."""
    save_picture(comparison_figure(found, simulated=simulated), path, dpi=110)


def comparison_figure(found: Comparison, *, simulated: bool) -> Figure:
    """Return each sensor against the reference, and its residual against time and incidence angle."""
    figure = Figure(figsize=(13.0, 2.7 * len(found.faces) + 0.6), layout="constrained")
    axes = figure.subplots(len(found.faces), 3, sharex="col", squeeze=False)
    times = (found.utc_s * 1e3).astype("datetime64[ms]")
    everything = (found.reference_w_m2, found.before_w_m2, found.irradiance_w_m2)
    top = 1.05 * max(float(np.max(values)) for values in everything)
    for place, (row, (name, face)) in enumerate(zip(axes, found.faces.items(), strict=True)):
        scatter, in_time, by_angle = row
        for label, values, colour, marker in (
            ("before", found.before_w_m2[:, place], _BEFORE, "x"),
            ("after", found.irradiance_w_m2[:, place], _AFTER, "o"),
        ):
            left = values - found.reference_w_m2
            dots = {"s": 7.0, "marker": marker, "color": colour, "alpha": 0.5, "linewidths": 0.5, "rasterized": True}
            scatter.scatter(found.reference_w_m2, values, label=label, **dots)
            in_time.scatter(times, left, **dots)
            by_angle.scatter(found.incidence_deg, left, **dots)
        scatter.plot([0.0, top], [0.0, top], color=_LINE, linewidth=0.8)
        scatter.set(xlim=(0.0, top), ylim=(0.0, top), ylabel=f"{name} [W/m2]")
        agreed = face.after
        in_time.set_title(f"{name}: MBE {agreed.mbe:+z.1f}, MAE {agreed.mae:.1f} W/m2 after", fontsize="medium")
        for panel in (in_time, by_angle):
            panel.axhline(0.0, color=_LINE, linewidth=0.8)
            panel.set_ylabel("sensor - reference [W/m2]")
            panel.grid(alpha=0.3)
        locator = AutoDateLocator(minticks=3, maxticks=7)  # type: ignore[no-untyped-call]  # matplotlib has no types here
        in_time.xaxis.set_major_locator(locator)
        in_time.xaxis.set_major_formatter(ConciseDateFormatter(locator))  # type: ignore[no-untyped-call]  # as above
    figure.legend(*axes[0][0].get_legend_handles_labels(), markerscale=3.0, loc="outside lower center", ncols=2)
    for panel, label in zip(axes[-1], ("reference [W/m2]", "time [UTC]", "angle of incidence [deg]"), strict=True):
        panel.set_xlabel(label)
    return stamp_simulated(figure, simulated)
