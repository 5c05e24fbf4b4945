"""The state on a screen that changes in place, as long as a person looks."""

import time
from collections.abc import Callable
from typing import Any

from rich.console import Console, Group, RenderableType
from rich.live import Live
from rich.text import Text

from daemon.base.errors import UserError
from daemon.commands.status.screen import live_screen, status_line

_EVERY_S = 1.0
_LINE_EVERY_S = 5.0


def watch(see: Callable[[], dict[str, Any]], console: Console, sleep: Callable[[float], object] = time.sleep) -> None:
    """Show the service until Ctrl-C, also while it restarts; if the console is no terminal, a line every few seconds.

    Parameters
    ----------
    see
        Returns the state, or raises `UserError` while there is none. An error of the first call goes to the caller.
    console, sleep
        Where to show it, and the function that waits.
    """
    state = see()
    if not console.is_terminal:
        while True:
            console.print(status_line(state), highlight=False, soft_wrap=True, markup=False)
            sleep(_LINE_EVERY_S)
            state, why = _read_or_keep_state(see, state)
            if why is not None:
                console.print(why, highlight=False, soft_wrap=True, markup=False)
    with Live(live_screen(state), console=console, auto_refresh=False, screen=True) as live:
        why = None
        while True:
            live.update(_screen(state, why), refresh=True)
            sleep(_EVERY_S)
            state, why = _read_or_keep_state(see, state)


def _read_or_keep_state(see: Callable[[], dict[str, Any]], before: dict[str, Any]) -> tuple[dict[str, Any], str | None]:
    try:
        return see(), None
    except UserError as error:
        return before, f"NO CONNECTION: what is shown is old. {error}"


def _screen(state: dict[str, Any], why: str | None) -> RenderableType:
    if why is None:
        return live_screen(state)
    return Group(Text(why, style="bold red"), live_screen(state))
