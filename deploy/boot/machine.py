"""The tree, booted: systemd runs in it as on a rig's machine, without a network but its own loopback."""

import contextlib
import json
import os
import shutil
import signal
import subprocess
import time
from pathlib import Path
from typing import Any

from boot.host import PATIENCE_S, CheckFailed, CheckSkipped, own_cgroups, run, wait

FOREIGN = "203.0.113.5"
"""An address that the machine has and that is not of its own network: one that RFC 5737 has for documentation."""


class Machine:
    """A container of systemd-nspawn.

    Parameters
    ----------
    root
        The tree.
    name
        Of the machine.
    seen
        A folder of the host's, and where it is seen inside.
    """

    def __init__(self, root: Path, name: str, seen: tuple[Path, str]) -> None:
        self.root = root
        self._name = name
        self._seen = seen
        self._console = root.parent / "console"
        self._nspawn: subprocess.Popen[bytes] | None = None
        self._leader = 0
        self._cgroups: list[Path] = []

    def boot(self) -> str:
        """Boot and return how long it took in words; `CheckSkipped` where no container can boot."""
        own_unit = ["--keep-unit"] if not Path("/run/systemd/system").is_dir() else []
        began_s = time.monotonic()
        self._cgroups = _make_cgroups(self._name) if own_unit else []
        # In cgroups of its own: systemd inside takes over those that it is started in.
        enter = 'while [ "$1" != -- ]; do echo $$ >"$1/cgroup.procs"; shift; done; shift; exec "$@"'
        with self._console.open("wb") as console:
            self._nspawn = subprocess.Popen(  # noqa: S603
                [
                    *("/bin/sh", "-c", enter, "sh", *map(str, self._cgroups), "--"),
                    *("systemd-nspawn", "--boot", "--register=no", *own_unit, "--console=read-only"),
                    *("--private-network", "--resolv-conf=off", "--timezone=off"),
                    *("-D", str(self.root), f"--machine={self._name}"),
                    f"--bind-ro={self._seen[0]}:{self._seen[1]}",
                ],
                stdin=subprocess.DEVNULL,
                stdout=console,
                stderr=console,
                start_new_session=True,
            )
        try:
            wait(self._is_up, "systemd in the tree does not run")
        except CheckFailed as error:
            said = self._console.read_text(errors="replace").strip().splitlines()[-3:]
            raise CheckSkipped(f"no container boots here ({error}): {' / '.join(said)}") from None
        took_s = time.monotonic() - began_s
        run("nsenter", "-t", self._leader, "-n", "ip", "address", "add", f"{FOREIGN}/32", "dev", "lo")
        return f"systemd {self.systemctl('--version').split()[1]} runs {took_s:.1f} s after its start"

    def _is_up(self) -> bool:
        assert self._nspawn is not None  # noqa: S101
        if self._nspawn.poll() is not None:
            raise CheckFailed("systemd-nspawn ended at once")
        task = Path(f"/proc/{self._nspawn.pid}/task/{self._nspawn.pid}")
        children = (task / "children").read_text(encoding="ascii").split()
        self._leader = int(children[0]) if children else 0
        if not self._leader:
            return False
        done = self.run_unchecked("systemctl", "is-system-running")
        return done.stdout.strip() in {"running", "degraded"}

    def run_unchecked(self, *command: str, text: str | None = None) -> "subprocess.CompletedProcess[str]":
        """Run a command inside, whatever comes of it."""
        inside = ["nsenter", "-t", str(self._leader), "-m", "-u", "-i", "-n", "-p", "-C"]
        # The machine must not see what the host's shell has set.
        path = "/usr/local/sbin:/usr/local/bin:/usr/sbin:/usr/bin:/sbin:/bin"
        env = {"PATH": path, "LANG": "C.UTF-8", "COLUMNS": "200"}
        return subprocess.run(  # noqa: S603
            [*inside, *command], capture_output=True, text=True, check=False, input=text, timeout=PATIENCE_S, env=env
        )

    def run(self, *command: str, text: str | None = None) -> str:
        """Run a command inside and return its standard output; `CheckFailed` if it fails."""
        done = self.run_unchecked(*command, text=text)
        if done.returncode != 0:
            said = (done.stdout + done.stderr).strip()
            raise CheckFailed(f"{' '.join(command)[:120]} ended with {done.returncode}: {said}")
        return done.stdout

    def systemctl(self, *words: str) -> str:
        """Run systemctl inside."""
        return self.run("systemctl", "--no-pager", *words)

    def show(self, unit: str, *names: str) -> dict[str, str]:
        """Return properties of a unit by their names."""
        lines = self.systemctl("show", unit, *(f"--property={name}" for name in names)).splitlines()
        return dict(line.partition("=")[::2] for line in lines)

    def is_active(self, unit: str) -> bool:
        """Whether a unit is active now: for ours, whether it has said so by notify."""
        return self.show(unit, "ActiveState")["ActiveState"] == "active"

    def wait_active(self, unit: str) -> float:
        """Wait until a unit is active and return how long that took [s]."""
        began_s = time.monotonic()
        wait(lambda: self.is_active(unit), lambda: f"{unit} active; {self.journal(unit, 8)}")
        return time.monotonic() - began_s

    def journal(self, unit: str, lines: int) -> str:
        """Return the last lines that a unit has in the journal."""
        return self.run("journalctl", "--no-pager", "--output=cat", f"--unit={unit}", f"--lines={lines}").strip()

    def journal_entries(self, *words: str) -> list[dict[str, Any]]:
        """Return entries of the journal, each with all its fields."""
        self.run("journalctl", "--sync")
        found = self.run("journalctl", "--no-pager", "--output=json", *words)
        return [json.loads(line) for line in found.splitlines()]

    def write(self, name: str, text: str, mode: int = 0o644) -> None:
        """Write a file of root's on the machine's disk, by its absolute name; /run and /tmp are no disk."""
        path = self.root / name.lstrip("/")
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text, encoding="utf-8")
        path.chmod(mode)

    def stop(self) -> None:
        """End the machine, whatever state it is in, and leave no process and no cgroup behind."""
        if self._nspawn is None:
            return
        if self._leader and self._nspawn.poll() is None:
            with contextlib.suppress(ProcessLookupError):
                # systemd's word for: power off now.
                os.kill(self._leader, signal.SIGRTMIN + 4)
            with contextlib.suppress(subprocess.TimeoutExpired):
                self._nspawn.wait(20)
        if self._nspawn.poll() is None:
            self._nspawn.kill()
            self._nspawn.wait()
        self._nspawn = None
        for group in self._cgroups:
            for folder in [*sorted(group.rglob("*/"), reverse=True), group]:
                with contextlib.suppress(OSError):
                    folder.rmdir()
        shutil.rmtree(Path("/run/systemd/nspawn/propagate") / self._name, ignore_errors=True)


def _make_cgroups(name: str) -> list[Path]:
    """Make a folder beside this process's own in each hierarchy that systemd uses, where that can be done."""
    made = []
    for group in own_cgroups():
        with contextlib.suppress(OSError):
            (group / name).mkdir()
            made.append(group / name)
    return made
