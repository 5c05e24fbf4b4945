"""Options and checks that several commands share."""

from collections import Counter
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from typer.core import TyperArgument, TyperCommand, TyperOption

from daemon.api.client import CONFIG_VARIABLE
from daemon.base.errors import UserError
from daemon.config.simulation import LARGEST_SEED

if TYPE_CHECKING:
    from daemon.studies.spread.workers import Workers

# Headings of the list of commands.
SERVICE = "The service"
OPERATION = "Commands to the running service"
FILES = "Files and tools"
SCIENCE = "Science"
BENCH = "Instruments and the bench"


# The names are not listed here: to find those of all installed packages takes every command a tenth of a second.
LawOption = Annotated[
    str | None, typer.Option(metavar="LAW", help="Pointing law, as in law.driver; an unknown name prints the list.")
]
CubeOption = Annotated[
    str | None,
    typer.Option(
        "--cube",
        metavar="NAME",
        help="Driver that reads the faces, as in instruments.cube.driver; an unknown name prints the list.",
    ),
]
PositionerOption = Annotated[
    str | None,
    typer.Option(
        "--positioner",
        metavar="NAME",
        help="Driver of the positioner, as in instruments.positioner.driver; an unknown name prints the list.",
    ),
]
# Where deploy/ puts the configurations; each is read by the unit of its role.
CONFIG_FOLDER = Path("/etc/heliocube")
ConfigOption = Annotated[
    Path | None,
    typer.Option(
        "--config",
        "-c",
        metavar="FILE",
        envvar=CONFIG_VARIABLE,
        help="The service's configuration.",
    ),
]
ApiOption = Annotated[
    str | None,
    typer.Option("--api", metavar="ADDRESS:PORT", help="Address of the service, instead of a configuration."),
]
TrackerOption = Annotated[
    str | None, typer.Option("--tracker", metavar="NAME", help="Name of the tracker, if there are several.")
]

ReportOption = Annotated[
    Path | None,
    typer.Option(
        "--report", metavar="DIR", help="Also write a report page, as 'heliocube report' does, into this folder."
    ),
]
ZoneOption = Annotated[
    str | None,
    typer.Option(
        "--zone", metavar="ZONE", help="Time zone of local times, such as Europe/Paris; if left out, the machine's."
    ),
]
JobsOption = Annotated[int, typer.Option("--jobs", min=1, max=256, metavar="N", help="Number of processes.")]
ClusterOption = Annotated[
    str | None,
    typer.Option("--cluster", metavar="HOST:PORT", help="Use the workers of this dask scheduler instead of --jobs."),
]
ForceOption = Annotated[bool, typer.Option("--force", help="Overwrite existing files.")]


# Options that reach a service, or give a reason, are not here: a script may add one again, and a stop must not be
# refused for that. A second --tracker is refused in daemon.entry, before the command is known.
_SINGLE_VALUE_OPTIONS = {
    *("--against", "--bias", "--day", "--ghi", "--lat", "--law", "--laws", "--model", "--only", "--points"),
    *("--schedule", "--site", "--sites", "--skies", "--sky", "--store", "--tables", "--weather"),
    "--without",
}


def checked_seed(seed: int | None) -> int | None:
    """Return a seed; `typer.BadParameter` if it is too large. As a range of typer its digits would fill the help."""
    if seed is not None and seed > LARGEST_SEED:
        raise typer.BadParameter(f"'{seed}' is not a number up to {LARGEST_SEED}")
    return seed


def show_values_in_words() -> None:
    """Let help pages say FILE or NUMBER for an option's value, where the library would show ``<list[Path]>``."""
    TyperOption.display_type_rich = _value_in_words  # type: ignore[method-assign,assignment]
    # An argument needs no word: its name stands before it.
    TyperArgument.display_type_rich = lambda *_args, **_known: None  # type: ignore[method-assign]


def _value_in_words(option: TyperOption, ctx: Any) -> str | None:
    """Return the word for an option's value; None for a switch, which has no value."""
    kind = option.type_descriptor
    if option.is_flag or option.metavar is not None:
        return None if option.is_flag else option.metavar
    if kind.is_choice:
        return option.display_type(ctx).strip("<>").removeprefix("list[").removesuffix("]")
    if kind.is_path or kind.annotation in (Path, list[Path]):
        return "PATH"
    return "NUMBER" if kind.is_ranged or kind.annotation in (int, float) else "TEXT"


def refuse_repeated_options() -> None:
    """Let every command refuse an option given twice if both values may be meant: only the last one would count."""
    make_parser = TyperCommand.make_parser

    def make(command: TyperCommand, ctx: Any) -> Any:
        parser = make_parser(command, ctx)
        parse = parser.parse_args

        def parse_once(args: list[str]) -> Any:
            found = parse(args)
            given = Counter(option.opts[0] for option in found[2] if not getattr(option, "multiple", True))
            for name in sorted(_SINGLE_VALUE_OPTIONS & given.keys()):
                if given[name] > 1:
                    raise UserError(
                        f"nothing is done: {name} is given {given[name]} times, and only one would count: put several"
                        " into one value where --help shows how, or give the command once for each"
                    )
            return found

        parser.parse_args = parse_once  # type: ignore[method-assign]
        return parser

    TyperCommand.make_parser = make  # type: ignore[method-assign,assignment]


def refuse_underscores_in_numbers() -> None:
    """Let no command take ``1_5`` for 15, as the library does: a person who types it means 1.5 or slips."""

    def strictly(process: Any) -> Any:
        def process_value(parameter: Any, ctx: Any, value: Any) -> Any:
            kinds = {float: "a number", int: "a whole number"}
            kind = kinds.get(parameter.type_descriptor.annotation)
            if kind is not None and isinstance(value, str) and "_" in value:
                raise typer.BadParameter(f"{value!r} is not {kind}", ctx=ctx, param=parameter)
            return process(parameter, ctx, value)

        return process_value

    for parameters in (TyperArgument, TyperOption):
        parameters.process_value = strictly(parameters.process_value)  # type: ignore[method-assign]


def chosen_workers(jobs: int, cluster: str | None) -> "Workers":
    """Return the workers; `UserError` if both --jobs and --cluster are given."""
    from daemon.studies.spread.workers import Workers

    if cluster is not None and jobs != 1:
        raise UserError("--jobs is for this machine and --cluster for others: name one of them")
    if cluster is not None and not cluster.rpartition(":")[2].isdigit():
        raise UserError(f"--cluster: '{cluster}' is not an address, such as 192.168.1.5:8786")
    return Workers(jobs, cluster)


class RoleChoice(StrEnum):
    """The roles as the command line names them."""

    both = "both"
    cube = "cube"
    tracker = "tracker"


def unit_role(file: Path) -> RoleChoice | None:
    """Return the role in which an installed unit starts a configuration, or None if no unit does."""
    units = (RoleChoice.tracker, RoleChoice.cube)
    return next((role for role in units if file.absolute() == CONFIG_FOLDER / f"{role}.toml"), None)


class TableFormat(StrEnum):
    """Kinds of tables."""

    csv = "csv"
    parquet = "parquet"
