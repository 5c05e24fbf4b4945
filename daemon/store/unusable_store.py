"""A store that cannot be used is moved aside, with its date and the reason in its name; nothing in it is touched.

If something is only in the place of a file that SQLite keeps beside the store, that alone is moved, and the store goes
on.
"""

import os
import stat
from datetime import UTC, datetime
from pathlib import Path

# The endings of the files that SQLite keeps beside a database: without these the latest records are lost.
_COMPANIONS = ("-wal", "-shm", "-journal")
# The reasons to move something aside, as its new name has them, and how a sentence about it begins.
KINDS = {
    "damaged": "a damaged store",
    "newer": "a store that was written by a newer heliocube",
    "foreign": "a file that is no store of heliocube, or one with a damaged beginning,",
    "folder": "a folder in the store's place",
    "device": "a pipe or a device in the store's place",
    "link": "a link in the store's place that leads back to itself",
    "locked": "a store that may not be written by this user",
    "beside": "what was in the place of a file that SQLite keeps beside the store",
}
_HOLDS_NO_RECORDS = ("folder", "device", "link", "beside")


def sidecar_files(path: Path) -> list[Path]:
    """Return the files that SQLite keeps beside a database and that are there."""
    return [beside for suffix in _COMPANIONS if os.path.lexists(beside := Path(f"{path}{suffix}"))]


def sidecar_obstacles(path: Path) -> list[Path]:
    """Return what stands in the place of such a file and is no file: a folder, a pipe, a link to nowhere."""
    return [beside for beside in sidecar_files(path) if not _is_file(beside)]


def _is_file(path: Path) -> bool:
    try:
        return stat.S_ISREG(path.stat().st_mode)
    except OSError:
        # SQLite itself may have removed it meanwhile.
        return not path.is_symlink()


def move_aside(path: Path, kind: str, utc_s: float) -> Path:
    """Give a store and the files beside it, or what is in the way beside it, a new name in its folder; return that.

    Parameters
    ----------
    path
        The file, or what is in its place.
    kind
        Of `KINDS`.
    utc_s
        Now [s].

    Raises
    ------
    OSError
        The folder cannot be written to.
    """
    if kind == "beside":
        for beside in sidecar_obstacles(path):
            beside.rename(_unused_path(path, kind, utc_s))
        return find_moved_aside(path)[-1]
    aside = _unused_path(path, kind, utc_s)
    # The files beside it go first: a store that still stood there without them would be used, and lose their records.
    for beside in sidecar_files(path):
        beside.rename(f"{aside}{str(beside).removeprefix(str(path))}")
    path.rename(aside)
    return aside


def _unused_path(path: Path, kind: str, utc_s: float) -> Path:
    """Return a name that nothing has yet."""
    stamp = datetime.fromtimestamp(utc_s, UTC).strftime("%Y%m%dT%H%M%SZ")
    again, aside = 1, path.with_name(f"{path.stem}.{stamp}.{kind}{path.suffix}")
    while os.path.lexists(aside):
        again += 1
        aside = path.with_name(f"{path.stem}.{stamp}-{again}.{kind}{path.suffix}")
    return aside


def find_moved_aside(path: Path) -> list[Path]:
    """Return what has been moved aside from a store's path and is still there, the oldest first."""
    found = path.parent.glob(f"{path.stem}.*Z*.*{path.suffix}")
    return sorted(one for one in found if one.name.split(".")[-2] in KINDS)


def aside_text(path: Path) -> str | None:
    """Return in a sentence what has been moved aside from a store's path, and what to do; None for nothing."""
    found = find_moved_aside(path)
    if not found:
        return None
    newest = found[-1]
    more = f", and {len(found) - 1} before it" if len(found) > 1 else ""
    kind = newest.name.split(".")[-2]
    salvage = f"'heliocube store salvage {newest} --into {path.parent}' gets what can be read from it; "
    remedy = "" if kind in _HOLDS_NO_RECORDS else salvage
    what_now = "the store goes on" if kind == "beside" else "a new store was begun"
    return (
        f"{KINDS[kind]} was moved aside as {newest}{more}, and {what_now}: {remedy}"
        "this alarm ends when what was moved aside is in another folder"
    )
