"""The stamp on pictures of simulated data: no hardware is behind them."""

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from matplotlib.figure import Figure

STAMP_COLOUR = "#a03c00"


def stamp_simulated(figure: "Figure", simulated: bool, words: str = "SIMULATED") -> "Figure":
    """Return the figure, with the words at the top right where it is `simulated`."""
    if simulated:
        # A title has a line of its own, where no data can be.
        figure.suptitle(words, x=0.995, ha="right", color=STAMP_COLOUR, weight="bold", size=11.0)
    return figure
