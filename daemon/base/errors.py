"""Errors that a person can put right, and what the program ends with."""

import traceback
from enum import IntEnum
from pathlib import Path
from typing import ClassVar


class ExitCode(IntEnum):
    """What the program ends with. 1 is Python's own, for a defect."""

    GOOD = 0
    """It was done; of a command: its effect was seen, whole or under way. Of a check: all is well."""
    MISTYPED = 2
    """The command line, a file or a value is wrong: nothing was asked of the service, or it could not mean anything."""
    NOT_SEEN = 3
    """The service took the command, and telemetry did not show its effect in time."""
    ALARMS = 4
    """Of a check: the service works, and something is the matter; of a test message: not everybody got it."""
    UNREACHABLE = 5
    """Nothing answers there, or something that is not heliocube."""
    REFUSED = 6
    """The service answers, and does not do it: the token is not its own, or the tracker may not move like that now."""
    UNWRITTEN = 7
    """Standard output takes no more, so nobody has read what came of it; what was asked may have been done."""
    INTERRUPTED = 130
    """Ctrl-C ended it; what was done by then is kept where the last line says so. The same as of any program."""


class UserError(Exception):
    """Bad input: one sentence with the place and the remedy; the command line ends with `exit_code`."""

    exit_code: ClassVar[ExitCode] = ExitCode.MISTYPED


class InterruptedEarlyError(UserError):
    """Ctrl-C has ended the work; the sentence says what is kept of it."""

    exit_code: ClassVar[ExitCode] = ExitCode.INTERRUPTED


def raised_at(error: BaseException) -> str:
    """Return where an error was raised, such as "law.py, line 12": its author looks there first."""
    *_, last = traceback.extract_tb(error.__traceback__)
    return f"{Path(last.filename).name}, line {last.lineno}"
