"""`heliocube store`: commands on the file of the records itself."""

from dataclasses import asdict
from pathlib import Path
from typing import Annotated

import typer

from daemon.base.words import pluralise
from daemon.commands.answers import JsonOption, explain_interruption, print_json, say

app = typer.Typer(help="Work on the file of the records: salvage what a damaged one still holds.", no_args_is_help=True)


@app.callback()
def _group() -> None:
    """Keep `salvage` a command of a group although it is the only one."""


@app.command()
def salvage(
    file: Annotated[Path, typer.Argument(help="Store that is damaged, or was moved aside. It is read, never changed.")],
    into: Annotated[
        Path,
        typer.Option(
            metavar="DIR", help="Folder of the store to write the records into: the service's own, or a new one."
        ),
    ],
    as_json: JsonOption = False,
) -> None:
    """Write what can be read from a store into another one, even while the service runs."""
    from rich.console import Console

    from daemon.base.process import signals_as_ctrl_c
    from daemon.commands.progress import progress_bar
    from daemon.store.salvage import salvage as write_records

    # SIGTERM and SIGHUP end it like Ctrl-C: otherwise a copy as large as the store would be left behind.
    with (
        explain_interruption(f"what was read so far is in {into}"),
        signals_as_ctrl_c(),
        progress_bar(Console(stderr=True), "salvaging") as progress,
    ):
        found = write_records(file, into, progress)
    if as_json:
        print_json({"file": file, "into": into, **asdict(found)})
        return
    counts = ", ".join(f"{count} {name}" for name, count in found.read.items())
    state = "is damaged" if found.damaged else "is whole"
    say(f"{file} {state}: {counts} could be read; {sum(found.added.values())} of them are new in {into}")
    if found.missing:
        missing = pluralise(found.missing, "record between them is", "records between them are")
        say(f"{missing} missing: unreadable here, or in another store")
