"""`heliocube status`: at a glance, on a screen that follows, as JSON, or as an exit code."""

from typing import Annotated

import typer

from daemon.base.errors import ExitCode, UserError
from daemon.commands.answers import JsonOption, print_json, say
from daemon.commands.options import OPERATION, ApiOption, ConfigOption

app = typer.Typer()


@app.command(rich_help_panel=OPERATION)
def status(
    config: ConfigOption = None,
    api: ApiOption = None,
    as_json: JsonOption = False,
    watch: Annotated[bool, typer.Option("--watch", "-w", help="Keep showing it until Ctrl-C.")] = False,
    check: Annotated[
        bool,
        typer.Option("--check", help="For scripts: one line for the state, one for each problem, and an exit code."),
    ] = False,
) -> None:
    """Show what the service does, where the tracker stands and what the cube reads.

    Exit code: 0; 5 if the service cannot be reached; 2 for a wrong command line or file.
    With --check also 4, if the service works and something needs attention.
    """
    import contextlib

    from rich.console import Console

    from daemon.api.client import find_unarmed

    if watch and (check or as_json):
        raise UserError("--watch is for people: leave it out with --check and --json, and ask again when you need it")
    client = find_unarmed(config, api)
    if check:
        from daemon.commands.status import check as checks

        state, health = client.state(), client.health()
        lines, code = checks.verdict(state, health)
        if as_json:
            print_json(checks.page(state, health))
        else:
            say("\n".join(lines))
        raise typer.Exit(code)
    if as_json:
        print_json(client.state())
        return
    console = Console(highlight=False)
    if watch:
        from daemon.commands.status.watch import watch as go_on

        with contextlib.suppress(KeyboardInterrupt):
            go_on(client.state, console)
        raise typer.Exit(ExitCode.GOOD)
    from daemon.commands.status.screen import render

    console.print(render(client.state()))
