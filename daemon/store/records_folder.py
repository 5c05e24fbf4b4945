"""Where a service keeps records and state if nobody has named a folder, and the lock that keeps others out."""

import contextlib
import os
import sys
from collections.abc import Iterator, Mapping
from pathlib import Path

from daemon.base.errors import UserError

# 'config init' writes the same name: a stop is found again although somebody has taken that line out of the file.
RECORDS_NAME = "records"
_USUAL_FILE = "heliocube.toml"
# The state folder of the units in deploy/. systemd tells it to them, and not to the shell of a person.
SYSTEMD_STATE_FOLDER = Path("/var/lib/heliocube")


def default_records_folder(file: Path, environment: Mapping[str, str]) -> Path:
    """Return the folder for what the service of a configuration file must not forget; two files get two folders.

    Parameters
    ----------
    file
        The configuration.
    environment
        Of the process, in which systemd names the folder of a unit's state.
    """
    # systemd may list several, with colons between them.
    state = environment.get("STATE_DIRECTORY", "").partition(":")[0]
    if state:
        return Path(state) / file.stem
    return file.parent / (RECORDS_NAME if file.name == _USUAL_FILE else f"{file.stem}-{RECORDS_NAME}")


def records_folder_to_read(file: Path, environment: Mapping[str, str]) -> Path:
    """Return the same folder for the command of a person, to which systemd tells no folder."""
    found, units = default_records_folder(file, environment), SYSTEMD_STATE_FOLDER / file.stem
    return units if units.exists() and not found.exists() else found


@contextlib.contextmanager
def lock_folder(directory: Path | None, roles: tuple[str, ...]) -> Iterator[None]:
    """Keep other services of the same roles out of a folder for as long as this one runs.

    Two services would overwrite each other's stops. A folder that cannot be written to is not locked.

    Raises
    ------
    UserError
        Another service is at work there.
    """
    with contextlib.ExitStack() as stack:
        if directory is not None:
            with contextlib.suppress(OSError):
                directory.mkdir(parents=True, exist_ok=True)
            for role in roles:
                stack.enter_context(_hold_lock(directory, role))
        yield


def is_folder_locked(directory: Path, role: str) -> bool:
    """Tell whether a service of a role is at work in a folder, by the lock: the lock's file outlives the service."""
    if sys.platform == "win32":
        return False
    import fcntl  # noqa: PLC0415 - not there on Windows

    try:
        descriptor = os.open(_lock_file(directory, role), os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC)
    except FileNotFoundError:
        return False
    except OSError:
        # The file belongs to another user, whose service may hold it.
        return True
    try:
        fcntl.flock(descriptor, fcntl.LOCK_SH | fcntl.LOCK_NB)
    except BlockingIOError:
        return True
    except OSError:
        # Some network disks have no locks.
        return False
    finally:
        os.close(descriptor)
    return False


def _lock_file(directory: Path, role: str) -> Path:
    return directory / f".{role}-in-use"


@contextlib.contextmanager
def _hold_lock(directory: Path, role: str) -> Iterator[None]:
    if sys.platform == "win32":
        # Only the cube's role runs there, which has no stop to keep.
        yield
        return
    import fcntl  # noqa: PLC0415 - not there on Windows

    try:
        descriptor = os.open(_lock_file(directory, role), os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o600)
    except OSError:
        yield
        return
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        os.close(descriptor)
        raise UserError(
            f"another service that runs keeps records and state of the role {role} in {directory}; stop that service"
            " first, or give this one a store.directory of its own"
        ) from None
    except OSError:
        # Some network disks have no locks.
        pass
    try:
        yield
    finally:
        os.close(descriptor)
