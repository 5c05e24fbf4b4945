"""The choices of `heliocube plot` and `report`, checked before scientific libraries are loaded."""

from collections.abc import Sequence
from datetime import tzinfo
from pathlib import Path
from typing import Literal
from zoneinfo import ZoneInfo, ZoneInfoNotFoundError

from daemon.base.errors import UserError

NAMES = ("light", "angles", "received", "motion", "wind", "power")
"""Names of the pictures, in the order in which `pictures` draws them."""

_ENDINGS = (".png", ".svg")


def check_pictures(names: Sequence[str]) -> None:
    """Raise `UserError` for a picture that does not exist."""
    for name in names:
        if name not in NAMES:
            raise UserError(f"there is no picture {ascii(name)[:40]}; choose from {', '.join(NAMES)}")


def picture_paths(out: Path, names: Sequence[str]) -> list[Path]:
    """Return the file of each picture: `out` itself for one, its name with the picture's for several."""
    if out.suffix.lower() not in _ENDINGS:
        raise UserError(f"--out: {out} must end in .png or .svg")
    return [out if len(names) == 1 else out.with_name(f"{out.stem}-{name}{out.suffix}") for name in names]


def format_of_tables(directory: Path) -> Literal["csv", "parquet"]:
    """Return how the tables in a folder are written; `UserError` where there are none."""
    forms: tuple[Literal["parquet", "csv"], ...] = ("parquet", "csv")
    for form in forms:
        if (directory / f"scans.{form}").exists():
            return form
    raise UserError(
        f"--tables: {directory} has neither scans.csv nor scans.parquet: name a folder that simulate or"
        " export has written"
    )


def zone_of(name: str | None) -> tzinfo | None:
    """Return the time zone of that name, None for this machine's; raises `UserError`."""
    if name is None:
        return None
    try:
        return ZoneInfo(name)
    except (ZoneInfoNotFoundError, ValueError, OSError):
        raise UserError(f"--zone: there is no time zone {ascii(name)[:60]}; write one such as Europe/Paris") from None
