"""The service's state for as long as it runs: a screen that changes in place, or a line now and then."""

import asyncio
import logging
from collections.abc import Callable
from typing import Any

from rich.console import Console
from rich.live import Live

from daemon.commands.status.screen import live_screen, status_line

log = logging.getLogger("heliocube")

_REFRESH_S = 0.25
_LINE_EVERY_S = 5.0


class LiveView:
    """Shows the service on a console for as long as it runs.

    Parameters
    ----------
    see
        Returns the state, as /api/state does.
    console
        Where to show it: a terminal gets a screen that changes in place, anything else plain lines.
    speed
        How many times faster the service's clock runs than the machine's.
    """

    def __init__(self, see: Callable[[], dict[str, Any]], console: Console, speed: float) -> None:
        self._see = see
        self._console = console
        self._speed = speed

    async def run(self) -> None:
        """Refresh until cancelled, or until output fails; then the service goes on without a display."""
        try:
            await self._show()
        except (OSError, SystemExit) as error:
            # For a closed pipe rich raises SystemExit.
            why = error.strerror if isinstance(error, OSError) else "nobody reads it any more"
            log.warning("the display has ended, and the service goes on without it: %s", why)
            self._console.quiet = True

    async def _show(self) -> None:
        if not self._console.is_terminal:
            while True:
                await asyncio.sleep(_LINE_EVERY_S * self._speed)
                self._console.print(status_line(self._see()), highlight=False, markup=False, soft_wrap=True)
        with Live(live_screen(self._see()), console=self._console, auto_refresh=False, transient=False) as live:
            while True:
                await asyncio.sleep(_REFRESH_S * self._speed)
                live.update(live_screen(self._see()), refresh=True)
