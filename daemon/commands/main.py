"""The command line: `heliocube`."""

import contextlib
import errno
import logging
import os
import sys
from importlib.metadata import version
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Annotated, Any

import typer
from rich.console import Console
from typer.core import TyperGroup

from daemon.base.clock import iso_utc
from daemon.base.errors import ExitCode, InterruptedEarlyError, UserError
from daemon.base.process import signals_as_ctrl_c
from daemon.commands import alarms, dashboard, export, operate, probe, store, tools
from daemon.commands import config as config_commands
from daemon.commands.answers import JsonOption, print_json, say
from daemon.commands.archive import command as archive_command
from daemon.commands.options import (
    BENCH,
    FILES,
    OPERATION,
    SCIENCE,
    SERVICE,
    CubeOption,
    ForceOption,
    LawOption,
    PositionerOption,
    ReportOption,
    RoleChoice,
    TableFormat,
    ZoneOption,
    checked_seed,
    refuse_repeated_options,
    refuse_underscores_in_numbers,
    show_values_in_words,
)
from daemon.commands.progress import progress_bar
from daemon.commands.setup import command as setup_command
from daemon.commands.status import command as status_command
from daemon.commands.studies import calibrate, campaign, compare, energy, gain, samples
from daemon.commands.studies import report as reports
from daemon.commands.studies.simulate import (
    check_report_and_zone,
    checked_pictures,
    draw_pictures,
    explain_missing_pages,
    missing_page_clause,
    page_of,
    print_summary,
    print_written_paths,
    replay,
)
from daemon.commands.upgrade import command as upgrade_command
from daemon.studies.inputs import instant, settings_for, site_values, with_identical_trackers

if TYPE_CHECKING:
    from collections.abc import Sequence

    # Help and completion must not wait for scientific libraries.
    from daemon.config.settings import Settings


class _Commands(TyperGroup):
    """All commands. A command that Ctrl-C ends without a result says so; a wrong value is explained in plain words."""

    def invoke(self, ctx: Any) -> Any:
        """Run the command; raises `InterruptedEarlyError` for a Ctrl-C that the command does not handle itself."""
        try:
            return super().invoke(ctx)
        except KeyboardInterrupt:
            raise InterruptedEarlyError("interrupted before its end; no whole result was written") from None
        except typer.BadParameter as error:
            from pydantic import ValidationError

            from daemon.config.section import describe_error

            if isinstance(error.__cause__, ValidationError):
                error.message = describe_error(error.__cause__.errors()[0])
            raise


# Part of matplotlib's message when it cannot be loaded, on a full disk for example. Only commands that draw load it.
_CACHE_FOLDER_VARIABLE = "MPLCONFIGDIR"

show_values_in_words()
refuse_repeated_options()
refuse_underscores_in_numbers()
app = typer.Typer(
    cls=_Commands,
    help="Control service for dual-axis sun trackers that point by a radiometric cube.\n\n"
    "To see it work: heliocube run. To install it on a rig: docs/install.md.",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)
app.add_typer(status_command.app)
app.add_typer(upgrade_command.app)
app.add_typer(operate.app)
app.add_typer(alarms.app, name="alarms", rich_help_panel=OPERATION)
app.add_typer(setup_command.app)
app.add_typer(config_commands.app, name="config", rich_help_panel=FILES)
app.add_typer(tools.app, name="bridge", rich_help_panel=FILES)
app.add_typer(calibrate.app, name="calibrate", rich_help_panel=SCIENCE)
app.add_typer(compare.app, name="compare", rich_help_panel=SCIENCE)
app.add_typer(probe.app, name="probe", rich_help_panel=BENCH)
# So that a negative number is not taken for an option.
app.command("bench-ctl", rich_help_panel=BENCH, context_settings={"ignore_unknown_options": True})(tools.control)
app.command(rich_help_panel=BENCH)(campaign.campaign)
app.add_typer(export.app)
app.add_typer(reports.app)
app.add_typer(store.app, name="store", rich_help_panel=FILES)


ConfigOption = Annotated[
    Path | None,
    typer.Option("--config", "-c", metavar="FILE", help="Configuration file. Without one: the simulated rig."),
]
WeatherOption = Annotated[
    str | None,
    typer.Option(
        metavar="SKY",
        help="Simulated sky: clear, overcast, variable, broken, or a measured file (CSV, BSRN, SURFRAD, MIDC, TMY3).",
    ),
]
SiteOption = Annotated[
    str | None, typer.Option(metavar="LAT,LON[,ALT]", help="Site, in degrees north, degrees east and metres.")
]
SeedOption = Annotated[
    int | None,
    typer.Option(min=0, callback=checked_seed, metavar="NUMBER", help="Seed of the simulated weather and noise."),
]


@app.callback(invoke_without_command=True)
def _top(show_version: Annotated[bool, typer.Option("--version", help="Print the version and exit.")] = False) -> None:
    if show_version:
        typer.echo(f"heliocube {version('heliocube')}")
        raise typer.Exit


@app.command(rich_help_panel=SERVICE)
def run(
    config: ConfigOption = None,
    role: Annotated[RoleChoice, typer.Option(help="What this process does.")] = RoleChoice.both,
    speed: Annotated[
        float | None,
        typer.Option(
            metavar="FACTOR", help="Simulated rig: how many times faster than real time, 60 unless configured."
        ),
    ] = None,
    start: Annotated[
        str | None, typer.Option(metavar="UTC", help="Simulated rig: the time at which its clock starts.")
    ] = None,
    weather: WeatherOption = None,
    law: LawOption = None,
    site: SiteOption = None,
    seed: SeedOption = None,
    cube: CubeOption = None,
    positioner: PositionerOption = None,
    for_s: Annotated[
        float | None, typer.Option("--for", min=0, metavar="SECONDS", help="End after this many seconds of real time.")
    ] = None,
    with_dashboard: Annotated[
        bool, typer.Option("--dashboard", help="Serve the dashboard as well, in a process of its own beside this one.")
    ] = False,
) -> None:
    """Run the service until Ctrl-C, SIGTERM or SIGHUP: read the cube, decide, move the tracker."""
    from daemon.config.file import with_loopback_bridge

    settings = _settings(
        config,
        weather=weather,
        law=law,
        site=site,
        seed=seed,
        speed=speed,
        start=start,
        cube=cube,
        positioner=positioner,
    )
    if config is None and role is RoleChoice.both:
        settings = with_loopback_bridge(settings)
    if settings.instruments.kind == "real":
        _refuse_simulation({"--speed": speed, "--start": start, "--weather": weather, "--seed": seed})
    with contextlib.ExitStack() as stack:
        if with_dashboard and settings.store.directory is None and not settings.real:
            # A store gives the dashboard a day to show. It is deleted when the process ends.
            directory = Path(stack.enter_context(TemporaryDirectory(prefix="heliocube-")))
            settings = settings.model_copy(update={"store": settings.store.model_copy(update={"directory": directory})})
        if with_dashboard:
            stack.enter_context(dashboard.dashboard_beside(settings.api.listen, settings.dashboard.listen))
        # Only now: a mistake in an option or in the file is reported before scientific libraries are loaded.
        from daemon.commands.records_folder import with_default_store_folder
        from daemon.commands.run import run_service
        from daemon.service.rig import Role

        run_service(
            with_default_store_folder(settings, config, os.environ), Role(role), for_s, Console(markup=False), config
        )


@app.command(rich_help_panel=SERVICE)
@signals_as_ctrl_c()
def simulate(
    out: Annotated[Path, typer.Option(metavar="DIR", help="Folder for the tables; created if it is missing.")],
    start: Annotated[str, typer.Option(metavar="UTC", help="First day or instant, such as 2022-10-14.")],
    days: Annotated[float, typer.Option(min=0.01, max=366, metavar="DAYS", help="How many days.")] = 1.0,
    weather: WeatherOption = None,
    law: LawOption = None,
    config: ConfigOption = None,
    site: SiteOption = None,
    seed: SeedOption = None,
    cube: CubeOption = None,
    positioner: PositionerOption = None,
    trackers: Annotated[
        int | None,
        typer.Option(
            min=1,
            max=9999,
            metavar="NUMBER",
            help="Number of trackers that one cube serves; they are named t1, t2 and so on.",
        ),
    ] = None,
    table_format: Annotated[TableFormat, typer.Option("--format", help="Kind of tables.")] = TableFormat.csv,
    plot: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE", help="Also draw light, angles and insolation: FILE.png gives FILE-light.png and so on."
        ),
    ] = None,
    report_to: ReportOption = None,
    zone: ZoneOption = None,
    force: ForceOption = False,
    as_json: JsonOption = False,
) -> None:
    """Run the service on the simulated rig for days in seconds, and write tables."""
    from daemon.store.tables import check_tables

    settings = _settings(
        config, weather=weather, law=law, site=site, seed=seed, speed=None, start=None, cube=cube, positioner=positioner
    )
    if trackers is not None:
        settings = with_identical_trackers(settings, trackers)
    begin = instant(start, "--start")
    check_tables(out, table_format.value, force=force)
    drawn = checked_pictures(plot, settings, force=force)
    span = (begin.timestamp(), begin.timestamp() + days * 86400.0)
    local = check_report_and_zone(report_to, zone, settings, span, force=force)
    from daemon.studies.simulate import simulate as run_simulation

    console = Console(stderr=True)
    with progress_bar(console) as progress:
        summary = run_simulation(settings, begin, days, out, table_format.value, progress, force=force)
    pages: Sequence[Path] = ()
    if not as_json:
        print_summary(summary, settings, out)
    ended = summary.interrupted_utc_s
    kept = f"the tables in {out} are whole" if ended is None else f"the tables end at {iso_utc(ended)[:19]}Z"
    with explain_missing_pages(kept):
        if drawn:
            draw_pictures(drawn, settings, out, local)
            pages = drawn
        if report_to is not None and ended is None:
            from daemon.studies.report.studies import report_simulation

            reports = report_simulation(settings, span, out, table_format.value, report_to, local, force=force)
            pages = [*pages, *reports]
    if as_json:
        print_json(page_of(summary, settings, out, pages))
    else:
        print_written_paths(pages)
    if ended is not None:
        raise InterruptedEarlyError(f"interrupted: {kept}{missing_page_clause(report_to)}")


app.add_typer(dashboard.app)
app.add_typer(archive_command.app, name="archive", rich_help_panel=SERVICE)
app.command(rich_help_panel=SERVICE)(alarms.notify)
app.command(rich_help_panel=SERVICE)(replay)
app.command(rich_help_panel=SCIENCE)(gain.gain)
app.command(rich_help_panel=SCIENCE)(energy.energy)
app.command(rich_help_panel=SCIENCE)(samples.samples)


@app.command(rich_help_panel=BENCH)
def bench(
    directory: Annotated[
        Path, typer.Option("--dir", metavar="DIR", help="Folder for the ports, the control socket and heliocube.toml.")
    ],
    weather: WeatherOption = None,
    start: Annotated[str | None, typer.Option(metavar="UTC", help="Start of the simulated clock.")] = None,
    seed: SeedOption = None,
    site: SiteOption = None,
    config: ConfigOption = None,
    cube: CubeOption = None,
    positioner: PositionerOption = None,
    rotctld: Annotated[
        str | None,
        typer.Option(metavar="HOST:PORT", help="Your own rotctld, instead of a simulated positioner."),
    ] = None,
) -> None:
    """Run simulated instruments on real ports; `heliocube run --config DIR/heliocube.toml` then drives them.

    DIR/heliocube.toml is written from the file of --config, if there is one, with the ports of the bench.
    """
    settings = _settings(
        config,
        weather=weather,
        law=None,
        site=site,
        seed=seed,
        speed=None,
        start=start,
        cube=cube,
        positioner=positioner,
        rotctld=rotctld,
    )
    tools.run_bench_server(settings, directory)


def _settings(
    config: Path | None,
    *,
    weather: str | None,
    law: str | None,
    site: str | None,
    seed: int | None,
    speed: float | None,
    start: str | None,
    cube: str | None,
    positioner: str | None,
    rotctld: str | None = None,
) -> "Settings":
    """Read the file, if any, and override it by the command line's choices."""
    return settings_for(
        config,
        weather=weather,
        law=law,
        site=None if site is None else site_values(site),
        seed=seed,
        speed=speed,
        start=None if start is None else instant(start, "--start"),
        cube=cube,
        positioner=positioner,
        rotctld=rotctld,
    )


def _refuse_simulation(options: dict[str, object]) -> None:
    """Refuse options for which only a simulated rig has a use."""
    given = [name for name, value in options.items() if value is not None]
    if given:
        raise UserError(
            f"{', '.join(given)}: this configuration has real instruments (instruments.kind), whose time and sky are"
            " real; leave the option out, or try it on a simulated rig"
        )


def main() -> None:
    """Entry point: an error that a person can put right gives one sentence and its own exit code, never a traceback."""
    # If it cannot keep its fonts in the home folder it says so at length. A person who wants a picture need not know.
    logging.getLogger("matplotlib").setLevel(logging.ERROR)
    try:
        app()
    except UserError as error:
        say(f"heliocube: {error}", err=True)
        sys.exit(error.exit_code)
    except OSError as error:
        if _CACHE_FOLDER_VARIABLE in str(error):
            say(
                "heliocube: matplotlib, which draws the pictures, needs a folder of its own, and there is no room for"
                " one in the user's home or among the temporary files: free space there, or set"
                f" {_CACHE_FOLDER_VARIABLE} to a folder",
                err=True,
            )
            sys.exit(ExitCode.MISTYPED)
        # Every command uses paths that a person has named. A path that may not be accessed is handled here for all.
        if error.filename is None or error.errno not in (errno.EACCES, errno.EPERM, errno.ENAMETOOLONG):
            raise
        say(f"heliocube: {error.filename} cannot be used: {error.strerror}; name another place", err=True)
        sys.exit(ExitCode.MISTYPED)


if __name__ == "__main__":
    main()
