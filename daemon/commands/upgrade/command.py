"""`heliocube self-check`: whether all is well around the service, after an upgrade above all."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from daemon.base.errors import UserError
from daemon.commands.options import OPERATION, ConfigOption, RoleChoice

if TYPE_CHECKING:
    # The command line imports this module to show its help, which must not wait for the science.
    from collections.abc import Iterator

    from daemon.commands.upgrade.finding import Finding
    from daemon.config.settings import Settings
    from daemon.service.rig import Role

app = typer.Typer()


@app.command("self-check", rich_help_panel=OPERATION)
def self_check(
    config: ConfigOption = None,
    role: Annotated[
        RoleChoice | None, typer.Option(help="What the process does; without it, what the file is enough for.")
    ] = None,
    as_json: Annotated[bool, typer.Option("--json", help="The same as JSON.")] = False,
) -> None:
    """Look at program, configuration, store, instruments, wind source, clock and disk: a line each.

    Nothing is written and nothing moves. While the service runs it is asked, and not its instruments. Ends with 0, with
    4 where something is to be looked at, and with 2 where the configuration cannot be used.
    """
    import json

    from daemon.commands.upgrade.finding import exit_code, lines, page

    if config is None:
        raise UserError("self-check needs the service's configuration: name it with --config or in HELIOCUBE_CONFIG")
    found = list(_findings(config, role))
    typer.echo(json.dumps(page(found), indent=2) if as_json else "\n".join(lines(found)))
    raise typer.Exit(exit_code(found))


def _findings(config: Path, role: RoleChoice | None) -> "Iterator[Finding]":
    from daemon.commands.upgrade import machine, running
    from daemon.config.file import load_settings

    yield machine.program()
    yield machine.configuration(config, role)
    try:
        settings = _in_its_place(load_settings(config), config)
    except UserError:
        return
    yield machine.store(settings)
    yield machine.disk(settings)
    yield machine.clock(settings)
    service = running.asked(settings)
    if service is not None:
        yield from service
        return
    chosen = _role(settings, role)
    if chosen is not None:
        yield from _alone(settings, chosen)


def _in_its_place(settings: "Settings", config: Path) -> "Settings":
    """Return the settings with the folder that their service keeps its records in, also where they name none."""
    import os

    from daemon.commands.kept import records_of

    directory = records_of(settings, config, os.environ)
    return settings.model_copy(update={"store": settings.store.model_copy(update={"directory": directory})})


def _role(settings: "Settings", role: RoleChoice | None) -> "Role | None":
    """Return the role that was given, or else the most that the settings are enough for."""
    from daemon.commands.run import lacking
    from daemon.service.rig import Role

    if role is not None:
        return Role(role.value)
    return next((each for each in (Role.BOTH, Role.TRACKER, Role.CUBE) if not lacking(settings, each)), None)


def _alone(settings: "Settings", role: "Role") -> "Iterator[Finding]":
    import asyncio

    from daemon.commands.upgrade.instruments import instruments
    from daemon.commands.upgrade.machine import wind_source
    from daemon.service.rig import Role

    yield from asyncio.run(instruments(settings, role))
    if role is not Role.CUBE:
        yield from wind_source(settings)
