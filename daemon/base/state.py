"""State that outlives a restart: small files, replaced as a whole, also on a full disk, and never waited for."""

import contextlib
import logging
import os
import threading
import time
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Generic, Protocol, TypeVar

from daemon.base.files import sync_directory

if TYPE_CHECKING:
    # Not at run time: a program that imports this module need not wait for a large library.
    from pydantic import BaseModel

log = logging.getLogger("heliocube.state")

ROOM_BYTES = 4096
"""Size of a new spare: one block of most file systems."""
# Bytes of a kept file: many times what any can grow to.
_LONGEST = 8 << 20
_CLOSE_WITHIN_S = 3.0
_SLOW_AFTER_S = 5.0

State = TypeVar("State", bound="BaseModel")


class DailyCount(Protocol):
    """What is counted on one day."""

    @property
    def day(self) -> int:
        """The day, counted from 1970."""


Counted = TypeVar("Counted", bound=DailyCount)


def roll_over_day(day: int, before: Counted, later: Counted | None, fresh: Counted) -> tuple[Counted, Counted | None]:
    """Return the count of a day that begins, and the count of a later day that is to be kept meanwhile, or None.

    A machine whose clock battery is empty starts with a date years ago, and its clock is set later: the count of the
    day that it is set to goes on.

    Parameters
    ----------
    day
        The day that begins.
    before, later
        The count until now, and what was returned last as kept.
    fresh
        The count of a day of which nothing is known.
    """
    now = later if later is not None and later.day == day else fresh
    return now, before if day < before.day else None


class UnreadableStateError(Exception):
    """A file of kept state is there and cannot be used; `path` is its name."""

    def __init__(self, path: Path) -> None:
        super().__init__(f"{path} cannot be read")
        self.path = path


def spare_of(path: Path) -> Path:
    """Return the file beside a kept one that holds the room for its next content."""
    return path.with_suffix(".spare")


def replace_state_file(path: Path, text: str) -> None:
    """Replace a file as a whole, in the room of its previous content: a full disk has no other.

    The previous content stays beside the file as its spare, and the next content is written over it. Content that fits
    into the spare's blocks needs no others, on a file system that writes in place and lets a file have two names for a
    moment.

    Raises
    ------
    OSError
        The file cannot be written. It stays as it was.
    """
    spare, before = spare_of(path), path.with_suffix(".before")
    path.parent.mkdir(parents=True, exist_ok=True)
    if not spare.exists() and before.exists() and not (path.exists() and before.samefile(path)):
        # The last writer died before it had made this the spare again.
        before.replace(spare)
    _overwrite(spare, text)
    with contextlib.suppress(OSError):
        if path.exists():
            before.unlink(missing_ok=True)
            os.link(path, before)
    spare.replace(path)
    sync_directory(path.parent)
    with contextlib.suppress(OSError):
        if before.exists():
            before.replace(spare)
        else:
            _overwrite(spare, text)


def reserve_disk_space(path: Path) -> None:
    """Make the spare of a kept file, and a second one if the file is not there yet: the disk may be full later."""
    spare, first = spare_of(path), path.with_suffix(".before")
    with contextlib.suppress(OSError):
        path.parent.mkdir(parents=True, exist_ok=True)
        for room in (spare,) if path.exists() else (spare, first):
            if not room.exists():
                _overwrite(room, " " * ROOM_BYTES)


def _overwrite(path: Path, text: str) -> None:
    """Give a file another content in its own place; it is on the disk when this returns."""
    if path.exists() and not (path.is_file() and os.access(path, os.W_OK)):
        # Somebody else's file, such as root's who ran a command here, or a pipe.
        path.unlink()
    with path.open("r+" if path.exists() else "w", encoding="utf-8", newline="\n") as file:
        file.write(text)
        file.truncate()
        file.flush()
        os.fsync(file.fileno())


@dataclass(slots=True)
class _Content:
    """What one file is to hold, and since when [s]; `tried` once writing it has been attempted."""

    text: str
    forgotten: str
    logger: logging.Logger
    since_s: float
    tried: bool = False


class StateFolder:
    """The small files that one tracker keeps over a restart; nothing that moves the tracker waits for the disk.

    The newest content of each file counts. What cannot be written is kept in memory and tried again.

    Parameters
    ----------
    directory
        Where the files are, made if it is missing; None keeps everything in memory only.
    behind
        Whether a thread writes, as a service in real time needs; without it, `put` writes before it returns.
    replace
        Writes a text to a path so that a crash leaves the whole old or the whole new file; raises `OSError`.
    reserve
        Keeps room for a path that is to be replaced one day; a disk that fails is no error.
    now_s
        The machine's own time [s], also where the service's is simulated: disks go by the machine's.
    """

    def __init__(
        self,
        directory: Path | None,
        *,
        behind: bool = False,
        replace: Callable[[Path, str], None] = replace_state_file,
        reserve: Callable[[Path], None] = reserve_disk_space,
        now_s: Callable[[], float] = time.monotonic,
    ) -> None:
        self.directory = directory
        self._writes_in_thread = behind
        self._replace = replace
        self._reserve = reserve
        self._now_s = now_s
        self._changed = threading.Condition()
        self._paths_without_room: list[Path] = []
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

    def reserve(self, path: Path) -> None:
        """Keep room on the disk for a file that may have to be written when no other room is left."""
        with self._changed:
            self._paths_without_room.append(path)
        self._write()

    @property
    def is_writing(self) -> bool:
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
            if not self._waiting:
                return
            for path in self._failed:
                self._waiting[path].tried = False
        self._write()

    def wait_for_writes(self, within_s: float) -> bool:
        """Wait until everything has been tried once, and return whether all is on the disk; blocks."""
        with self._changed:
            self._changed.wait_for(lambda: not self._working, within_s)
            return not self._waiting

    def close(self) -> None:
        """Try once more what waits, for a few seconds at most, and report what a restart will have forgotten."""
        self.retry()
        self.wait_for_writes(_CLOSE_WITHIN_S)
        unsaved = self.unsaved
        if unsaved is not None:
            log.error("%s", unsaved)

    def _write(self) -> None:
        with self._changed:
            if self._working:
                return
            self._working = True
        if self._writes_in_thread:
            # A daemon thread, for which the end of the process does not wait: a disk may never answer.
            thread = threading.Thread(target=self._work, name="kept state", daemon=True)
            try:
                thread.start()
            except RuntimeError:
                # The machine has no room for another thread: what waits is tried again.
                with self._changed:
                    self._working = False
        else:
            self._work()

    def _work(self) -> None:
        while True:
            with self._changed:
                job = self._next_job()
                if job is None:
                    self._working = False
                    self._changed.notify_all()
                    return
            job()

    def _next_job(self) -> Callable[[], None] | None:
        for path, kept in self._waiting.items():
            if not kept.tried:
                kept.tried = True
                return partial(self._try_to_write, path, kept)
        # Room comes last: a content that waits may be a person's stop.
        return partial(self._reserve, self._paths_without_room.pop()) if self._paths_without_room else None

    def _try_to_write(self, path: Path, kept: _Content) -> None:
        reason = self._attempt(path, kept.text)
        with self._changed:
            self._note(path, kept, reason)

    def _attempt(self, path: Path, text: str) -> str | None:
        try:
            self._replace(path, text)
        except OSError as error:
            return error.strerror or str(error)
        except Exception as error:  # noqa: BLE001 - the other files are written all the same, this one is tried again
            return str(error) or repr(error)
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
        # Each wording once: a law in the shadow keeps a day of its own, in a file told in the same words.
        forgotten = " and ".join(dict.fromkeys(self._waiting[path].forgotten for path in chosen))
        reason = self._failed.get(chosen[0], "the disk has not answered yet")
        # All files are in the same folder, which is named once.
        files = " and ".join([str(chosen[0]), *(path.name for path in chosen[1:])])
        return f"a restart would forget {forgotten}: {files} cannot be written ({reason})"


class StateFile(Generic[State]):
    """What must outlive a restart, in a small JSON file; without a folder it lives in memory only.

    Parameters
    ----------
    folder, name
        Folder and name of the file; a folder without a directory has no file.
    model
        What the file holds. A file with anything else in it is unreadable.
    logger
        Where a disk that fails is reported.
    forgotten
        What a restart would forget if the file cannot be written, as the end of a sentence.

    Attributes
    ----------
    path
        Path of the file, or None.
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
            There is a file that cannot be used; the caller decides what that means.
        """
        if self.path is None:
            return None
        try:
            if not self.path.is_file() and (self.path.exists() or self.path.is_symlink()):
                # To open a pipe is to wait for a writer, and a device may never end; and where a link leads nowhere, a
                # disk may be missing.
                raise UnreadableStateError(self.path)
            with self.path.open("rb") as file:
                content = file.read(_LONGEST + 1)
            if len(content) > _LONGEST:
                raise UnreadableStateError(self.path)
            return self._model.model_validate_json(content)
        except (FileNotFoundError, NotADirectoryError):
            return None
        except (OSError, ValueError) as error:
            raise UnreadableStateError(self.path) from error

    def reserve(self) -> None:
        """Keep room for the file on the disk, so that it can be written even if the disk is full by then."""
        if self.path is not None:
            self._folder.reserve(self.path)

    def save(self, state: State) -> None:
        """Have the file replaced as a whole; the folder tells whether that goes well."""
        if self.path is not None:
            self._folder.put(self.path, state.model_dump_json(exclude_none=True), self._forgotten, self._logger)
