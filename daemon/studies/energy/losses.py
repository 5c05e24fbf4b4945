"""Where the law `optimal` loses energy against the bound: one cause after the other, by type of day.

The study runs a series of trackers, each with one burden more than the one before. A cause is what its burden costs:

structure
    What four faces cannot tell of the sky: a tracker that knows what the faces show in the same minute, and moves at
    once, against the bound.
delay
    The light has changed by the time it is known: the law at its least thrift, without a budget, moving at once.
price
    Moves that are not worth their wear are left out: the law as it is set.
motion
    Moves take time, and the drive has a deadband.
noise
    Readings are off by 1 % and 1 W/m2, at random.
gaps
    1 % of the minutes are without readings, one or two minutes at a time.

What is kept is the gain over ideal chronometric. The steps depend on each other: in another order each would cost
something else. A step can also gain, as less restless moves do.
"""

import csv
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from textwrap import wrap
from typing import Any, Literal, cast, get_args

import numpy as np

from daemon.base.files import atomic_text_file
from daemon.studies.energy.benchmark import IDEAL_DRIVE, Assumptions, DaysUnderSky, describe_conditions, under_sky
from daemon.studies.energy.names import parse_law
from daemon.studies.text_table import WIDTH, table
from solar.energy import DAY_TYPES, DaylightWeather, Drive
from solar.frames import Array
from solar.laws import optimal_live
from solar.laws.light import aim_vector, light_from_faces
from solar.laws.memory import THRIFT_RANGE
from solar.laws.optimal_live import LiveOptimalSettings
from solar.laws.steer import steer_towards

Cause = Literal["structure", "delay", "price", "motion", "noise", "gaps"]
CAUSES: tuple[Cause, ...] = get_args(Cause)
KEPT = "kept"
NOISE_SHARE, NOISE_W_M2 = 0.01, 1.0
MISSING_SHARE = 0.01
_UNTHRIFTY_SETTINGS = {"thrift": THRIFT_RANGE[0], "travel_per_day_deg": 100000.0, "moves_per_day": 1440}


@dataclass(frozen=True, slots=True)
class Losses:
    """What one law loses under one sky.

    Attributes
    ----------
    sky, law
        By name.
    bound_gain_kwh_m2
        The bound's energy above ideal chronometric on each type of day, shape (4,).
    lost_kwh_m2
        How much of that each cause costs on each type of day, shape (6, 4).
    """

    sky: str
    law: str
    bound_gain_kwh_m2: Array
    lost_kwh_m2: Array

    @property
    def kept_kwh_m2(self) -> Array:
        """The law's energy above ideal chronometric with all burdens, shape (4,)."""
        kept: Array = self.bound_gain_kwh_m2 - self.lost_kwh_m2.sum(axis=0)
        return kept

    def points(self, energy_kwh_m2: Array) -> Array:
        """Return energy in percent of `bound_gain_kwh_m2`, summed over all days."""
        whole = float(self.bound_gain_kwh_m2.sum())
        return 100.0 * energy_kwh_m2 / whole if whole > 0.0 else np.full_like(energy_kwh_m2, np.nan)


def run_losses(
    weather: DaylightWeather,
    skies: Sequence[str],
    law_names: Sequence[str],
    assumptions: Assumptions,
    seed: int,
    progress: Callable[[float], None],
) -> Iterator[Losses]:
    """Yield the losses of every law under every sky, as soon as they are known.

    Parameters
    ----------
    weather, skies, law_names, assumptions
        As for the benchmark.
    seed
        Seed of noise and gaps.
    progress
        Told the share that is done.
    """
    types = weather.day_types()
    members = np.stack([types == number for number in range(len(DAY_TYPES))]).astype(np.float64)
    done = 0
    for sky in skies:
        days = under_sky(weather, sky, assumptions)
        room = members @ (days.bound_kwh_m2 - days.chronometric_kwh_m2)
        for name in law_names:
            progress((done + 0.5) / (len(skies) * len(law_names)))
            done += 1
            settings = cast("LiveOptimalSettings", parse_law(name).settings)
            harvests = np.stack([days.bound_kwh_m2, *_energy_by_burden(days, settings, np.random.default_rng(seed))])
            yield Losses(sky, name, room, -np.diff(harvests, axis=0) @ members.T)
    progress(1.0)


def as_text(found: Sequence[Losses], weather: DaylightWeather, assumptions: Assumptions, *, simulated: bool) -> str:
    """Return the tables of all skies and laws and what they assume, for reading."""
    lines = describe_conditions(weather, assumptions, simulated=simulated)
    lines += wrap(
        "Points are percent of what the bound gains over ideal chronometric on all days. Each cause is the cost of"
        " one more burden to a tracker that already has those above it.",
        WIDTH,
    )
    for each in found:
        heads = ("points", "all", *DAY_TYPES)
        rows = [(name, *_cells(each.points(lost))) for name, lost in zip(CAUSES, each.lost_kwh_m2, strict=True)]
        rows += [
            (KEPT, *_cells(each.points(each.kept_kwh_m2))),
            ("bound", *_cells(each.points(each.bound_gain_kwh_m2))),
        ]
        room = f"{each.bound_gain_kwh_m2.sum():.1f} kWh/m2"
        lines += ["", f"sky {each.sky}, {each.law}: the bound gains {room}", *table([heads, *rows])]
    return "\n".join(lines) + "\n"


def write_csv(found: Sequence[Losses], path: Path, *, simulated: bool) -> None:
    """Write a line for each cause and type of day, with whether the weather was simulated."""
    with atomic_text_file(path) as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(("sky", "law", "cause", "day_type", "lost_kwh_m2", "points", "simulated"))
        for each in found:
            for cause, lost in zip((*CAUSES, KEPT), (*each.lost_kwh_m2, each.kept_kwh_m2), strict=True):
                for kind, energy, points in zip(DAY_TYPES, lost, each.points(lost), strict=True):
                    numbers = (f"{energy:z.4f}", "" if np.isnan(points) else f"{points:z.4f}")
                    writer.writerow((each.sky, each.law, cause, kind, *numbers, "true" if simulated else "false"))


def as_dict(found: Sequence[Losses], *, simulated: bool) -> dict[str, Any]:
    """Return the losses for scripts: energy [kWh/m2] by type of day under its name."""
    return {
        "simulated": simulated,
        "rows": [
            {
                "sky": each.sky,
                "law": each.law,
                "bound_gains_kwh_m2": _by_type(each.bound_gain_kwh_m2),
                "lost_kwh_m2": {cause: _by_type(lost) for cause, lost in zip(CAUSES, each.lost_kwh_m2, strict=True)},
                "kept_kwh_m2": _by_type(each.kept_kwh_m2),
            }
            for each in found
        ],
    }


def _energy_by_burden(
    days: DaysUnderSky, settings: LiveOptimalSettings, random: np.random.Generator
) -> Iterator[Array]:
    """Yield the energy of each day [kWh/m2], shape (days,), after each burden is added."""
    weather, faces, assumptions = days.weather, days.faces, days.assumptions

    def by_the_law(settings: LiveOptimalSettings, faces: Array, drive: Drive) -> Array:
        return days.run(optimal_live.steer(settings, weather, faces, assumptions.limits), drive).energy_kwh_m2

    light = light_from_faces(faces, weather.sun, assumptions.albedo)
    best = aim_vector(light, weather.sun, assumptions.albedo)
    yield days.run(steer_towards(weather, best, assumptions.limits), IDEAL_DRIVE).energy_kwh_m2
    yield by_the_law(settings.model_copy(update=_UNTHRIFTY_SETTINGS), faces, IDEAL_DRIVE)
    yield by_the_law(settings, faces, IDEAL_DRIVE)
    yield by_the_law(settings, faces, assumptions.drive)
    noisy = faces * (1.0 + NOISE_SHARE * random.standard_normal(faces.shape))
    noisy += NOISE_W_M2 * random.standard_normal(faces.shape)
    yield by_the_law(settings, noisy, assumptions.drive)
    # Half of the gaps are two minutes long.
    begins = random.random(len(faces)) < MISSING_SHARE / 1.5
    lasts = random.random(len(faces)) < 0.5
    missing = begins | np.roll(begins & lasts, 1)
    yield by_the_law(settings, np.where(missing[:, None], np.nan, noisy), assumptions.drive)


def _cells(by_type: Array) -> list[str]:
    return [f"{value:z.1f}" for value in (float(by_type.sum()), *by_type)]


def _by_type(energy: Array) -> dict[str, float]:
    return dict(zip(DAY_TYPES, energy.tolist(), strict=True))
