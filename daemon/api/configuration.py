"""Tells whose service answers: a configuration copied with its `api.listen` leads to the service of the original."""

import os
from collections.abc import Sequence
from pathlib import Path

QUERY_KEY = "configuration"
"""Key of a query that names the configuration whose service is meant, by one path or several."""

_LONGEST_PATH = 200


class WrongServiceError(Exception):
    """The service is not that of the configuration that was named; the message is one sentence."""


def paths_of(configuration: Path) -> tuple[str, ...]:
    """Return the whole path of a file, and the path to which its links lead if that is another: both name it."""
    found = os.path.abspath(configuration), os.path.realpath(configuration)  # noqa: PTH100 - takes a ".." away
    # Bytes in a path that are not UTF-8 have to survive JSON and a query.
    return tuple(dict.fromkeys(os.fsencode(path).decode("utf-8", "replace") for path in found))


class OwnConfiguration:
    """The configuration of a service, to be compared with the one that a request means.

    Parameters
    ----------
    file
        The file that the service was started with, or None.
    trackers
        The names of its trackers.
    """

    def __init__(self, file: Path | None, trackers: Sequence[str]) -> None:
        self._paths = () if file is None else paths_of(file)
        without = "a service that was started without a configuration"
        whose = f"the service of {self._paths[0]}" if self._paths else without
        names = f"{len(trackers)} trackers" if len(trackers) > 1 else "".join(f"tracker {name}" for name in trackers)
        self._text = f"{whose}{f' ({names})' if names else ''}"

    def require(self, meant: Sequence[str], undone: str = "") -> None:
        """Raise `WrongServiceError` with `undone` in front, unless the configuration that is meant is this one."""
        other = self._foreign_configuration(meant)
        if other is not None:
            raise WrongServiceError(
                f"{undone}api.listen of {other} leads to {self._text}; give {other} an api.listen of its own and start"
                " its service again, or name the service that answers by its own file or by --api"
            )

    def check_stop_was_meant(self, meant: Sequence[str], outcome: str) -> None:
        """Raise `WrongServiceError` with what a stop has done here, unless the configuration that is meant is this."""
        other = self._foreign_configuration(meant)
        if other is not None:
            raise WrongServiceError(
                f"the tracker of {other} was NOT stopped: its api.listen leads to {self._text}, which was told to stop"
                f" instead: {outcome}"
            )

    def _foreign_configuration(self, meant: Sequence[str]) -> str | None:
        """Return which file is meant, if it is not this service's; None where it is, or none is named."""
        if not meant or set(meant) & set(self._paths):
            return None
        return "".join(letter if letter.isprintable() else "?" for letter in meant[0])[:_LONGEST_PATH]
