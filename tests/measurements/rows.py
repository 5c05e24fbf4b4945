"""What rows of trackers take from each other in a year, and what turning back gains: a model on measured weather.

Usage: python tests/measurements/rows.py FOLDER [--columns 5] [--rows 2] [--pitch 2.5] [--every 4] [--laws optimal ...]
       [--shade-costs area thirds all]

FOLDER holds the months of weather at Lyngby. Only every fourth day (--every 4) is driven, in steps of five minutes.
"""

import argparse
import time
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from pathlib import Path
from types import ModuleType
from typing import NamedTuple

import numpy as np

from daemon.studies.energy.benchmark import read_minute_weather
from solar.energy import (
    DaylightWeather,
    Drive,
    Harvest,
    IrradianceSource,
    Steer,
    arrange_daylight,
    build_sky,
    face_irradiances,
    harvest,
)
from solar.ephemeris import DAY_S, Site
from solar.frames import Angles, Array, Limits, normal_from_angles
from solar.laws import chronometric, flat, mu_prime, optimal_live
from solar.laws.law import Moment, Reading, TrackerFacts
from solar.rows.group import TrackerGroup

LYNGBY = Site(55.79064, 12.52505, 50.0)
STEP_S = 300.0
ALBEDO = 0.2
EDGE_M = 2.0
LIMITS = Limits()
AT_ONCE = 1000
LAWS = {"chronometric": chronometric, "mu-prime": mu_prime, "optimal": optimal_live}
COSTS = {"area": 0, "thirds": 3, "all": 1}
"""How many groups of cells a module has. Shade takes whole groups; without groups it takes its own area."""
EVENING_UTC_S = 1474646400.0
"""2016-09-23 16:00, the sun 9 deg above the west."""
DECISIONS = 60


class Field(NamedTuple):
    """A field of trackers. `always` turns back whenever there is shade, `group` only if it pays; `taken`: W/m2 lost."""

    always: TrackerGroup
    group: TrackerGroup
    taken: Callable[[Array, Array], Array]


def main() -> None:
    """Print a table for shade that costs its area, and for shade that costs groups of cells."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path, help="folder with the months of weather at Lyngby")
    parser.add_argument(
        "--columns", type=int, default=5, help="trackers side by side, from east to west (default: %(default)s)"
    )
    parser.add_argument(
        "--rows", type=int, default=2, help="rows of trackers, from south to north (default: %(default)s)"
    )
    parser.add_argument("--pitch", type=float, default=2.5, help="distance between trackers, in widths of the module")
    parser.add_argument("--every", type=int, default=4, help="drive only every so many-th day")
    parser.add_argument(
        "--laws",
        nargs="+",
        choices=LAWS,
        default=list(LAWS),
        help="laws that drive the trackers (default: all of them)",
    )
    parser.add_argument(
        "--shade-costs",
        nargs="+",
        choices=COSTS,
        default=list(COSTS),
        help="what shade costs: its area, or the thirds or all of the module that it touches (default: all of them)",
    )
    asked = parser.parse_args()
    weather = five_minutes(sorted(asked.folder.glob("*.csv*")), asked.every)
    light = build_sky(weather, "perez1990")
    faces = face_irradiances(light, ALBEDO)
    print(
        f"{asked.rows} x {asked.columns} trackers, modules of {EDGE_M:g} x {EDGE_M:g} m, {asked.pitch:g} widths apart;"
        f" {weather.by_day(weather.dhi_w_m2).astype(bool).sum()} days, steps of {STEP_S:g} s"
    )
    print("| shade costs | law | alone | in rows, as if alone | always back | if it pays | gain | deg/day |")
    print("|---|---|---|---|---|---|---|---|")
    for cost in asked.shade_costs:
        groups = COSTS[cost]
        field = field_of(weather, asked.rows, asked.columns, asked.pitch * EDGE_M, groups)
        for line in lines(weather, light, faces, field, asked.laws):
            print(f"| {cost} | {line} |", flush=True)
    for name in asked.laws:
        alone_ms, in_rows_ms = (cost_ms(LAWS[name], group) for group in (None, field.group))
        print(f"{name}: a decision takes {alone_ms:.1f} ms alone and {in_rows_ms:.1f} ms with shade")


def five_minutes(files: list[Path], every: int) -> DaylightWeather:
    """Return five-minute means of every so many-th day."""
    utc_s, dni, dhi, *_ = read_minute_weather(files, LYNGBY)
    chosen = (utc_s // DAY_S) % every == 0
    steps, place = np.unique(utc_s[chosen] // STEP_S, return_inverse=True)
    count = np.bincount(place)
    means = [np.bincount(place, values[chosen]) / count for values in (dni, dhi)]
    whole = count == round(STEP_S / 60.0)
    return arrange_daylight(steps[whole] * STEP_S, means[0][whole], means[1][whole], LYNGBY, STEP_S)


def field_of(weather: DaylightWeather, rows: int, columns: int, pitch_m: float, groups: int) -> Field:
    """Return a field of so many rows from south to north."""
    east, north = (pitch_m * part.ravel() for part in np.meshgrid(np.arange(columns), np.arange(rows)))
    size_m, latitude_deg = (EDGE_M, EDGE_M), LYNGBY.latitude_deg
    always, group = (
        TrackerGroup.from_map(east.tolist(), north.tolist(), (), size_m, latitude_deg, groups, only_if_it_pays=pays)
        for pays in (False, True)
    )

    def taken(a_deg: Array, b_deg: Array) -> Array:
        towards = np.maximum(np.sum(weather.sun * normal_from_angles(a_deg, b_deg), axis=-1), 0.0)
        lost = [
            group.shade(weather.sun[some], a_deg[some], b_deg[some]).lost
            for some in (slice(first, first + AT_ONCE) for first in range(0, len(a_deg), AT_ONCE))
        ]
        result: Array = weather.dni_w_m2 * towards * np.concatenate(lost)
        return result

    return Field(always, group, taken)


def lines(
    weather: DaylightWeather, light: IrradianceSource, faces: Array, field: Field, names: Sequence[str]
) -> Iterator[str]:
    """Yield a line of the table for each law."""

    def driven(steer: Steer, *, shaded: bool) -> Harvest:
        return harvest(weather, light, ALBEDO, Drive(), steer, field.taken if shaded else None)

    lit = weather.day_types() >= 0
    level = driven(flat.steer(flat.SETTINGS(), weather, faces, LIMITS), shaded=True).energy_kwh_m2.sum()
    yield f"flat | {level:.1f} | {level:.1f} | | | |"
    for name in names:
        steer = partial(LAWS[name].steer, LAWS[name].SETTINGS(), weather, faces, LIMITS)
        alone, as_alone = (driven(steer(), shaded=shaded) for shaded in (False, True))
        always, if_it_pays = (driven(steer(group=group), shaded=True) for group in (field.always, field.group))
        energies = [each.energy_kwh_m2.sum() for each in (alone, as_alone, always, if_it_pays)]
        travel = " to ".join(f"{each.travel_deg[lit].mean():.0f}" for each in (as_alone, if_it_pays))
        numbers = " | ".join(f"{energy:.1f}" for energy in energies)
        yield f"{name} | {numbers} | {100.0 * (energies[3] / energies[1] - 1.0):+.2f} % | {travel}"


def cost_ms(law: ModuleType, group: TrackerGroup | None) -> float:
    """Return the median processor time of one decision with the sun low in the west [ms]."""
    facts = TrackerFacts(
        site=LYNGBY, limits=LIMITS, scan_every_s=5.0, decide_every_s=STEP_S, utc_s=EVENING_UTC_S, group=group
    )
    asked = law.build(law.SETTINGS(), facts)
    faces, took_s = (20.0, 250.0, 650.0, 160.0), []
    for number in range(DECISIONS):
        utc_s = EVENING_UTC_S + 10.0 * number
        asked.observe(Reading(utc_s, utc_s, faces))
        began_s = time.process_time()
        asked.aim(Moment(utc_s, faces, Angles(45.0, 40.0)))
        took_s.append(time.process_time() - began_s)
    return 1e3 * float(np.median(took_s))


if __name__ == "__main__":
    main()
