"""Finds the folder of a service's records and state, for all commands that start the service or read the records."""

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING

from daemon.store.records_folder import default_records_folder, records_folder_to_read

if TYPE_CHECKING:
    # The command line imports this module to show its help, which must not wait for scientific libraries.
    from daemon.config.settings import Settings


def with_default_store_folder(settings: "Settings", file: Path | None, environment: Mapping[str, str]) -> "Settings":
    """Return the settings with a folder for the records and state of a service on real instruments.

    Parameters
    ----------
    settings
        If they name a folder, it stays; a simulated rig gets none.
    file
        The file that they were read from.
    environment
        Environment of the process.
    """
    if settings.store.directory is not None or not settings.real or file is None:
        return settings
    store = settings.store.model_copy(update={"directory": default_records_folder(file, environment)})
    return settings.model_copy(update={"store": store})


def find_records_folder(settings: "Settings", file: Path, environment: Mapping[str, str]) -> Path | None:
    """Return the folder in which the service of a file keeps its records, to read them; None if it keeps none."""
    if settings.store.directory is not None or not settings.real:
        return settings.store.directory
    return records_folder_to_read(file, environment)


def with_records_folder(settings: "Settings", file: Path, environment: Mapping[str, str]) -> "Settings":
    """Return the settings with the folder in which the service of a file keeps its records, to read them."""
    store = settings.store.model_copy(update={"directory": find_records_folder(settings, file, environment)})
    return settings.model_copy(update={"store": store})
