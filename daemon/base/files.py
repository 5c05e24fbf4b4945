"""Small files: replaced as a whole so that a crash leaves no part, kept state, and secrets for their owner alone."""

import contextlib
import logging
import os
import stat
from pathlib import Path
from typing import TYPE_CHECKING, Generic, TypeVar

from daemon.base.errors import UserError

if TYPE_CHECKING:
    # A stop reads its token by this module, and waits for no large library.
    from pydantic import BaseModel

State = TypeVar("State", bound="BaseModel")


class UnreadableStateError(Exception):
    """A file of kept state is there and cannot be used; `path` is its name."""

    def __init__(self, path: Path) -> None:
        super().__init__(f"{path} cannot be read")
        self.path = path


class StateFile(Generic[State]):
    """What must outlive a restart, in a small JSON file; without a folder it lives in memory only.

    Parameters
    ----------
    directory, name
        Of the file; no directory, no file.
    model
        What the file holds. A file with anything else in it is unreadable.
    logger
        Where a disk that fails is reported.
    forgotten
        What a restart would forget if the file cannot be written, as the end of a sentence.

    Attributes
    ----------
    path
        Of the file, or None.
    """

    def __init__(
        self, directory: Path | None, name: str, model: type[State], logger: logging.Logger, forgotten: str
    ) -> None:
        self.path = None if directory is None else directory / name
        self._model = model
        self._logger = logger
        self._forgotten = forgotten
        self._failed = False

    def load(self) -> State | None:
        """Return what was kept, None if nothing was.

        Raises
        ------
        UnreadableStateError
            There is a file, and nobody knows what was kept in it: what that means is the caller's to say.
        """
        if self.path is None:
            return None
        try:
            return self._model.model_validate_json(self.path.read_text())
        except (FileNotFoundError, NotADirectoryError):
            return None
        except (OSError, ValueError) as error:
            raise UnreadableStateError(self.path) from error

    def save(self, state: State) -> bool:
        """Replace the file as a whole, and return whether that went well; a disk that fails is reported once."""
        if self.path is None:
            return True
        try:
            replace_file(self.path, state.model_dump_json(exclude_none=True))
        except OSError as error:
            if not self._failed:
                self._logger.warning(
                    "%s cannot be written (%s): a restart would forget %s", self.path, error, self._forgotten
                )
            self._failed = True
            return False
        self._failed = False
        return True


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
