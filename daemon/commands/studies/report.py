"""`heliocube report` and `heliocube plot`: a day, a week or a month of one tracker as a page, and its pictures."""

import time
from glob import escape
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.console import Console

from daemon.base.errors import UserError
from daemon.base.process import signals_as_ctrl_c
from daemon.commands.answers import JsonOption, print_json, warn
from daemon.commands.archive.readable import check_readable
from daemon.commands.export import store_directory
from daemon.commands.options import FILES, ForceOption, TrackerOption, ZoneOption
from daemon.commands.progress import progress_bar
from daemon.commands.studies.simulate import print_written_paths
from daemon.studies.report.choices import check_pictures, format_of_tables, picture_paths, zone_of

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence
    from contextlib import AbstractContextManager

    # The command line imports this module to show its help, which must not wait for scientific libraries.
    from daemon.archive.reader import ArchiveReader
    from daemon.config.settings import Settings
    from daemon.studies.report.material import Material
    from daemon.studies.report.span import RequestedSpan

app = typer.Typer()

DayOption = Annotated[
    str | None,
    typer.Option("--day", metavar="DAY", help="A day of the site: 2022-10-14, yesterday or today."),
]
FromOption = Annotated[
    str | None, typer.Option("--from", metavar="DAY|UTC", help="First day or instant, with --to instead of --day.")
]
ToOption = Annotated[
    str | None, typer.Option("--to", metavar="DAY|UTC", help="End; this instant itself is not included.")
]
StoreOption = Annotated[
    str | None,
    typer.Option(
        "--store", metavar="DIR|URL", help="Folder of the store, or URL of an archive, instead of a configuration."
    ),
]
ConfigOption = Annotated[
    Path | None,
    typer.Option(
        "--config", "-c", metavar="FILE", help="Configuration file; its store, limits and budget of motion are used."
    ),
]


@app.command(rich_help_panel=FILES)
@signals_as_ctrl_c()
def report(
    day: DayOption = None,
    start: FromOption = None,
    end: ToOption = None,
    out: Annotated[Path, typer.Option(metavar="DIR", help="Folder for the pages; created if it is missing.")] = Path(),
    store: StoreOption = None,
    config: ConfigOption = None,
    tracker: TrackerOption = None,
    zone: ZoneOption = None,
    force: ForceOption = False,
    as_json: JsonOption = False,
) -> None:
    """Write a page about a day, a week or a month: what the tracker did, what it gained, how good the records are.

    One file for each tracker, complete in itself: it can be opened, sent and printed anywhere.
    """
    from daemon.studies.report.span import RequestedSpan

    wanted = RequestedSpan(day, start, end)
    place, settings = store_directory("report", store, config), _settings(config)
    check_readable(place)
    local = zone_of(zone)
    from daemon.studies.report.write import check_output, with_settings, write_reports

    with (
        _readable(place, wanted) as (directory, called),
        progress_bar(Console(stderr=True), "reading and drawing") as progress,
    ):
        trackers = "*" if tracker is None else escape(tracker)
        taken = [path.name for path in out.glob(f"{_name(directory, wanted)}-{trackers}.html")]
        check_output(out, taken, "--out", force=force)
        materials = _materials(directory, called, wanted, tracker, lambda share: progress(0.8 * share))
        known = [with_settings(material, settings) for material in materials]
        paths = write_reports(known, out, local, lambda share: progress(0.8 + 0.2 * share), force=force)
    _print_paths(paths, as_json=as_json, simulated=any(each.simulated for each in materials))


@app.command(rich_help_panel=FILES)
@signals_as_ctrl_c()
def plot(
    what: Annotated[
        list[str],
        typer.Argument(metavar="PICTURE...", help="light, angles, received, motion, wind or power; one or more."),
    ],
    out: Annotated[
        Path,
        typer.Option(
            metavar="FILE", help="PNG or SVG file; several pictures of FILE.png are FILE-light.png and so on."
        ),
    ],
    day: DayOption = None,
    start: FromOption = None,
    end: ToOption = None,
    store: StoreOption = None,
    tables: Annotated[
        Path | None,
        typer.Option("--tables", metavar="DIR", help="Folder of tables by 'simulate' or 'export', instead of a store."),
    ] = None,
    config: ConfigOption = None,
    site: Annotated[
        str | None, typer.Option(metavar="LAT,LON[,ALT]", help="Site of the tables, in degrees north, east and metres.")
    ] = None,
    tracker: TrackerOption = None,
    zone: ZoneOption = None,
    force: ForceOption = False,
    as_json: JsonOption = False,
) -> None:
    """Draw quick pictures of a day from the store, or from tables of simulate or export."""
    check_pictures(what)
    paths = picture_paths(out, what)
    if tables is not None:
        format_of_tables(tables)
        if store is not None:
            raise UserError("plot needs either --store or --tables, not both")
    from daemon.studies.report.span import RequestedSpan

    whole = tables is not None and day is None and start is None and end is None
    wanted = None if whole else RequestedSpan(day, start, end)
    local, place = zone_of(zone), "" if tables is not None else store_directory("plot", store, config)
    if place:
        check_readable(place)
    # Slow to import: the checks above refuse most mistakes without them.
    from daemon.studies.report.plot import draw, material_of_tables, missing_picture_notes
    from daemon.studies.report.write import check_output, with_settings

    settings = _settings(config)
    check_output(out.parent, [path.name for path in paths], "--out", force=force)
    with progress_bar(Console(stderr=True), "reading") as progress:
        if tables is not None:
            material = material_of_tables(tables, site, settings, wanted, tracker, warn)
        else:
            asked = RequestedSpan(day, start, end)
            with _readable(place, asked) as (directory, called):
                found = _materials(directory, called, asked, tracker, progress)
            names = ", ".join(each.tracker for each in found)
            if len(found) > 1:
                raise UserError(f"that store has several trackers, {names}: choose one with --tracker NAME")
            material = found[0]
    without = missing_picture_notes(material, what)
    drawn = {name: path for name, path in zip(what, paths, strict=True) if name not in without}
    if drawn:
        draw(with_settings(material, settings), list(drawn), list(drawn.values()), local)
        _print_paths(list(drawn.values()), as_json=as_json, simulated=material.simulated)
    if without:
        raise UserError("; ".join(without.values()))


def _print_paths(paths: "Sequence[Path]", *, as_json: bool, simulated: bool) -> None:
    if as_json:
        print_json({"simulated": simulated, "written": paths})
    else:
        print_written_paths(paths)


def _settings(config: Path | None) -> "Settings | None":
    if config is None:
        return None
    from daemon.config.file import load_settings

    return load_settings(config)


def _readable(place: str, wanted: "RequestedSpan") -> "AbstractContextManager[tuple[Path, str]]":
    """Give access to the records of a span, in a store or in a copy from an archive."""
    from daemon.commands.archive.readable import open_store_or_archive

    def ends_s(reader: "ArchiveReader") -> tuple[float, float]:
        span = wanted.span(reader.longitude_deg, time.time())
        return span.start_utc_s, span.end_utc_s

    return open_store_or_archive(place, ends_s)


def _name(directory: Path, wanted: "RequestedSpan") -> str:
    """Return the name of the span, for which only the site's place is read; empty without any run."""
    from daemon.store.runs import runs_of
    from daemon.store.schema import FILE_NAME

    runs = runs_of(directory / FILE_NAME)
    return wanted.span(runs[-1].origin.longitude_deg, time.time()).name if runs else ""


def _materials(
    directory: Path, called: str, wanted: "RequestedSpan", tracker: str | None, progress: "Callable[[float], None]"
) -> "list[Material]":
    from daemon.studies.report.material import read_material

    return read_material(directory, wanted, tracker, time.time(), progress, called)
