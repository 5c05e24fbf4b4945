"""The energy benchmark: laws side by side on measured weather, as a table."""

import csv
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from textwrap import wrap
from typing import Any, NamedTuple, cast

import numpy as np
from numpy.typing import NDArray

from daemon.base.errors import UserError, error_location
from daemon.base.files import atomic_text_file
from daemon.base.words import pluralise
from daemon.config.plugin_sections import FALLBACK_LAW
from daemon.rigs.measured import merge_to_minutes, read_weather
from daemon.studies.energy.names import BOUND, FIXED, parse_law
from daemon.studies.text_table import WIDTH, signed, table
from solar.energy import (
    DAY_TYPES,
    DaylightWeather,
    Drive,
    Harvest,
    IrradianceSource,
    Steer,
    best_possible,
    build_sky,
    face_irradiances,
    harvest,
    steer_fixed_tilt,
)
from solar.ephemeris import Site
from solar.frames import Array, Limits
from solar.laws.law import Law, TrackerFacts
from solar.laws.steer import LawFailedError, steer_by_readings

_PVLIB = (
    "The skies isotropic, haydavies and perez1990 agree with pvlib's above 5 deg of the sun's elevation; below it a"
    " horizontal plane keeps its GHI."
)
NO_BUDGET_NOTE = (
    "There is no daily budget of moves and travel here: the service follows the sun by the clock once three quarters of"
    " its motion.travel_per_day_deg are used, which concerns laws that turn to and fro under broken clouds, such as"
    " mu-prime and sun-vector, and not optimal, which has a smaller budget of its own."
)
IDEAL_DRIVE = Drive(np.inf, 0.0, 1)
_HEADS = ("law", "kWh/m2", "gain %", *DAY_TYPES, "share %", "worst clear", "deg/day", "return", "moves")
_TYPE_GAIN_COLUMNS = tuple(f"gain_{day_type}_pct" for day_type in DAY_TYPES)
# Where less than this share of the daylight is known, the ways from and to the night position weigh too much.
_LEAST_WHOLE_SHARE = 0.9
# The tables show a smaller gain as 0.00 %, and a share of so little could be any number.
_LEAST_ROOM_PCT = 0.005
_TRAVEL_COLUMNS = ("travel_deg_per_day", "return_deg_per_day", "moves_per_day")
CSV_NUMBERS = ("energy_kwh_m2", "gain_pct", *_TYPE_GAIN_COLUMNS, "share_pct", "worst_clear_day_pct", *_TRAVEL_COLUMNS)


@dataclass(frozen=True, slots=True)
class EnergyRow:
    """One law under one sky, whole days of weather.

    Attributes
    ----------
    energy_kwh_m2
        Plane-of-array insolation.
    gain_pct
        Over the ideal chronometric tracker, overall and by day type (NaN where there is no such day).
    share_pct
        Share of what the bound gains over the ideal chronometric tracker; NaN where that is next to nothing.
    worst_clear_day_pct
        Least gain of any clear day.
    travel_deg_per_day, return_deg_per_day, moves_per_day
        Means over `DaylightWeather.whole_days`; the return is the way back to the night position, not part of the
        travel. NaN for the bound and for planes that are fixed: nothing moves there.
    """

    sky: str
    law: str
    energy_kwh_m2: float
    gain_pct: float
    gain_by_type_pct: tuple[float, ...]
    share_pct: float
    worst_clear_day_pct: float
    travel_deg_per_day: float
    return_deg_per_day: float
    moves_per_day: float


@dataclass(frozen=True, slots=True)
class Assumptions:
    """What the benchmark assumes of ground and tracker."""

    albedo: float
    limits: Limits
    drive: Drive


@dataclass(frozen=True, slots=True)
class DaysUnderSky:
    """The days under one sky, and what the laws are compared with there.

    Attributes
    ----------
    weather, assumptions
        Days, and what is assumed of ground and tracker.
    light, faces
        The sky, and what the cube's faces read under it [W/m2], shape (n, 4).
    bound_kwh_m2, chronometric_kwh_m2
        Of each day, shape (days,): at the best pose of every instant, and following the sun with ideal moves.
    """

    weather: DaylightWeather
    assumptions: Assumptions
    light: IrradianceSource
    faces: Array
    bound_kwh_m2: Array
    chronometric_kwh_m2: Array

    def run(self, steer: Steer, drive: Drive) -> Harvest:
        """Drive a tracker through all days."""
        return harvest(self.weather, self.light, self.assumptions.albedo, drive, steer)


def under_sky(weather: DaylightWeather, sky: str, assumptions: Assumptions) -> DaysUnderSky:
    """Return the days under one of SKIES."""
    light = build_sky(weather, sky)
    faces = face_irradiances(light, assumptions.albedo)
    bound = weather.by_day(best_possible(weather, light, assumptions.limits, assumptions.albedo))
    by_the_clock = steer_of(FALLBACK_LAW, weather, faces, assumptions)
    chronometric = harvest(weather, light, assumptions.albedo, IDEAL_DRIVE, by_the_clock).energy_kwh_m2
    return DaysUnderSky(
        weather=weather,
        assumptions=assumptions,
        light=light,
        faces=faces,
        bound_kwh_m2=bound,
        chronometric_kwh_m2=chronometric,
    )


def run_benchmark(
    weather: DaylightWeather,
    skies: Sequence[str],
    law_names: Sequence[str],
    assumptions: Assumptions,
    progress: Callable[[float], None],
) -> Iterator[EnergyRow]:
    """Yield the row of every law under every sky, as soon as it is done; `progress` is told the share that is done.

    Raises `UserError` for a law that fails: laws may come from anybody.
    """
    done = 0
    total = len(skies) * (len(law_names) + 1)
    types, whole_days = weather.day_types(), weather.whole_days()
    for sky_name in skies:
        days = under_sky(weather, sky_name, assumptions)
        bound = days.bound_kwh_m2
        chronometric = days.chronometric_kwh_m2
        summarise = partial(_row, sky_name, types=types, whole_days=whole_days, reference=chronometric, bound=bound)
        for name in law_names:
            progress((done + 1) / total)
            done += 1
            if name == BOUND:
                yield summarise(name, _harvest_without_travel(bound))
            else:
                yield summarise(name, _harvest_of(name, days))
    progress(1.0)


def _harvest_of(name: str, days: DaysUnderSky) -> Harvest:
    drive = IDEAL_DRIVE if name.startswith(FIXED) else days.assumptions.drive
    try:
        found = days.run(steer_of(name, days.weather, days.faces, days.assumptions), drive)
    except UserError:
        raise
    except LawFailedError as error:
        raise UserError(f"the law {name} has failed on {error}: {_cause(error.__cause__ or error)}") from error
    except Exception as error:
        raise UserError(f"the law {name} has failed: {_cause(error)}") from error
    # The benchmark begins each day at the night position. A fixed plane was never there, and has no travel.
    return _harvest_without_travel(found.energy_kwh_m2) if name.startswith(FIXED) else found


def _harvest_without_travel(energy_kwh_m2: Array) -> Harvest:
    nothing = np.full(len(energy_kwh_m2), np.nan)
    return Harvest(energy_kwh_m2, nothing, nothing, nothing)


def _cause(error: BaseException) -> str:
    """Return an error in words, with the line that raised it."""
    return f"{type(error).__name__}: {error} ({error_location(error)})"


def write_csv(rows: Sequence[EnergyRow], path: Path, *, simulated: bool) -> None:
    """Write the rows, one line each, with whether the weather was simulated."""
    with atomic_text_file(path) as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(("sky", "law", *CSV_NUMBERS, "simulated"))
        writer.writerows((row.sky, row.law, *csv_cells(row), "true" if simulated else "false") for row in rows)


def csv_cells(row: EnergyRow) -> list[str]:
    """Return a row's numbers as CSV has them, in the order of CSV_NUMBERS; empty for what is not known."""
    numbers = (row.energy_kwh_m2, row.gain_pct, *row.gain_by_type_pct, row.share_pct, row.worst_clear_day_pct)
    travel = (row.travel_deg_per_day, row.return_deg_per_day, row.moves_per_day)
    return ["" if np.isnan(value) else f"{value:z.4f}" for value in (*numbers, *travel)]


def as_text(rows: Sequence[EnergyRow], weather: DaylightWeather, assumptions: Assumptions, *, simulated: bool) -> str:
    """Return the tables of all skies and what they assume, for reading."""
    lines = describe_conditions(weather, assumptions, simulated=simulated)
    travel = (
        "Travel adds A and B from the night position on; the way back to it at night is in its own column. A day of"
        " which half is missing counts half."
    )
    lines += [line for text in (travel, NO_BUDGET_NOTE, *_partial_days_caution(weather)) for line in wrap(text, WIDTH)]
    for name in dict.fromkeys(row.sky for row in rows):
        lines += ["", f"sky {name}", *table([_HEADS, *(_cells(row) for row in rows if row.sky == name)])]
    return "\n".join(lines) + "\n"


def _partial_days_caution(weather: DaylightWeather) -> list[str]:
    """Return a caution on means per day where most days are known only in part; else nothing."""
    whole_days, lit = weather.whole_days(), int(np.count_nonzero(weather.day_types() >= 0))
    if whole_days > _LEAST_WHOLE_SHARE * lit:
        return []
    text = (
        f"The records are of parts of {pluralise(lit, 'day')}, which count as {whole_days:.2f} whole days. The ways"
        " from and to the night position are made in full on each of them: travel and moves per day are more than those"
        " of whole days."
    )
    return [text]


def describe_conditions(weather: DaylightWeather, assumptions: Assumptions, *, simulated: bool) -> list[str]:
    """Return lines of text on what the tables of a benchmark cover and what they assume."""
    types = weather.day_types()
    days = ", ".join(f"{np.count_nonzero(types == index)} {name}" for index, name in enumerate(DAY_TYPES))
    moves = (
        "ideal moves" if np.isinf(assumptions.drive.speed_deg_per_s) else f"{assumptions.drive.speed_deg_per_s:g} deg/s"
    )
    lines = [
        *(["SIMULATED: at least one weather file says that it was not measured."] if simulated else []),
        f"{pluralise(int(np.count_nonzero(types >= 0)), 'day')} ({days}), {len(weather.utc_s)} minutes of daylight.",
        (
            f"Albedo {assumptions.albedo:g}; {assumptions.limits}; {moves}, one axis at a time."
            " Gains are over ideal chronometric."
        ),
        _PVLIB,
    ]
    return [line for text in lines for line in wrap(text, WIDTH)]


def as_dict(
    rows: Sequence[EnergyRow], weather: DaylightWeather, assumptions: Assumptions, *, simulated: bool
) -> dict[str, Any]:
    """Return the rows for scripts: gains in percent over ideal chronometric, by type of day under its name."""
    types = weather.day_types()
    return {
        "simulated": simulated,
        "days": {name: int(np.count_nonzero(types == index)) for index, name in enumerate(DAY_TYPES)},
        "minutes_of_daylight": len(weather.utc_s),
        "whole_days": weather.whole_days(),
        "albedo": assumptions.albedo,
        "limits": assumptions.limits,
        "speed_deg_per_s": assumptions.drive.speed_deg_per_s,
        "rows": [
            asdict(row) | {"gain_by_type_pct": dict(zip(DAY_TYPES, row.gain_by_type_pct, strict=True))} for row in rows
        ],
    }


def _cells(row: EnergyRow) -> list[str]:
    by_type = [signed(value, 2) for value in row.gain_by_type_pct]
    travel = [_rounded(value) for value in (row.travel_deg_per_day, row.return_deg_per_day, row.moves_per_day)]
    numbers = [f"{row.energy_kwh_m2:.1f}", signed(row.gain_pct, 2), *by_type, _rounded(row.share_pct, 1)]
    return [row.law, *numbers, signed(row.worst_clear_day_pct, 3), *travel]


def _rounded(value: float, digits: int = 0) -> str:
    return "-" if np.isnan(value) else f"{value:z.{digits}f}"


def _row(
    sky_name: str,
    law: str,
    result: Harvest,
    *,
    types: NDArray[np.intp],
    whole_days: float,
    reference: Array,
    bound: Array,
) -> EnergyRow:
    energy = result.energy_kwh_m2
    lit = types >= 0
    room = float((bound[lit] - reference[lit]).sum())
    has_room = room > _LEAST_ROOM_PCT / 100.0 * float(reference[lit].sum())
    clear = types == 0
    return EnergyRow(
        sky=sky_name,
        law=law,
        energy_kwh_m2=float(energy.sum()),
        gain_pct=_gain(energy, reference, lit),
        gain_by_type_pct=tuple(_gain(energy, reference, types == index) for index in range(len(DAY_TYPES))),
        share_pct=100.0 * float((energy - reference).sum()) / room if has_room else np.nan,
        worst_clear_day_pct=float((100.0 * (energy[clear] / reference[clear] - 1.0)).min()) if clear.any() else np.nan,
        travel_deg_per_day=float(result.travel_deg[lit].sum()) / whole_days,
        return_deg_per_day=float(result.return_deg[lit].sum()) / whole_days,
        moves_per_day=float(result.moves[lit].sum()) / whole_days,
    )


def _gain(energy: Array, reference: Array, chosen: NDArray[np.bool_]) -> float:
    if not chosen.any():
        return np.nan
    return 100.0 * float(energy[chosen].sum() / reference[chosen].sum() - 1.0)


def steer_of(name: str, weather: DaylightWeather, faces: Array, assumptions: Assumptions) -> Steer:
    """Return the function that steers the trackers of all days by the law, or the fixed plane, of this name."""
    asked = parse_law(name)
    if asked.law is None:
        return steer_fixed_tilt(weather, asked.tilt_deg or 0.0)
    steer = getattr(asked.law, "steer", None)
    if steer is not None:
        return cast("Steer", steer(asked.settings, weather, faces, assumptions.limits))
    build = asked.law.build

    def law_of(tracker: TrackerFacts) -> Law:
        return cast("Law", build(asked.settings, tracker))

    return steer_by_readings(law_of, weather, faces, assumptions.limits)


class MinuteWeather(NamedTuple):
    """Weather by the minute.

    Attributes
    ----------
    utc_s
        Whole minutes [s], shape (n,).
    dni_w_m2, dhi_w_m2
        Irradiances at each minute, shape (n,).
    warnings
        What a person should know, a sentence each.
    simulated
        Whether any file says that it was not measured.
    """

    utc_s: Array
    dni_w_m2: Array
    dhi_w_m2: Array
    warnings: list[str]
    simulated: bool


def read_minute_weather(files: Sequence[Path], site: Site) -> MinuteWeather:
    """Read weather files.

    Between records up to an hour apart the weather is linear, also from one file to the next. Where files overlap, the
    first counts. Impossible values are missing ones, and a warning counts them.

    Raises
    ------
    UserError
        A file cannot be read.
    """
    weathers = [read_weather(path) for path in files]
    (utc_s, dni, dhi), warnings = merge_to_minutes(weathers, site)
    simulated = any(weather.simulated for weather in weathers)
    return MinuteWeather(utc_s=utc_s, dni_w_m2=dni, dhi_w_m2=dhi, warnings=warnings, simulated=simulated)
