"""The log of a process whose screen changes in place."""

from rich.console import Console
from rich.text import Text


class ScreenLogStream:
    """A stream for the log that writes above the changing screen; a line of another stream would break it.

    Parameters
    ----------
    console
        The console that has the screen.
    """

    def __init__(self, console: Console) -> None:
        self._console = console

    def write(self, text: str) -> int:
        """Write whole lines."""
        self._console.print(Text(text), end="", soft_wrap=True)
        return len(text)

    def flush(self) -> None:
        """Do nothing: every line is written at once."""
