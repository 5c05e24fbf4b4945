"""What several commands share."""

from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

# Headings of the list of commands.
SERVICE = "The service"
OPERATION = "To the running service"
FILES = "Files and tools"
SCIENCE = "Science"
BENCH = "Instruments and the bench"


# The names are not listed here: to find those of all installed packages takes a tenth of a second of every command.
LawOption = Annotated[
    str | None, typer.Option(metavar="LAW", help="Pointing law by name, as law.driver; a wrong one lists them all.")
]
CubeOption = Annotated[
    str | None,
    typer.Option(
        "--cube", metavar="NAME", help="What reads the faces, as instruments.cube.driver; a wrong one lists all."
    ),
]
PositionerOption = Annotated[
    str | None,
    typer.Option(
        "--positioner", metavar="NAME", help="What turns it, as instruments.positioner.driver; a wrong one lists all."
    ),
]
CONFIG_VARIABLE = "HELIOCUBE_CONFIG"
ConfigOption = Annotated[
    Path | None,
    typer.Option("--config", "-c", envvar=CONFIG_VARIABLE, help="The service's configuration, for its section api."),
]
ApiOption = Annotated[
    str | None,
    typer.Option("--api", metavar="ADDRESS:PORT", help="Where the service listens, without a configuration."),
]
TrackerOption = Annotated[
    str | None, typer.Option("--tracker", metavar="NAME", help="Which tracker, where there are several.")
]

ReportOption = Annotated[
    Path | None, typer.Option("--report", metavar="DIR", help="Folder for a page about it, like that of 'report'.")
]
ZoneOption = Annotated[
    str | None,
    typer.Option("--zone", metavar="ZONE", help="Zone of local times, such as Europe/Paris; else the machine's."),
]
ForceOption = Annotated[bool, typer.Option("--force", help="Overwrite what is there.")]


class RoleChoice(StrEnum):
    """The roles as the command line names them."""

    both = "both"
    cube = "cube"
    tracker = "tracker"


class TableFormat(StrEnum):
    """Kinds of tables."""

    csv = "csv"
    parquet = "parquet"
