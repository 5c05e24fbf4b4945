"""Small files: TOML within bounds, replacing as a whole so that a crash leaves no part, and secrets."""

import contextlib
import itertools
import os
import stat
import sys
import tomllib
from collections.abc import Iterator
from pathlib import Path
from typing import Any, TextIO

from daemon.base.errors import UserError

# A file that names every key with its comment has 40 kB.
_MOST_TOML_BYTES = 131072
_MOST_TOML_VALUES = 2000
_DEEPEST_TOML = 20
# The time to parse a key grows with the square of its parts.
_MOST_POINTS = 200
_LONGEST_TOML_TEXT = 4096


@contextlib.contextmanager
def atomic_output_path(path: Path) -> Iterator[Path]:
    """Give a path beside `path` for a file that takes its place once it is written; an error leaves what was there.

    Links are followed; whatever else is there is replaced.
    """
    # Not Path.resolve, which raises at a link to itself.
    path = Path(os.path.realpath(path))
    part = path.with_name(f".{path.name}.part")
    try:
        yield part
        part.replace(path)
    finally:
        with contextlib.suppress(OSError):
            part.unlink()


@contextlib.contextmanager
def atomic_text_file(path: Path, errors: str = "strict") -> Iterator[TextIO]:
    """Give a text file that takes the place of `path` once all has been written; an error leaves what was there.

    `errors` tells what becomes of letters that UTF-8 does not have, as for `open`.
    """
    with atomic_output_path(path) as part, part.open("w", encoding="utf-8", errors=errors, newline="") as file:
        yield file


def replace_file(path: Path, text: str) -> None:
    """Write `text` to `path` by way of a file beside it, and make its folder; an `OSError` leaves no part of it."""
    path.parent.mkdir(parents=True, exist_ok=True)
    with atomic_text_file(path) as file:
        _write_and_sync(file, text)
    sync_directory(Path(file.name).parent)


def rewrite_file(path: Path, text: str) -> None:
    """Replace the content of a person's file as a whole; its owner and its rights stay as they are.

    Raises
    ------
    OSError
        The file cannot be written, for example on a full disk. It stays as it was.
    """
    with atomic_text_file(path) as file:
        _write_and_sync(file, text, path.stat())
    sync_directory(Path(file.name).parent)


def write_new(path: Path, text: str, like: os.stat_result | None = None) -> None:
    """Write a file that must not be there yet, with owner and rights as in `like`.

    Raises
    ------
    OSError
        The file is there, or cannot be written. No part of it is left.
    """
    file = path.open("x", encoding="utf-8", newline="\n")
    try:
        with file:
            _write_and_sync(file, text, like)
    except OSError:
        path.unlink(missing_ok=True)
        raise
    sync_directory(path.parent)


def _write_and_sync(file: TextIO, text: str, like: os.stat_result | None = None) -> None:
    """Write a text into an open file, with owner and rights as in `like`, and have it on the disk."""
    if like is not None:
        Path(file.name).chmod(stat.S_IMODE(like.st_mode))
    if like is not None and sys.platform != "win32":
        # This fails rather than make somebody else's file our own.
        os.chown(file.name, like.st_uid, like.st_gid)
    file.write(text)
    file.flush()
    os.fsync(file.fileno())


def numbered_paths(path: Path) -> Iterator[Path]:
    """Yield a path, and the same with -2, -3 and so on at its end."""
    yield path
    yield from (path.with_name(f"{path.name}-{again}") for again in itertools.count(2))


def first_free(path: Path) -> Path:
    """Return the first of `numbered_paths` that is not there."""
    return next(each for each in numbered_paths(path) if not each.exists())


def make_folder(folder: Path) -> None:
    """Make a folder, and those above it; what root makes is given to the owner of the folder that is there already."""
    if folder.is_dir():
        return
    if not folder.parent.exists():
        make_folder(folder.parent)
    folder.mkdir(exist_ok=True)
    give_to_folder_owner(folder)


def give_to_folder_owner(path: Path) -> None:
    """Give a path that root has made to the owner of the folder that it is in."""
    if sys.platform == "win32" or os.geteuid() != 0:
        return
    owner = path.parent.stat()
    os.chown(path, owner.st_uid, owner.st_gid)


def sync_directory(folder: Path) -> None:
    """Have the names in a folder on the disk when this returns: until then a renamed file may lose its new name.

    Does nothing on Windows and on file systems that cannot do this.
    """
    if sys.platform == "win32":
        return
    with contextlib.suppress(OSError):
        descriptor = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
        try:
            os.fsync(descriptor)
        finally:
            os.close(descriptor)


def toml_text(path: Path) -> str:
    """Return the text of a TOML file that is worth parsing.

    Raises
    ------
    OSError
        It cannot be read; `FileNotFoundError` among them.
    ValueError
        It is not worth parsing: the message is one sentence without the file's name.
    """
    if not path.is_file() and path.exists() and not path.is_dir():
        raise ValueError("the file is not an ordinary one, but a device or a pipe")
    with path.open("rb") as file:
        content = file.read(_MOST_TOML_BYTES + 1)
    if len(content) > _MOST_TOML_BYTES:
        raise ValueError(
            f"the file is longer than {_MOST_TOML_BYTES} bytes, and no configuration of heliocube is that long"
        )
    try:
        # Some editors of Windows put a byte order mark in front, which TOML does not know.
        text = content.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise ValueError(f"byte {error.start} is not UTF-8; save the file as UTF-8 text") from None
    for number, line in enumerate(text.split("\n"), 1):
        if line.count(".") > _MOST_POINTS and not line.lstrip().startswith("#"):
            raise ValueError(f"line {number}: more than {_MOST_POINTS} points in one line")
    return text


def parse_toml(text: str) -> dict[str, Any]:
    """Return the values of a TOML text; raises `tomllib.TOMLDecodeError`, and `ValueError` as `toml_text` does."""
    try:
        values = tomllib.loads(text)
    except tomllib.TOMLDecodeError:
        raise
    except ValueError:
        # Python reads no integers of more than some thousands of digits.
        raise ValueError("a number in it has too many digits") from None
    except RecursionError:
        raise ValueError("its brackets are nested too deeply") from None
    _check_bounds(values)
    return values


def _check_bounds(values: dict[str, Any]) -> None:
    waiting: list[tuple[str, Any, int]] = [("", values, 0)]
    for count, (place, value, depth) in enumerate(waiting):
        if depth > _DEEPEST_TOML:
            raise ValueError(f"{place[:60]}...: tables and lists are nested more than {_DEEPEST_TOML} deep")
        if count > _MOST_TOML_VALUES:
            raise ValueError(
                f"it has more than {_MOST_TOML_VALUES} values, and no configuration of heliocube has so many"
            )
        reason = _why_unusable(value)
        if reason is not None:
            raise ValueError(f"{place}: {reason}")
        if isinstance(value, dict):
            for name in value:
                if (reason := _why_unusable(name)) is not None:
                    raise ValueError(f"a key in [{place}]: {reason}")
            names = [ascii(name)[1:-1] for name in value]
            places = [f"{place}.{name}" if place else name for name in names]
            waiting += [(inner, each, depth + 1) for inner, each in zip(places, value.values(), strict=True)]
        elif isinstance(value, list):
            waiting += [(f"{place}[{number}]", inner, depth + 1) for number, inner in enumerate(value)]


def _why_unusable(value: Any) -> str | None:
    """Return why nobody can mean a single value, or None."""
    if isinstance(value, int) and not -(1 << 63) <= value < 1 << 63:
        return "the number has more than the 64 bits that TOML gives it"
    if isinstance(value, str) and len(value) > _LONGEST_TOML_TEXT:
        return f"the text is longer than {_LONGEST_TOML_TEXT} characters"
    if isinstance(value, str) and "\0" in value:
        return "the text has a NUL character in it, which no path and no name may have"
    return None


def write_secret(path: Path, content: bytes, called: str, error: type[UserError]) -> None:
    """Write a new file that only its owner can read; never overwrites, and leaves no part of a file.

    Parameters
    ----------
    called
        The file as messages name it, such as ``the token file /etc/x``.
    error
        What is raised, with one sentence.
    """
    try:
        descriptor = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600)
    except FileExistsError:
        raise error(f"{called} exists and is not overwritten: move it away to make a new one") from None
    except OSError as failure:
        raise error(f"{called} cannot be written: {failure.strerror}") from None
    try:
        with os.fdopen(descriptor, "wb") as file:
            file.write(content)
            file.flush()
            os.fsync(descriptor)
    except OSError as failure:
        # A part of the file would be taken for the secret.
        path.unlink(missing_ok=True)
        raise error(f"{called} cannot be written: {failure.strerror}") from None
    sync_directory(path.parent)


def read_secret(
    path: Path, most_bytes: int, called: str, missing: str, error: type[UserError], *, group_may_read: bool
) -> bytes:
    """Return the first `most_bytes` of a file that is open to its owner only, or also to its group's readers.

    Windows has no such file modes; there nothing is checked.

    Parameters
    ----------
    called
        The file as messages name it.
    missing
        The sentence for a file that is not there, with the remedy.
    error
        What is raised, with one sentence.
    """
    try:
        if path.exists() and not (path.is_file() or path.is_dir()):
            raise error(f"{called} is not an ordinary file, but a device or a pipe")
        with path.open("rb") as file:
            mode = os.fstat(file.fileno()).st_mode
            content = file.read(most_bytes)
    except FileNotFoundError:
        raise error(missing) from None
    except OSError as failure:
        raise error(f"{called} cannot be read: {failure.strerror}") from None
    if os.name == "posix" and stat.S_IMODE(mode) & (0o027 if group_may_read else 0o077):
        if group_may_read:
            reason = f"is open to others than its owner and its group's readers: run chmod 640 {path}"
        else:
            reason = f"can be read by others than its owner: run chmod 600 {path}"
        raise error(f"{called} {reason}")
    return content
