"""`heliocube archive`: the process that fills an archive, and the commands on an archive."""

import os
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from daemon.api.client import CONFIG_VARIABLE
from daemon.base.errors import UserError
from daemon.base.words import pluralise
from daemon.commands.answers import JsonOption, explain_interruption, message_printer, print_json, warn
from daemon.studies.inputs import instant

if TYPE_CHECKING:
    # The command line imports this module to show its help, which must not wait for the database's client.
    from daemon.archive.address import ArchiveAddress

# Longer ago than any record, and still a valid date.
_LONGEST_DAYS = 9_999
# There can be many reasons: each names the table of its day.
_MOST_REASONS = 5
_HOW_TO_RETRY = "see why in heliocube.set_aside, put it right, then 'heliocube archive retry'"

app = typer.Typer(
    help="Keep the records of many services in one PostgreSQL database.\n\nWithout a command: store the records that"
    " the services send to the broker, until Ctrl-C, SIGTERM or SIGHUP."
)

ConfigOption = Annotated[
    Path | None,
    typer.Option(
        "--config",
        "-c",
        metavar="FILE",
        envvar=CONFIG_VARIABLE,
        help="Configuration file; its sections archive and mqtt are used.",
    ),
]
ToOption = Annotated[
    str | None,
    typer.Option(
        "--to", metavar="URL", help="Database, postgresql://USER@HOST/DATABASE, instead of the configuration's."
    ),
]


@app.callback(invoke_without_command=True)
def archive(context: typer.Context, config: ConfigOption = None, to: ToOption = None) -> None:
    """Store the records that services send to the broker, until Ctrl-C, SIGTERM or SIGHUP."""
    if context.invoked_subcommand is not None:
        return
    import asyncio

    from daemon.archive.ingest import serve
    from daemon.base import process
    from daemon.base.clock import SystemClock
    from daemon.config.links import ArchiveSettings, MqttSettings
    from daemon.config.section import read_tables, resolve_file_paths, validate_section
    from daemon.mqtt.credentials import load_user

    raw = read_tables(config)
    own = validate_section(config, raw, "archive", ArchiveSettings)
    mqtt = resolve_file_paths(config, validate_section(config, raw, "mqtt", MqttSettings))
    if mqtt.credentials_file is not None:
        # The file is read again at each connection. Checked here, a missing file is reported at once.
        load_user(mqtt.credentials_file)
    address = find_archive_address(config, to)
    process.configure_logging(sys.stderr, journal="JOURNAL_STREAM" in os.environ)
    asyncio.run(serve(mqtt, own, address, SystemClock(), process.SystemdNotifier(os.environ, os.getpid())))


@app.command()
def fill(
    store: Annotated[
        Path, typer.Argument(help="Folder of a store, or its file. The service that writes to it may go on running.")
    ],
    name: Annotated[
        str,
        typer.Option(metavar="PREFIX/NAME", help="The name under which the service of this store sends its records."),
    ],
    config: ConfigOption = None,
    to: ToOption = None,
    as_json: JsonOption = False,
) -> None:
    """Copy into the archive the records of a store that are missing there; none is written twice."""
    from daemon.archive.fill import fill as write_records
    from daemon.mqtt.topics import check_topic

    address = find_archive_address(config, to)
    try:
        check_topic(name)
    except ValueError as error:
        raise UserError(
            f"--name: {error}; it is mqtt.prefix and mqtt.name of the service, such as plant/roof"
        ) from None
    with explain_interruption(f"what was read so far is in {address}"):
        found = write_records(store, address, name)
    if as_json:
        print_json({"store": store, "archive": str(address), "installation": name, **found._asdict()})
        return
    read = pluralise(found.read, "record was", "records were")
    typer.echo(f"{store}: {read} read; {found.added} of them are new in {address}, as {name}")
    if found.aside:
        refused = pluralise(found.aside, "record was", "records were")
        warn(f"{refused} not taken by the database, and set aside: {_HOW_TO_RETRY}")
    if found.damaged:
        warn(f"{pluralise(found.damaged, 'record is', 'records are')} damaged in {store} and left out")
    if found.unsound:
        runs = ", ".join(map(str, found.unsound))
        warn(f"the entry of run {runs} in {store} is damaged: the run's records are left out")


@app.command()
def retry(config: ConfigOption = None, to: ToOption = None, as_json: JsonOption = False) -> None:
    """Try again to write the records that were set aside because the database did not take them."""
    from daemon.archive.refused_records import retry as write_again

    address = find_archive_address(config, to)
    with explain_interruption(f"what was written so far is in {address}"):
        found = write_again(address)
    if as_json:
        print_json({"archive": str(address), **found._asdict()})
        return
    aside = pluralise(found.aside, "record was", "records were")
    typer.echo(f"{aside} set aside in {address}; written now: {found.taken}")
    often = sorted(found.still.items(), key=lambda item: -item[1])
    for why, count in often[:_MOST_REASONS]:
        warn(f"{pluralise(count, 'record')}: {why}")
    if len(often) > _MOST_REASONS:
        rest = sum(count for _, count in often[_MOST_REASONS:])
        warn(f"{pluralise(rest, 'record')} for {len(often) - _MOST_REASONS} other reasons")


@app.command()
def parquet(
    out: Annotated[Path, typer.Option(metavar="DIR", help="Folder for the files; created if it is missing.")],
    day: Annotated[
        str | None, typer.Option(metavar="DAY", help="Only this UTC day, such as 2022-10-14, even if its file exists.")
    ] = None,
    drop_after: Annotated[
        int | None,
        typer.Option(
            metavar="DAYS",
            min=1,
            max=_LONGEST_DAYS,
            help="Delete days older than this from the database, if their files have all the rows.",
        ),
    ] = None,
    config: ConfigOption = None,
    to: ToOption = None,
    as_json: JsonOption = False,
) -> None:
    """Write a Parquet file for each past day whose file is missing or lacks rows; meant to run every night."""
    from datetime import UTC, datetime, timedelta

    from daemon.archive.parquet import drop_days, write_days

    address, today = find_archive_address(config, to), datetime.now(UTC).date()
    wanted = None if day is None else instant(day, "--day").date()
    if wanted is not None and not wanted < today:
        raise UserError(f"--day {day}: that day is not over")
    tell = message_printer(as_json=as_json)
    found, dropped = [], []
    with explain_interruption(f"what was written so far is in {out}"):
        for one in write_days(address, out, today, wanted):
            found.append(one)
            if one.written:
                tell(f"{one.path}: {pluralise(one.rows, 'row')}")
        if wanted is not None and not found:
            raise UserError(f"--day {day}: {address} has no record of that day")
        if drop_after is not None:
            for one in drop_days(address, out, today - timedelta(days=drop_after)):
                dropped.append(one)
                tell(f"{one.kind} of {one.day} dropped: {one.path} has its {pluralise(one.rows, 'row')}")
    if as_json:
        print_json({"days": [one._asdict() for one in found], "dropped": [one._asdict() for one in dropped]})
        return
    written = f"{sum(one.written for one in found)} of {pluralise(len(found), 'file')} written"
    tell(f"{written}, {pluralise(len(dropped), 'day')} dropped")


def find_archive_address(config: Path | None, named: str | None) -> "ArchiveAddress":
    """Return the address of the archive, as named or from the file; raises `UserError`."""
    from dataclasses import replace

    from daemon.archive.address import load_password, parse_archive
    from daemon.config.links import ArchiveSettings
    from daemon.config.section import read_tables, resolve_file_paths, validate_section

    settings = resolve_file_paths(config, validate_section(config, read_tables(config), "archive", ArchiveSettings))
    url = named or settings.database
    if url is None:
        raise UserError("no database is named: set archive.database in the file of --config, or name it with --to")
    address = parse_archive(url)
    return (
        address if settings.password_file is None else replace(address, password=load_password(settings.password_file))
    )
