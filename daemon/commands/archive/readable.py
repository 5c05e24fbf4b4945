"""Gives commands a store to read: a folder as it is, or a copy of the part of an archive that is wanted."""

import math
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

from daemon.archive.address import is_archive, parse_archive
from daemon.store.schema import FILE_NAME, require_store

if TYPE_CHECKING:
    from daemon.archive.reader import ArchiveReader

# Returns begin and end [s UTC] of the wanted span, from the reader, which knows the site.
Span = Callable[["ArchiveReader"], tuple[float, float]]


def _whole_span(_reader: "ArchiveReader") -> tuple[float, float]:
    return -math.inf, math.inf


def check_readable(store: str) -> None:
    """Raise `UserError`, before large libraries are loaded, if this is neither an archive's address nor a store."""
    if is_archive(store):
        parse_archive(store)
    else:
        require_store(Path(store) / FILE_NAME)


@contextmanager
def open_store_or_archive(store: str, span: Span = _whole_span) -> Iterator[tuple[Path, str]]:
    """Yield the folder of a store, and its name for messages; the copy of an archive is deleted afterwards.

    Parameters
    ----------
    store
        A folder, or ``postgresql://USER@HOST/DATABASE#PREFIX/NAME``.
    span
        Which span of an archive is wanted.

    Raises
    ------
    UserError
        The archive cannot be read, or has no records of that time.
    """
    if not is_archive(store):
        yield Path(store), ""
        return
    from daemon.archive.reader import ArchiveReader, temporary_store
    from daemon.base.process import signals_as_ctrl_c

    reader = ArchiveReader(parse_archive(store))
    try:
        # A copy of months is large, and would be left behind if a lost connection ended the command.
        with signals_as_ctrl_c(), temporary_store(reader, *span(reader)) as folder:
            yield folder, f"the archive {reader.address.url}, {reader.installation}"
    finally:
        reader.close()
