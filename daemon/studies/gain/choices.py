"""The choices of `heliocube gain`, apart from the code that carries them out, so that `--help` answers at once."""

from enum import StrEnum
from pathlib import Path

from daemon.base.errors import UserError

_PLOT_SUFFIXES = (".png", ".svg", ".pdf")


class Device(StrEnum):
    """What the dual axis is compared with."""

    STATIC = "static"
    VERTICAL = "vertical"
    HORIZONTAL = "horizontal"


class AnswerFormat(StrEnum):
    """How the answer is written."""

    TABLE = "table"
    CSV = "csv"
    PARQUET = "parquet"


class PlotKind(StrEnum):
    """The figures there are."""

    MAP = "map"
    BEST_TILT = "best-tilt"
    DAILY = "daily"
    PRINTED = "printed"


def check_plot(path: Path) -> None:
    """Raise `UserError` if the name of a figure's file does not end in one of the kinds there are."""
    if path.suffix.lower() not in _PLOT_SUFFIXES:
        raise UserError(f"--plot: {path} must end in {', '.join(_PLOT_SUFFIXES[:-1])} or {_PLOT_SUFFIXES[-1]}")
