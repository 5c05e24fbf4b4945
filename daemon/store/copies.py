"""The copy of a store that is kept before a newer release changes it, so that there is a way back."""

import logging
import shutil
import sqlite3
from contextlib import closing
from pathlib import Path

log = logging.getLogger("heliocube.store")

_STEM = "heliocube.version-"
_SUFFIX = ".sqlite"
_SPARE_BYTES = 64 << 20


def copy_path(path: Path, version: int) -> Path:
    """Return where a store of a version is kept, beside the one in use."""
    return path.with_name(f"{_STEM}{version}{_SUFFIX}")


def copies_of(directory: Path) -> list[Path]:
    """Return the copies in a folder, the oldest version first."""
    found = [path for path in directory.glob(f"{_STEM}*{_SUFFIX}") if version_of(path) is not None]
    return sorted(found, key=lambda path: version_of(path) or 0)


def version_of(copy: Path) -> int | None:
    """Return the version that a copy's name bears, or None for another file."""
    number = copy.name.removeprefix(_STEM).removesuffix(_SUFFIX)
    return int(number) if number.isascii() and number.isdecimal() else None


def keep_copy(connection: sqlite3.Connection, path: Path, version: int) -> None:
    """Copy a store of an older version beside it, if there is room; a copy of that version that is there is replaced.

    Without room, or if the disk fails, the store is changed all the same, because to keep new records is worth more
    than a short way back; a warning says so.

    Parameters
    ----------
    connection
        To the store, not in a transaction.
    path, version
        Of the store.
    """
    copy = copy_path(path, version)
    part = copy.with_name(f"{copy.name}.part")
    size = _size_bytes(connection)
    try:
        lacking = missing_space_text(path, size)
        if lacking is not None:
            _warn_without_copy(path, version, lacking)
            return
        # A process that was killed while it copied has left it.
        part.unlink(missing_ok=True)
        with closing(sqlite3.connect(part)) as target:
            connection.backup(target)
        part.replace(copy)
    except (sqlite3.Error, OSError) as error:
        _warn_without_copy(path, version, str(error))
    else:
        log.warning(
            "the store %s is of version %d: before it is changed, a copy is kept as %s (%.0f MB)",
            path,
            version,
            copy,
            size / 1e6,
        )
    finally:
        part.unlink(missing_ok=True)


def missing_space_text(path: Path, size: int) -> str | None:
    """Return why a copy of a store of that many bytes does not fit beside it, or None; raises `OSError`."""
    free, needed = shutil.disk_usage(path.parent).free, size + _SPARE_BYTES
    if free >= needed:
        return None
    return f"a copy needs {needed / 1e6:.0f} MB and {free / 1e6:.0f} MB are free"


def _warn_without_copy(path: Path, version: int, why: str) -> None:
    log.warning(
        "the store %s is of version %d and is changed WITHOUT a copy (%s): on a return to the release before,"
        " this store is moved aside and a new store begins",
        path,
        version,
        why,
    )


def _size_bytes(connection: sqlite3.Connection) -> int:
    pages: int = connection.execute("PRAGMA page_count").fetchone()[0]
    size: int = connection.execute("PRAGMA page_size").fetchone()[0]
    return pages * size
