"""The report of an experiment: tables, figures, and one page that holds them all."""

import base64
from collections.abc import Sequence
from dataclasses import dataclass
from html import escape
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from daemon.base.clock import iso_utc
from daemon.base.errors import UserError
from daemon.base.files import replace_file
from daemon.store.outputs import check_outputs
from daemon.studies.compare import figures
from daemon.studies.compare.fit import Fit
from daemon.studies.compare.gains import Gain, extrapolation, gains, spans_by_sky, write_csv
from daemon.studies.compare.pairs import Pairs
from daemon.studies.compare.spans import Span
from daemon.studies.compare.stored import KeptCurve
from daemon.studies.stamp import stamp_simulated
from daemon.studies.text_table import signed
from solar.ephemeris import DAY_S, Site, solar_days
from solar.pv_module import Q_PEAK_G4_1_305, curve, maximum_power

_STYLE = """body{font:16px/1.5 system-ui,sans-serif;max-width:62rem;margin:2rem auto;padding:0 1rem;color:#222}
table{border-collapse:collapse;margin:1rem 0}td,th{padding:.25rem .7rem;border-bottom:1px solid #ddd;text-align:right}
td.t,th.t{text-align:left}figure{margin:2rem 0}img{max-width:100%}figcaption{color:#555}pre{overflow-x:auto}"""


@dataclass(frozen=True, slots=True)
class CaptionedFigure:
    """One figure of the report: its file's name, what the caption says, and the figure."""

    name: str
    caption: str
    figure: Figure


@dataclass(frozen=True, slots=True)
class Table:
    """A table of the page: its heading, its columns' names, and rows of texts."""

    heading: str
    columns: tuple[str, ...]
    rows: Sequence[tuple[str, ...]]


def experiment_figures(pairs: Pairs, found: Fit | None, site: Site) -> list[CaptionedFigure]:
    """Return Figures 11 and 12 for every day with power (Figure 13 is 11 for the paper's second day)."""
    shown = []
    bias = None if found is None else found.bias
    days = solar_days(pairs.utc_s, site.longitude_deg)
    cube, chrono = pairs.names
    mark = _simulated_prefix(pairs)
    for day in np.unique(days).tolist():
        part = pairs.select(days == day)
        if part.utc_s.size < 2:
            continue
        date = iso_utc(day * DAY_S)[:10]
        shown.append(
            CaptionedFigure(
                f"power-{date}",
                f"Pmpp of {cube}{'' if bias is None else ', corrected,'} and {chrono} on {date}"
                " (the paper's Figures 11 and 13).",
                figures.power_figure(part, bias, f"{mark}Pmpp of {cube} and {chrono}, {date}"),
            )
        )
        if np.isfinite(part.cube.b_deg).any() and np.isfinite(part.chrono.b_deg).any():
            shown.append(
                CaptionedFigure(
                    f"movement-{date}",
                    f"Movement of both trackers and the sun's path on {date} (the paper's Figure 12).",
                    figures.movement_figure(part, site, f"{mark}Movement of {cube} and {chrono}, {date}"),
                )
            )
    return shown


def captioned_bias_figure(flat: Pairs, found: Fit) -> CaptionedFigure:
    """Return the figure of the fit."""
    caption = f"{flat.names[0]} against {flat.names[1]} while both lay flat (the paper's Figure 4)."
    return CaptionedFigure(
        "bias", _simulated_prefix(flat) + caption, stamp_simulated(figures.bias_figure(flat, found), flat.simulated)
    )


def modelled_curve(pairs: Pairs) -> CaptionedFigure | None:
    """Return the model's I-V curve for T-Cube's highest power, if irradiance and module temperature are known."""
    side = pairs.cube
    known = np.isfinite(side.irradiance_w_m2) & np.isfinite(side.module_temp_degc) & (side.pmpp_w > 0.0)
    if not known.any():
        return None
    place = int(np.argmax(np.where(known, side.pmpp_w, -np.inf)))
    light, warmth = float(side.irradiance_w_m2[place]), float(side.module_temp_degc[place])
    voltage = np.linspace(0.0, float(maximum_power(Q_PEAK_G4_1_305, light, warmth).voc_v), 101)
    when = iso_utc(float(pairs.utc_s[place]))[:19]
    figure = figures.curve_figure(
        voltage,
        np.maximum(curve(Q_PEAK_G4_1_305, light, warmth, voltage), 0.0),
        f"{_simulated_prefix(pairs)}{pairs.names[0]}, {when}Z, by the model of the module",
    )
    caption = (
        f"I(V) and P(V) of {pairs.names[0]}'s module at {light:.0f} W/m2 and {warmth:.0f} degC, by the model of the"
        " module and not measured, for the time of its highest power"
        f" ({side.pmpp_w[place]:.1f} W {_source(pairs)}; the paper's Figure 3)."
    )
    return CaptionedFigure("curve", caption, figure)


def captioned_kept_curve(kept: KeptCurve, pairs: Pairs) -> CaptionedFigure:
    """Return the figure of a measured I-V curve."""
    name, when = pairs.names[0], iso_utc(kept.time_utc_s)[:19]
    figure = figures.curve_figure(kept.voltage_v, kept.current_a, f"{_simulated_prefix(pairs)}{name}, {when}Z")
    caption = (
        f"I(V) and P(V) of {name}'s module as {_source(pairs)}, the curve of its highest power (the paper's Figure 3)."
    )
    return CaptionedFigure("curve", caption, figure)


def gain_table(rows: Sequence[Gain], names: tuple[str, str], heading: str = "Equation (16)") -> Table:
    """Return the gains for the page."""
    columns = ("date", "period", "from UTC", "to UTC", "hours", f"{names[0]} Wh", f"{names[1]} Wh", "gain %",
               "uncorrected %", "irradiation %", "outside the fit %")  # fmt: skip
    body = []
    for row in rows:
        texts = (row.date, row.period, row.start[11:16], row.end[11:16])
        sums = (f"{row.hours:.2f}", f"{row.cube_wh:.1f}", f"{row.chrono_wh:.1f}")
        percent = [signed(value, 2, "") for value in (row.gain_pct, row.uncorrected_pct, row.irradiation_pct)]
        beyond = "" if row.extrapolated_pct != row.extrapolated_pct else f"{row.extrapolated_pct:.0f}"
        body.append((*texts, *sums, *percent, beyond))
    return Table(heading, columns, body)


def fit_table(found: Fit) -> Table:
    """Return the fit's statistics for the page."""
    columns = ("", "pairs", "MBE W", "rMBE %", "MAE W", "rMAE %")
    body = [
        (
            name,
            str(one.pairs),
            f"{one.mbe:+z.3f}",
            f"{one.rmbe_percent:+z.2f}",
            f"{one.mae:.3f}",
            f"{one.rmae_percent:.2f}",
        )
        for name, one in (("before", found.before), ("after", found.after))
    ]
    return Table(f"Bias of {found.names[0]}'s chain against {found.names[1]}'s", columns, body)


def write_report(
    pairs: Pairs,
    found: Fit | None,
    flat: Pairs | None,
    site: Site,
    spans: Sequence[Span],
    kept: KeptCurve | None,
    out: Path,
    *,
    force: bool,
) -> list[Gain]:
    """Write ``gains.csv``, the figures and ``report.html`` to a folder, and return the gains.

    Parameters
    ----------
    pairs
        Pairs of the experiment.
    found
        The fit that corrects T-Cube's power; None leaves the power as it is.
    flat
        The pairs of the fit, for its figure; None if they are not at hand.
    site
        Site of the trackers.
    spans
        Named periods; if there are none, the diffuse fraction divides the time into periods.
    kept
        A measured I-V curve of T-Cube's module; if None, it is modelled where irradiance and temperature are known.
    force
        Whether files that are there are replaced.

    Raises
    ------
    UserError
        `out` cannot take the files, or one of them is there already.
    """
    curve_shown = modelled_curve(pairs) if kept is None else captioned_kept_curve(kept, pairs)
    shown = [one for one in (curve_shown,) if one is not None]
    if found is not None and flat is not None:
        shown.append(captioned_bias_figure(flat, found))
    shown += experiment_figures(pairs, found, site)
    # Only now it is known which figures there are. All files are checked before any of them is written.
    check_outputs([out / "report.html", out / "gains.csv", *figure_files(out, shown)], "--out", force=force)
    rows = gains(pairs, None if found is None else found.bias, spans or spans_by_sky(pairs, site), site)
    tables = [gain_table(rows, pairs.names)] + ([] if found is None else [fit_table(found)])
    notes = [
        f"{pairs.names[0]}'s power is "
        + ("not corrected for the bias between the chains." if found is None else "corrected by the fit below."),
        "Periods are named by their sky where the diffuse fraction shows it, or as they were asked for.",
    ]
    try:
        out.mkdir(parents=True, exist_ok=True)
        write_csv(rows, out / "gains.csv")
    except OSError as error:
        raise UserError(f"--out: {out} cannot be written to: {error.strerror}") from None
    far = extrapolation(rows, pairs.names[0])
    if far is not None:
        notes.append(f"{far}.")
    if pairs.simulated:
        notes.insert(0, "SIMULATED: powers here come from a model or a bench and not from modules on a roof.")
    title = f"{_simulated_prefix(pairs)}{pairs.names[0]} and {pairs.names[1]}"
    write_page(out / "report.html", title, notes, tables, shown)
    return rows


def figure_files(out: Path, shown: Sequence[CaptionedFigure]) -> list[Path]:
    """Return the files of the figures in a folder."""
    return [out / f"{one.name}.{ending}" for one in shown for ending in ("png", "svg")]


def write_page(
    path: Path, title: str, notes: Sequence[str], tables: Sequence[Table], shown: Sequence[CaptionedFigure]
) -> None:
    """Write the figures beside `path`, and to `path` a page that needs no other file."""
    parts = [
        f"<!DOCTYPE html><html lang='en'><meta charset='utf-8'><title>{escape(title)}</title><style>{_STYLE}</style>",
        f"<h1>{escape(title)}</h1>",
        *[f"<p>{escape(note)}</p>" for note in notes],
    ]
    for table in tables:
        parts.append(f"<h2>{escape(table.heading)}</h2><table><tr>")
        parts += [f"<th>{escape(name)}</th>" for name in table.columns]
        parts.append("</tr>")
        parts += ["<tr>" + "".join(f"<td>{escape(cell)}</td>" for cell in row) + "</tr>" for row in table.rows]
        parts.append("</table>")
    for one in shown:
        image = figures.save(one.figure, path.parent, one.name).read_bytes()
        data = base64.b64encode(image).decode("ascii")
        said = escape(one.caption)
        parts.append(
            f"<figure><img alt='{said}' src='data:image/png;base64,{data}'><figcaption>{said}</figcaption></figure>"
        )
    try:
        replace_file(path, "\n".join(parts) + "\n")
    except OSError as error:
        raise UserError(f"{path} cannot be written: {error.strerror}") from None


def _simulated_prefix(pairs: Pairs) -> str:
    return "SIMULATED: " if pairs.simulated else ""


def _source(pairs: Pairs) -> str:
    return "simulated" if pairs.simulated else "measured"
