"""`heliocube bench` and `heliocube bench-ctl`: the simulated rig on real transports."""

import json
from pathlib import Path
from typing import Annotated

import typer

from daemon.config.sections import Settings


def serve(settings: Settings, directory: Path) -> None:
    """Run the bench."""
    from daemon.rigs.bench import serve_bench

    serve_bench(settings, directory)


def control(
    directory: Annotated[Path, typer.Argument(metavar="DIR", help="The bench's folder.", show_default=False)],
    verb: Annotated[str, typer.Argument(help="The command; 'help' lists them.", show_default=False)],
    arguments: Annotated[list[str] | None, typer.Argument(help="What the command takes.", show_default=False)] = None,
) -> None:
    """Change or ask the bench that runs in DIR."""
    from daemon.rigs.simulated import ask_bench, bench_verbs

    if verb == "help":
        for name, (usage, meaning) in bench_verbs().items():
            typer.echo(f"{f'{name} {usage}'.rstrip():<36}  {meaning}")
        return
    result = ask_bench(directory.absolute(), verb, arguments or [])
    if result is not None:
        typer.echo(json.dumps(result, indent=2))
