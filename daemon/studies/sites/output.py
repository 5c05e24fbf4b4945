"""The results of all sites, for people and for programs."""

import csv
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from textwrap import wrap
from typing import Any

import numpy as np

from daemon.base.files import atomic_text_file
from daemon.base.words import pluralise
from daemon.studies.energy.benchmark import CSV_NUMBERS, NO_BUDGET_NOTE, EnergyRow, csv_cells
from daemon.studies.sites.study import Benchmark, SiteOutcome
from daemon.studies.text_table import WIDTH, signed, table
from solar.energy import DAY_TYPES

_HEADS = ("law", "gain %", "least", "at", "most", "at", "share %", "deg/day")
_COLUMNS = ("name", "latitude_deg", "longitude_deg", "altitude_m", "weather", "year", "days", "sky", "law")


def is_simulated(outcomes: Sequence[SiteOutcome]) -> bool:
    """Tell whether the weather of any site is simulated."""
    return any(outcome.simulated for outcome in outcomes)


def write_csv(outcomes: Sequence[SiteOutcome], path: Path) -> None:
    """Write a line for each site, sky and law; a site that could not be used has one line with the reason."""
    with atomic_text_file(path) as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow((*_COLUMNS, *CSV_NUMBERS, "simulated", "refused"))
        for outcome in outcomes:
            site = outcome.site
            year = "" if site.year is None else site.year
            head = (site.name, *site.place, site.weather_text, year, outcome.days)
            simulated = "true" if outcome.simulated else "false"
            for row in outcome.rows:
                writer.writerow((*head, row.sky, row.law, *csv_cells(row), simulated, ""))
            if outcome.refused is not None:
                writer.writerow((*head, "", "", *("" for _ in CSV_NUMBERS), "", outcome.refused))


def as_text(outcomes: Sequence[SiteOutcome], benchmark: Benchmark) -> str:
    """Return how the gains of each law are spread over the sites, for reading."""
    used = [outcome for outcome in outcomes if outcome.rows]
    names = {outcome.site.name for outcome in used}
    assumptions = benchmark.assumptions
    speed = assumptions.drive.speed_deg_per_s
    moves = "ideal moves" if np.isinf(speed) else f"{speed:g} deg/s"
    days = sum(outcome.days for outcome in used)
    modelled = [outcome for outcome in used if outcome.simulated]
    lines = [
        *([f"SIMULATED: the weather of {len(modelled)} of {len(used)} was not measured."] if modelled else []),
        (
            f"{pluralise(len(used), 'line')} of the table, {pluralise(len(names), 'site')}, {pluralise(days, 'day')}."
            " Gains are over ideal chronometric: their median over the lines, the least and the most, each with"
            " its site."
        ),
        f"Albedo {assumptions.albedo:g}; {assumptions.limits}; {moves}, one axis at a time.",
        NO_BUDGET_NOTE,
    ]
    lines = [line for text in lines for line in wrap(text, WIDTH)]
    for sky in benchmark.skies:
        rows = [_spread(law, _rows(used, sky, law)) for law in benchmark.laws]
        lines += ["", f"sky {sky}", *table([_HEADS, *(row for row in rows if row)])]
    for outcome in outcomes:
        if outcome.refused is not None:
            lines += ["", *wrap(f"not used: {outcome.site.name}: {outcome.refused}", WIDTH)]
    return "\n".join(lines) + "\n"


def as_dict(outcomes: Sequence[SiteOutcome], benchmark: Benchmark) -> dict[str, Any]:
    """Return the results for scripts, site by site."""
    return {
        "simulated": is_simulated(outcomes),
        "albedo": benchmark.assumptions.albedo,
        "limits": benchmark.assumptions.limits,
        "speed_deg_per_s": benchmark.assumptions.drive.speed_deg_per_s,
        "seed": benchmark.seed,
        "sites": [_site_page(outcome) for outcome in outcomes],
    }


def _site_page(outcome: SiteOutcome) -> dict[str, Any]:
    site = outcome.site
    rows = [
        asdict(row) | {"gain_by_type_pct": dict(zip(DAY_TYPES, row.gain_by_type_pct, strict=True))}
        for row in outcome.rows
    ]
    return {
        "name": site.name,
        "latitude_deg": site.latitude_deg,
        "longitude_deg": site.longitude_deg,
        "altitude_m": site.altitude_m,
        "weather": site.weather_text,
        "year": site.year,
        "simulated": outcome.simulated,
        "days": outcome.days,
        "warnings": outcome.warnings,
        "refused": outcome.refused,
        "rows": rows,
    }


def _rows(outcomes: Sequence[SiteOutcome], sky: str, law: str) -> list[tuple[str, EnergyRow]]:
    return [
        (outcome.site.name, row)
        for outcome in outcomes
        for row in outcome.rows
        if row.sky == sky and row.law == law and np.isfinite(row.gain_pct)
    ]


def _spread(law: str, found: Sequence[tuple[str, EnergyRow]]) -> tuple[str, ...] | None:
    if not found:
        return None
    gains = [row.gain_pct for _, row in found]
    (least_at, least), (most_at, most) = found[int(np.argmin(gains))], found[int(np.argmax(gains))]
    return (
        law,
        signed(float(np.median(gains)), 2),
        signed(least.gain_pct, 2),
        least_at,
        signed(most.gain_pct, 2),
        most_at,
        _median([row.share_pct for _, row in found], 1),
        _median([row.travel_deg_per_day for _, row in found], 0),
    )


def _median(values: Sequence[float], digits: int) -> str:
    known = [value for value in values if np.isfinite(value)]
    return f"{np.median(known):z.{digits}f}" if known else "-"
