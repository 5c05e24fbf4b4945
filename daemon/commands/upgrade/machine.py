"""The part of the self-check that needs no instrument: the program, the file, the store, the clock, the disk."""

import shutil
import sqlite3
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path

from daemon.base.clock import iso_utc
from daemon.base.errors import UserError
from daemon.base.installation import overwritten_package_text, release
from daemon.base.kernel_clock import synchronised
from daemon.commands.file_check import check_file
from daemon.commands.options import RoleChoice
from daemon.commands.upgrade.finding import CONFIGURATION, Finding
from daemon.config.file import ConfigError
from daemon.config.settings import Settings
from daemon.store.copies import missing_space_text
from daemon.store.schema import FILE_NAME, VERSION, open_for_reading, require_link_target, unreadable_store_error
from daemon.store.tables import COLUMNS
from daemon.store.unusable_store import aside_text

_MB = 1e6
# Records of one tracker in a day, as docs/data.md says.
_DAY_MB = 5.0
_FEWEST_DAYS = 30
_AS_ITS_USER = "look as the user that the service runs as, with sudo -u"
_WITHOUT_SYNCHRONISATION = "the sun's position comes from it: see 'timedatectl', and enable systemd-timesyncd or chrony"


def check_program() -> Finding:
    """Return which heliocube this is, and whether another package has overwritten parts of it."""
    found = overwritten_package_text()
    if found is not None:
        return Finding("program", f"heliocube {release()}", found)
    return Finding("program", f"heliocube {release()}")


def check_configuration(path: Path, role: RoleChoice | None) -> Finding:
    """Return whether `heliocube run` could use the file."""
    try:
        check_file(path, role)
    except ConfigError as error:
        return Finding(CONFIGURATION, "; ".join(error.problems), f"see 'heliocube config check {path}'")
    except UserError as error:
        return Finding(CONFIGURATION, str(error), f"see 'heliocube config check {path}'")
    return Finding(CONFIGURATION, str(path))


def check_store(settings: Settings) -> Finding:
    """Return whether the records can be read, of which version the store is, and when the latest record was kept."""
    directory = settings.store.directory
    if directory is None:
        return Finding("store", "store.directory is not set: a simulated rig keeps no records then")
    path = directory / FILE_NAME
    if (aside := aside_text(path)) is not None:
        return Finding("store", str(path), aside)
    try:
        require_link_target(path)
        if not path.exists():
            return Finding("store", f"nothing in {directory} yet: the first start makes it")
        text, older = _store_contents(path)
        lacking = missing_space_text(path, path.stat().st_size) if older else None
        return Finding("store", f"{path}: {text}", f"{lacking}: make room before the next start" if lacking else "")
    except UserError as error:
        return Finding("store", str(path), str(error))
    except OSError as error:
        return Finding("store", f"{path}: {error.strerror}", _AS_ITS_USER)


def _store_contents(path: Path) -> tuple[str, bool]:
    """Return a text on what a store holds, and whether it is of an older version."""
    with closing(open_for_reading(path)) as connection:
        try:
            version: int = connection.execute("PRAGMA user_version").fetchone()[0]
            latest_utc_s = _latest_utc_s(connection)
        except sqlite3.Error as error:
            raise unreadable_store_error(path, error) from None
    size = f"{path.stat().st_size / _MB:.1f} MB"
    latest = "no record yet" if latest_utc_s is None else f"the latest record of {iso_utc(latest_utc_s)[:19]}Z"
    if version == VERSION:
        return f"version {version}, {size}, {latest}", False
    return f"version {version}, {size}, {latest}; the next start keeps a copy and makes it version {VERSION}", True


def _latest_utc_s(connection: sqlite3.Connection) -> float | None:
    there = {row[0] for row in connection.execute("SELECT name FROM sqlite_master WHERE type = 'table'")}
    names = [name for name, _ in COLUMNS.values() if name in there]
    latest = (connection.execute(f"SELECT MAX(time) FROM {name}").fetchone()[0] for name in names)  # noqa: S608 - ours
    return max((float(utc_s) for utc_s in latest if utc_s is not None), default=None)


def check_disk(settings: Settings) -> Finding:
    """Return how much room is left where the records are kept, and for how many days that is enough."""
    directory = (settings.store.directory or Path()).absolute()
    try:
        there = next(each for each in (directory, *directory.parents) if each.exists())
        free_mb = shutil.disk_usage(there).free / _MB
    except OSError as error:
        return Finding("disk", f"{directory}: {error.strerror}", _AS_ITS_USER)
    days = free_mb / (_DAY_MB * len(settings.trackers))
    text = f"{free_mb / 1e3:.1f} GB are free at {there}"
    if settings.store.directory is None:
        return Finding("disk", text)
    text = f"{text}, enough for {min(days, 36500):.0f} days of records"
    remedy = "" if days >= _FEWEST_DAYS else f"make room, or lower store.keep_days (now {settings.store.keep_days})"
    return Finding("disk", text, remedy)


def check_clock(settings: Settings) -> Finding:
    """Return whether the machine's clock is synchronised."""
    if not settings.real or settings.bench_clock is not None:
        return Finding("clock", "simulated")
    found = synchronised()
    if found is None:
        return Finding("clock", "this machine does not say whether its clock is synchronised")
    if not found:
        return Finding("clock", "is not synchronised", _WITHOUT_SYNCHRONISATION)
    return Finding("clock", "is synchronised")


def check_wind_source(settings: Settings) -> Iterator[Finding]:
    """Yield for each tracker what would stow it in a storm, as far as the file says."""
    for name, own in settings.trackers:
        subject = "wind source" if len(settings.trackers) == 1 else f"wind source of {name}"
        topics = [part.topic for part in (own.mqtt.wind, own.mqtt.safe) if own.mqtt.enabled and part.topic]
        if topics:
            text = f"{', '.join(topics)} at {own.mqtt.host}; only the running service can tell whether it is heard"
            yield Finding(subject, text)
        elif not own.real:
            yield Finding(subject, "simulated")
        elif own.safety.without_wind_source == "accepted":
            yield Finding(subject, 'none, and safety.without_wind_source = "accepted"')
        else:
            remedy = 'set mqtt.wind.topic or mqtt.safe.topic, or safety.without_wind_source = "accepted"'
            yield Finding(subject, "none: nothing stows the tracker in a storm", remedy)
