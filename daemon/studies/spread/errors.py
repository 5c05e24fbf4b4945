"""The error of missing or unfit workers."""

from typing import ClassVar

from daemon.base.errors import ExitCode, UserError


class WorkersError(UserError):
    """There are no workers, or none that could do this work."""

    exit_code: ClassVar[ExitCode] = ExitCode.UNREACHABLE
