"""`heliocube archive`: the process that fills an archive, and what is done to one by hand."""

import os
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from daemon.base.errors import UserError
from daemon.commands.options import CONFIG_VARIABLE

if TYPE_CHECKING:
    # The command line imports this module to show its help, which must not wait for the database's client.
    from daemon.archive.address import ArchiveAddress

app = typer.Typer(help="Keep the records of many services in one PostgreSQL.")

ConfigOption = Annotated[
    Path | None,
    typer.Option("--config", "-c", envvar=CONFIG_VARIABLE, help="For its sections archive and mqtt."),
]
ToOption = Annotated[
    str | None,
    typer.Option("--to", metavar="URL", help="The database, postgresql://USER@HOST/DATABASE, instead of the file's."),
]


@app.callback(invoke_without_command=True)
def archive(context: typer.Context, config: ConfigOption = None, to: ToOption = None) -> None:
    """Take in the records that services send to the broker, until Ctrl-C or SIGTERM."""
    if context.invoked_subcommand is not None:
        return
    import asyncio

    from daemon.archive.ingest import serve
    from daemon.base import process
    from daemon.base.clock import SystemClock
    from daemon.config.links import ArchiveSettings, MqttSettings
    from daemon.config.section import beside, one_section, read_tables

    raw = read_tables(config)
    own = one_section(config, raw, "archive", ArchiveSettings)
    mqtt = beside(config, one_section(config, raw, "mqtt", MqttSettings))
    address = database(config, to)
    process.configure(sys.stderr, journal="JOURNAL_STREAM" in os.environ)
    asyncio.run(serve(mqtt, own, address, SystemClock(), process.Notifier(os.environ, os.getpid())))


def database(config: Path | None, named: str | None) -> "ArchiveAddress":
    """Return where the archive is, by name or by the file; raises `UserError`."""
    from daemon.archive.address import parse_archive
    from daemon.config.links import ArchiveSettings
    from daemon.config.section import one_section, read_tables

    url = named or one_section(config, read_tables(config), "archive", ArchiveSettings).database
    if url is None:
        raise UserError("no database is named: set archive.database in the file of --config, or name it on the line")
    return parse_archive(url)
