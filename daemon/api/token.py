"""The token that a command over the local interface must bear."""

import base64
import os
import re
from pathlib import Path

from daemon.base.errors import UserError
from daemon.base.files import read_secret, write_secret

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
    write_secret(path, f"{token}\n".encode("ascii"), f"the token file {path}", TokenError)


def load_token(path: Path) -> str:
    """Return the token in a file: one line of 32 characters or more, readable by its owner and at most its group.

    Raises
    ------
    TokenError
        One sentence with the file and the remedy. Windows has no such file modes; there they are not looked at.
    """
    remedy = "copy a new one from a new folder of 'heliocube config init FOLDER'"
    called = f"the token file {path}"
    missing = f"{called} does not exist: {remedy}"
    content = read_secret(path, _LONGEST + 2, called, missing, TokenError, group_may_read=True)
    return check_token(content.decode("latin-1").strip(), called, remedy)


def check_token(text: str, where: str, remedy: str = "copy the whole token") -> str:
    """Return `text` if it can be a token; raises `TokenError` with `where` it stands and the remedy."""
    if not _SHORTEST <= len(text) <= _LONGEST or _TOKEN.fullmatch(text) is None:
        raise TokenError(f"{where} is not one line of {_SHORTEST} to {_LONGEST} letters and digits: {remedy}")
    return text
