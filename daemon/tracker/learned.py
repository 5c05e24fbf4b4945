"""What the law `optimal` has learned of its site and used of its day, kept over a restart."""

import logging
from pathlib import Path
from typing import Annotated

from pydantic import BaseModel, ConfigDict, Field

from daemon.base.replace_file import replace_file
from solar.laws.site import ALBEDO_RANGE, GAIN_RANGE, Learned

log = logging.getLogger("heliocube.optimal")

_FILE_NAME = "learned.json"

Albedo = Annotated[float, Field(ge=ALBEDO_RANGE[0], le=ALBEDO_RANGE[1], allow_inf_nan=False)]
Gain = Annotated[float, Field(ge=GAIN_RANGE[0], le=GAIN_RANGE[1], allow_inf_nan=False)]


class Kept(BaseModel):
    """Albedo and relative gains of the vertical faces, and the budget used on a solar day (counted from 1970)."""

    model_config = ConfigDict(frozen=True, extra="forbid", strict=True)

    albedo: Albedo
    gain_east: Gain = 1.0
    gain_south: Gain = 1.0
    gain_west: Gain = 1.0
    day: int
    travelled_deg: float = Field(default=0.0, ge=0.0, allow_inf_nan=False)
    moves: int = Field(default=0, ge=0)

    @property
    def learned(self) -> Learned:
        """What the science makes of it."""
        return Learned(self.albedo, self.gain_east, self.gain_south, self.gain_west)


class LearnedFile:
    """A small file beside the store; without a folder what is learned lives in memory only.

    Parameters
    ----------
    directory
        Of the file, or None.
    """

    def __init__(self, directory: Path | None) -> None:
        self._path = None if directory is None else directory / _FILE_NAME

    def load(self) -> Kept | None:
        """Return what was kept, or None; a file that cannot be used is told and learning begins anew."""
        if self._path is None:
            return None
        try:
            return Kept.model_validate_json(self._path.read_text())
        except (FileNotFoundError, NotADirectoryError):
            return None
        except (OSError, ValueError):
            log.warning("%s cannot be used: what was learned of the site is learned anew", self._path)
            return None

    def save(self, kept: Kept) -> None:
        """Replace the file as a whole; a disk that fails is told and does not hinder tracking."""
        if self._path is None:
            return
        try:
            replace_file(self._path, kept.model_dump_json())
        except OSError as error:
            log.warning("%s cannot be written (%s): a restart would forget what was learned", self._path, error)
