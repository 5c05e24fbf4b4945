"""What a law keeps from one run to the next: a small file beside the store, of whatever law it is."""

import json
import logging
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from daemon.base.files import replace_file

log = logging.getLogger("heliocube.law")

_FILE_NAME = "learned.json"


class LawFile:
    """A small file beside the store; without a folder what is learned lives in memory only.

    Parameters
    ----------
    directory
        Of the file, or None.
    """

    def __init__(self, directory: Path | None) -> None:
        self._path = None if directory is None else directory / _FILE_NAME

    def load(self) -> dict[str, Any] | None:
        """Return what was kept, or None; a file that cannot be used is told and learning begins anew."""
        if self._path is None:
            return None
        try:
            kept = json.loads(self._path.read_text())
        except (FileNotFoundError, NotADirectoryError):
            return None
        except (OSError, ValueError):
            self.refuse()
            return None
        if not isinstance(kept, dict):
            self.refuse()
            return None
        return kept

    def refuse(self) -> None:
        """Tell that what was kept is not what the law can go on from."""
        log.warning("%s cannot be used: what was learned of the site is learned anew", self._path)

    def save(self, kept: Mapping[str, Any] | None) -> None:
        """Replace the file as a whole; a disk that fails is told and does not hinder tracking."""
        if self._path is None or kept is None:
            return
        try:
            replace_file(self._path, json.dumps(kept, separators=(",", ":")))
        except OSError as error:
            log.warning("%s cannot be written (%s): a restart would forget what was learned", self._path, error)
