"""`heliocube compare`: two trackers side by side, as in the paper's experiment."""

from contextlib import ExitStack, contextmanager
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, TypeVar

import typer
from rich.console import Console

from daemon.base.errors import UserError
from daemon.base.process import signals_as_ctrl_c
from daemon.commands.answers import JsonOption, print_json, say, warn
from daemon.commands.options import ClusterOption, ForceOption, JobsOption, TableFormat, checked_seed, chosen_workers
from daemon.config.plugin_sections import DEFAULT_LAW, FALLBACK_LAW
from daemon.store.outputs import check_outputs
from daemon.studies.compare.spans import parse_span
from daemon.studies.inputs import check_data_files, check_weather_file, instant, parse_site, site_values, weather_choice

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from daemon.base.records import Record
    from daemon.studies.compare.pairs import Pairs
    from solar.ephemeris import Site

Name = TypeVar("Name", bound=str)

app = typer.Typer(help="Compare two trackers: T-Cube and T-Chrono.", no_args_is_help=True)


DataArgument = Annotated[
    list[Path] | None,
    typer.Argument(metavar="[POWERS]...", help="CSV (or .gz) or Parquet: time, tracker, pmpp_w and more."),
]
StoreOption = Annotated[
    list[str] | None,
    typer.Option(
        metavar="[NAME=]DIR|URL",
        help="Folder of a store, or URL of an archive; NAME= in front names its tracker. May be repeated.",
    ),
]
CubeOption = Annotated[str, typer.Option(metavar="NAME", help="The tracker whose gain is asked for.")]
ChronoOption = Annotated[str, typer.Option(metavar="NAME", help="The tracker it is compared with.")]
ConfigOption = Annotated[Path | None, typer.Option("--config", "-c", metavar="FILE", help="Configuration file.")]
LawsOption = Annotated[str, typer.Option(metavar="LAW,LAW", help="Laws of T-Cube and T-Chrono.")]


@app.command()
@signals_as_ctrl_c()
def simulate(
    start: Annotated[str, typer.Option(metavar="UTC", help="First day or instant, such as 2022-10-12.")],
    out: Annotated[
        Path | None,
        typer.Option(
            metavar="DIR", help="Folder for powers.csv, computed from the true poses; created if it is missing."
        ),
    ] = None,
    store: Annotated[
        Path | None,
        typer.Option(metavar="DIR", help="Folder of a store for all records, with I-V curves by simulated loads."),
    ] = None,
    days: Annotated[float, typer.Option(min=0.01, max=366, help="How many days.")] = 1.0,
    weather: Annotated[
        str | None, typer.Option(metavar="SKY", help="clear, overcast, variable, broken, or a measured file.")
    ] = None,
    laws: LawsOption = f"{DEFAULT_LAW},{FALLBACK_LAW}",
    config: ConfigOption = None,
    site: Annotated[
        str | None, typer.Option(metavar="LAT,LON[,ALT]", help="Site: degrees north, degrees east, metres.")
    ] = None,
    seed: Annotated[
        int | None,
        typer.Option(min=0, callback=checked_seed, metavar="NUMBER", help="Seed of the weather and the noise."),
    ] = None,
    table_format: Annotated[TableFormat, typer.Option("--format", help="Kind of table.")] = TableFormat.csv,
    force: ForceOption = False,
    as_json: JsonOption = False,
) -> None:
    """Run both trackers on one simulated cube, and measure both modules every 5 s."""
    from daemon.commands.progress import progress_bar
    from daemon.config.file import load_settings, override
    from daemon.config.settings import Settings

    if out is None and store is None:
        raise UserError("compare simulate needs --out DIR for a table, --store DIR for a store, or both")
    names = _laws(laws)
    if out is not None:
        check_outputs([out / f"powers.{table_format.value}"], "--out", force=force)
    changes: dict[str, dict[str, Any]] = {"simulation": {}, "load": {"driver": "none"}}
    if store is not None:
        changes["load"] = {"driver": "simulated", "keep_curves": True}
    if weather is not None:
        changes["simulation"]["weather"] = chosen = weather_choice(weather)
        if isinstance(chosen, Path):
            check_weather_file(chosen)
    if seed is not None:
        changes["simulation"]["seed"] = seed
    if site is not None:
        changes["site"] = site_values(site)
    settings = override(Settings() if config is None else load_settings(config), changes)
    begin_s = instant(start, "--start").timestamp()
    from daemon.rigs.simulated import build_simulated_pair, build_weather
    from daemon.studies.compare.measurements import writer
    from daemon.studies.compare.side_by_side import MODULES, T_CHRONO, T_CUBE, run_side_by_side, two_trackers
    from daemon.studies.compare.stored import open_simulation_stores
    from solar.ephemeris import DAY_S

    sky, warning = build_weather(settings, begin_s, begin_s + days * DAY_S, with_gaps=True)
    console = Console(stderr=True)
    if warning:
        warn(warning)
    with ExitStack() as stack:
        tables = None if out is None else stack.enter_context(writer(out, table_format.value, force=force))
        keep: Callable[[str, Record], None] = _drop_record
        if store is not None:
            keep = stack.enter_context(open_simulation_stores(settings, (T_CUBE, T_CHRONO), store, begin_s))
        with progress_bar(console) as progress:
            measured = run_side_by_side(
                settings,
                two_trackers(*names),
                lambda clock: build_simulated_pair(settings, clock, sky, MODULES),
                begin_s,
                days,
                keep,
                progress,
            )
        if not measured:
            raise UserError("there was no light in the simulated time: choose another --start or more --days")
        if tables is not None:
            for one in measured:
                tables.write(one)
    place = settings.site
    if as_json:
        table = None if out is None else out / f"powers.{table_format.value}"
        print_json(
            {"simulated": True, "site": place, "laws": names, "powers": len(measured), "table": table, "store": store}
        )
        return
    say(
        f"SIMULATED {place.name} ({place.latitude_deg:g}, {place.longitude_deg:g}), T-Cube {names[0]}, T-Chrono"
        f" {names[1]}, weather {settings.simulation.weather}, sky {settings.simulation.sky}, seed"
        f" {settings.simulation.seed}"
    )
    if out is not None:
        say(f"{len(measured)} powers in {out / f'powers.{table_format.value}'}")
    if store is not None:
        say(f"all records of both trackers in the store {store}")


@app.command()
@signals_as_ctrl_c()
def fit(
    out: Annotated[Path, typer.Option(metavar="FILE", help="JSON file for the bias; figures get the same name.")],
    data: DataArgument = None,
    store: StoreOption = None,
    start: Annotated[
        str | None, typer.Option("--from", metavar="UTC", help="Begin of the time in which both lay flat.")
    ] = None,
    end: Annotated[
        str | None, typer.Option("--to", metavar="UTC", help="End of that time; this instant itself is not included.")
    ] = None,
    cube: CubeOption = "T-Cube",
    chrono: ChronoOption = "T-Chrono",
    force: ForceOption = False,
    as_json: JsonOption = False,
) -> None:
    """Find the bias between the two measuring chains from a time in which both trackers lay flat."""
    check_outputs([out], "--out", force=force)
    check_outputs([out.with_suffix(".png"), out.with_suffix(".svg")], "--out", force=force)
    _check_measurements(data, store, cube, chrono)
    from daemon.studies.compare import figures
    from daemon.studies.compare.fit import as_text, flat_pairs, write
    from daemon.studies.compare.fit import fit as fit_bias
    from daemon.studies.stamp import stamp_simulated

    pairs, _ = _pairs(data, store, cube, chrono)
    flat = flat_pairs(
        pairs,
        None if start is None else instant(start, "--from"),
        None if end is None else instant(end, "--to"),
    )
    found = fit_bias(flat)
    write(found, out)
    figures.save(stamp_simulated(figures.bias_figure(flat, found), flat.simulated), out.parent, out.stem)
    if as_json:
        agreement = {"before": found.before._asdict(), "after": found.after._asdict()}
        print_json(asdict(found) | agreement | {"written": out})
        return
    if flat.simulated:
        say("SIMULATED")
    say(as_text(found), end="")
    say(f"written to {out}; figure: {out.with_suffix('.png').name} and {out.with_suffix('.svg').name}")


@app.command()
@signals_as_ctrl_c()
def report(
    out: Annotated[Path, typer.Option(metavar="DIR", help="Folder for report.html, gains.csv and the figures.")],
    data: DataArgument = None,
    store: StoreOption = None,
    site: Annotated[
        str | None,
        typer.Option(metavar="LAT,LON[,ALT]", help="Site of the trackers; not needed with a store, which has it."),
    ] = None,
    bias: Annotated[Path | None, typer.Option(metavar="FILE", help="File of 'heliocube compare fit'.")] = None,
    period: Annotated[
        list[str] | None,
        typer.Option(
            metavar="NAME=FROM/TO", help="A period by the clock, instead of those by the sky. May be repeated."
        ),
    ] = None,
    cube: CubeOption = "T-Cube",
    chrono: ChronoOption = "T-Chrono",
    force: ForceOption = False,
    as_json: JsonOption = False,
) -> None:
    """Report what T-Cube gained over T-Chrono, equation (16), by day and period, with the paper's figures."""
    check_outputs([out / "report.html", out / "gains.csv"], "--out", force=force)
    _check_measurements(data, store, cube, chrono)
    spans = [parse_span(text) for text in period or []]
    from daemon.studies.compare.fit import flat_pairs, read
    from daemon.studies.compare.gains import as_text, check_spans, extrapolation
    from daemon.studies.compare.report import write_report
    from daemon.studies.compare.stored import kept_curve
    from solar.ephemeris import Site

    place = None if site is None else Site(*parse_site(site))
    found = None if bias is None else read(bias)
    pairs, stored_site = _pairs(data, store, cube, chrono)
    place = place or stored_site
    if place is None:
        raise UserError("report needs --site LAT,LON[,ALT]: tables do not say where the trackers are")
    check_spans(pairs, spans)
    if found is not None and found.names != (cube, chrono):
        raise UserError(
            f"--bias: {bias} corrects {found.names[0]} to {found.names[1]}, not {cube} to {chrono}: fit it again"
        )
    if found is not None and found.simulated and not pairs.simulated:
        raise UserError(
            f"--bias: {bias} was fitted to simulated powers and cannot correct measured ones: fit it to a time in which"
            f" your {cube} and {chrono} lay flat"
        )
    try:
        flat = flat_pairs(pairs)
    except UserError:
        # The days of the fit need not be among those of the report.
        flat = None
    with _readable(store or []) as folders:
        curve = kept_curve(folders, cube)
    rows = write_report(pairs, found, flat, place, spans, curve, out, force=force)
    far = extrapolation(rows, cube)
    if far is not None:
        warn(far)
    if as_json:
        page = {"simulated": pairs.simulated, "trackers": pairs.names, "corrected": found is not None}
        print_json(page | {"gains": rows, "page": out / "report.html"})
        return
    if pairs.simulated:
        say("SIMULATED")
    say(as_text(rows, pairs.names), end="")
    if found is None:
        say(f"{cube}'s power is not corrected: name the file of 'heliocube compare fit' with --bias")
    say(f"figures and page: {out / 'report.html'}")


@app.command()
@signals_as_ctrl_c()
def paper(
    out: Annotated[
        Path, typer.Option(metavar="DIR", help="Folder for paper.html, paper.txt, paper.csv and the figures.")
    ],
    skies: Annotated[
        str, typer.Option(metavar="SKY,SKY", help="Models of diffuse light: haydavies, perez1990, isotropic.")
    ] = "haydavies,perez1990",
    seeds: Annotated[int, typer.Option(min=1, max=1000, help="Number of simulated weathers for each model.")] = 30,
    afternoon: Annotated[
        str, typer.Option(metavar="SKY", help="Built-in weather after 12:10 on the 12th: broken or variable.")
    ] = "broken",
    law: Annotated[str, typer.Option(metavar="LAW", help="Law of T-Cube.")] = DEFAULT_LAW,
    config: ConfigOption = None,
    jobs: JobsOption = 1,
    cluster: ClusterOption = None,
    force: ForceOption = False,
    as_json: JsonOption = False,
) -> None:
    """Repeat the paper's experiment of 12 and 14 October 2022 on built-in weather, and print its gains and ours."""
    workers = chosen_workers(jobs, cluster)
    check_outputs(list(_paper_files(out)), "--out", force=force)
    from typing import get_args

    from daemon.config.plugin_sections import law_names
    from daemon.config.simulation import WeatherName
    from solar.skies.sky import SKY_MODELS, SkyModel

    chosen: list[SkyModel] = [_one_of(text, SKY_MODELS, "--skies") for text in _words(skies)]
    if not chosen:
        raise UserError(f"--skies: name at least one of {', '.join(SKY_MODELS)}")
    names: tuple[WeatherName, ...] = get_args(WeatherName)
    weather, cube_law = _one_of(afternoon, names, "--afternoon"), _one_of(law, law_names(), "--law")
    from daemon.commands.progress import progress_bar
    from daemon.config.file import load_settings
    from daemon.config.settings import Settings
    from daemon.studies.compare.paper import as_dict, as_text, find_correction, notes, run_paper, spreads, write_paper
    from daemon.studies.spread.workers import check_workers

    settings = Settings()
    if config is not None:
        # The site stays the paper's, as the periods are fixed by the clock there.
        settings = load_settings(config).model_copy(update={"site": settings.site})
    check_workers(workers)
    with progress_bar(Console(stderr=True), "correcting") as progress:
        correction = find_correction(settings, progress)
    with progress_bar(Console(stderr=True), "repeating") as progress:
        runs, ended = run_paper(settings, chosen, seeds, weather, cube_law, correction.found, workers, progress)
    asked = len(chosen) * seeds
    found, paragraphs = spreads(runs, cube_law), notes(settings, weather, cube_law, seeds, done=len(runs), asked=asked)
    write_paper(runs, correction, found, paragraphs, settings.site.place(), out)
    if as_json:
        page = {"simulated": True, "periods": [as_dict(one) for one in found], "notes": paragraphs}
        print_json(page | {"page": out / "paper.html"})
    else:
        say(as_text(found))
        say("\n\n".join(paragraphs))
        say(f"\nfigures and page: {out / 'paper.html'}")
    if ended is not None:
        raise type(ended)(f"{ended}; {out} has {len(runs)} of {asked} runs")


def _paper_files(out: Path) -> "Iterator[Path]":
    """Yield the files of `compare paper`, without loading scientific libraries: its two days are fixed."""
    yield from (out / name for name in ("paper.html", "paper.txt", "paper.csv"))
    days = ("2022-10-12", "2022-10-14")
    figures = ("curve", "bias", *(f"{what}-{day}" for day in days for what in ("power", "movement")))
    yield from (out / f"{name}.{ending}" for name in figures for ending in ("png", "svg"))


def _drop_record(_name: str, _record: object) -> None:
    """Drop a record: nobody keeps it."""


def _check_measurements(data: list[Path] | None, stores: list[str] | None, cube: str, chrono: str) -> None:
    """Raise `UserError` if no measurements can come from these, before scientific libraries are loaded."""
    if cube == chrono:
        raise UserError(f"--cube and --chrono both name '{cube}': two trackers are needed")
    if bool(data) is bool(stores):
        raise UserError("measurements come either from tables, POWERS..., or from --store DIR: name one of them")
    check_data_files(data or (), "measured powers")


def _pairs(data: list[Path] | None, stores: list[str] | None, cube: str, chrono: str) -> "tuple[Pairs, Site | None]":
    """Return the measurements of tables or stores, joined in pairs, and the site if they are from stores."""
    from daemon.studies.compare.pairs import pair, read_tables
    from daemon.studies.compare.stored import read_stores

    if data:
        frame, notes = read_tables(data)
        for note in notes:
            warn(note)
        return pair(frame, (cube, chrono)), None
    with _readable(stores or []) as folders:
        frame, site = read_stores(folders)
    return pair(frame, (cube, chrono)), site


@contextmanager
def _readable(stores: list[str]) -> "Iterator[list[tuple[str | None, Path]]]":
    """Yield the names and folders of stores, of which some may be copies of archives."""
    from daemon.archive.address import is_archive
    from daemon.commands.archive.readable import open_store_or_archive
    from daemon.studies.compare.stored import parse_store

    with ExitStack() as stack:
        # An archive's address may contain an equals sign, which does not end a name.
        named = [(None, text) if is_archive(text) else parse_store(text) for text in stores]
        yield [(name, stack.enter_context(open_store_or_archive(str(place)))[0]) for name, place in named]


def _words(text: str) -> list[str]:
    return list(dict.fromkeys(word.strip() for word in text.split(",") if word.strip()))


def _one_of(text: str, known: tuple[Name, ...], option: str) -> Name:
    for name in known:
        if name == text:
            return name
    raise UserError(f"{option}: there is no '{text}'; choose one of {', '.join(known)}")


def _laws(text: str) -> Any:
    from daemon.config.plugin_sections import law_names

    names = [word.strip() for word in text.split(",")]
    if len(names) != 2:
        raise UserError(
            f"--laws: '{text}' is not two laws, T-Cube's and T-Chrono's, such as {DEFAULT_LAW},{FALLBACK_LAW}"
        )
    return tuple(_one_of(name, law_names(), "--laws") for name in names)
