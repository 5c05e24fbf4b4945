"""Equation (16) day by day and period by period."""

import csv
from collections.abc import Sequence
from dataclasses import astuple, dataclass, fields
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from daemon.base.clock import iso_utc
from daemon.base.errors import UserError
from daemon.base.files import atomic_text_file
from daemon.studies.compare.pairs import Pairs
from daemon.studies.compare.spans import Span
from daemon.studies.text_table import signed, table
from solar.compare import ChainBias, energy_wh, gain_pct, longest_gap_s
from solar.ephemeris import DAY_S, Site, solar_days, sun_position
from solar.frames import Array
from solar.skies.sky_periods import LOWEST_SUN_DEG, sky_periods

WHOLE_DAY = "day"
# Share of the hours for which both irradiances must be known: with fewer, the gain would be that of another time.
_LEAST_KNOWN = 0.95


@dataclass(frozen=True, slots=True)
class Gain:
    """Equation (16) over one period.

    Attributes
    ----------
    date, period
        Solar day of the site, and the part of it.
    start, end
        Times [UTC] of the period's first and last pair.
    hours
        For how long both trackers were measured.
    cube_wh, chrono_wh
        Energies, T-Cube's after correction.
    gain_pct
        Gain of T-Cube over T-Chrono.
    uncorrected_pct
        The same without the correction.
    irradiation_pct
        The same in irradiation on the modules' planes, over the pairs that have both; NaN if they are missing for more
        than a twentieth of the hours.
    extrapolated_pct
        Share of T-Cube's measured energy at powers outside those of the fit; NaN without a correction.
    simulated
        Whether any pair was simulated.
    """

    date: str
    period: str
    start: str
    end: str
    hours: float
    cube_wh: float
    chrono_wh: float
    gain_pct: float
    uncorrected_pct: float
    irradiation_pct: float
    extrapolated_pct: float
    simulated: bool


def corrected_power(pairs: Pairs, bias: ChainBias | None) -> Array:
    """Return T-Cube's power after correction, or unchanged if there is no bias."""
    return pairs.cube.pmpp_w if bias is None else bias.corrected(pairs.cube.pmpp_w)


def spans_by_sky(pairs: Pairs, site: Site) -> list[Span]:
    """Return the periods of clear, variable and overcast sky, where the diffuse fraction is known."""
    elevation_deg = sun_position(pairs.utc_s, *site).elevation_deg
    fraction = np.where(elevation_deg >= LOWEST_SUN_DEG, pairs.diffuse_fraction, np.nan)
    return [Span(one.kind, one.start_utc_s, one.end_utc_s) for one in sky_periods(pairs.utc_s, fraction)]


def check_spans(pairs: Pairs, spans: Sequence[Span]) -> None:
    """Raise `UserError` for a named period without measurements of both trackers."""
    for span in spans:
        if _inside(pairs, span).sum() < 2:
            first, last, *ends = (
                f"{iso_utc(at)[:16]}Z" for at in (*pairs.utc_s[[0, -1]].tolist(), span.start_utc_s, span.end_utc_s)
            )
            raise UserError(
                f"--period: in '{span.name}', {ends[0]} to {ends[1]}, the two trackers were not measured together; they"
                f" were from {first} to {last}"
            )


def gains(pairs: Pairs, bias: ChainBias | None, spans: Sequence[Span], site: Site) -> list[Gain]:
    """Return the gain of every solar day with pairs, each followed by those of the spans whose first pair is in it."""
    found = []
    days = solar_days(pairs.utc_s, site.longitude_deg)
    for day in np.unique(days).tolist():
        date = iso_utc(day * DAY_S)[:10]
        of_day = pairs.select(days == day)
        # The longest gap is found for each day: tables of several days may have different rates.
        gap_s = longest_gap_s(of_day.utc_s)
        found.append(_gain(of_day, bias, date, WHOLE_DAY, gap_s))
        for span in spans:
            inside = _inside(pairs, span)
            if inside.sum() > 1 and days[inside][0] == day:
                found.append(_gain(pairs.select(inside), bias, date, span.name, gap_s))
    return found


def _inside(pairs: Pairs, span: Span) -> NDArray[np.bool_]:
    return (pairs.utc_s >= span.start_utc_s) & (pairs.utc_s < span.end_utc_s)


def _gain(pairs: Pairs, bias: ChainBias | None, date: str, period: str, gap_s: float) -> Gain:
    time = pairs.utc_s

    def sum_up(values: Array) -> float:
        return energy_wh(time, values, gap_s)

    cube, chrono = sum_up(corrected_power(pairs, bias)), sum_up(pairs.chrono.pmpp_w)
    hours = sum_up(np.ones(time.shape))
    beyond = np.nan
    measured = sum_up(pairs.cube.pmpp_w)
    if bias is not None and measured > 0.0:
        outside = np.where(bias.is_extrapolated(pairs.cube.pmpp_w), pairs.cube.pmpp_w, 0.0)
        beyond = 100.0 * sum_up(outside) / measured
    start, end = (iso_utc(float(time[place]))[:19] for place in (0, -1))
    return Gain(
        date=date,
        period=period,
        start=f"{start}Z",
        end=f"{end}Z",
        hours=hours,
        cube_wh=cube,
        chrono_wh=chrono,
        gain_pct=gain_pct(cube, chrono),
        uncorrected_pct=gain_pct(measured, chrono),
        irradiation_pct=_irradiation_pct(pairs, hours, gap_s),
        extrapolated_pct=beyond,
        simulated=pairs.simulated,
    )


def _irradiation_pct(pairs: Pairs, hours: float, gap_s: float) -> float:
    ours, theirs = pairs.cube.irradiance_w_m2, pairs.chrono.irradiance_w_m2
    known = np.isfinite(ours) & np.isfinite(theirs)
    known_hours, cube, chrono = (
        energy_wh(pairs.utc_s[known], values[known], gap_s) for values in (np.ones(known.shape), ours, theirs)
    )
    return gain_pct(cube, chrono) if known_hours >= _LEAST_KNOWN * hours else np.nan


def as_text(rows: Sequence[Gain], names: tuple[str, str]) -> str:
    """Return the gains as a table for people; the gain in irradiation only if any is known."""
    heads = ["hours", f"{names[0]}/Wh", f"{names[1]}/Wh", "gain/%", "uncorrected/%", "irradiation/%"]
    if all(np.isnan(row.irradiation_pct) for row in rows):
        heads.pop()
    lines: list[Sequence[str]] = [("date", "period", "from UTC", "to UTC", *heads)]
    for row in rows:
        known = (row.gain_pct, row.uncorrected_pct, row.irradiation_pct)[: len(heads) - 3]
        percent = [signed(value, 2, "") for value in known]
        energies = (f"{row.hours:.2f}", f"{row.cube_wh:.1f}", f"{row.chrono_wh:.1f}")
        lines.append((row.date, row.period[:17], row.start[11:16], row.end[11:16], *energies, *percent))
    return "\n".join(table(lines, keys=4)) + "\n"


def extrapolation(rows: Sequence[Gain], name: str) -> str | None:
    """Return a sentence that names the periods that are corrected mostly by extrapolation, or None."""
    found = [f"{row.date} {row.period} ({row.extrapolated_pct:.0f} %)" for row in rows if row.extrapolated_pct > 50.0]
    if not found:
        return None
    return (
        f"{name}'s energy was measured mostly at powers outside those of the fit, where the correction is extrapolated"
        f" and may be far off: {', '.join(found)}; without it see 'uncorrected'"
    )


def write_csv(rows: Sequence[Gain], path: Path) -> None:
    """Write the gains as CSV; what is not known is empty."""
    with atomic_text_file(path) as file:
        table = csv.writer(file, lineterminator="\n")
        table.writerow([field.name for field in fields(Gain)])
        for row in rows:
            table.writerow([_cell(value) for value in astuple(row)])


def _cell(value: object) -> object:
    if isinstance(value, float):
        return "" if value != value else f"{value:z.4f}"
    return str(value).lower() if isinstance(value, bool) else value
