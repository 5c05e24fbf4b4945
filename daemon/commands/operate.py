"""The operator's commands to the running service."""

from pathlib import Path
from typing import Annotated

import typer

from daemon.base.errors import UserError
from daemon.commands.answers import JsonOption, print_json, say
from daemon.commands.options import OPERATION, ApiOption, ConfigOption, TrackerOption

app = typer.Typer()

TokenOption = Annotated[
    Path | None,
    typer.Option(
        "--token-file",
        metavar="FILE",
        help="File with the service's token, instead of a configuration; or set HELIOCUBE_TOKEN.",
    ),
]
WhyOption = Annotated[str, typer.Option(metavar="TEXT", help="Reason, for the records.")]
_DEFAULT_WHY = "an operator asked"
_EXIT_CODES = (
    "Exit code: 0 if its effect was seen, complete or under way; 3 if it was not seen in time; 5 if the service cannot"
    " be reached; 6 if it is refused."
)


def _add_plain_command(name: str, meaning: str) -> None:
    """Offer a command that takes only the options that all commands have."""

    @app.command(
        name,
        help=f"{meaning}\n\n{_EXIT_CODES}",
        rich_help_panel=OPERATION,
        context_settings={"allow_extra_args": True},
    )
    def command(
        context: typer.Context,
        config: ConfigOption = None,
        api: ApiOption = None,
        token_file: TokenOption = None,
        why: WhyOption = _DEFAULT_WHY,
        tracker: TrackerOption = None,
        as_json: JsonOption = False,
    ) -> None:
        if context.args:
            raise UserError(
                f"nothing is done: '{name}' takes no name; for one of several trackers add --tracker {context.args[0]}"
            )
        send_command(name, config, api, token_file, why, tracker, as_json=as_json)


_add_plain_command("stow", "Go to the stow position now and stay there until 'auto'.")
_add_plain_command("hold", "Stay where the tracker is until 'auto'; a stow for wind still moves it.")
_add_plain_command("auto", "Track again: end a stop, maintenance, stow, snow, hold or goto.")
_add_plain_command("stop", "Stop the axes at once; nothing moves them until 'auto', not even a storm.")
_add_plain_command("snow", "Go to the steep position that sheds snow and hail and stay there until 'auto'.")
_add_plain_command("maintenance", "Stop the axes, keep them still and silence all alarms, until 'auto'.")


@app.command(
    help=f"Go to a position inside the limits and stay there until 'auto'.\n\n{_EXIT_CODES}",
    rich_help_panel=OPERATION,
    context_settings={"ignore_unknown_options": True},
)
def goto(
    a_deg: Annotated[float, typer.Argument(metavar="A", help="Angle A in degrees, negative towards the east.")],
    b_deg: Annotated[float, typer.Argument(metavar="B", help="Angle B in degrees, 90 is flat.")],
    config: ConfigOption = None,
    api: ApiOption = None,
    token_file: TokenOption = None,
    why: WhyOption = _DEFAULT_WHY,
    tracker: TrackerOption = None,
    as_json: JsonOption = False,
) -> None:
    """Go to a position inside the limits and stay there until 'auto'."""
    send_command("goto", config, api, token_file, why, tracker, as_json=as_json, a_deg=a_deg, b_deg=b_deg)


_add_plain_command("home", "Clear faults and make a reference run: both axes move over their whole range.")
_add_plain_command("clear", "Clear the faults and doubts that are shown, without a reference run.")
_add_plain_command("relearn", "Forget what the law has learned of the site.")


def send_command(
    name: str,
    config: Path | None,
    api: str | None,
    token_file: Path | None,
    why: str,
    tracker: str | None,
    *,
    as_json: bool = False,
    **arguments: float | str,
) -> None:
    """Give a command to the service, print the answer and leave with its exit code."""
    from daemon.api.client import find_service
    from daemon.commands.status.times import localise_times

    which = {} if tracker is None else {"tracker": tracker}
    if why:
        which["why"] = why
    try:
        reply = find_service(config, api, token_file).command(name, **which, **arguments)
    except UserError as error:
        error.args = (localise_times(str(error)),)
        raise
    if as_json:
        print_json(reply.page)
    else:
        say(localise_times(reply.text))
    raise typer.Exit(reply.exit_code)
