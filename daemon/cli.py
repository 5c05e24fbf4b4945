"""The command line: `heliocube`."""

import sys
from enum import StrEnum
from importlib.metadata import version
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.console import Console

from daemon import cli_bridge, cli_calibrate, cli_config, cli_export, cli_gain, cli_operate
from daemon.cli_options import instant, site_values
from daemon.config import Settings
from daemon.errors import UserError

app = typer.Typer(
    help="Control service for dual-axis sun trackers that point by a radiometric cube.",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)
app.add_typer(cli_config.app, name="config")
app.add_typer(cli_bridge.app, name="bridge")
app.command()(cli_gain.gain)
app.add_typer(cli_calibrate.app, name="calibrate")
app.add_typer(cli_export.app)
app.add_typer(cli_operate.app)


class RoleChoice(StrEnum):
    """The roles as the command line names them."""

    both = "both"
    cube = "cube"
    tracker = "tracker"


class LawChoice(StrEnum):
    """The laws as the command line names them."""

    mu_prime = "mu-prime"
    sun_vector = "sun-vector"
    chronometric = "chronometric"
    flat = "flat"


class TableFormat(StrEnum):
    """Kinds of tables."""

    csv = "csv"
    parquet = "parquet"


ConfigOption = Annotated[
    Path | None, typer.Option("--config", "-c", help="Configuration file; without it the embedded simulated rig.")
]
WeatherOption = Annotated[
    str | None,
    typer.Option(help="Simulated sky: clear, overcast, variable, or a measured file (CSV, BSRN, SURFRAD, MIDC, TMY3)."),
]
LawOption = Annotated[LawChoice | None, typer.Option(help="Pointing law.")]
SiteOption = Annotated[str | None, typer.Option(metavar="LAT,LON[,ALT]", help="Site: degrees north, east, metres.")]
SeedOption = Annotated[int | None, typer.Option(min=0, help="Seed of the simulated weather and noise.")]


@app.callback(invoke_without_command=True)
def _top(show_version: Annotated[bool, typer.Option("--version", help="Print the version and leave.")] = False) -> None:
    if show_version:
        typer.echo(f"heliocube {version('heliocube')}")
        raise typer.Exit


@app.command()
def run(
    config: ConfigOption = None,
    role: Annotated[RoleChoice, typer.Option(help="What this process does.")] = RoleChoice.both,
    speed: Annotated[float | None, typer.Option(help="Simulated rig: times real speed (default 60).")] = None,
    start: Annotated[str | None, typer.Option(metavar="UTC", help="Simulated rig: its clock's start.")] = None,
    weather: WeatherOption = None,
    law: LawOption = None,
    site: SiteOption = None,
    seed: SeedOption = None,
    for_s: Annotated[
        float | None, typer.Option("--for", min=0, help="End after this many seconds of wall time.")
    ] = None,
) -> None:
    """Run the service: acquire, bridge, decide and move, until Ctrl-C or SIGTERM."""
    from daemon.config_file import on_a_port_of_its_own
    from daemon.run import run_service
    from daemon.service import Role

    settings = _settings(config, weather=weather, law=law, site=site, seed=seed, speed=speed, start=start)
    if config is None and role is RoleChoice.both:
        settings = on_a_port_of_its_own(settings)
    run_service(settings, Role(role), for_s, Console())


@app.command()
def simulate(
    out: Annotated[Path, typer.Option(help="Folder for the tables; made if it is not there.")],
    start: Annotated[str, typer.Option(metavar="UTC", help="First day or instant, such as 2022-10-14.")],
    days: Annotated[float, typer.Option(min=0.01, max=366, help="How many days.")] = 1.0,
    weather: WeatherOption = None,
    law: LawOption = None,
    config: ConfigOption = None,
    site: SiteOption = None,
    seed: SeedOption = None,
    table_format: Annotated[TableFormat, typer.Option("--format", help="Kind of tables.")] = TableFormat.csv,
) -> None:
    """Run the same service on the in-process rig under virtual time: a day in seconds."""
    from daemon.simulate import simulate as run_simulation
    from daemon.simulate_report import progress_bar, report

    settings = _settings(config, weather=weather, law=law, site=site, seed=seed, speed=None, start=None)
    console = Console(stderr=True)
    with progress_bar(console) as progress:
        summary = run_simulation(settings, instant(start, "--start"), days, out, table_format.value, progress)
    report(summary, settings, out, console, Console())


def _settings(
    config: Path | None,
    *,
    weather: str | None,
    law: LawChoice | None,
    site: str | None,
    seed: int | None,
    speed: float | None,
    start: str | None,
) -> Settings:
    """Read the file, if any, and lay the command line's choices over it."""
    from daemon.config_file import load_settings, override

    settings = load_settings(config) if config is not None else Settings()
    changes: dict[str, dict[str, Any]] = {"simulation": {}, "law": {}, "site": {}}
    if weather is not None:
        changes["simulation"]["weather"] = weather if weather in ("clear", "overcast", "variable") else Path(weather)
    if law is not None:
        changes["law"]["name"] = law.value
    if site is not None:
        changes["site"] = site_values(site)
    if seed is not None:
        changes["simulation"]["seed"] = seed
    if speed is not None:
        changes["simulation"]["speed"] = speed
    if start is not None:
        changes["simulation"]["start_utc"] = instant(start, "--start")
    return override(settings, changes)


def main() -> None:
    """Entry point: a person's mistake is one sentence and exit code 2, never a traceback."""
    try:
        app()
    except UserError as error:
        Console(stderr=True).print(f"heliocube: {error}", markup=False, highlight=False, soft_wrap=True)
        sys.exit(2)


if __name__ == "__main__":
    main()
