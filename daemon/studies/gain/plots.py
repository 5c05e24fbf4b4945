"""Figures of `heliocube gain`."""

from math import log10
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import BoundaryNorm
from matplotlib.figure import Figure
from matplotlib.patheffects import withStroke

from daemon.base.errors import UserError
from daemon.studies.gain.choices import Device, PlotKind
from daemon.studies.gain.evaluate import Columns, exact_energies, tilts_at
from daemon.studies.gain.request import DeviceTilts, Request
from daemon.studies.gain.weather import SkySource
from daemon.studies.picture_file import save_picture
from solar import gain
from solar.frames import Array
from solar.gain import printed
from solar.gain.ratios import Energies
from solar.gain.real_sky import best_tilt_vertical_sky

# Okabe & Ito's colours, which the colour-blind can tell apart.
_COLOURS = {Device.STATIC: "#0072B2", Device.VERTICAL: "#D55E00", Device.HORIZONTAL: "#009E73"}
# They tell curves apart where all is printed in grey.
_LINES = {Device.STATIC: "-", Device.VERTICAL: "--", Device.HORIZONTAL: "-."}
_DOTS = {Device.STATIC: "o", Device.VERTICAL: "x", Device.HORIZONTAL: "^"}
_NAMES = {
    Device.STATIC: "static panel",
    Device.VERTICAL: "vertical axis",
    Device.HORIZONTAL: "horizontal axis (the paper's)",
}
_RATIOS = {Device.STATIC: "K_DS_clip", Device.VERTICAL: "K_DV", Device.HORIZONTAL: "K_DH"}
_LEVELS = [0, 1, 2, 5, 10, 15, 20, 30, 40, 50, 60, 80, 100, 150, 200, 300]
_MONTHS = ["Jan", "Feb", "Mar", "Apr", "May", "Jun", "Jul", "Aug", "Sep", "Oct", "Nov", "Dec"]
_MONTH_STARTS = np.cumsum([1, 31, 28, 31, 30, 31, 30, 31, 31, 30, 31, 30])
_HIGHEST_GAIN_PERCENT = 200.0
_LOSS = 0.01
_MOST_SKIES = 19
_MOST_DOTS = 60
_MOST_PERCENT = 1e4


def draw(kind: PlotKind, request: Request, columns: Columns, sky: SkySource | None, path: Path) -> None:
    """Draw a figure of `kind` into a file; `columns` are the request's answer.

    Raises
    ------
    UserError
        The request does not have what the figure shows, or the file cannot be written.
    """
    if kind is PlotKind.MAP:
        figure = gain_map(request, columns, sky)
    elif kind is PlotKind.BEST_TILT:
        figure = best_tilts(request, sky)
    elif kind is PlotKind.DAILY:
        figure = daily_gain(request, sky)
    else:
        figure = printed_against_exact(request)
    save_picture(figure, path, dpi=130)


def gain_map(request: Request, columns: Columns, sky: SkySource | None) -> Figure:
    """Draw what the dual axis gains [%] by latitude and tilt: a panel for each device, a row of panels for each sky."""
    tilts, latitudes = request.tilts_deg, request.latitudes_deg
    if tilts is None or tilts.size < 3 or latitudes.size < 2:
        raise UserError(
            "the map needs several latitudes and at least three tilts, such as --lat-range 0:65:1 --tilt 0:90:1"
        )
    if request.azimuths_deg.size > 1 or (request.days is not None and request.days.size > 1):
        raise UserError("the map is drawn for one azimuth and one day or the year; give one of each")
    suffixes = {"": "constant beam, no atmosphere"} | ({"_sky": sky.label} if sky is not None else {})
    figure = Figure(figsize=(1.5 + 4.2 * len(request.against), 0.9 + 4.0 * len(suffixes)), layout="constrained")
    axes = figure.subplots(len(suffixes), len(request.against), sharex=True, sharey=True, squeeze=False)
    norm = BoundaryNorm(_LEVELS, 256, extend="both")
    grid = (latitudes.size, tilts.size)
    for row, (suffix, label) in zip(axes, suffixes.items(), strict=True):
        for panel, device in zip(row, request.against, strict=True):
            percent = 100.0 * (columns[_RATIOS[device] + suffix].reshape(grid).T - 1.0)
            # In polar night there is nothing to gain, and nothing is drawn.
            shown = np.minimum(percent, _MOST_PERCENT)
            panel.contourf(latitudes, tilts, shown, _LEVELS, norm=norm, cmap="viridis", extend="both")
            lines = panel.contour(latitudes, tilts, shown, _LEVELS[1:], colors="white", linewidths=0.6)
            # On the brightest levels white numbers need a dark edge.
            for text in panel.clabel(lines, fmt="%g", fontsize=8):
                text.set_path_effects([withStroke(linewidth=2.0, foreground="#333333")])
            best = _tilt_of_lowest(tilts, percent)
            panel.plot(
                latitudes,
                np.abs(best) if device is Device.VERTICAL else best,
                color="black",
                linestyle="--",
                linewidth=1.4,
            )
            panel.set_title(f"against {_NAMES[device]}\n{label}", fontsize=10)
    for panel in axes[-1]:
        panel.set_xlabel("latitude [deg north]")
    for panel in axes[:, 0]:
        panel.set_ylabel("tilt [deg]")
    bar = figure.colorbar(ScalarMappable(norm, "viridis"), ax=axes, ticks=_LEVELS, extend="both")
    bar.set_label("dual axis gains [%]")
    period = "in a year" if request.days is None else f"on day {request.days[0]:.0f}"
    figure.suptitle(f"What a dual axis gains {period}{_azimuth(request)}; dashed: the best tilt", fontsize=12)
    return figure


def best_tilts(request: Request, sky: SkySource | None) -> Figure:
    """Draw each device's best tilt for the year by latitude, and what the dual axis gains over it there."""
    latitudes = request.latitudes_deg
    if latitudes.size < 2:
        raise UserError("the best tilt is drawn by latitude: give several, such as --lat-range 0:65:1")
    if request.azimuths_deg.size > 1:
        raise UserError("the best tilt is drawn for one azimuth; give one")
    azimuth = request.azimuths_deg[0]
    exact = {
        Device.STATIC: gain.best_tilt_static(latitudes, azimuth),
        Device.VERTICAL: gain.best_tilt_vertical(latitudes),
        Device.HORIZONTAL: gain.best_tilt_horizontal(latitudes, azimuth),
    }
    dual = 2.0 * gain.half_day_h(latitudes[:, None], gain.DAYS).sum(axis=-1)
    figure = Figure(figsize=(8.0, 8.0), layout="constrained")
    upper, lower = figure.subplots(2, 1, sharex=True, height_ratios=(3, 2))
    for device in request.against:
        style = {"color": _COLOURS[device], "linestyle": _LINES[device]}
        upper.plot(latitudes, exact[device].tilt_deg, label=_NAMES[device], **style)
        lower.plot(latitudes, 100.0 * (dual / exact[device].energy_h - 1.0), **style)
    if Device.VERTICAL in request.against:
        tilt, width = exact[Device.VERTICAL].tilt_deg, gain.tilt_tolerance_deg(_LOSS)
        upper.fill_between(
            latitudes, np.maximum(tilt - width, 0.0), np.minimum(tilt + width, 90.0), color=_COLOURS[Device.VERTICAL],
            alpha=0.18, linewidth=0, label=f"vertical axis, within {_LOSS:.0%} of its best",
        )  # fmt: skip
        if sky is not None:
            _sky_tilts(upper, latitudes, sky)
    upper.set_ylabel("best tilt for the year [deg]")
    figure.legend(*upper.get_legend_handles_labels(), fontsize=9, loc="outside lower center", ncols=2, frameon=False)
    lower.set_ylabel("dual axis gains over\nthe best tilt [%]")
    lower.set_xlabel("latitude [deg north]")
    lower.set_ylim(bottom=0.0)
    for panel in (upper, lower):
        panel.grid(alpha=0.3)
    figure.suptitle(f"Best tilt by latitude: constant beam, no atmosphere{_azimuth(request)}", fontsize=12)
    return figure


def daily_gain(request: Request, sky: SkySource | None) -> Figure:
    """Draw what the dual axis gains [%] on each day of the year, in theory and, as dots, under a sky."""
    latitude, tilts = _one_case(request, "daily gain")
    energies = exact_energies(latitude, tilts, gain.DAYS, request.azimuths_deg[:1])
    figure = Figure(figsize=(9.5, 5.2), layout="constrained")
    panel = figure.subplots()
    real = (
        sky.energies(latitude, tilts, request.azimuths_deg[:1], gain.DAYS, request.against) if sky is not None else None
    )
    for device in request.against:
        colour, tilt = _COLOURS[device], _tilt(tilts, device)
        name = f"{_NAMES[device]}, tilt {tilt:.1f}°"
        panel.plot(gain.DAYS, _percent(energies, device), color=colour, linestyle=_LINES[device], label=name)
        if real is not None:
            percent = _percent(real, device)
            known = np.flatnonzero(np.isfinite(percent))
            some = known[:: max(known.size // _MOST_DOTS, 1)]
            panel.plot(gain.DAYS[some], percent[some], _DOTS[device], color=colour, markersize=4)
    _label_months(panel)
    shown = np.concatenate([line.get_ydata() for line in panel.lines])
    finite = shown[np.isfinite(shown)]
    low, high = (float(finite.min()), float(finite.max())) if finite.size else (0.0, 1.0)
    panel.set_ylim(max(min(0.0, 1.05 * low), -50.0), min(1.05 * high, _HIGHEST_GAIN_PERCENT))
    panel.axhline(0.0, color="black", linewidth=0.8)
    panel.set_ylabel("dual axis gains [%]")
    figure.legend(fontsize=9, loc="outside lower center", ncols=3, frameon=False)
    cut = f" (cut at {_HIGHEST_GAIN_PERCENT:g} %)" if high > _HIGHEST_GAIN_PERCENT else ""
    figure.suptitle(
        f"What a dual axis gains, day by day, at latitude {latitude:g}°{_azimuth(request)}{cut}", fontsize=12
    )
    dots = f"; dots: {sky.label}" if sky is not None else ""
    panel.set_title(f"lines: constant beam, no atmosphere{dots}", fontsize=9)
    return figure


def printed_against_exact(request: Request) -> Figure:
    """Draw the paper's printed ratios and its scripts' beside the exact ones, day by day."""
    latitude, tilts = _one_case(request, "comparison with the paper")
    azimuth = float(request.azimuths_deg[0])
    energies, days = exact_energies(latitude, tilts, gain.DAYS, request.azimuths_deg[:1]), gain.DAYS
    static, vertical, horizontal = (_tilt(tilts, device) for device in Device)
    static_paper = (
        {"limit (13), azimuth to 0": printed.k_ds_eq13(latitude, static, days)}
        if azimuth == 0.0
        else {"equation (11), script 1": printed.k_ds_eq11(latitude, static, days, azimuth)}
    )
    panels: dict[Device, dict[str, Array]] = {
        Device.STATIC: {
            "exact, one face": energies.k_ds_clip,
            "exact, |cos|": energies.k_ds_abs,
            **static_paper,
        },
        Device.VERTICAL: {
            "exact": energies.k_dv,
            "equation (25)": printed.k_dv_eq25(latitude, vertical, days),
            "script 2": printed.script2(latitude, vertical, days),
        },
        Device.HORIZONTAL: {
            "exact, full day": energies.k_dh,
            "equation (49)": printed.k_dh_eq49(latitude, horizontal, days, azimuth),
            "script 3": printed.script3(latitude, horizontal, days, azimuth),
        },
    }
    figure = Figure(figsize=(9.5, 1.0 + 2.9 * len(request.against)), layout="constrained")
    axes = figure.subplots(len(request.against), 1, sharex=True, squeeze=False)[:, 0]
    for panel, device in zip(axes, request.against, strict=True):
        styles = ("-", "-.", "--") if device is Device.STATIC else ("-", "--", ":")
        colours = ("black", "#7a828a", "#D55E00") if device is Device.STATIC else ("black", "#D55E00", "#0072B2")
        for (name, ratio), style, colour in zip(panels[device].items(), styles, colours, strict=True):
            finite = np.where(np.isfinite(ratio), ratio, np.nan).ravel()
            panel.plot(days, finite, style, color=colour, label=name, linewidth=1.6)
        panel.set_yscale("log")
        panel.set_ylabel(f"dual axis over\n{_NAMES[device].partition(' (')[0]}\n(log scale)")
        panel.set_title(f"tilt {_tilt(tilts, device):.1f}°", fontsize=10, loc="left")
        panel.legend(fontsize=9, ncols=3, loc="lower right", bbox_to_anchor=(1.0, 1.0), frameon=False)
        panel.grid(alpha=0.3, which="both")
        _label_log_plainly(panel)
    _label_months(axes[-1])
    figure.suptitle(f"The paper's printed ratios against the exact ones at latitude {latitude:g}°{_azimuth(request)}")
    return figure


def _tilt_of_lowest(tilts: Array, percent: Array) -> Array:
    """Return the tilt of each column's lowest value; NaN where a column has no value.

    Where the tilts are evenly spaced, a parabola finds it between them.
    """
    lowest = np.argmin(np.where(np.isnan(percent), np.inf, percent), axis=0)
    inner = np.clip(lowest, 1, tilts.size - 2)
    before, at, after = (np.take_along_axis(percent, (inner + step)[None], axis=0)[0] for step in (-1, 0, 1))
    curvature = before - 2.0 * at + after
    usable = np.isfinite(curvature) & (curvature > 0.0) & (inner == lowest) & (np.ptp(np.diff(tilts)) < 1e-6)
    shift = np.divide(before - after, 2.0 * curvature, out=np.zeros(at.shape), where=usable)
    refined = tilts[lowest] + shift * (tilts[1] - tilts[0])
    return np.where(np.isfinite(percent).any(axis=0), refined, np.nan)


def _sky_tilts(panel: Axes, latitudes: Array, sky: SkySource) -> None:
    some = latitudes[np.unique(np.linspace(0, latitudes.size - 1, _MOST_SKIES).round().astype(np.int64))]
    found = np.array([best_tilt_vertical_sky(sky.series_at(latitude), _LOSS) for latitude in some.tolist()])
    best, low, high = found.T
    panel.errorbar(
        some, best, np.array([best - low, high - best]), fmt="o", markersize=4, capsize=2, linewidth=0.9,
        color="#7A3300", label=f"vertical axis under a {sky.label}, within {_LOSS:.0%}",
    )  # fmt: skip


def _one_case(request: Request, what: str) -> tuple[float, DeviceTilts]:
    """Return the latitude and the tilts of a figure of one case; `UserError` if the request has several."""
    tilts = request.tilts_deg
    if request.latitudes_deg.size != 1 or (tilts is not None and tilts.size != 1) or request.azimuths_deg.size != 1:
        raise UserError(f"the {what} is drawn for one latitude, one tilt and one azimuth")
    latitude = float(request.latitudes_deg[0])
    return latitude, tilts_at(request, latitude)


def _tilt(tilts: DeviceTilts, device: Device) -> float:
    tilt = float(getattr(tilts, device.value).flat[0])
    return abs(tilt) if device is Device.VERTICAL else tilt


def _percent(energies: Energies, device: Device) -> Array:
    ratio = {Device.STATIC: energies.k_ds_clip, Device.VERTICAL: energies.k_dv, Device.HORIZONTAL: energies.k_dh}
    percent = 100.0 * (ratio[device].ravel() - 1.0)
    return np.where(np.isfinite(percent), percent, np.nan)


def _azimuth(request: Request) -> str:
    azimuth = request.azimuths_deg[0]
    return f", azimuth {azimuth:g}° from south to east" if azimuth else ""


def _label_months(panel: Axes) -> None:
    panel.set_xlim(1, 365)
    panel.set_xticks(_MONTH_STARTS, _MONTHS, ha="left")
    panel.grid(alpha=0.3)


def _label_log_plainly(panel: Axes) -> None:
    """Label a logarithmic axis with plain numbers, as many as fit between its ends."""
    low, high = panel.get_ylim()
    decades = log10(high / low)
    if decades < 0.2:
        steps = [tenth / 10.0 for tenth in range(10, 100)]
    elif decades < 0.6:
        steps = [1, 1.1, 1.2, 1.3, 1.5, 1.7, 2, 2.5, 3, 4, 5, 7]
    else:
        steps = [1, 2, 5] if decades < 2.5 else [1]
    ticks = [tick for power in range(-2, 6) for step in steps if low <= (tick := step * 10.0**power) <= high]
    panel.set_yticks(ticks, [f"{tick:g}" for tick in ticks])
    panel.set_yticks([], minor=True)
