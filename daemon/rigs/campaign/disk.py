"""A disk that can be full."""

import errno
import os
from pathlib import Path

from daemon.base.state import ROOM_BYTES, replace_kept, reserve_room, spare_of


class Disk:
    """What the service writes its kept files to.

    Attributes
    ----------
    is_full
        Whether there is no room at present but what files have already.
    """

    def __init__(self) -> None:
        self.is_full = False

    def replace(self, path: Path, text: str) -> None:
        """Replace a file as a whole; `OSError` while the disk is full and what the file has is not enough."""
        if self.is_full and not (spare_of(path).is_file() and len(text.encode()) <= ROOM_BYTES):
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), str(path))
        replace_kept(path, text)

    def reserve(self, path: Path) -> None:
        """Keep room for a file, where there is some."""
        if not self.is_full:
            reserve_room(path)
