"""Which folder the service of a file keeps its records and state in, for all commands that start it or read them."""

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING

from daemon.store.place import default_place, to_read

if TYPE_CHECKING:
    # The command line imports this module to show its help, which must not wait for the science.
    from daemon.config.settings import Settings


def with_place(settings: "Settings", file: Path | None, environment: Mapping[str, str]) -> "Settings":
    """Return the settings with a folder for what a service on real instruments must not forget.

    Parameters
    ----------
    settings
        Whose own folder, if there is one, stays; a simulated rig gets none.
    file
        They were read from.
    environment
        Of the process.
    """
    if settings.store.directory is not None or not settings.real or file is None:
        return settings
    store = settings.store.model_copy(update={"directory": default_place(file, environment)})
    return settings.model_copy(update={"store": store})


def records_of(settings: "Settings", file: Path, environment: Mapping[str, str]) -> Path | None:
    """Return the folder that the service of a file keeps its records in, for those who read them; None for nowhere."""
    if settings.store.directory is not None or not settings.real:
        return settings.store.directory
    return to_read(file, environment)


def with_records(settings: "Settings", file: Path, environment: Mapping[str, str]) -> "Settings":
    """Return the settings with the folder that the service of a file keeps its records in, for those who look at it."""
    store = settings.store.model_copy(update={"directory": records_of(settings, file, environment)})
    return settings.model_copy(update={"store": store})
