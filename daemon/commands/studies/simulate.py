"""What `heliocube simulate` prints, the checks before its work, and `heliocube replay`."""

import contextlib
import math
from collections.abc import Iterator
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from rich.console import Console

from daemon.base.errors import InterruptedEarlyError, UserError
from daemon.base.process import signals_as_ctrl_c
from daemon.base.words import pluralise
from daemon.commands.answers import JsonOption, print_json, say, warn
from daemon.commands.options import ForceOption, LawOption, ReportOption, TrackerOption, ZoneOption
from daemon.commands.progress import progress_bar
from daemon.store.outputs import check_outputs
from daemon.studies.text_table import signed

if TYPE_CHECKING:
    from collections.abc import Sequence
    from datetime import tzinfo

    # The command line imports this module to show its help, which must not wait for scientific libraries.
    from daemon.config.settings import Settings
    from daemon.studies.simulate import Summary
    from daemon.studies.simulated_day import PlaneInsolation


def page_of(summary: "Summary", settings: "Settings", out: Path, pages: "Sequence[Path]") -> dict[str, Any]:
    """Return the results of a simulation for scripts."""
    return {
        "simulated": True,
        "site": settings.site,
        "laws": list(dict.fromkeys(own.law.driver for _, own in settings.trackers)),
        "weather": settings.simulation.weather,
        "seed": settings.simulation.seed,
        **asdict(summary),
        "warnings": [*summary.warnings, *summary.failed_laws],
        "tables": out,
        "reports": pages,
    }


def print_summary(summary: "Summary", settings: "Settings", out: Path) -> None:
    """Print what was simulated and where the tables are; a warning goes to standard error."""
    for warning in summary.warnings:
        warn(warning)
    site = settings.site
    hours = ", ".join(f"{mode} {seconds / 3600:.1f} h" for mode, seconds in summary.mode_s.items() if seconds >= 180)
    laws = ", ".join(dict.fromkeys(own.law.driver for _, own in settings.trackers))
    several = len(settings.trackers) > 1
    together = f"of {len(settings.trackers)} trackers together " if several else ""
    lines = (
        (
            f"SIMULATED {site.name} ({site.latitude_deg:g}, {site.longitude_deg:g}), law {laws}, "
            f"weather {settings.simulation.weather}, seed {settings.simulation.seed}"
        ),
        (
            f"{pluralise(summary.scans, 'scan')}, {together}{pluralise(summary.decisions, 'decision')}, "
            f"{pluralise(summary.moves, 'move')}, {summary.travel_deg:.0f} degrees of travel"
        ),
        f"modes{', together' if several else ''}: {hours}",
        *_lines_of_planes(summary.insolation),
        *(["this leaves out the shade of neighbours"] if any(own.rows.east_m for _, own in settings.trackers) else []),
        f"tables in {out}",
    )
    for line in [*lines[:1], *summary.failed_laws, *lines[1:]]:
        say(line)


def _lines_of_planes(planes: "Sequence[PlaneInsolation]") -> list[str]:
    if len(planes) <= _MOST_LINES:
        return [_line_of_plane(each, several=len(planes) > 1) for each in planes]
    least, most = (choose(planes, key=lambda each: each.gain_pct) for choose in (min, max))
    return [f"on the modules of {len(planes)} trackers, from the least to the most:"] + [
        _line_of_plane(each, several=True) for each in (least, most)
    ]


def _line_of_plane(one: "PlaneInsolation", *, several: bool) -> str:
    of = f" of {one.tracker}" if several else ""
    gain = "no light" if math.isnan(one.gain_pct) else f"{signed(one.gain_pct, 2)} %"
    return (
        f"on the module{of}: {one.received_kwh_m2:.2f} kWh/m2 by {one.law}, {one.chronometric_kwh_m2:.2f} where an"
        f" ideal chronometric tracker stands: {gain}"
    )


_MOST_LINES = 10
_PICTURES = ("light", "angles", "received")


def checked_pictures(plot: Path | None, settings: "Settings", *, force: bool) -> "Sequence[Path]":
    """Return the files of the wanted pictures, checked before the work; raises `UserError`."""
    if plot is None:
        return ()
    if plot.suffix.lower() not in (".png", ".svg"):
        raise UserError(f"--plot: {plot} must end in .png or .svg")
    if len(settings.trackers) > 1:
        raise UserError("--plot is for one tracker: draw several with 'heliocube plot --tables DIR --tracker NAME'")
    paths = [plot.with_name(f"{plot.stem}-{name}{plot.suffix}") for name in _PICTURES]
    check_outputs(paths, "--plot", force=force)
    return paths


def draw_pictures(paths: "Sequence[Path]", settings: "Settings", tables: Path, zone: "tzinfo | None") -> None:
    """Draw light, angles and what the plane received, from the tables of a simulation."""
    from daemon.studies.report.plot import draw, material_of_tables

    draw(material_of_tables(tables, None, settings, None, None), _PICTURES, paths, zone)


def check_report_and_zone(
    out: Path | None, zone: str | None, settings: "Settings", span: tuple[float, float], *, force: bool
) -> "tzinfo | None":
    """Check before the work whether its report can be written, and return the zone of local times.

    Pictures without a report have local times too. Raises `UserError`.
    """
    if out is None and zone is None:
        return None
    from daemon.studies.report.choices import zone_of

    local = zone_of(zone)
    if out is None:
        return local
    from daemon.studies.report.studies import span_of
    from daemon.studies.report.write import check_output, file_name

    names = [file_name(span_of(*span).name, name) for name, _ in settings.trackers]
    check_output(out, names, "--report", force=force)
    return local


def missing_page_clause(report_to: Path | None) -> str:
    """Return the end of the sentence about an interruption: it says that no page was written, if one was wanted."""
    return "" if report_to is None else ", and no page was written"


@contextlib.contextmanager
def explain_missing_pages(what: str) -> Iterator[None]:
    """Let Ctrl-C report `what` is kept while pictures and pages are made; raises `InterruptedEarlyError`."""
    try:
        yield
    except KeyboardInterrupt:
        raise InterruptedEarlyError(f"interrupted: {what}, but not all pictures and pages are") from None


def print_written_paths(paths: "Sequence[Path]") -> None:
    """Say where pages or pictures are."""
    for path in paths:
        say(f"written: {path}")


@signals_as_ctrl_c()
def replay(
    out: Annotated[
        Path, typer.Option(metavar="FILE", help="File for the positions, one line per reading: .csv or .csv.gz.")
    ],
    faces: Annotated[
        Path | None,
        typer.Argument(metavar="FACES.csv", help="CSV with time,east,south,west,zenith (UTC, W/m2), plain or .gz."),
    ] = None,
    site: Annotated[
        str | None,
        typer.Option(
            metavar="LAT,LON[,ALT]", help="Site: degrees north, degrees east, metres; if left out, that of --config."
        ),
    ] = None,
    law: LawOption = None,
    store: Annotated[Path | None, typer.Option(metavar="DIR", help="Folder of a store, instead of FACES.csv.")] = None,
    config: Annotated[Path | None, typer.Option("--config", "-c", metavar="FILE", help="Configuration file.")] = None,
    tracker: TrackerOption = None,
    report_to: ReportOption = None,
    zone: ZoneOption = None,
    force: ForceOption = False,
    as_json: JsonOption = False,
) -> None:
    """Let recorded cube data drive a simulated tracker, through the code that runs live."""
    from daemon.config.settings import settings_of_tracker
    from daemon.store.outputs import check_outputs
    from daemon.studies.inputs import check_regular_file, settings_for, site_values

    if (faces is None) is (store is None):
        raise UserError("replay needs either FACES.csv or --store DIR")
    if site is None and config is None:
        raise UserError("replay needs --site LAT,LON[,ALT], or --config FILE with a site")
    settings = settings_for(config, law=law, site=None if site is None else site_values(site))
    settings = settings_of_tracker(settings, tracker)
    if faces is not None and out.exists() and faces.exists() and out.samefile(faces):
        raise UserError(f"--out: {out} is the file with the readings; name another")
    if not out.name.lower().endswith((".csv", ".csv.gz")):
        raise UserError(f"--out: {out} must end in .csv or .csv.gz")
    check_outputs([out], "--out", force=force)
    if faces is not None:
        check_regular_file(faces, "a cube's readings")
        if not faces.exists():
            raise UserError(f"there is no file {faces}: name a CSV file with the columns time,east,south,west,zenith")
    from daemon.studies.recorded import read_csv, rows_of_store, unit_note
    from daemon.studies.replay import replay as run_replay

    if faces is not None:
        recording = read_csv(faces)
        rows = recording.rows
        for note in recording.notes():
            say(f"{faces}: {note}", err=True)
    else:
        assert store is not None  # noqa: S101 - narrowing; one of the two is there
        rows = rows_of_store(store)
    called = f"the store {store}" if faces is None else str(faces)
    in_kilowatts = unit_note(called, rows, settings.site.place())
    if in_kilowatts is not None:
        warn(in_kilowatts)
    # The end is not part of a span, and the last reading has to be.
    span = (float(rows.utc_s[0]), float(rows.utc_s[-1]) + 1.0)
    local = check_report_and_zone(report_to, zone, settings, span, force=force)
    with progress_bar(Console(stderr=True), "replaying") as progress:
        replayed = run_replay(settings, rows, called, out, progress)
    done = len(replayed.qualities)
    pages: Sequence[Path] = ()
    if report_to is not None and done == len(rows):
        from daemon.studies.report.studies import report_replay

        with explain_missing_pages(f"{out} is whole"):
            pages = report_replay(settings, span, rows, replayed, out, report_to, local, force=force)
    warnings, law = replayed.failed_laws, settings.law.driver
    if as_json:
        told = [*filter(None, [in_kilowatts]), *warnings]
        page = {"simulated": True, "rows": done, "law": law, "warnings": told, "table": out, "reports": pages}
        print_json(page)
    else:
        say(f"{pluralise(done, 'row')} by {law} on a SIMULATED tracker: {out}")
        for warning in warnings:
            say(warning)
        print_written_paths(pages)
    if done < len(rows):
        raise InterruptedEarlyError(
            f"interrupted: {done} of {len(rows)} rows are in {out}{missing_page_clause(report_to)}"
        )
