"""Runs the energy benchmark at each site, in this process or on workers."""

import zlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime

import numpy as np

from daemon.base.errors import UserError
from daemon.config.file import override
from daemon.config.settings import Settings
from daemon.rigs.simulated import build_weather
from daemon.studies.energy.benchmark import Assumptions, EnergyRow, MinuteWeather, read_minute_weather, run_benchmark
from daemon.studies.sites.table import AskedSite
from daemon.studies.spread.workers import Workers, gather
from solar.energy import arrange_daylight
from solar.ephemeris import Site, sun_direction

_MINUTE_S = 60.0


@dataclass(frozen=True, slots=True)
class Benchmark:
    """What is compared at every site.

    Attributes
    ----------
    skies, laws
        By name.
    assumptions
        Ground and tracker.
    seed
        Seed of built-in weather; each site has clouds of its own from it.
    """

    skies: tuple[str, ...]
    laws: tuple[str, ...]
    assumptions: Assumptions
    seed: int


@dataclass(frozen=True, slots=True)
class SiteOutcome:
    """The results of one site.

    Attributes
    ----------
    site
        The site, as the table has it.
    days
        Days with daylight, rounded; a day that is known in part counts as its share of a day.
    rows
        One for each sky and law.
    simulated
        Whether the weather is a model's, or its file says so.
    warnings
        What a person should know of the weather, a sentence each.
    refused
        Why there are no rows.
    """

    site: AskedSite
    days: int
    rows: tuple[EnergyRow, ...]
    simulated: bool
    warnings: tuple[str, ...]
    refused: str | None = None


@dataclass(frozen=True, slots=True)
class _Task:
    site: AskedSite
    benchmark: Benchmark


def run_sites(
    sites: Sequence[AskedSite], benchmark: Benchmark, workers: Workers, progress: Callable[[float], None]
) -> tuple[list[SiteOutcome], UserError | None]:
    """Return the results of the sites, in their order, and the error that ended the work early, or None.

    A site whose weather cannot be used, or where a law fails, is among them with the reason; the others go on.
    """
    return gather(_run_site, [_Task(site, benchmark) for site in sites], workers, progress)


def _run_site(task: _Task) -> SiteOutcome:
    asked, benchmark = task.site, task.benchmark
    site = Site(*asked.place)
    try:
        minutes = _minutes(asked, site, benchmark.seed)
        days = arrange_daylight(minutes.utc_s, minutes.dni_w_m2, minutes.dhi_w_m2, site)
    except (UserError, ValueError) as error:
        return _refused_outcome(asked, error)
    try:
        rows = tuple(run_benchmark(days, benchmark.skies, benchmark.laws, benchmark.assumptions, lambda _share: None))
    except UserError as error:
        return _refused_outcome(asked, error)
    return SiteOutcome(
        site=asked,
        days=max(round(days.whole_days()), 1),
        rows=rows,
        simulated=minutes.simulated,
        warnings=tuple(minutes.warnings),
    )


def _refused_outcome(asked: AskedSite, error: Exception) -> SiteOutcome:
    return SiteOutcome(site=asked, days=0, rows=(), simulated=False, warnings=(), refused=str(error))


def _minutes(asked: AskedSite, site: Site, seed: int) -> MinuteWeather:
    if isinstance(asked.weather, str):
        return _model_year(asked, site, seed)
    return read_minute_weather(asked.weather, site)


def _model_year(asked: AskedSite, site: Site, seed: int) -> MinuteWeather:
    """Return the daylight of a calendar year (UTC) of built-in weather, with this site's own clouds."""
    year = asked.year or 0
    begin_s, end_s = (datetime(each, 1, 1, tzinfo=UTC).timestamp() for each in (year, year + 1))
    utc_s = np.arange(begin_s, end_s, _MINUTE_S)
    utc_s = utc_s[sun_direction(utc_s, *site)[:, 2] > 0.0]
    own_seed = int(np.random.SeedSequence([seed, zlib.crc32(asked.name.encode())]).generate_state(1)[0])
    place = {"latitude_deg": site.latitude_deg, "longitude_deg": site.longitude_deg, "altitude_m": site.altitude_m}
    settings = override(Settings(), {"site": place, "simulation": {"weather": asked.weather, "seed": own_seed}})
    weather, _ = build_weather(settings, begin_s, end_s)
    conditions = weather.at(utc_s)
    return MinuteWeather(
        utc_s=utc_s, dni_w_m2=conditions.dni_w_m2, dhi_w_m2=conditions.dhi_w_m2, warnings=[], simulated=True
    )
