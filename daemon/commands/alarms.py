"""`heliocube alarms`: what is wrong, what to do, and that somebody has seen it; `notify` tells people."""

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from daemon.api.client import CONFIG_VARIABLE
from daemon.base.errors import ExitCode, UserError
from daemon.commands.answers import JsonOption, print_json, say
from daemon.commands.operate import TokenOption, WhyOption, send_command
from daemon.commands.options import ApiOption, ConfigOption, TrackerOption

if TYPE_CHECKING:
    from rich.table import Table

app = typer.Typer()


@app.callback(invoke_without_command=True)
def alarms(
    context: typer.Context,
    config: ConfigOption = None,
    api: ApiOption = None,
    as_json: JsonOption = False,
) -> None:
    """Show the alarms, what to do about each, and acknowledge them."""
    from rich.console import Console

    from daemon.api.client import find_without_token

    if context.invoked_subcommand is not None:
        return
    state = find_without_token(config, api).state()
    if as_json:
        print_json(state["alarms"])
    elif state["alarms"]:
        Console(highlight=False).print(*(_lines(alarm, state) for alarm in state["alarms"]), sep="\n")
    else:
        say("no alarm is on, and none waits to be acknowledged")


@app.command("ack")
def acknowledge(
    name: Annotated[str | None, typer.Argument(metavar="NAME", help="Name of the alarm, such as move-failed.")] = None,
    everything: Annotated[bool, typer.Option("--all", help="All alarms that are shown.")] = False,
    config: ConfigOption = None,
    api: ApiOption = None,
    token_file: TokenOption = None,
    why: WhyOption = "",
    tracker: TrackerOption = None,
    as_json: JsonOption = False,
) -> None:
    """Say that you have seen an alarm. This moves nothing and ends no stop."""
    if everything is (name is not None):
        raise UserError("name the alarm, such as 'heliocube alarms ack move-failed', or say --all")
    which = {} if name is None else {"alarm": name}
    send_command("acknowledge", config, api, token_file, why, tracker, as_json=as_json, **which)


def _lines(alarm: dict[str, Any], state: dict[str, Any]) -> "Table":
    from rich.table import Table
    from rich.text import Text

    from daemon.commands.status.screen import alarm_state
    from daemon.commands.status.times import localise_times

    lines = Table.grid(padding=(0, 2))
    lines.add_column(style="dim")
    lines.add_column()
    of = f" of {alarm['tracker']}" if alarm["tracker"] and len(state["trackers"]) > 1 else ""
    style = "bold" if alarm["state"] == "acknowledged" else "bold red"
    rows = {
        alarm["severity"]: Text(f"{alarm['name']}{of}: {localise_times(alarm['text'], state['time'])}", style=style),
        "state": Text(f"{alarm['state']}, {alarm_state(alarm, state)}"),
        "effect": Text(alarm["effect"]),
        "remedy": Text(alarm["remedy"].replace("`", "'")),
    }
    for label, text in rows.items():
        lines.add_row(label, text)
    return lines


def notify(
    config: Annotated[
        Path | None,
        typer.Option(
            "--config",
            "-c",
            metavar="FILE",
            envvar=CONFIG_VARIABLE,
            help="Configuration file; its sections notify and api are used.",
        ),
    ] = None,
    api: Annotated[
        list[str] | None,
        typer.Option(
            metavar="ADDRESS:PORT", help="Address of a service, instead of the configuration's. May be repeated."
        ),
    ] = None,
    test: Annotated[
        bool, typer.Option("--test", help="Send one message to each address, and print which of them accepted it.")
    ] = False,
) -> None:
    """Send alarms to people by e-mail, ntfy, chat or telephone, until Ctrl-C, SIGTERM or SIGHUP."""
    import asyncio
    import logging
    import os

    from daemon.base import process
    from daemon.base.clock import SystemClock
    from daemon.base.state import StateFolder
    from daemon.config.link_rules import conflicts_of_quiet_hours
    from daemon.config.links import NotifySettings, read_client_section
    from daemon.config.section import resolve_file_paths
    from daemon.notify import courier
    from daemon.notify.recipients import recipients_of

    settings = resolve_file_paths(config, read_client_section(config, "notify", NotifySettings))
    if api:
        settings = settings.model_copy(update={"services": tuple(api)})
    for conflict in conflicts_of_quiet_hours(settings):
        raise UserError(f"{conflict.key} {conflict.reason}")
    recipients = recipients_of(settings.people_file)
    process.configure_logging(sys.stderr, journal="JOURNAL_STREAM" in os.environ)
    logging.getLogger("httpx").setLevel(logging.WARNING)
    if test:
        delivered = asyncio.run(courier.send_test_notice(settings, recipients, typer.echo))
        raise typer.Exit(ExitCode.GOOD if delivered else ExitCode.ALARMS)
    services, people = ", ".join(settings.services), ", ".join(each.name for each in recipients)
    say(f"telling {people} of alarms of {services}")
    manager = process.SystemdNotifier(os.environ, os.getpid())
    # systemd gives a folder. Started by hand there is none: the person sees the terminal.
    kept_in = os.environ.get("STATE_DIRECTORY", "").partition(":")[0]
    folder = StateFolder(Path(kept_in) if kept_in else None, behind=True)
    asyncio.run(courier.serve(settings, recipients, SystemClock(), manager, folder))
