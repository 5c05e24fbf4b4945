"""Small files: TOML within bounds, replacing as a whole so that a crash leaves no part, kept state, and secrets."""

import contextlib
import logging
import os
import stat
import threading
import time
import tomllib
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Generic, TypeVar

from daemon.base.errors import UserError

if TYPE_CHECKING:
    # A stop reads its token by this module, and waits for no large library.
    from pydantic import BaseModel

log = logging.getLogger("heliocube.state")

# A file that names every key with its comment has 40 kB.
_MOST_TOML_BYTES = 131072
_MOST_TOML_VALUES = 2000
_DEEPEST_TOML = 20
# What parses a key takes the square of its parts.
_MOST_POINTS = 200
_LONGEST_TOML_TEXT = 4096

_CLOSE_WITHIN_S = 3.0
_SLOW_AFTER_S = 5.0

State = TypeVar("State", bound="BaseModel")


class UnreadableStateError(Exception):
    """A file of kept state is there and cannot be used; `path` is its name."""

    def __init__(self, path: Path) -> None:
        super().__init__(f"{path} cannot be read")
        self.path = path


def replace_file(path: Path, text: str) -> None:
    """Write `text` to `path` by way of a file beside it, and make its folder; raises `OSError` and leaves nothing."""
    part = path.with_suffix(".part")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with part.open("w", encoding="utf-8", newline="\n") as file:
            file.write(text)
            file.flush()
            os.fsync(file.fileno())
        part.replace(path)
    except OSError:
        with contextlib.suppress(OSError):
            part.unlink()
        raise


@dataclass(slots=True)
class _Content:
    """What one file is to hold, since when [s]; `tried` once it has been attempted."""

    text: str
    forgotten: str
    logger: logging.Logger
    since_s: float
    tried: bool = False


class StateFolder:
    """The small files that one tracker keeps over a restart; nothing that moves it waits for their disk.

    Of each file the newest content counts. What cannot be written is kept in memory and tried again.

    Parameters
    ----------
    directory
        Of the files, made if it is missing; None keeps everything in memory only.
    behind
        Whether a thread writes, as a service in real time needs; without it, `put` writes before it returns.
    replace
        Writes a text to a path so that a crash leaves the whole old or the whole new file; raises `OSError`.
    now_s
        The machine's own time [s], whatever the service's is: disks know no other.
    """

    def __init__(
        self,
        directory: Path | None,
        *,
        behind: bool = False,
        replace: Callable[[Path, str], None] = replace_file,
        now_s: Callable[[], float] = time.monotonic,
    ) -> None:
        self.directory = directory
        self._behind = behind
        self._replace = replace
        self._now_s = now_s
        self._changed = threading.Condition()
        self._waiting: dict[Path, _Content] = {}
        self._failed: dict[Path, str] = {}
        self._working = False

    def put(self, path: Path, text: str, forgotten: str, logger: logging.Logger) -> None:
        """Have a file replaced as a whole.

        Parameters
        ----------
        path, text
            The file and its new content.
        forgotten
            What a restart would forget without it, as the end of a sentence.
        logger
            Where a disk that fails is reported, once until it works again.
        """
        with self._changed:
            # At the end of the queue: the files are written in the order of their latest contents.
            self._waiting.pop(path, None)
            self._waiting[path] = _Content(text, forgotten, logger, self._now_s())
        self._write()

    @property
    def at_work(self) -> bool:
        """Whether something is being written that has not failed yet."""
        with self._changed:
            return self._working

    @property
    def unsaved(self) -> str | None:
        """What a restart now would forget, and why, in a sentence; None if all is on the disk."""
        with self._changed:
            return self._sentence(self._waiting)

    @property
    def trouble(self) -> str | None:
        """What is unsaved because the disk fails or does not answer, or None; a disk at work is no trouble."""
        with self._changed:
            latest_s = self._now_s() - _SLOW_AFTER_S
            slow = [path for path, kept in self._waiting.items() if path in self._failed or kept.since_s <= latest_s]
            return self._sentence(slow)

    def retry(self) -> None:
        """Try again what could not be written; to be called every few seconds."""
        with self._changed:
            if not self._failed:
                return
            for path in self._failed:
                self._waiting[path].tried = False
        self._write()

    def settle(self, within_s: float) -> bool:
        """Wait until everything has been tried once, and return whether all is on the disk; blocks."""
        with self._changed:
            self._changed.wait_for(lambda: not self._working, within_s)
            return not self._waiting

    def close(self) -> None:
        """Try once more what waits, for a few seconds at most, and report what a restart will have forgotten."""
        self.retry()
        self.settle(_CLOSE_WITHIN_S)
        unsaved = self.unsaved
        if unsaved is not None:
            log.error("%s", unsaved)

    def _write(self) -> None:
        with self._changed:
            if self._working:
                return
            self._working = True
        if self._behind:
            # Not waited for at the end of the process: a disk may never answer.
            threading.Thread(target=self._work, name="kept state", daemon=True).start()
        else:
            self._work()

    def _work(self) -> None:
        while True:
            with self._changed:
                found = next(((path, kept) for path, kept in self._waiting.items() if not kept.tried), None)
                if found is None:
                    self._working = False
                    self._changed.notify_all()
                    return
                path, kept = found
                kept.tried = True
            reason = self._attempt(path, kept.text)
            with self._changed:
                self._note(path, kept, reason)

    def _attempt(self, path: Path, text: str) -> str | None:
        try:
            self._replace(path, text)
        except OSError as error:
            return error.strerror or str(error)
        return None

    def _note(self, path: Path, kept: _Content, reason: str | None) -> None:
        if reason is None:
            if self._waiting.get(path) is kept:
                del self._waiting[path]
            if self._failed.pop(path, None) is not None:
                kept.logger.info("%s is written again", path)
            return
        if path not in self._failed:
            kept.logger.warning("%s cannot be written (%s): a restart would forget %s", path, reason, kept.forgotten)
        self._failed[path] = reason

    def _sentence(self, paths: Iterable[Path]) -> str | None:
        chosen = list(paths)
        if not chosen:
            return None
        forgotten = " and ".join(self._waiting[path].forgotten for path in chosen)
        reason = self._failed.get(chosen[0], "the disk has not answered yet")
        return f"a restart would forget {forgotten}: {chosen[0]} cannot be written ({reason})"


class StateFile(Generic[State]):
    """What must outlive a restart, in a small JSON file; without a folder it lives in memory only.

    Parameters
    ----------
    folder, name
        Of the file; a folder without a directory, no file.
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
        self, folder: StateFolder, name: str, model: type[State], logger: logging.Logger, forgotten: str
    ) -> None:
        self.path = None if folder.directory is None else folder.directory / name
        self._folder = folder
        self._model = model
        self._logger = logger
        self._forgotten = forgotten

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
            return self._model.model_validate_json(self.path.read_bytes())
        except (FileNotFoundError, NotADirectoryError):
            return None
        except (OSError, ValueError) as error:
            raise UnreadableStateError(self.path) from error

    def save(self, state: State) -> None:
        """Have the file replaced as a whole; whether that goes well is the folder's to say."""
        if self.path is not None:
            self._folder.put(self.path, state.model_dump_json(exclude_none=True), self._forgotten, self._logger)


def toml_text(path: Path) -> str:
    """Return the text of a TOML file that is worth parsing.

    Raises
    ------
    OSError
        It cannot be read; `FileNotFoundError` among them.
    ValueError
        It is none: the message is one sentence without the file's name.
    """
    if not path.is_file() and path.exists() and not path.is_dir():
        raise ValueError("the file is no ordinary one, but a device or a pipe")
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
    """Return the values of a TOML text; raises `tomllib.TOMLDecodeError`, and `ValueError` with a sentence as above."""
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
        reason = _unusable(value)
        if reason is not None:
            raise ValueError(f"{place}: {reason}")
        if isinstance(value, dict):
            for name in value:
                if (reason := _unusable(name)) is not None:
                    raise ValueError(f"a key in [{place}]: {reason}")
            names = [ascii(name)[1:-1] for name in value]
            places = [f"{place}.{name}" if place else name for name in names]
            waiting += [(inner, each, depth + 1) for inner, each in zip(places, value.values(), strict=True)]
        elif isinstance(value, list):
            waiting += [(f"{place}[{number}]", inner, depth + 1) for number, inner in enumerate(value)]


def _unusable(value: Any) -> str | None:
    """Return what makes a single value one that nobody can mean, or None."""
    if isinstance(value, int) and not -(1 << 63) <= value < 1 << 63:
        return "the number has more than the 64 bits that TOML gives it"
    if isinstance(value, str) and len(value) > _LONGEST_TOML_TEXT:
        return f"the text is longer than {_LONGEST_TOML_TEXT} characters"
    if isinstance(value, str) and "\0" in value:
        return "the text has a NUL character in it, which no path and no name may have"
    return None


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
    if path.exists() and not (path.is_file() or path.is_dir()):
        raise error(f"{called} is no ordinary file, but a device or a pipe")
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
