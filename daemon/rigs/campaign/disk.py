"""A disk that can be full."""

import errno
import os
from pathlib import Path

from daemon.base.files import replace_file


class Disk:
    """What the service writes its kept files to.

    Attributes
    ----------
    is_full
        Whether nothing can be written at present.
    """

    def __init__(self) -> None:
        self.is_full = False

    def replace(self, path: Path, text: str) -> None:
        """Replace a file as a whole; `OSError` while the disk is full."""
        if self.is_full:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), str(path))
        replace_file(path, text)
