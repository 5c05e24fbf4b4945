"""A disk that can be full."""

import errno
import os
from pathlib import Path

from daemon.base.state import ROOM_BYTES, replace_state_file, reserve_disk_space, spare_of


class Disk:
    """The disk to which the service writes the files that it keeps.

    Attributes
    ----------
    is_full
        Whether the disk has no room at present, except what files have already.
    """

    def __init__(self) -> None:
        self.is_full = False

    def replace(self, path: Path, text: str) -> None:
        """Replace a file as a whole; `OSError` if the disk is full and the file's reserved room does not suffice."""
        if self.is_full and not (spare_of(path).is_file() and len(text.encode()) <= ROOM_BYTES):
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), str(path))
        replace_state_file(path, text)

    def reserve(self, path: Path) -> None:
        """Reserve room for a file, unless the disk is full."""
        if not self.is_full:
            reserve_disk_space(path)
