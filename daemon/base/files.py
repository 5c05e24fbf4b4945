"""Small files: replaced as a whole so that a crash leaves no part, and secrets that only their owner can read."""

import contextlib
import os
import stat
from pathlib import Path

from daemon.base.errors import UserError


def write_secret(path: Path, content: bytes, called: str, error: type[UserError]) -> None:
    """Write a new file that only its owner can read; never overwrites.

    Parameters
    ----------
    called
        The file as messages name it, such as ``the token file /etc/x``.
    error
        What is raised, with one sentence.
    """
    try:
        descriptor = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600)
        with os.fdopen(descriptor, "wb") as file:
            file.write(content)
    except FileExistsError:
        raise error(f"{called} exists and is not overwritten: move it away to make a new one") from None
    except OSError as failure:
        raise error(f"{called} cannot be written: {failure.strerror}") from None


def read_secret(
    path: Path, most_bytes: int, called: str, missing: str, error: type[UserError], *, group_may_read: bool
) -> bytes:
    """Return the first `most_bytes` of a file that is open to its owner only, or also to its group's readers.

    Windows has no such file modes; there they are not looked at.

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


def replace_file(path: Path, text: str) -> None:
    """Write `text` to `path` by way of a file beside it, and make its folder; raises `OSError` and leaves nothing."""
    part = path.with_suffix(".part")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with part.open("w") as file:
            file.write(text)
            file.flush()
            os.fsync(file.fileno())
        part.replace(path)
    except OSError:
        with contextlib.suppress(OSError):
            part.unlink()
        raise
