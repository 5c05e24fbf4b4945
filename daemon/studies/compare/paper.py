"""The experiment of Andriamahefa et al. (2023), section 4, on built-in weather, beside the results they printed."""

import csv
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np

from daemon.base.errors import UserError
from daemon.base.files import atomic_text_file, replace_file
from daemon.base.words import pluralise
from daemon.config.file import override
from daemon.config.plugin_sections import FALLBACK_LAW
from daemon.config.settings import Settings
from daemon.config.simulation import WeatherName
from daemon.rigs.simulated import build_simulated_pair, build_weather_in_parts
from daemon.studies.compare.fit import Fit, fit, flat_pairs
from daemon.studies.compare.gains import WHOLE_DAY, Gain, gains
from daemon.studies.compare.pairs import Pairs, frame_of, pair
from daemon.studies.compare.report import (
    Table,
    captioned_bias_figure,
    experiment_figures,
    fit_table,
    modelled_curve,
    write_page,
)
from daemon.studies.compare.side_by_side import MODULES, T_CHRONO, T_CUBE, run_side_by_side, two_trackers
from daemon.studies.compare.spans import Span
from daemon.studies.spread.workers import Workers, gather
from daemon.studies.text_table import signed, table
from solar.ephemeris import Site, sun_direction
from solar.frames import Array, Limits, angles_within, normal_from_angles
from solar.skies.overcast import ISOTROPIC, STANDARD, overcast_factor
from solar.skies.sky import SkyModel

NAMES = (T_CUBE, T_CHRONO)
Parts = Sequence[tuple[float, WeatherName]]
# From before sunrise to after sunset at SIRTA in October.
_BEGIN_HOUR, _DAY_SHARE = 5, 12.5 / 24.0
_FLAT_START, _FLAT_DAYS = datetime(2022, 8, 3, 3, tzinfo=UTC), 18.0 / 24.0


def _october_utc_s(day: int, hour: int, minute: int = 0) -> float:
    return datetime(2022, 10, day, hour, minute, tzinfo=UTC).timestamp()


@dataclass(frozen=True, slots=True)
class PaperGain:
    """The paper's gain in one period, and the bounds between which ours has to lie [%]."""

    span: Span
    paper_pct: float
    lowest_pct: float
    highest_pct: float


# The afternoon's end is not printed; sunset is at 17:10.
PAPER_GAINS = (
    PaperGain(Span("clear", _october_utc_s(12, 7), _october_utc_s(12, 10, 20)), -0.15, -0.5, 0.1),
    PaperGain(Span("overcast", _october_utc_s(12, 10, 20), _october_utc_s(12, 12, 10)), 12.7, 10.0, np.inf),
    PaperGain(Span("variable", _october_utc_s(12, 12, 10), _october_utc_s(12, 17, 15)), -1.0, -2.0, 1.0),
    PaperGain(Span("overcast day", _october_utc_s(14, 5), _october_utc_s(14, 17, 30)), 40.5, 25.0, np.inf),
)


SPANS = tuple(printed.span for printed in PAPER_GAINS)


@dataclass(frozen=True, slots=True)
class Run:
    """Both days under one sky model and one seed of the weather; only the first run keeps its pairs."""

    sky: SkyModel
    seed: int
    gains: tuple[Gain, ...]
    pairs: tuple[Pairs, ...]


@dataclass(frozen=True, slots=True)
class Correction:
    """The day of August on which both trackers lie flat, and the fit to it."""

    flat: Pairs
    found: Fit


@dataclass(frozen=True, slots=True)
class _RunRequest:
    """What a run depends on; sky and seed are among the settings."""

    settings: Settings
    afternoon: WeatherName
    cube_law: str
    found: Fit
    with_pairs: bool


def find_correction(settings: Settings, progress: Callable[[float], None]) -> Correction:
    """Return the correction from a simulated day of August on which both trackers lie flat; `progress` takes 0..1."""
    day = _one_day(settings, ("flat", "flat"), _FLAT_START, _FLAT_DAYS, [(0.0, "clear")], progress)
    flat = flat_pairs(day)
    return Correction(flat, fit(flat))


def run_paper(
    settings: Settings,
    skies: Sequence[SkyModel],
    seeds: int,
    afternoon: WeatherName,
    cube_law: str,
    found: Fit,
    workers: Workers,
    progress: Callable[[float], None],
) -> tuple[list[Run], UserError | None]:
    """Return 12 and 14 October 2022 under every sky and seed, and the error that ended the work early, or None.

    Parameters
    ----------
    settings
        Settings of the rig; their sky and their seed are replaced.
    skies, seeds
        Models of the diffuse light, and the number of weathers, with seeds from 1 on.
    afternoon
        Weather after 12:10 on the 12th.
    cube_law
        Law of T-Cube.
    found
        The fit that corrects T-Cube's power.
    workers
        Who simulates.
    progress
        Called with the share done, 0..1.
    """
    asked = [
        _RunRequest(
            override(settings, {"simulation": {"sky": sky, "seed": seed}}), afternoon, cube_law, found,
            with_pairs=sky == skies[0] and seed == 1,
        )
        for sky in skies for seed in range(1, seeds + 1)
    ]  # fmt: skip
    return gather(_run_both_days, asked, workers, progress)


def _run_both_days(asked: _RunRequest) -> Run:
    days: tuple[tuple[int, Parts], ...] = ((12, _weather_of_twelfth(asked.afternoon)), (14, [(0.0, "overcast")]))
    laws = (asked.cube_law, FALLBACK_LAW)
    pairs = tuple(
        _one_day(asked.settings, laws, datetime(2022, 10, day, _BEGIN_HOUR, tzinfo=UTC), _DAY_SHARE, parts)
        for day, parts in days
    )
    site = asked.settings.site.place()
    rows = [row for day in pairs for row in gains(day, asked.found.bias, SPANS, site) if row.period != WHOLE_DAY]
    simulation = asked.settings.simulation
    return Run(simulation.sky, simulation.seed, tuple(rows), pairs if asked.with_pairs else ())


def _one_day(
    settings: Settings,
    laws: tuple[str, str],
    start: datetime,
    days: float,
    parts: Parts,
    progress: Callable[[float], None] = lambda _share: None,
) -> Pairs:
    weather = build_weather_in_parts(settings, parts)
    measured = run_side_by_side(
        settings,
        two_trackers(*laws),
        lambda clock: build_simulated_pair(settings, clock, weather, MODULES),
        start.timestamp(),
        days,
        lambda _name, _record: None,
        progress,
    )
    return pair(frame_of(measured), NAMES)


def _weather_of_twelfth(afternoon: WeatherName) -> Parts:
    return [
        (_october_utc_s(12, 0), "clear"),
        (_october_utc_s(12, 10, 20), "overcast"),
        (_october_utc_s(12, 12, 10), afternoon),
    ]


def overcast_gain_limits(site: Site, limits: Limits, albedo: float = 0.2) -> list[tuple[str, str, float]]:
    """Return what lying flat gains over facing the sun under a closed sky, for each overcast period and sky.

    The result has triples of period, sky and gain in irradiation [%]. Horizontal irradiance is proportional to the sine
    of the sun's elevation, as under cloud of uniform thickness.
    """
    found = []
    for printed in (PAPER_GAINS[1], PAPER_GAINS[3]):
        utc_s = np.arange(printed.span.start_utc_s, printed.span.end_utc_s, 60.0)
        sun = sun_direction(utc_s, *site)
        sun = sun[sun[:, 2] > 0.0]
        normals = normal_from_angles(*angles_within(sun, limits))
        tilt_deg: Array = np.degrees(np.arccos(np.clip(normals[:, 2], -1.0, 1.0)))
        for name, brightening in (("isotropic", ISOTROPIC), ("Moon & Spencer", STANDARD)):
            share = float(np.sum(sun[:, 2] * overcast_factor(tilt_deg, brightening, albedo)) / np.sum(sun[:, 2]))
            found.append((printed.span.name, name, 100.0 * (1.0 / share - 1.0)))
    return found


@dataclass(frozen=True, slots=True)
class Spread:
    """One period under one sky: the gains of all weathers [%], and how many of them lie within the bounds.

    The spread counts: a median can neither meet nor miss a single figure of a single afternoon. Only the paper's law
    has to give the paper's results; other laws have no bounds to keep.
    """

    printed: PaperGain
    sky: SkyModel
    gains_pct: tuple[float, ...]
    has_bounds: bool

    @property
    def median_pct(self) -> float:
        """The median."""
        return float(np.median(self.gains_pct))

    @property
    def quartiles_pct(self) -> tuple[float, float]:
        """The quartiles: half of the weathers lie between them."""
        low, high = np.percentile(self.gains_pct, [25, 75])
        return float(low), float(high)

    @property
    def count_within_bounds(self) -> int:
        """How many weathers give a gain within the bounds."""
        return sum(self.printed.lowest_pct <= gain <= self.printed.highest_pct for gain in self.gains_pct)

    @property
    def within_bounds_text(self) -> str:
        """`count_within_bounds` beside the number of all weathers, as text; empty where there are no bounds to keep."""
        return f"{self.count_within_bounds} of {len(self.gains_pct)}" if self.has_bounds else ""


def spreads(runs: Sequence[Run], cube_law: str) -> list[Spread]:
    """Return one spread for each period and sky."""
    skies = list(dict.fromkeys(run.sky for run in runs))
    return [
        Spread(
            printed,
            sky,
            tuple(
                row.gain_pct for run in runs if run.sky == sky for row in run.gains if row.period == printed.span.name
            ),
            cube_law == "mu-prime",
        )
        for printed in PAPER_GAINS
        for sky in skies
    ]


def notes(settings: Settings, afternoon: WeatherName, cube_law: str, seeds: int, *, done: int, asked: int) -> list[str]:
    """Return paragraphs on what the experiment assumes and what it cannot show, for `done` of `asked` runs."""
    limits = settings.limits.limits()
    cube, simulated = settings.cube, settings.simulation
    closed = overcast_gain_limits(settings.site.place(), limits)
    texts = ", ".join(f"{period} {sky} {gain:+z.1f} %" for period, sky, gain in closed)
    early = "" if done == asked else f" ({done} of these {asked} runs: it was ended before the others)"
    assumed = (
        f"SIMULATED. T-Cube runs {cube_law}, T-Chrono chronometric, as two services fed by one cube:"
        f" a scan every {cube.scan_every_s:g} s, noise of {simulated.sensor_noise_mv:g} mV, gain errors of"
        f" {100.0 * simulated.sensor_gain_error:g} %. Built-in weather, {pluralise(seeds, 'seed')} from 1 on for each"
        f" sky{early}: on 12 October clear until 10:20, overcast until 12:10, then '{afternoon}'; on 14 October"
        " overcast."
        " The gain is equation (16) on Pmpp after the second-order correction, which is fitted on a simulated clear day"
        " in August with both trackers flat. Our figures are the median of the seeds, the quartiles between which half"
        " of them lie, the lowest and the highest, and how many lie within the range asked for. T-Cube's travel has no"
        " daily limit here, as the paper's had none."
    )
    closed_sky = (
        f"Under a closed sky no law gains more over chronometric than lying flat: {texts} in irradiation, albedo 0.2."
        " In the simulation's sky models diffuse light without a beam is uniform (isotropic, haydavies), or somewhat"
        " brighter around the sun and darker at the horizon (perez1990). The paper's +40.5 % is more than a uniform sky"
        " can give, and about what a standard overcast sky does, which is three times as bright at the zenith as at the"
        " horizon. Its +12.7 % before noon is less than a uniform sky gives: some light must have come from the sun's"
        " side."
    )
    variable = (
        "The variable period is the sum of losses while the sun is out and T-Cube is late, and of gains while it is"
        " hidden; which of them wins depends on the afternoon. The paper's own figures (1 Wh is 1 %) say that"
        " T-Chrono's module gave some 100 Wh then, a tenth of a clear afternoon's."
    )
    left_out = (
        "The model cannot show: reflections near the cube, which the paper holds responsible for the over-tilt; the"
        " real sky of the two days; spectrum, soiling and the reflection of the modules' glass; the warmth that a"
        " module keeps when the light changes; shade and a bent frame."
    )
    return [assumed, closed_sky, variable, left_out]


def as_text(found: Sequence[Spread]) -> str:
    """Return the paper's gains and ours side by side, as text for people."""
    heads = ("period", "sky", "paper/%", "asked for/%", "within", "median/%", "quartiles", "lowest..highest")
    lines = [heads, *((one.printed.span.name, one.sky, *_numbers(one)) for one in found)]
    return "\n".join(table(lines, keys=2)) + "\n"


def as_dict(one: Spread) -> dict[str, Any]:
    """Return one period under one sky for scripts; gains in percent, infinite where there is no bound."""
    printed = one.printed
    return {
        "period": printed.span.name,
        "paper_pct": printed.paper_pct,
        "asked_for_pct": (printed.lowest_pct, printed.highest_pct),
        "sky": one.sky,
        "median_pct": one.median_pct,
        "quartiles_pct": one.quartiles_pct,
        "gains_pct": one.gains_pct,
        "within": one.count_within_bounds if one.has_bounds else None,
    }


def write_paper(
    runs: Sequence[Run],
    correction: Correction,
    found: Sequence[Spread],
    paragraphs: Sequence[str],
    site: Site,
    out: Path,
) -> None:
    """Write ``paper.txt``, ``paper.csv`` with every run, the first run's figures and ``paper.html``; `UserError`."""
    text = as_text(found) + "\n" + "\n\n".join(paragraphs) + "\n"
    columns = ("period", "sky", "paper %", "asked for %", "within", "median %", "quartiles", "lowest..highest")
    table = Table(
        "Equation (16), paper and ours",
        columns,
        [(one.printed.span.name, one.sky, *_numbers(one)) for one in found],
    )
    shown = [captioned_bias_figure(correction.flat, correction.found)]
    paragraphs = list(paragraphs)
    for first in (run for run in runs if run.pairs):
        shown = [one for one in (modelled_curve(first.pairs[0]),) if one is not None] + shown
        for day in first.pairs:
            shown += experiment_figures(day, correction.found, site)
        paragraphs.append(f"The figures are of the sky {first.sky} and seed {first.seed}.")
    try:
        out.mkdir(parents=True, exist_ok=True)
        replace_file(out / "paper.txt", text)
        with atomic_text_file(out / "paper.csv") as file:
            rows = csv.writer(file, lineterminator="\n")
            names = ("sky", "seed", "period", "cube_wh", "chrono_wh", "gain_pct", "irradiation_pct", "simulated")
            rows.writerow(names)
            for run in runs:
                for row in run.gains:
                    numbers = (row.cube_wh, row.chrono_wh, row.gain_pct, row.irradiation_pct)
                    rows.writerow((run.sky, run.seed, row.period, *(f"{value:z.4f}" for value in numbers), "true"))
    except OSError as error:
        raise UserError(f"--out: {out} cannot be written to: {error.strerror}") from None
    title = "T-Cube and T-Chrono at SIRTA, 12 and 14 October 2022, simulated"
    write_page(out / "paper.html", title, paragraphs, [table, fit_table(correction.found)], shown)


def _bounds(printed: PaperGain) -> str:
    if np.isinf(printed.highest_pct):
        return f"{printed.lowest_pct:+g} or more"
    return f"{printed.lowest_pct:+g}..{printed.highest_pct:+g}"


def _numbers(one: Spread) -> tuple[str, ...]:
    printed, (low, high) = one.printed, one.quartiles_pct
    asked = (signed(printed.paper_pct, 2), _bounds(printed), one.within_bounds_text)
    all_of_them = f"{min(one.gains_pct):+z.2f}..{max(one.gains_pct):+z.2f}"
    return (*asked, signed(one.median_pct, 2), f"{low:+z.2f}..{high:+z.2f}", all_of_them)
