"""`heliocube self-check` tells after an upgrade whether all is well; `heliocube rollback` is the way back."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from daemon.base.errors import ExitCode, UserError
from daemon.commands import options
from daemon.commands.answers import JsonOption, message_printer, print_json, say
from daemon.commands.options import FILES, OPERATION, ConfigOption, RoleChoice

if TYPE_CHECKING:
    # The command line imports this module to show its help, which must not wait for scientific libraries.
    from collections.abc import Iterator

    from daemon.commands.upgrade.finding import Finding
    from daemon.config.settings import Settings
    from daemon.service.rig import Role

app = typer.Typer()


@app.command("self-check", rich_help_panel=OPERATION)
def self_check(
    config: ConfigOption = None,
    role: Annotated[
        RoleChoice | None,
        typer.Option(
            help="What the process does. If left out: the role of the unit that starts this file, or else any role"
            " that the file allows."
        ),
    ] = None,
    as_json: JsonOption = False,
) -> None:
    """Check program, configuration, store, instruments, wind source, clock and disk, and print a line for each.

    Nothing is written and nothing moves. If the service runs, it is asked; otherwise the instruments are.
    Exit code: 0 if all is well, 4 if something needs attention, 2 if the configuration cannot be used.
    """
    from daemon.commands.upgrade.finding import exit_code, lines, page, text_column

    if config is None:
        raise UserError("self-check needs the service's configuration: name it with --config or in HELIOCUBE_CONFIG")
    found = list(_findings(config, role))
    if as_json:
        print_json(page(found))
    else:
        say("\n".join(lines(found)), hang=text_column(found))
    raise typer.Exit(exit_code(found))


def _findings(config: Path, role: RoleChoice | None) -> "Iterator[Finding]":
    import os

    from daemon.commands.records_folder import with_records_folder
    from daemon.commands.upgrade import machine, running
    from daemon.commands.upgrade.finding import Finding
    from daemon.config.file import load_settings

    yield machine.check_program()
    yield machine.check_configuration(config, role)
    try:
        settings = with_records_folder(load_settings(config), config, os.environ)
    except UserError:
        return
    yield machine.check_store(settings)
    yield machine.check_disk(settings)
    yield machine.check_clock(settings)
    service = running.query_service(settings, config)
    if service is not None:
        yield from service
        return
    if settings.api.enabled:
        yield Finding("service", f"does not run: nothing listens at {settings.api.listen}")
    chosen = _role(settings, role or options.unit_role(config))
    if chosen is not None:
        yield from _findings_without_service(settings, chosen)


def _role(settings: "Settings", role: RoleChoice | None) -> "Role | None":
    """Return the role that was given, or else the widest role that can run with the settings."""
    from daemon.commands.run import missing_requirements
    from daemon.service.rig import Role

    if role is not None:
        return Role(role.value)
    return next(
        (each for each in (Role.BOTH, Role.TRACKER, Role.CUBE) if not missing_requirements(settings, each)), None
    )


def _findings_without_service(settings: "Settings", role: "Role") -> "Iterator[Finding]":
    import asyncio

    from daemon.commands.upgrade.instruments import check_instruments
    from daemon.commands.upgrade.machine import check_wind_source
    from daemon.service.rig import Role

    yield from asyncio.run(check_instruments(settings, role))
    if role is not Role.CUBE:
        yield from check_wind_source(settings)


@app.command(rich_help_panel=FILES)
def rollback(
    config: Annotated[
        list[Path] | None,
        typer.Option(
            "--config",
            "-c",
            metavar="FILE",
            help="Configuration of a service that goes back. May be repeated.",
            show_default=False,
        ),
    ] = None,
    to: Annotated[
        Path | None,
        typer.Option(
            metavar="PROGRAM", help="The heliocube program of the earlier release, if it was installed by hand."
        ),
    ] = None,
    as_json: JsonOption = False,
) -> None:
    """Go back to the release before the last upgrade and keep the records made since; every tracker is held.

    The units are stopped and started again. Files that only the newer release can read are kept beside the old ones.
    """
    import os

    from daemon.commands.upgrade import installed
    from daemon.commands.upgrade.installed import Program
    from daemon.commands.upgrade.rollback import roll_back

    installation = installed.find_installation() if to is None else None
    program = Program.at(to) if installation is None else installation.previous
    configs = config or [
        path for role in ("tracker", "cube") if (path := options.CONFIG_FOLDER / f"{role}.toml").exists()
    ]
    if not configs:
        raise UserError("there is no configuration in /etc/heliocube: name it with --config")
    tell, done = message_printer(as_json=as_json), []
    with installed.interruptible(installation):
        units = installed.stop_units() if installation is not None else []
        try:
            for path in configs:
                for sentence in roll_back(path, program, os.environ):
                    tell(sentence)
                    done.append(sentence)
            if installation is not None:
                installation.activate_previous()
                if units:
                    # A unit may take a minute to start. Whoever does not wait should know how far this came.
                    sentence = f"{program.name} is in use; starting {', '.join(units)}"
                    tell(sentence)
                    done.append(sentence)
        finally:
            failed = installed.start_units(units)
    for unit in failed:
        tell(f"{unit} does not start: see 'systemctl status {unit}'")
    where = "is in use" if installation is not None else "can be started"
    tell(f"{program.name} {where}: {installed.RELEASE_ADVICE}")
    if as_json:
        print_json({"release": program.name, "in_use": installation is not None, "done": done, "not_started": failed})
    raise typer.Exit(ExitCode.NOT_SEEN if failed else ExitCode.GOOD)
