"""The choices of `heliocube gain`, apart from what they set off, so that `--help` answers at once."""

from enum import StrEnum


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
