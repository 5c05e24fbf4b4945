"""Which release ran last and for how long. A new release holds the tracker; after a day, old copies are removed."""

import asyncio
import logging
from collections.abc import Callable
from pathlib import Path

from pydantic import BaseModel, ConfigDict, Field

from daemon.base.clock import Clock
from daemon.base.records import Event
from daemon.base.state import StateFile, StateFolder, UnreadableStateError
from daemon.store.copies import copies_of
from daemon.store.schema import FILE_NAME as STORE_NAME
from daemon.store.settings_kept import FILE_NAME as SETTINGS_NAME

log = logging.getLogger("heliocube.store")

FILE_NAME = "release.json"
CUBE_FILE_NAME = "release-cube.json"
SUBJECT = "release"

_DAY_S = 86400.0
_LOOK_EVERY_S = 600.0
_SETTLE_EVERY_S = 1.0
_EARLIER = "an earlier release"
_FORGOTTEN = "that this release has been started"


class ReleaseKept(BaseModel):
    """The release that was started last, and how long it has run [s] since copies are kept for it."""

    model_config = ConfigDict(frozen=True, extra="ignore", strict=True)

    release: str
    ran_s: float = Field(default=0.0, ge=0.0, allow_inf_nan=False)


def last_started(directory: Path | None, name: str = FILE_NAME) -> str | None:
    """Return which release was last started on a folder; None where that is not known."""
    try:
        kept = StateFile(StateFolder(directory), name, ReleaseKept, log, _FORGOTTEN).load()
    except UnreadableStateError:
        return None
    return None if kept is None else kept.release


class ReleaseWatch:
    """Remembers in a folder which release was started there.

    Parameters
    ----------
    folder
        Of the file; a folder without a directory knows no release before.
    name
        Of the file, `FILE_NAME` or `CUBE_FILE_NAME`: two services may share a folder.
    release
        That of this process, as `daemon.base.installation.release` has it.
    clock
        The service's time.
    publish
        Takes events about it.

    Attributes
    ----------
    before
        The release of the last start where it was another one; None if it is the same, or this is the first start.
    """

    def __init__(
        self, folder: StateFolder, name: str, release: str, clock: Clock, publish: Callable[[Event], None]
    ) -> None:
        self._directory = folder.directory
        self._file = StateFile(folder, name, ReleaseKept, log, _FORGOTTEN)
        self._release = release
        self._clock = clock
        self._publish = publish
        self._kept = self._load()
        self.before = self._release_before()
        if self._kept is None and self.before is None:
            # No release ran before this one. It is written at once: the next start knows it even if this one is killed.
            self._save(0.0)

    @property
    def hold_why(self) -> str | None:
        """Why a tracker whose program was changed is held, in a sentence, or None."""
        if self.before is None:
            return None
        return (
            f"the program was changed from {self.before} to {self._release}, and nobody has checked the tracker since"
        )

    async def run(self, is_everything_saved: Callable[[], bool]) -> None:
        """Write down that this release has been started, and remove the copies of stores once it has run for a day.

        Parameters
        ----------
        is_everything_saved
            Whether the hold is on the disk: until then the next start has to find the change again.
        """
        if self.before is not None:
            self._publish(self._event(f"changed from {self.before} to {self._release}"))
        while True:
            if not self._is_release_saved and is_everything_saved():
                self._save(0.0)
            start_s = self._clock.monotonic()
            await asyncio.sleep(_LOOK_EVERY_S if self._is_release_saved else _SETTLE_EVERY_S)
            if self._is_release_saved:
                await self._count_run_time(self._clock.monotonic() - start_s)

    @property
    def _is_release_saved(self) -> bool:
        return self._kept is not None and self._kept.release == self._release

    async def _count_run_time(self, ran_s: float) -> None:
        """Count the time that this release has run, as long as there are copies to remove."""
        if self._directory is None or self._kept is None:
            return
        copies = await asyncio.to_thread(copies_of, self._directory)
        if not copies:
            return
        if self._kept.ran_s + ran_s < _DAY_S:
            self._save(self._kept.ran_s + ran_s)
            return
        for copy in copies:
            await self._remove(copy)
        self._save(0.0)

    async def _remove(self, copy: Path) -> None:
        try:
            await asyncio.to_thread(copy.unlink)
        except OSError as error:
            log.warning("%s cannot be removed: %s", copy, error.strerror)
        else:
            text = f"{self._release} has run for a day: {copy}, the store as it was before, is removed"
            log.warning("%s", text)
            self._publish(self._event(text))

    def _save(self, ran_s: float) -> None:
        self._kept = ReleaseKept(release=self._release, ran_s=ran_s)
        self._file.save(self._kept)

    def _load(self) -> ReleaseKept | None:
        try:
            return self._file.load()
        except UnreadableStateError as error:
            log.warning("%s: which release ran last is not known", error)
            return ReleaseKept(release="")

    def _release_before(self) -> str | None:
        if self._kept is not None:
            return None if self._kept.release == self._release else self._kept.release or _EARLIER
        # A release that did not write this file yet has left its records, or the values of its configuration.
        left = [] if self._directory is None else [self._directory / name for name in (STORE_NAME, SETTINGS_NAME)]
        return _EARLIER if any(path.exists() for path in left) else None

    def _event(self, text: str) -> Event:
        return Event(self._clock.utc(), self._clock.monotonic(), SUBJECT, text)
