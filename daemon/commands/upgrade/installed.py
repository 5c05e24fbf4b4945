"""The releases of an installed heliocube, in the layout of deploy/steps.sh, and the units that run them."""

import os
import shutil
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from daemon.base.errors import InterruptedEarlyError, UserError
from daemon.base.process import signals_as_ctrl_c

_UNITS = tuple(f"heliocube-{name}" for name in ("tracker", "cube", "dashboard", "notify", "archive"))
_WANTED = ("active", "activating", "reloading", "failed")
# The installation of a release writes this file last.
_COMPLETE_MARK = ".complete"
_SYSTEMD = Path("/run/systemd/system")
_WITHIN_S = 120.0
RELEASE_ADVICE = "look at the tracker, then release it as 'heliocube status' says"
"""What is left to do after another release has been put in use: it holds each tracker."""


@dataclass(frozen=True, slots=True)
class Program:
    """The heliocube of another release.

    Attributes
    ----------
    name
        The name by which people know it.
    folder
        Folder of its commands.
    """

    name: str
    folder: Path

    @classmethod
    def at(cls, command: Path | None) -> "Program":
        """Return the program to which a command belongs; raises `UserError` if there is no such command."""
        if command is None or not command.is_file():
            raise UserError(f"--to {command}: there is no such program; name the heliocube of the release before")
        folder = command.resolve().parent
        return cls(folder.parent.name, folder)

    def accepts(self, config: Path) -> bool:
        """Return whether this release finds a configuration good."""
        return self._run("heliocube", "config", "check", str(config)).returncode == 0

    def release(self) -> str:
        """Return the release as its service names it, or `name` if the program does not tell."""
        done = self._run("python", "-c", "from daemon.base.installation import release; print(release())")
        return (done.stdout.strip() if done.returncode == 0 else "") or self.name

    def store_version(self) -> int | None:
        """Return which version of a store this release writes, or None if it does not tell."""
        done = self._run("python", "-c", "from daemon.store.schema import VERSION; print(VERSION)")
        return int(done.stdout) if done.returncode == 0 and done.stdout.strip().isdecimal() else None

    def _run(self, name: str, *arguments: str) -> "subprocess.CompletedProcess[str]":
        """Return the outcome of one of its commands; raises `UserError` if the command does not end."""
        command = str(self.folder / name)
        try:
            # Not in the current folder: a folder named 'daemon' there would be taken for the program's.
            return subprocess.run(  # noqa: S603 - the release that a person names, or that was installed before
                [command, *arguments], capture_output=True, text=True, check=False, cwd="/", timeout=_WITHIN_S
            )
        except subprocess.TimeoutExpired:
            raise UserError(
                f"{command} has not answered within {_WITHIN_S:g} s: see what delays it, such as a slow disk, and give"
                " the command again; it goes on where it was"
            ) from None


@dataclass(frozen=True, slots=True)
class Installation:
    """Two releases side by side, one of which is in use.

    Attributes
    ----------
    current
        The link to the release in use.
    previous
        The other release.
    """

    current: Path
    previous: Program

    @classmethod
    def of(cls, prefix: Path) -> "Installation":
        """Return the installation to which an environment belongs; raises `UserError` if it has no way back."""
        releases = prefix.resolve().parent
        current = releases.parent / "current"
        if releases.name != "releases" or not current.is_symlink():
            raise UserError(
                "this heliocube was installed by hand: name the one of the release before with --to"
                " VENV/bin/heliocube, and the configuration with --config"
            )
        others = [folder for folder in releases.iterdir() if folder != prefix.resolve() and _is_complete(folder)]
        if current.resolve() != prefix.resolve() or len(others) != 1:
            raise UserError(
                f"{releases} has no release before {current.resolve().name}, which is in use: start the units"
                " that do not run (systemctl start heliocube-tracker, or -cube), or install the release that is wanted"
            )
        return cls(current, Program(others[0].name, others[0] / "bin"))

    @property
    def is_back(self) -> bool:
        """Whether the release before is in use."""
        return self.current.resolve() == self.previous.folder.parent.resolve()

    def activate_previous(self) -> None:
        """Put the release before in use, in one step, so that no release is left to go back to from there."""
        # Otherwise the command, given again, would take the newer release for the release before.
        (self.current / _COMPLETE_MARK).unlink(missing_ok=True)
        new = self.current.with_name("current.new")
        new.unlink(missing_ok=True)
        new.symlink_to(Path("releases") / self.previous.name)
        new.replace(self.current)


def _is_complete(folder: Path) -> bool:
    return (folder / _COMPLETE_MARK).exists() and (folder / "bin" / "heliocube").is_file()


def find_installation() -> Installation:
    """Return the installation of this process; raises `UserError` if it has no way back."""
    found = Installation.of(Path(sys.prefix))
    if sys.platform != "win32" and os.geteuid() != 0:
        raise UserError("going back changes what is installed: run it with sudo")
    return found


def stop_units() -> list[str]:
    """Stop the units that run or should run, and return them; none without systemd."""
    if shutil.which("systemctl") is None or not _SYSTEMD.is_dir():
        return []
    # Failed units too: one that the newer release cannot even start is the best reason to go back.
    running = [unit for unit in _UNITS if _systemctl("is-active", unit).stdout.strip() in _WANTED]
    for at, unit in enumerate(running, 1):
        try:
            _stop(unit)
        except BaseException:
            # Start this unit too: it may still stop later.
            start_units(running[:at])
            raise
    return running


def _stop(unit: str) -> None:
    if _systemctl("stop", unit).returncode != 0:
        raise UserError(f"{unit} does not stop: see 'systemctl status {unit}'; nothing has been changed")


@contextmanager
def interruptible(installation: Installation | None) -> Iterator[None]:
    """Treat a lost connection and the order to end like Ctrl-C, so that units that were stopped are started again.

    Parameters
    ----------
    installation
        The installation that goes back; None for one that was made by hand.

    Raises
    ------
    InterruptedEarlyError
        In place of `KeyboardInterrupt`.
    """
    try:
        with signals_as_ctrl_c():
            yield
    except KeyboardInterrupt:
        further = "; give the command again, and it goes on where it was"
        if installation is not None and installation.is_back:
            further = f", and {installation.previous.name} is in use: {RELEASE_ADVICE}"
        raise InterruptedEarlyError(f"interrupted: units that ran are started again{further}") from None


def start_units(units: list[str]) -> list[str]:
    """Start units again, and return those that do not start."""
    if units:
        _systemctl("reset-failed", *units)
        # Order all of them first: to wait for one may take a minute, and a person may interrupt before the next.
        _systemctl("start", "--no-block", *units)
    return [unit for unit in units if _systemctl("start", unit).returncode != 0]


def _systemctl(*arguments: str) -> "subprocess.CompletedProcess[str]":
    return subprocess.run(["systemctl", *arguments], capture_output=True, text=True, check=False)  # noqa: S603, S607 - our own
