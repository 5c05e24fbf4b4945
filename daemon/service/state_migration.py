"""What a tracker without a name has kept, handed on when the configuration names trackers.

A stop, a storm or a doubt must not be forgotten because the configuration has got a new line: it holds for every
tracker that has kept nothing of its own yet, until a person releases it. If a tracker gets another name, or its table
is gone or comes back after a time without a name, the service itself holds every tracker that was not at work beside
it or after it: each may be that tracker.
"""

import logging
import math
from collections.abc import Sequence
from pathlib import Path

from pydantic import BaseModel, ConfigDict, Field

from daemon.base.alarms import kept
from daemon.base.clock import LEAST_SHOWN_UTC_S, MOST_SHOWN_UTC_S
from daemon.base.errors import UserError
from daemon.base.files import replace_file
from daemon.base.state import StateFile, StateFolder, UnreadableStateError
from daemon.motion import doubts, place
from daemon.received import today
from daemon.store.records_folder import is_folder_locked
from daemon.tracker import budget, law_file, stow_watch, wishes
from daemon.tracker.stow_watch import SafetyFile
from daemon.tracker.wishes import PROGRAM, Wish, Wishes, WishFile

log = logging.getLogger("heliocube.service")

STARTED_NAME = "started.json"
"""Name of the file that tells of the last start; every start writes it."""


class LastStart(BaseModel):
    """Time of the last start [s of UTC], its version, and its number among all starts with this folder (0: unknown)."""

    model_config = ConfigDict(frozen=True, extra="ignore", strict=True)

    started_utc_s: float = Field(allow_inf_nan=False, ge=LEAST_SHOWN_UTC_S, le=MOST_SHOWN_UTC_S)
    version: str = ""
    number: int = Field(default=0, ge=0)


# The trackers of one service write their files of the start one after the other, within this time.
_STARTED_TOGETHER_S = 30.0
_FILES = tuple(module.FILE_NAME for module in (wishes, stow_watch, doubts, budget, law_file, kept, today))
_FILES_IN_FORCE: tuple[str, ...] = tuple(module.FILE_NAME for module in (wishes, stow_watch, doubts))
_LOOK = "look at the tracker, then 'heliocube auto'"
_REMEDY = f"give that name back in a table [[tracker]] and restart, or {_LOOK}"


def last_start_file(folder: StateFolder) -> StateFile[LastStart]:
    """Return the file of a tracker's last start."""
    return StateFile(folder, STARTED_NAME, LastStart, log, "what persons ask for, a storm and what is in doubt")


def last_start_utc_s(folder: StateFolder) -> float:
    """Return when a tracker was last started, by the clock of then [s]; minus infinity where that is not known."""
    kept = _last_start(folder)
    return -math.inf if kept is None else kept.started_utc_s


def next_start_number(directory: Path | None) -> int:
    """Return the number of a new start, which is higher than any that is kept in a service's folder or below it."""
    paths = () if directory is None else (directory, *directory.glob("*/"))
    return 1 + max((_last_start_number(path) for path in paths), default=0)


def _last_start_number(folder: Path) -> int:
    # Nothing will be written there, so no room is kept for it.
    kept = _last_start(StateFolder(folder, reserve=lambda _path: None))
    return 0 if kept is None else kept.number


def _last_start(folder: StateFolder) -> LastStart | None:
    try:
        return last_start_file(folder).load()
    except UnreadableStateError:
        return None


def migrate_state_to_trackers(directory: Path, trackers: Sequence[str]) -> None:
    """Copy each kept file of a folder to the trackers that have no such file, and give the original another name.

    The place where the axes rest is handed on only to a single tracker: of several, nobody knows which one rested
    there, and the others would be in doubt because of it.

    Raises
    ------
    UserError
        The disk fails: a service that went on would have forgotten what is in force.
    """
    for name in (*_FILES, place.FILE_NAME):
        before = directory / name
        if not before.is_file():
            continue
        heirs = trackers if name != place.FILE_NAME or len(trackers) == 1 else ()
        try:
            # A damaged file is handed on too: its reader decides what that means.
            content = before.read_text(encoding="utf-8", errors="replace")
            for tracker in heirs:
                own = directory / tracker / name
                if not own.exists():
                    # As a whole or not at all: half a file would pass for the tracker's own, and count as a stop.
                    replace_file(own, content)
            before.replace(before.with_name(f"{name}.before"))
        except OSError as error:
            raise UserError(f"{before} cannot be handed on to {', '.join(trackers)}: {error.strerror}") from None
        if heirs:
            log.warning("%s holds for %s from now on", before, ", ".join(heirs))


def orphaned_state_text(directory: Path, trackers: Sequence[str], own: Path) -> str | None:
    """Return what is in force in folders of trackers that are not in the configuration any more, in words, or None.

    Call this before `migrate_state_to_trackers`, which leaves nothing in the folder of a tracker without a name.

    Parameters
    ----------
    directory
        In which each tracker with a table has a folder.
    trackers
        The names in the tables.
    own
        The folder of one of the trackers. Only trackers that have gone since its last start count: one that ran beside
        it is not the same tracker, and the person who started it without an older one knew of that one.
    """
    found = []
    for folder in sorted({path.parent for name in _FILES_IN_FORCE for path in directory.glob(f"*/{name}")}):
        # A folder here may be that of another service which is at work in it.
        if folder.name not in trackers and _is_newer(folder, own) and not is_folder_locked(folder, "tracker"):
            found += _texts_in_force(folder, f"'{folder.name}'")
    told = [f"a tracker is no longer in the configuration, but {'; '.join(found)}: {_REMEDY}"] if found else []
    # Only files that both have: where the tracker has none, `migrate_state_to_trackers` gives it a copy.
    both = [name for name in _FILES_IN_FORCE if trackers and (directory / name).exists() and (own / name).exists()]
    if both and _is_newer(directory, own) and (found := _texts_in_force(directory, "it", both)):
        told.append(f"a tracker without a table [[tracker]] has been started since, and {'; '.join(found)}: {_LOOK}")
    return "; ".join(told) or None


def _is_newer(gone: Path, own: Path) -> bool:
    """Whether a tracker that is gone was started after the last start of the other one."""
    if not (own / STARTED_NAME).exists():
        return True
    numbers = _last_start_number(gone), _last_start_number(own)
    if all(numbers):
        return numbers[0] > numbers[1]
    # Folders of an older release have no number or no such file: go by times, though these are wrong after a clock was
    # set.
    lasts = [gone / name for name in (STARTED_NAME, *_FILES_IN_FORCE) if (gone / name).exists()]
    return lasts[0].stat().st_mtime > (own / STARTED_NAME).stat().st_mtime + _STARTED_TOGETHER_S


def _texts_in_force(folder: Path, called: str, names: Sequence[str] = _FILES_IN_FORCE) -> list[str]:
    # Nothing will be written there, so no room is kept for it.
    state = StateFolder(folder, reserve=lambda _path: None)
    asked = WishFile(state).load() if wishes.FILE_NAME in names else Wishes()
    if asked.held_by_program:
        # The kept reason may itself name such folders, and would be told again with each name.
        asked = asked.model_copy(update={"hold": Wish(why="nobody has looked yet", by=PROGRAM)})
    storm = SafetyFile(state).load() if stow_watch.FILE_NAME in names else None
    doubted = doubts.kept_doubts(state) if doubts.FILE_NAME in names else ()
    return [
        *(f"in {folder} {called} is still {text}" for text in asked.describe_ended(Wishes())),
        *(f"{folder} keeps for {called}: {text}" for text in (*((storm.text,) if storm else ()), *doubted)),
    ]
