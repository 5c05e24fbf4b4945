"""`heliocube energy`: what the laws harvest on measured weather."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.console import Console

from daemon.base.errors import InterruptedEarlyError, UserError
from daemon.base.files import replace_file
from daemon.base.process import signals_as_ctrl_c
from daemon.commands.answers import JsonOption, print_json, say, warn
from daemon.commands.options import ClusterOption, ForceOption, JobsOption, checked_seed, chosen_workers
from daemon.commands.progress import progress_bar
from daemon.store.outputs import check_outputs

if TYPE_CHECKING:
    # The command line imports this module to show its help, which must not wait for scientific libraries.
    from daemon.studies.energy.benchmark import Assumptions, EnergyRow, MinuteWeather
    from daemon.studies.energy.losses import Losses
    from daemon.studies.energy.worth import Prices
    from daemon.studies.sites.table import AskedSite
    from daemon.studies.spread.workers import Workers
    from solar.energy import DaylightWeather

_ENDINGS = ("txt", "csv", "png")


@signals_as_ctrl_c()
def energy(
    out: Annotated[
        Path,
        typer.Option(metavar="DIR", help="Folder for energy.txt, energy.csv and energy.png; created if it is missing."),
    ],
    weather: Annotated[
        list[Path] | None,
        typer.Argument(metavar="[WEATHER]...", help="Measured weather (CSV, BSRN, SURFRAD, MIDC, TMY3)."),
    ] = None,
    site: Annotated[
        str | None, typer.Option(metavar="LAT,LON[,ALT]", help="Site of the weather: degrees north, east, metres.")
    ] = None,
    sites: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE",
            help="Many sites instead: CSV with name, latitude, longitude and, optionally, altitude, weather (files, or"
            " a built-in sky) and its year. Writes energy-sites.txt, .csv and a map, .png.",
        ),
    ] = None,
    model: Annotated[
        str | None,
        typer.Option(
            metavar="SKY", help="Built-in sky of sites without weather: clear, overcast, variable, broken. SIMULATED."
        ),
    ] = None,
    seed: Annotated[
        int,
        typer.Option(
            min=0,
            callback=checked_seed,
            metavar="NUMBER",
            help="Seed of the built-in skies and of the random part of --losses.",
        ),
    ] = 1,
    laws: Annotated[
        str | None,
        typer.Option(
            help="Laws, separated by commas; all if left out. fixed:DEG is a fixed tilt, bound the best pointing"
            " possible, NAME:VALUE a law with this value of its one parameter, such as its thrift."
        ),
    ] = None,
    sky: Annotated[
        str,
        typer.Option(
            help="Skies, separated by commas: isotropic, haydavies, perez1990, perez1993 (all-weather radiance), cie"
            " (standard skies with drifting clouds)."
        ),
    ] = "perez1990",
    albedo: Annotated[float, typer.Option(min=0, max=1, help="Albedo of the ground.")] = 0.2,
    speed: Annotated[
        float, typer.Option("--axis-speed", min=0.01, max=90, metavar="DEG/S", help="Speed of each axis.")
    ] = 0.9,
    ideal: Annotated[bool, typer.Option("--ideal", help="Instant moves, no deadband.")] = False,
    peak_kw: Annotated[
        float | None,
        typer.Option(
            min=0.001,
            metavar="KW",
            help="Power of the modules at 1 kW/m2. With the next three options: earnings and wear by each law.",
        ),
    ] = None,
    price: Annotated[float | None, typer.Option(min=0, metavar="MONEY", help="Price of a kWh.")] = None,
    drive_price: Annotated[
        float | None, typer.Option(min=0, metavar="MONEY", help="Price of new drives for both axes, installed.")
    ] = None,
    drive_life_deg: Annotated[
        float | None, typer.Option(min=1, metavar="DEG", help="Travel that the drives last, A and B added.")
    ] = None,
    losses: Annotated[
        bool,
        typer.Option(
            "--losses",
            help="Instead, show by cause and type of day where the law optimal stays below the bound. Writes"
            " energy-losses.txt, .csv and .png.",
        ),
    ] = False,
    jobs: JobsOption = 1,
    cluster: ClusterOption = None,
    force: ForceOption = False,
    as_json: JsonOption = False,
) -> None:
    """Compare pointing laws on measured weather: energy, travel and moves, by type of day."""
    from daemon.studies.energy.names import LOSSES_LAW, check_laws_of_losses, check_names, default_names
    from daemon.studies.inputs import check_weather_file, parse_site

    skies, names = _words(sky), _words(laws) if laws is not None else [LOSSES_LAW] if losses else list(default_names())
    check_names(skies, names)
    speed_deg_per_s, workers = None if ideal else speed, chosen_workers(jobs, cluster)
    prices = _prices(peak_kw, price, drive_price, drive_life_deg)
    if sites is not None:
        if weather or site is not None:
            raise UserError("--sites has the place and the weather of each site: leave out WEATHER and --site")
        if prices is not None or losses:
            raise UserError("--losses, --peak-kw and the prices are for the weather of one site: leave out --sites")
        asked = _asked_sites(sites, model)
        check_outputs([out / f"energy-sites.{ending}" for ending in _ENDINGS], "--out", force=force)
        _compare_sites(asked, out, skies, names, albedo, speed_deg_per_s, seed, workers, as_json=as_json)
        return
    if not workers.is_this_process or model is not None:
        raise UserError("--jobs, --cluster and --model are for many sites: name their table with --sites")
    if not weather or site is None:
        raise UserError("energy needs weather files and their --site LAT,LON, or a table of sites, --sites FILE")
    place = parse_site(site)
    for path in weather:
        check_weather_file(path, built_in=())
    if losses:
        if prices is not None:
            raise UserError("--losses gives no amounts of money: leave out --peak-kw and the prices")
        check_laws_of_losses(names)
        check_outputs([out / f"energy-losses.{ending}" for ending in _ENDINGS], "--out", force=force)
        laid = _read_weather(weather, place, albedo, speed_deg_per_s)
        _print_losses(laid, out, skies, names, seed, as_json=as_json)
        return
    check_outputs([out / f"energy.{ending}" for ending in _ENDINGS], "--out", force=force)
    laid = _read_weather(weather, place, albedo, speed_deg_per_s)
    _compare(laid, out, skies, names, prices, as_json=as_json)


def _prices(
    peak_kw: float | None, price: float | None, drive_price: float | None, drive_life_deg: float | None
) -> "Prices | None":
    if peak_kw is None or price is None or drive_price is None or drive_life_deg is None:
        if any(given is not None for given in (peak_kw, price, drive_price, drive_life_deg)):
            raise UserError("the worth of a law needs all of --peak-kw, --price, --drive-price and --drive-life-deg")
        return None
    from daemon.studies.energy.worth import Prices

    return Prices(peak_kw=peak_kw, per_kwh=price, drive=drive_price, life_deg=drive_life_deg)


def _compare(
    laid: "tuple[MinuteWeather, DaylightWeather, Assumptions]",
    out: Path,
    skies: list[str],
    names: list[str],
    prices: "Prices | None",
    *,
    as_json: bool,
) -> None:
    from daemon.studies.energy import worth
    from daemon.studies.energy.benchmark import as_dict, as_text, run_benchmark, write_csv
    from daemon.studies.energy.plot import plot

    minutes, days, assumptions = laid
    ended: UserError | None = None
    rows: list[EnergyRow] = []
    with progress_bar(Console(stderr=True), "comparing") as progress:
        try:
            for row in run_benchmark(days, skies, names, assumptions, progress):
                rows.append(row)  # noqa: PERF402 - what is there counts when the next one is interrupted
        except KeyboardInterrupt:
            if not rows:
                raise
            ended = InterruptedEarlyError("interrupted")
        except UserError as error:
            if not rows:
                raise
            ended = error
    simulated = minutes.simulated
    text = as_text(rows, days, assumptions, simulated=simulated)
    page = as_dict(rows, days, assumptions, simulated=simulated)
    if prices is not None:
        years = worth.years_known(minutes.utc_s, days)
        worths = worth.worths(rows, days.whole_days(), years, prices)
        text += worth.as_text(worths, years, prices)
        page["worth"] = worth.as_dict(worths, prices)
    with _writing_to(out):
        replace_file(out / "energy.txt", text)
        write_csv(rows, out / "energy.csv", simulated=simulated)
        plot(rows, out / "energy.png", simulated=simulated)
    if as_json:
        print_json(page | {"tables": out, "warnings": minutes.warnings})
    else:
        Console().print(text, markup=False, highlight=False, soft_wrap=True, end="")
    if ended is not None:
        raise type(ended)(f"{ended}: {out} has {len(rows)} of {len(skies) * len(names)} laws")
    if not as_json:
        _say_written(out, "energy")


def _print_losses(
    laid: "tuple[MinuteWeather, DaylightWeather, Assumptions]",
    out: Path,
    skies: list[str],
    names: list[str],
    seed: int,
    *,
    as_json: bool,
) -> None:
    from daemon.studies.energy.losses import as_dict, as_text, run_losses, write_csv
    from daemon.studies.energy.losses_plot import plot

    minutes, days, assumptions = laid
    found: list[Losses] = []
    done = "all"
    with progress_bar(Console(stderr=True), "comparing") as progress:
        try:
            for losses in run_losses(days, skies, names, assumptions, seed, progress):
                found.append(losses)  # noqa: PERF402 - what is there counts when the next one is interrupted
        except KeyboardInterrupt:
            done = f"{len(found)} of {len(skies) * len(names)}"
            if not found:
                raise
    text = as_text(found, days, assumptions, simulated=minutes.simulated)
    with _writing_to(out):
        replace_file(out / "energy-losses.txt", text)
        write_csv(found, out / "energy-losses.csv", simulated=minutes.simulated)
        plot(found, out / "energy-losses.png", simulated=minutes.simulated)
    if as_json:
        print_json(as_dict(found, simulated=minutes.simulated) | {"tables": out, "warnings": minutes.warnings})
    else:
        Console().print(text, markup=False, highlight=False, soft_wrap=True, end="")
    if done != "all":
        raise InterruptedEarlyError(f"interrupted: the losses in {out} are those of {done} laws")
    if not as_json:
        _say_written(out, "energy-losses")


def _read_weather(
    weather: list[Path], place: tuple[float, float, float], albedo: float, speed_deg_per_s: float | None
) -> "tuple[MinuteWeather, DaylightWeather, Assumptions]":
    """Read the weather and print its warnings; return it, its daylight, and what the benchmark assumes."""
    from daemon.studies.energy.benchmark import IDEAL_DRIVE, Assumptions, read_minute_weather
    from solar.energy import Drive, arrange_daylight
    from solar.ephemeris import Site
    from solar.frames import Limits

    minutes = read_minute_weather(weather, Site(*place))
    for warning in minutes.warnings:
        warn(warning)
    try:
        days = arrange_daylight(minutes.utc_s, minutes.dni_w_m2, minutes.dhi_w_m2, Site(*place))
    except ValueError as error:
        raise UserError(f"the weather cannot be used: {error}") from error
    return (
        minutes,
        days,
        Assumptions(albedo, Limits(), IDEAL_DRIVE if speed_deg_per_s is None else Drive(speed_deg_per_s)),
    )


@contextmanager
def _writing_to(out: Path) -> Iterator[None]:
    """Make the folder; raise `UserError` if it cannot be written to."""
    try:
        out.mkdir(parents=True, exist_ok=True)
        yield
    except OSError as error:
        raise UserError(f"--out: {out} cannot be written to: {error.strerror}") from error


def _asked_sites(path: Path, model: str | None) -> "list[AskedSite]":
    from typing import get_args

    from daemon.config.simulation import WeatherName
    from daemon.studies.sites.table import read_sites

    names: tuple[WeatherName, ...] = get_args(WeatherName)
    chosen = next((name for name in names if name == model), None)
    if chosen is None and model is not None:
        raise UserError(f"--model: there is no '{model}'; choose one of {', '.join(names)}")
    return read_sites(path, chosen)


def _compare_sites(
    sites: "list[AskedSite]",
    out: Path,
    skies: list[str],
    names: list[str],
    albedo: float,
    speed_deg_per_s: float | None,
    seed: int,
    workers: "Workers",
    *,
    as_json: bool,
) -> None:
    from daemon.studies.energy.benchmark import IDEAL_DRIVE, Assumptions
    from daemon.studies.sites.map import draw_map
    from daemon.studies.sites.output import as_dict, as_text, write_csv
    from daemon.studies.sites.study import Benchmark, run_sites
    from solar.energy import Drive
    from solar.frames import Limits

    drive = IDEAL_DRIVE if speed_deg_per_s is None else Drive(speed_deg_per_s)
    benchmark = Benchmark(tuple(skies), tuple(names), Assumptions(albedo, Limits(), drive), seed)
    with progress_bar(Console(stderr=True), "comparing") as progress:
        outcomes, ended = run_sites(sites, benchmark, workers, progress)
    for outcome in outcomes:
        for warning in outcome.warnings:
            warn(f"{outcome.site.name}: {warning}")
    refused = [outcome for outcome in outcomes if outcome.refused is not None]
    if len(refused) == len(outcomes):
        raise UserError(f"no site could be used; the first: {refused[0].site.name}: {refused[0].refused}")
    text = as_text(outcomes, benchmark)
    with _writing_to(out):
        replace_file(out / "energy-sites.txt", text)
        write_csv(outcomes, out / "energy-sites.csv")
        draw_map(outcomes, out / "energy-sites.png")
    if as_json:
        print_json(as_dict(outcomes, benchmark) | {"tables": out})
    else:
        Console().print(text, markup=False, highlight=False, soft_wrap=True, end="")
    if ended is not None:
        raise type(ended)(f"{ended}: {out} has {len(outcomes)} of the table's {len(sites)} lines")
    if refused:
        raise UserError(f"{len(refused)} of {len(sites)} sites could not be used: {out} says why")
    if not as_json:
        _say_written(out, "energy-sites")


def _say_written(out: Path, stem: str) -> None:
    say(f"\nwritten to {out}: {', '.join(f'{stem}.{ending}' for ending in _ENDINGS)}")


def _words(text: str) -> list[str]:
    return list(dict.fromkeys(word.strip() for word in text.split(",") if word.strip()))
