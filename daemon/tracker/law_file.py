"""What a law keeps from one run to the next: a small file beside the store, for any law."""

import logging
from collections.abc import Mapping
from typing import Any

from pydantic import RootModel

from daemon.base.state import StateFile, StateFolder, UnreadableStateError

log = logging.getLogger("heliocube.law")

FILE_NAME = "learned.json"


class _LearnedData(RootModel[dict[str, Any]]):
    pass


class LawFile:
    """A small file beside the store; in a folder without a directory what is learned lives in memory only.

    Parameters
    ----------
    folder, name
        Folder and name of the file.
    """

    def __init__(self, folder: StateFolder, name: str = FILE_NAME) -> None:
        self._file = StateFile(folder, name, _LearnedData, log, "what was learned")

    def load(self) -> dict[str, Any] | None:
        """Return what was kept, or None; a file that cannot be read is reported and learning begins anew."""
        try:
            kept = self._file.load()
        except UnreadableStateError:
            self.refuse()
            return None
        return None if kept is None else kept.root

    def refuse(self) -> None:
        """Report that the law cannot go on from what was kept."""
        log.warning("%s cannot be used: the law learns the site again from the beginning", self._file.path)

    def save(self, kept: Mapping[str, Any] | None) -> None:
        """Have the file replaced as a whole; a slow or failing disk does not hold up tracking."""
        if kept is not None:
            self._file.save(_LearnedData(dict(kept)))
