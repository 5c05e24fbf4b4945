"""Goes back to the release before: holds the tracker, makes store and file usable for it, and keeps the newer ones."""

from collections.abc import Iterator, Mapping
from pathlib import Path

from daemon.base.alarms.kinds import with_tracker_option
from daemon.base.clock import SystemClock
from daemon.base.errors import UserError
from daemon.base.files import first_free, give_to_folder_owner, make_folder, rewrite_file, toml_text, write_new
from daemon.base.installation import release
from daemon.base.state import StateFolder
from daemon.base.words import pluralise
from daemon.commands.options import RoleChoice, unit_role
from daemon.commands.records_folder import find_records_folder
from daemon.commands.upgrade.installed import Program
from daemon.config.file import load_settings
from daemon.config.migrate import list_backups
from daemon.config.settings import Settings
from daemon.store.copies import copies_of, copy_path, version_of
from daemon.store.downgrade import downgrade_store, set_aside, version_in
from daemon.store.records_folder import lock_folder
from daemon.store.schema import FILE_NAME, VERSION
from daemon.tracker.wishes import FILE_NAME as WISHES_NAME
from daemon.tracker.wishes import PROGRAM, Wish, Wishes, WishFile


def roll_back(config: Path, to: Program, environment: Mapping[str, str]) -> Iterator[str]:
    """Make the state, the store and the file of one configuration usable for the release before; yield what was done.

    The hold comes first, then the store, then the file. After an interruption all of it can be done again.

    Parameters
    ----------
    config
        The configuration of the service, which may not run.
    to
        The program of the release before.
    environment
        Environment of the process.

    Raises
    ------
    UserError
        The file cannot be read, its service runs, or a file cannot be written.
    """
    # The other release runs in another folder, so it needs the whole path.
    config = config.absolute()
    settings = load_settings(config)
    directory = find_records_folder(settings, config, environment)
    try:
        if directory is not None:
            # If the file names no folder, its service has one all the same.
            settings = settings.model_copy(update={"store": settings.store.model_copy(update={"directory": directory})})
            folders = [own.store.directory or directory for _, own in settings.trackers]
            for folder in folders:
                make_folder(folder)
            with lock_folder(directory, ("cube", "tracker")):
                if unit_role(config) is not RoleChoice.cube:
                    yield from _hold_trackers(settings, to)
                yield from _roll_back_store(directory, to)
                for folder in (directory, *folders):
                    _give_to_owner(folder)
        yield from _roll_back_file(config, to)
    except OSError as error:
        raise UserError(
            f"{error.filename or directory}: {error.strerror}; correct that and give the command again"
        ) from None


def _hold_trackers(settings: Settings, to: Program) -> Iterator[str]:
    """Hold each tracker that has no wish of a person: an earlier release may not hold it by itself."""
    for name, own in settings.trackers:
        folder = StateFolder(own.store.directory)
        file = WishFile(folder)
        wishes = file.load()
        if wishes == Wishes():
            change = f"from {release()} to {to.release()}"
            why = f"the program was changed back {change}, and nobody has checked the tracker since"
            file.save(Wishes(hold=Wish(why=why, by=PROGRAM, since_utc_s=SystemClock().utc())))
            if folder.unsaved is not None:
                raise UserError(folder.unsaved)
        if wishes == Wishes() or wishes.held_by_program:
            yield with_tracker_option(
                f"{name} is held until 'heliocube auto'", name if len(settings.trackers) > 1 else None
            )
        else:
            yield f"{name} stays as a person has ordered"


def _roll_back_store(directory: Path, to: Program) -> Iterator[str]:
    path, now_utc_s = directory / FILE_NAME, SystemClock().utc()
    wanted, copies = to.store_version(), copies_of(directory)
    if wanted is None:
        # The latest copy has the version of the release before. It is gone once the newer release has run for a day.
        wanted = version_of(copies[-1]) if copies else None
    copy = copy_path(path, VERSION if wanted is None else wanted)
    if not path.exists() and copy.exists():
        # An earlier way back was interrupted here.
        copy.rename(path)
    if not path.exists() or wanted is None or version_in(path) <= wanted:
        yield f"{path}: {to.name} can use it as it is"
    elif copy.exists():
        done = downgrade_store(path, copy, now_utc_s)
        kept = f"with {pluralise(done.records, 'record')} that came since"
        since = "WITHOUT the records that came since" if done.left_out else kept
        yield f"{path}: as it was before the upgrade, {since}; all of it is in {done.newer}"
        if done.left_out:
            yield f"{done.newer} cannot be read: {done.left_out}"
    else:
        newer = set_aside(path, now_utc_s)
        yield f"{path}: there is no copy of it any more; a new one begins, and all that was kept is in {newer}"


def _roll_back_file(config: Path, to: Program) -> Iterator[str]:
    """Put back the configuration from before the upgrade, if the release before accepts only that one."""
    if to.accepts(config):
        yield f"{config}: {to.name} can use it as it is"
        return
    kept = list_backups(config)
    # An empty file, as a full disk leaves it, has no mistakes but is no configuration.
    old = next((each for each in kept if to.accepts(each) and toml_text(each).strip()), None)
    if old is None:
        # The mistake may not be in the form of the file; a token's file may be gone, for example.
        also = f" and in {kept[0]}" if kept else ""
        mistakes = f"{to.name} finds mistakes in it{also}"
        yield f"{config} stays as it is: {mistakes}; see 'heliocube config check {config}' then"
        return
    newer = first_free(config.with_name(f"{config.name}.newer-{release()}"))
    write_new(newer, toml_text(config), config.stat())
    rewrite_file(config, toml_text(old))
    yield f"{config}: as it was before the upgrade; your changes since then are only in {newer}"


def _give_to_owner(directory: Path) -> None:
    """Give the files that were written here to the owner of the folder, which is the service's user."""
    for path in (*directory.glob(f"{Path(WISHES_NAME).stem}.*"), *directory.glob(".*-in-use")):
        give_to_folder_owner(path)
