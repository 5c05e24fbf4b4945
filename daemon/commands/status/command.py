"""`heliocube status`: at a glance, on a screen that keeps changing, as JSON, or as an exit code."""

from typing import Annotated, Any

import typer

from daemon.base.errors import ExitCode, UserError
from daemon.commands.answers import JsonOption, print_json, say
from daemon.commands.options import OPERATION, ApiOption, ConfigOption, TrackerOption

app = typer.Typer()


@app.command(rich_help_panel=OPERATION)
def status(
    config: ConfigOption = None,
    api: ApiOption = None,
    tracker: TrackerOption = None,
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

    from daemon.api.client import find_without_token

    if watch and (check or as_json):
        raise UserError("--watch is for people: leave it out with --check and --json, and ask again when you need it")
    client = find_without_token(config, api)

    def see() -> dict[str, Any]:
        return client.state() if tracker is None else select_tracker(client.state(), tracker)

    if check:
        if tracker is not None:
            raise UserError("--check looks at all that the service does: leave --tracker out")
        from daemon.commands.status import check as checks

        state, health = client.state(), client.health()
        lines, code = checks.verdict(state, health)
        if as_json:
            print_json(checks.page(state, health))
        else:
            say("\n".join(lines))
        raise typer.Exit(code)
    if as_json:
        print_json(see())
        return
    console = Console(highlight=False)
    if watch:
        from daemon.commands.status.watch import watch as go_on

        with contextlib.suppress(KeyboardInterrupt):
            go_on(see, console)
        raise typer.Exit(ExitCode.GOOD)
    from daemon.commands.status.screen import render

    console.print(render(see()))


def select_tracker(state: dict[str, Any], tracker: str) -> dict[str, Any]:
    """Return the JSON of /api/state without the other trackers; `UserError` if there is no tracker of that name."""
    trackers = state["trackers"]
    if tracker not in trackers:
        raise UserError(f"there is no tracker {ascii(tracker)[:40]}; the trackers are {', '.join(trackers) or 'none'}")
    others = tuple(f"{name}: " for name in trackers if name != tracker)
    return state | {
        "trackers": {tracker: trackers[tracker]},
        "alarms": [alarm for alarm in state["alarms"] if alarm["tracker"] in (None, tracker)],
        "news": [item for item in state["news"] if not item["text"].startswith(others)],
    }
