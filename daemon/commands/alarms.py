"""`heliocube alarms`: what is the matter, what to do about it, and that somebody has seen it."""

from typing import TYPE_CHECKING, Annotated, Any

import typer

from daemon.base.errors import UserError
from daemon.commands.operate import JsonOption, TokenOption, WhyOption, give
from daemon.commands.options import ApiOption, ConfigOption, TrackerOption

if TYPE_CHECKING:
    from rich.table import Table

app = typer.Typer()


@app.callback(invoke_without_command=True)
def alarms(
    context: typer.Context,
    config: ConfigOption = None,
    api: ApiOption = None,
    as_json: Annotated[bool, typer.Option("--json", help="As JSON, with cause, effect and remedy.")] = False,
) -> None:
    """Show the alarms, what to do about each, and acknowledge them."""
    import json

    from rich.console import Console

    from daemon.api.client import find_unarmed

    if context.invoked_subcommand is not None:
        return
    state = find_unarmed(config, api).state()
    if as_json:
        typer.echo(json.dumps(state["alarms"], indent=2))
    elif state["alarms"]:
        Console(highlight=False).print(*(_lines(alarm, state) for alarm in state["alarms"]), sep="\n")
    else:
        typer.echo("no alarm is on, and none waits to be acknowledged")


@app.command("ack")
def acknowledge(
    name: Annotated[str | None, typer.Argument(metavar="NAME", help="Of the alarm, such as move-failed.")] = None,
    everything: Annotated[bool, typer.Option("--all", help="All alarms that are shown.")] = False,
    config: ConfigOption = None,
    api: ApiOption = None,
    token_file: TokenOption = None,
    why: WhyOption = "",
    tracker: TrackerOption = None,
    as_json: JsonOption = False,
) -> None:
    """Say that you have seen an alarm. Nothing moves by it, and no stop ends."""
    if everything is (name is not None):
        raise UserError("name the alarm, such as 'heliocube alarms ack move-failed', or say --all")
    which = {} if name is None else {"alarm": name}
    give("acknowledge", config, api, token_file, why, tracker, as_json=as_json, **which)


def _lines(alarm: dict[str, Any], state: dict[str, Any]) -> "Table":
    from rich.table import Table
    from rich.text import Text

    from daemon.commands.status.screen import alarm_state

    lines = Table.grid(padding=(0, 2))
    lines.add_column(style="dim")
    lines.add_column()
    of = f" of {alarm['tracker']}" if alarm["tracker"] and len(state["trackers"]) > 1 else ""
    style = "bold" if alarm["state"] == "acknowledged" else "bold red"
    rows = {
        alarm["severity"]: Text(f"{alarm['name']}{of}: {alarm['text']}", style=style),
        "state": Text(f"{alarm['state']}, {alarm_state(alarm, state['time'])}"),
        "effect": Text(alarm["effect"]),
        "remedy": Text(alarm["remedy"].replace("`", "'")),
    }
    for label, text in rows.items():
        lines.add_row(label, text)
    return lines
