"""Errors that a person can put right, and what the program ends with."""

import traceback
from enum import IntEnum
from pathlib import Path
from typing import ClassVar


class ExitCode(IntEnum):
    """What the program ends with. 1 is Python's own, for a defect."""

    GOOD = 0
    """All is well. After a command: telemetry has shown its effect, complete or under way."""
    MISTYPED = 2
    """The command line, a file or a value is wrong: the service was not asked, or the request made no sense."""
    NOT_SEEN = 3
    """The service took the command, but telemetry did not show its effect in time."""
    ALARMS = 4
    """From a check: the service works, but something is amiss. From a test message: not everybody got it."""
    UNREACHABLE = 5
    """The service cannot be reached: nothing answers at its address, or something that is not heliocube."""
    REFUSED = 6
    """The service refuses: the token is not its own, or the tracker may not move like that now."""
    OUTPUT_FAILED = 7
    """The answer cannot be written to standard output, so nobody has read it; the command may have been carried out."""
    INTERRUPTED = 130
    """Ctrl-C ended the program, which has this code for it as every program has; the last line says what is kept."""


class UserError(Exception):
    """Bad input: one sentence with the place and the remedy; the command line ends with `exit_code`."""

    exit_code: ClassVar[ExitCode] = ExitCode.MISTYPED


class InterruptedEarlyError(UserError):
    """Ctrl-C has ended the work; the sentence says what is kept of it."""

    exit_code: ClassVar[ExitCode] = ExitCode.INTERRUPTED


def error_location(error: BaseException) -> str:
    """Return where an error was raised, such as "law.py, line 12": its author looks there first."""
    *_, last = traceback.extract_tb(error.__traceback__)
    return f"{Path(last.filename).name}, line {last.lineno}"
