"""A small Debian in a folder, with what a rig's machine has; made once and kept, and copied for each run."""

import contextlib
import hashlib
import os
import shutil
import sys
import tempfile
from pathlib import Path

from boot.host import ROOT, CheckFailed, CheckSkipped, own_cgroups, run

DEBIAN = ("systemd", "systemd-sysv", "dbus", "python3", "python3-venv", "mosquitto", "mosquitto-clients")
CHECKOUT, WHEELS, PACKAGES = "/srv/checkout", "/srv/wheels", "/srv/packages"
# A folder among the packages, where links to its files can be made, and one in the cache.
ENVIRONMENTS = "environments"
# What the package is made of; either of the first two holds all that `runtime` does.
LOCKS = ("notify", "archive", "build")


class Tree:
    """The folder of one run.

    Parameters
    ----------
    cache
        Where all that takes long to make is kept from run to run: the Debian without heliocube, the wheels of the
        locks, and what they are unpacked and compiled to.
    suite
        Which Debian, such as ``trixie``; None for this machine's.
    python
        A Python of the version that this Debian has, which fetches the wheels; None for this machine's.

    Attributes
    ----------
    cache
        As given.
    base
        The Debian without heliocube.
    root
        The root of its file system.
    packages
        The folder that it sees as `PACKAGES`.
    """

    def __init__(self, cache: Path, suite: str | None = None, python: Path | None = None) -> None:
        self.cache = cache
        self._suite = suite or _suite()
        self._pythons = (Path("/usr/bin/python3"), Path(sys.executable)) if python is None else (python,)
        self.base = Path()
        self._work = Path()
        self.root = Path()
        self.packages = Path()

    def make(self, work: Path | None = None) -> str:
        """Make the tree, from the cache where it is there, and return what was done in words.

        Parameters
        ----------
        work
            The folder to make for it; by default one in the cache.
        """
        self.cache.mkdir(parents=True, exist_ok=True)
        self.base, made = self._base()
        if work is None:
            work = Path(tempfile.mkdtemp(prefix="run-", dir=self.cache))
        else:
            work.mkdir()
        self.set_folders(work, self.base)
        fetched = self._fetch_wheels()
        self.packages.mkdir()
        run("cp", "-a", "--reflink=auto", self.base, self.root)
        for name in (CHECKOUT, WHEELS, PACKAGES):
            (self.root / name.lstrip("/")).mkdir(parents=True)
        try:
            self.run("true")
        except CheckFailed as error:
            raise CheckSkipped(f"no container runs here: {error}") from None
        return f"{made}, {fetched}"

    def set_folders(self, work: Path, base: Path) -> None:
        """Say in which folder the tree is, and which Debian it is made from."""
        self._work, self.base = work, base
        self.root, self.packages = work / "root", work / "packages"

    def _base(self) -> tuple[Path, str]:
        suite = self._suite
        key = hashlib.sha256(repr((suite, DEBIAN)).encode()).hexdigest()[:12]
        base = self.cache / f"debian-{suite}-{key}"
        if base.exists():
            return base, f"{base.name} as kept"
        building = Path(tempfile.mkdtemp(prefix="building-", dir=self.cache))
        # Without a named mirror mmdebstrap takes this machine's own.
        try:
            run("mmdebstrap", "--quiet", "--variant=minbase", f"--include={','.join(DEBIAN)}", suite, building)
        except CheckFailed as error:
            shutil.rmtree(building, ignore_errors=True)
            raise CheckSkipped(f"no Debian tree could be made here: {error}") from None
        building.rename(base)
        return base, f"{base.name} made anew"

    def _fetch_wheels(self) -> str:
        """Fetch what the locks name with this machine's pip and its settings; the tree itself has no network."""
        locks = [ROOT / "deploy" / "lock" / f"{name}.txt" for name in LOCKS]
        key = hashlib.sha256(b"".join([self._suite.encode(), *(lock.read_bytes() for lock in locks)])).hexdigest()
        wheels, mark = self.cache / "wheels", self.cache / "wheels" / ".complete"
        if mark.exists() and mark.read_text() == key:
            return "wheels as kept"
        shutil.rmtree(wheels, ignore_errors=True)
        wheels.mkdir()
        run(
            *(self._python_with_pip(), "-m", "pip", "download", "--quiet", "--disable-pip-version-check"),
            *("--no-deps", "--only-binary", ":all:", "--require-hashes", "--dest", wheels),
            *(part for lock in locks for part in ("--requirement", lock)),
        )
        mark.write_text(key)
        return "wheels fetched"

    def _python_with_pip(self) -> Path:
        """Make an environment with pip, if possible of Debian's Python, for which the wheels are meant."""
        for python in self._pythons:
            with contextlib.suppress(CheckFailed, OSError):
                run(python, "-m", "venv", "--clear", self._work / "pip")
                return self._work / "pip" / "bin" / "python"
        raise CheckSkipped("no Python here makes an environment with pip: apt-get install python3-venv")

    def link_environments(self) -> None:
        """Let the build find what an earlier run has unpacked and compiled; their names say what is in them."""
        if (self.cache / ENVIRONMENTS).is_dir():
            run("cp", "-al", self.cache / ENVIRONMENTS, self.packages / ENVIRONMENTS)

    def keep_environments(self) -> None:
        """Keep for the next run what this one has made, in place of what was kept before."""
        before, new = self.cache / ENVIRONMENTS, self.packages / ENVIRONMENTS
        known = {path.name for path in before.iterdir()} if before.is_dir() else set()
        made = [path for path in new.iterdir() if path.name not in known]
        if not made:
            return
        kept = Path(tempfile.mkdtemp(prefix="building-", dir=self.cache))
        for path in made:
            run("cp", "-al", path, kept)
        shutil.rmtree(before, ignore_errors=True)
        # Another run may have kept its own first.
        with contextlib.suppress(OSError):
            kept.rename(before)
        shutil.rmtree(kept, ignore_errors=True)

    def run(self, *command: str, sources: Path = ROOT) -> str:
        """Run a command in the tree before its boot, without a network; it sees a checkout and the wheels."""
        return run(
            *("systemd-nspawn", "--quiet", "--register=no", "--keep-unit", "--pipe", "--private-network"),
            *("-D", self.root, f"--machine={self.machine}"),
            *(f"--bind-ro={sources}:{CHECKOUT}", f"--bind-ro={self.cache / 'wheels'}:{WHEELS}"),
            f"--bind={self.packages}:{PACKAGES}",
            *("--setenv=PIP_NO_INDEX=1", f"--setenv=PIP_FIND_LINKS={WHEELS}"),
            *command,
        )

    @property
    def machine(self) -> str:
        """A name of its own, since runs may stand side by side."""
        return f"heliocube-test-{os.getpid()}"

    def remove(self, *, keep: bool = False) -> None:
        """Remove what this run has made, but for the cache; a tree that is to be kept stays."""
        if self._work.is_dir() and self._work != Path() and not keep:
            shutil.rmtree(self._work)
        # What systemd-nspawn has made and does not remove; that of another run at work cannot be removed.
        for group in own_cgroups():
            for name in ("payload", "supervisor"):
                with contextlib.suppress(OSError):
                    (group / name).rmdir()


def _suite() -> str:
    """Return the Debian that this machine is, whose packages its apt knows; on another system the oldest supported."""
    lines = Path("/etc/os-release").read_text(encoding="utf-8").splitlines()
    release = dict(line.partition("=")[::2] for line in lines if "=" in line)
    return release.get("VERSION_CODENAME", "bookworm") if release.get("ID") == "debian" else "bookworm"
