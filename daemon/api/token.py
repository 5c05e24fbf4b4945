"""The token that a command over the local interface must bear."""

import base64
import os
import re
import stat
from pathlib import Path

from daemon.errors import UserError

_BYTES = 32
_SHORTEST, _LONGEST = 32, 512
_TOKEN = re.compile(r"[A-Za-z0-9._~+/=-]+")


class TokenError(UserError):
    """A token file cannot be used; the message names the file and the remedy."""


def generate_token() -> str:
    """Return a new token, from the operating system's generator."""
    return base64.urlsafe_b64encode(os.urandom(_BYTES)).rstrip(b"=").decode()


def write_token(path: Path, token: str) -> None:
    """Write `token` to a new file that only its owner can read; never overwrites. Raises `TokenError`."""
    try:
        descriptor = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600)
        with os.fdopen(descriptor, "w", encoding="ascii") as file:
            file.write(token + "\n")
    except FileExistsError:
        raise TokenError(
            f"the token file {path} exists and is not overwritten: move it away to make a new one"
        ) from None
    except OSError as error:
        raise TokenError(f"the token file {path} cannot be written: {error.strerror}") from None


def load_token(path: Path) -> str:
    """Return the token in a file: one line of 32 characters or more, readable by its owner and at most its group.

    Raises
    ------
    TokenError
        One sentence with the file and the remedy. Windows has no such file modes; there they are not looked at.
    """
    remedy = "write a new one with 'heliocube config init'"
    try:
        with path.open("rb") as file:
            mode = os.fstat(file.fileno()).st_mode
            content = file.read(_LONGEST + 2)
    except FileNotFoundError:
        raise TokenError(f"the token file {path} does not exist: {remedy}") from None
    except OSError as error:
        raise TokenError(f"the token file {path} cannot be read: {error.strerror}") from None
    if os.name == "posix" and stat.S_IMODE(mode) & 0o027:
        raise TokenError(
            f"the token file {path} is open to others than its owner and its group's readers: run chmod 640 {path}"
        )
    return check_token(content.decode("latin-1").strip(), f"the token file {path}", remedy)


def check_token(text: str, where: str, remedy: str = "copy the whole token") -> str:
    """Return `text` if it can be a token; raises `TokenError` with `where` it stands and the remedy."""
    if not _SHORTEST <= len(text) <= _LONGEST or _TOKEN.fullmatch(text) is None:
        raise TokenError(f"{where} is not one line of {_SHORTEST} to {_LONGEST} letters and digits: {remedy}")
    return text
