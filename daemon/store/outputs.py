"""Where results go: checked before the work, so that nothing is overwritten unasked."""

import os
from collections.abc import Iterable
from pathlib import Path

from daemon.base.errors import UserError


def check_outputs(paths: Iterable[Path], option: str, *, force: bool) -> None:
    """Raise `UserError` for results that could not be written, or would overwrite what is there.

    To be called before the work; nothing is made or changed.

    Parameters
    ----------
    paths
        Of the files that the work will write.
    option
        Of the command line that named them.
    force
        Whether files that are there may be replaced.
    """
    wanted = list(paths)
    for folder in dict.fromkeys(path.parent for path in wanted):
        check_folder(folder, option)
    for path in wanted:
        if path.is_dir():
            raise UserError(f"{option}: {path} is a folder: name a file in it")
        if path.exists() and not path.is_file():
            # The result, a file, would take its place.
            raise UserError(f"{option}: {path} is no ordinary file, but a device or a pipe: name another")
        if path.exists() and not force:
            raise UserError(f"{path} is there already: --force overwrites it, or name another {option}")


def check_folder(folder: Path, option: str) -> None:
    """Raise `UserError` for a folder that cannot take files, or cannot be made for them."""
    try:
        there = next(each for each in (folder, *folder.absolute().parents) if each.exists())
    except OSError as error:
        raise UserError(f"{option}: {folder} cannot be a folder: {error.strerror}") from None
    if not there.is_dir():
        raise UserError(f"{option}: {folder} cannot be a folder: {there} is a file")
    if not os.access(there, os.W_OK | os.X_OK):
        raise UserError(f"{option}: {there} cannot be written to: name another folder, or ask its owner for permission")
