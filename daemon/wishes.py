"""What an operator has asked for and not yet released, kept over a restart.

A service that is killed in a storm or under repair and comes back must not go to work by itself.
"""

import logging
from pathlib import Path

from pydantic import BaseModel, ConfigDict

from daemon.replace_file import replace_file

log = logging.getLogger("heliocube.control")

_FILE_NAME = "operator.json"


class Wishes(BaseModel):
    """Why the tracker is stopped, stowed or held; None where it is not."""

    model_config = ConfigDict(frozen=True, extra="forbid", strict=True)

    stop: str | None = None
    stow: str | None = None
    hold: str | None = None


class WishFile:
    """Wishes in a small file beside the store; without a folder they live in memory only.

    Parameters
    ----------
    directory
        Of the file, or None.
    """

    def __init__(self, directory: Path | None) -> None:
        self._path = None if directory is None else directory / _FILE_NAME

    def load(self) -> Wishes:
        """Return what was wished before the restart; a file that cannot be read counts as a stop."""
        if self._path is None:
            return Wishes()
        try:
            return Wishes.model_validate_json(self._path.read_text())
        except (FileNotFoundError, NotADirectoryError):
            return Wishes()
        except (OSError, ValueError):
            log.warning("%s cannot be read: the tracker stays stopped until 'heliocube auto'", self._path)
            return Wishes(stop=f"{self._path} cannot be read: nobody knows what was asked before the restart")

    def save(self, wishes: Wishes) -> None:
        """Replace the file as a whole; a disk that fails is told and does not hinder the command."""
        if self._path is None:
            return
        try:
            replace_file(self._path, wishes.model_dump_json())
        except OSError as error:
            log.warning("%s cannot be written (%s): a restart would forget what was asked", self._path, error)
