"""Points about the Debian package: built in the tree, installed, put over the one of the commit before, and purged."""

import json
import os
import shutil
import time
from pathlib import Path

from boot.host import ROOT, CheckFailed, run, wait
from boot.machine import Machine
from boot.records import ROLES, Records
from boot.restarts import Restarts
from boot.rig import UNITS, BootRig
from boot.tree import CHECKOUT, ENVIRONMENTS, PACKAGES, Tree

_NOTE = "prepared.json"
_LEAVES = ("etc/heliocube", "var/lib/heliocube", "var/lib/private/heliocube")
# Not ours: what the run itself has put there, and what the system keeps about every package and user.
_NOT_OURS = ("srv", "proc", "sys", "run", "tmp", "var/log", "var/cache", "var/tmp")


class Packages:
    """The packages of this commit and of the one before.

    Parameters
    ----------
    tree
        Where they are built.
    """

    def __init__(self, tree: Tree) -> None:
        self._tree = tree
        self._old = ""
        self._new = ""
        self._before: set[str] = set()

    def build(self) -> str:
        """Build both; where the commit before cannot be had, this one under an older number stands for it."""
        self._tree.link_environments()
        count, commit = _git("rev-list", "--count", "HEAD"), _git("rev-parse", "--short=8", "HEAD")
        self._new = self._build(ROOT, f"0.0+test{count or 1}.{commit or 'checkout'}")
        size_mb = (self._tree.packages / self._new).stat().st_size / 1e6
        words = f"{self._new}, {size_mb:.0f} MB uncompressed"
        if count and (earlier := self._earlier()):
            self._old = self._build(earlier, f"0.0+test{int(count) - 1}")
            self._tree.keep_environments()
            return f"{words}, and that of the commit before"
        self._old = self._build(ROOT, "0.0+test0")
        self._tree.keep_environments()
        return f"{words}; the commit before has no package, so this one under an older number stands for it"

    def _build(self, sources: Path, version: str) -> str:
        said = self._tree.run(
            # On the disk, where the package's files can be links to those that are kept.
            *("env", f"TMPDIR={PACKAGES}", "sh", f"{CHECKOUT}/deploy/deb/build", "--fast", "--out", PACKAGES),
            *("--keep", f"{PACKAGES}/{ENVIRONMENTS}", "--version", version),
            sources=sources,
        )
        return Path(said.strip().splitlines()[-1]).name

    def _earlier(self) -> Path | None:
        """Return the sources of the commit before, or None where they are not here or make no package."""
        if not _git("rev-parse", "--verify", "--quiet", "HEAD~1:deploy/deb/build"):
            return None
        archive, folder = self._tree.packages / "earlier.tar", self._tree.packages / "earlier"
        run("git", "-C", ROOT, "archive", "--format=tar", f"--output={archive}", "HEAD~1")
        folder.mkdir()
        run("tar", "--extract", f"--file={archive}", f"--directory={folder}")
        return folder

    def install(self) -> str:
        """Install the package of the commit before into the tree."""
        self._before = _files(self._tree.root)
        self._tree.run("dpkg", "--force-unsafe-io", "--install", f"{PACKAGES}/{self._old}")
        wants = self._tree.root / "etc/systemd/system/multi-user.target.wants"
        if enabled := sorted(path.name for path in wants.glob("heliocube*")):
            raise CheckFailed(f"it starts by itself: {enabled}")
        return f"{self._old}; nothing of it is enabled"

    def save_prepared(self) -> None:
        """Write beside the tree what has been made, for a later run."""
        made = {"base": str(self._tree.base), "old": self._old, "new": self._new}
        (self._tree.root.parent / _NOTE).write_text(json.dumps(made), encoding="utf-8")

    def has_prepared(self, work: Path) -> bool:
        """Whether all has been made in a folder."""
        return (work / _NOTE).exists()

    def load_prepared(self, work: Path) -> str:
        """Take over what an earlier run has made and noted."""
        made = json.loads((work / _NOTE).read_text(encoding="utf-8"))
        self._tree.set_folders(work, Path(made["base"]))
        self._old, self._new = made["old"], made["new"]
        self._before = _files(self._tree.base)
        return f"{self._old} is installed, {self._new} lies beside it"

    def upgrade(self, machine: Machine, rig: BootRig, records: Records, restarts: Restarts) -> str:
        """Put this commit's package over it at work: nothing moves, both roles come back, and no scan is lost."""
        before = {role: records.scans(role) for role in ROLES}
        pose, began_s = rig.wait_until_at_rest(), time.monotonic()
        machine.run("dpkg", "--force-unsafe-io", "--install", f"{PACKAGES}/{self._new}")
        took_s = time.monotonic() - began_s
        self._see_running(machine, self._new)
        held = restarts.check_hold_until_released(pose)
        wait(lambda: self._caught_up(records), "the tracker's records after the upgrade")
        return f"{took_s:.0f} s; {held}; {records.check_no_scan_lost(before)}"

    def check_rollback(self, machine: Machine, rig: BootRig, restarts: Restarts) -> str:
        """Go back to the commit before in one command, see that nothing moves, and put this commit's package back."""
        pose = rig.wait_until_at_rest()
        said = machine.run("heliocube", "rollback").strip().splitlines()
        self._see_running(machine, self._old)
        held = restarts.check_hold_until_released(pose)
        pose = rig.wait_until_at_rest()
        machine.run("dpkg", "--force-unsafe-io", "--install", f"{PACKAGES}/{self._new}")
        self._see_running(machine, self._new)
        restarts.check_hold_until_released(pose)
        return f'"{said[-1]}"; {held}; and forward again'

    def _see_running(self, machine: Machine, package: str) -> None:
        """Wait until both units are active, and see that their processes are those of a package."""
        for unit in UNITS:
            machine.wait_active(unit)
            running = machine.run("cat", f"/proc/{machine.show(unit, 'MainPID')['MainPID']}/cmdline").partition("\0")[0]
            if f"/{package.split('_')[1]}/" not in running:
                raise CheckFailed(f"{unit} is {running}")

    def _caught_up(self, records: Records) -> bool:
        sessions = {session for session, _ in records.scans("cube")}
        return {session for session, _ in records.scans("tracker")} == sessions

    def check_manual_pages(self, machine: Machine) -> str:
        """See manual pages and completion where the shells look for them."""
        page = machine.root / "usr/share/man/man1/heliocube-stop.1.gz"
        words = machine.run(
            *("bash", "-c"),
            "source /usr/share/bash-completion/completions/heliocube; COMP_WORDS=(heliocube st); COMP_CWORD=1;"
            " _heliocube_completion heliocube; echo ${COMPREPLY[*]}",
        ).split()
        pages = list(page.parent.glob("heliocube*.1.gz"))
        if not page.exists() or "stop" not in words or "stow" not in words:
            raise CheckFailed(f"{len(pages)} pages; 'heliocube st' is completed to {words}")
        return f"{len(pages)} manual pages; 'heliocube st' is completed to {', '.join(words)}"

    def purge(self, machine: Machine) -> str:
        """See that a purge leaves settings, keys, records and their user, and nothing else of ours."""
        machine.systemctl("stop", "bench.service")
        records = sorted((machine.root / "var/lib/heliocube").rglob("*.sqlite"))
        machine.run("dpkg", "--force-unsafe-io", "--purge", "heliocube")
        if running := machine.run("systemctl", "list-units", "--plain", "--no-legend", "heliocube*").strip():
            raise CheckFailed(f"still known to systemd: {running}")
        left = {name for name in _files(self._tree.root) - self._before if not name.startswith(_LEAVES)}
        if ours := sorted(name for name in left if "heliocube" in name):
            raise CheckFailed(f"left: {', '.join(ours[:5])}")
        if gone := [path.name for path in records if not path.exists()]:
            raise CheckFailed(f"records are gone: {gone}")
        kept = sorted(path.name for path in (machine.root / "etc/heliocube").iterdir())
        return f"left are {len(records)} stores, the reports, and of /etc/heliocube {', '.join(kept)}"


def _files(root: Path) -> set[str]:
    begin = len(str(root)) + 1
    names = (f"{folder}/{name}"[begin:] for folder, folders, files in os.walk(root) for name in (*files, *folders))
    return {name for name in names if not name.startswith(_NOT_OURS)}


def _git(*words: str) -> str:
    """Return what git says of this checkout; empty where it is none, or git has nothing to say."""
    if shutil.which("git") is None:
        return ""
    try:
        return run("git", "-C", ROOT, "-c", f"safe.directory={ROOT}", *words).strip()
    except CheckFailed:
        return ""
