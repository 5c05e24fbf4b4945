"""`heliocube export`: records of the store as tables."""

import math
import os
from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from daemon.api.client import CONFIG_VARIABLE
from daemon.base.errors import UserError
from daemon.base.process import signals_as_ctrl_c
from daemon.commands.answers import JsonOption, print_json, say
from daemon.commands.options import FILES, ForceOption, TableFormat
from daemon.studies.inputs import instant

app = typer.Typer()


class KindChoice(StrEnum):
    """Kinds of records as the command line names them."""

    scans = "scans"
    decisions = "decisions"
    moves = "moves"
    poses = "poses"
    modes = "modes"
    events = "events"
    curves = "curves"


@app.command(rich_help_panel=FILES)
@signals_as_ctrl_c()
def export(
    out: Annotated[Path, typer.Option(metavar="DIR", help="Folder for the tables; created if it is missing.")],
    start: Annotated[
        str | None, typer.Option("--from", metavar="UTC", help="First instant, such as 2022-10-14.")
    ] = None,
    end: Annotated[
        str | None, typer.Option("--to", metavar="UTC", help="End; this instant itself is not included.")
    ] = None,
    table_format: Annotated[TableFormat, typer.Option("--format", help="Kind of tables.")] = TableFormat.csv,
    kind: Annotated[
        list[KindChoice] | None,
        typer.Option(
            metavar="KIND", help="Only scans, decisions, moves, poses, modes, events or curves. May be repeated."
        ),
    ] = None,
    store: Annotated[
        str | None,
        typer.Option(metavar="DIR|URL", help="Folder of the store, or URL of an archive, instead of a configuration."),
    ] = None,
    config: Annotated[
        Path | None,
        typer.Option("--config", "-c", metavar="FILE", help="Configuration file; its section store is used."),
    ] = None,
    force: ForceOption = False,
    as_json: JsonOption = False,
) -> None:
    """Write records of the store as tables, even while the service runs."""
    from daemon.commands.archive.readable import open_store_or_archive
    from daemon.store.export import export as write_tables

    first = None if start is None else instant(start, "--from")
    last = None if end is None else instant(end, "--to")
    kinds = [one.value for one in kind or []]
    ends_s = -math.inf if first is None else first.timestamp(), math.inf if last is None else last.timestamp()
    with open_store_or_archive(store_directory("export", store, config), lambda _: ends_s) as (directory, _):
        found = write_tables(directory, out, table_format.value, first, last, kinds, force=force, needs_records=True)
    if as_json:
        print_json({"simulated": found.simulated, "tables": out, "format": table_format, "rows": found.rows})
        return
    counts = ", ".join(f"{count} {name}" for name, count in found.rows.items())
    say(f"written to {out}: {counts}")


def store_directory(command: str, store: str | None, config: Path | None) -> str:
    """Return the store that is named, or that the file of --config or HELIOCUBE_CONFIG sets; raises `UserError`."""
    if store is None and config is None and os.environ.get(CONFIG_VARIABLE):
        config = Path(os.environ[CONFIG_VARIABLE])
    if store is not None and config is None:
        return store
    if store is not None or config is None:
        raise UserError(f"{command} needs either --store DIR or --config FILE to find the store, or {CONFIG_VARIABLE}")
    from daemon.commands.records_folder import find_records_folder
    from daemon.config.file import load_settings

    directory = find_records_folder(load_settings(config), config, os.environ)
    if directory is None:
        raise UserError(f"{config} sets no store.directory, and its rig is simulated: its service keeps no records")
    return str(directory)
