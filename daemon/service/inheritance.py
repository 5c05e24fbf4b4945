"""What a tracker without a name has kept, handed on when the configuration names trackers.

A stop, a storm or a doubt must not be forgotten because a file has got a new line: it holds for every tracker that has
kept nothing of its own yet, until a person releases it.
"""

import logging
import shutil
from collections.abc import Sequence
from pathlib import Path

from daemon.base.alarms import kept
from daemon.base.errors import UserError
from daemon.motion import reference
from daemon.received import today
from daemon.tracker import budget, law_file, stow_watch, wishes

log = logging.getLogger("heliocube.service")

_FILES = tuple(module.FILE_NAME for module in (wishes, stow_watch, reference, budget, law_file, kept, today))


def hand_on(directory: Path, trackers: Sequence[str]) -> None:
    """Copy each kept file of a folder into those of the trackers that have none, and give it another name.

    Raises
    ------
    UserError
        The disk does not let it: a service that goes on would have forgotten what is in force.
    """
    for name in _FILES:
        before = directory / name
        if not before.is_file():
            continue
        try:
            for tracker in trackers:
                own = directory / tracker / name
                if not own.exists():
                    own.parent.mkdir(parents=True, exist_ok=True)
                    shutil.copyfile(before, own)
            before.replace(before.with_name(f"{name}.before"))
        except OSError as error:
            raise UserError(f"{before} cannot be handed on to {', '.join(trackers)}: {error.strerror}") from None
        log.warning("%s holds for %s from now on", before, ", ".join(trackers))
