"""The log of a process that has a screen which changes in place."""

from rich.console import Console
from rich.text import Text


class LogAbove:
    """A stream for the log that writes above what changes in place, which a line of another stream would tear.

    Parameters
    ----------
    console
        The one that has the screen.
    """

    def __init__(self, console: Console) -> None:
        self._console = console

    def write(self, text: str) -> int:
        """Write whole lines."""
        self._console.print(Text(text), end="", soft_wrap=True)
        return len(text)

    def flush(self) -> None:
        """Do nothing: every line is written at once."""
