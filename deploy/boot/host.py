"""Commands that run on the machine itself, and what it must have."""

import os
import shutil
import subprocess
import time
from collections.abc import Callable
from pathlib import Path
from typing import TypeVar

ROOT = Path(__file__).resolve().parents[2]
Found = TypeVar("Found")
PATIENCE_S = 300.0
"""How long to wait before a program counts as broken; a slow machine takes a minute for what others do at once."""

TOOLS = {
    "mmdebstrap": "mmdebstrap",
    "systemd-nspawn": "systemd-container",
    "nsenter": "util-linux",
    "ip": "iproute2",
    "git": "git",
}
"""Programs, and the packages of Debian that have them."""


class CheckSkipped(Exception):  # noqa: N818 -- nothing is wrong: this machine cannot show it
    """Nothing is wrong, but this machine cannot show it; the words say why."""


class CheckFailed(Exception):  # noqa: N818 -- what a point says when what it waits for does not come
    """A point is not as it should be; the words say what was seen."""


def need_tools() -> None:
    """Raise `CheckSkipped` unless this is root on a Linux with the tools."""
    if os.geteuid() != 0:
        raise CheckSkipped("a boot needs root")
    missing = sorted({package for tool, package in TOOLS.items() if shutil.which(tool) is None})
    if missing:
        raise CheckSkipped(f"a boot needs what is not installed: apt-get install {' '.join(missing)}")


def run(*command: object, **options: object) -> str:
    """Run a command on this machine and return its standard output; what it says goes into the error.

    Raises
    ------
    CheckFailed
        It failed, or took longer than `PATIENCE_S`.
    """
    words = [str(part) for part in command]
    try:
        done = subprocess.run(words, capture_output=True, text=True, check=False, timeout=PATIENCE_S, **options)  # type: ignore[call-overload]  # noqa: S603
    except subprocess.TimeoutExpired:
        raise CheckFailed(f"{' '.join(words)[:120]} took longer than {PATIENCE_S:g} s") from None
    if done.returncode != 0:
        said = "\n".join((done.stdout + done.stderr).strip().splitlines()[-15:])
        raise CheckFailed(f"{' '.join(words)[:120]} ended with {done.returncode}: {said}")
    return str(done.stdout)


def wait(found: Callable[[], Found], what: Callable[[], str] | str, pause_s: float = 0.2) -> Found:
    """Call `found` until it returns something true and return that.

    Raises
    ------
    CheckFailed
        With `what`, after `PATIENCE_S`.
    """
    deadline_s = time.monotonic() + PATIENCE_S
    while not (seen := found()):
        if time.monotonic() > deadline_s:
            raise CheckFailed(f"not within {PATIENCE_S:g} s: {what() if callable(what) else what}")
        time.sleep(pause_s)
    return seen


def own_cgroups() -> list[Path]:
    """Return the folder of this process in each hierarchy that systemd uses beside others."""
    lines = Path("/proc/self/cgroup").read_text(encoding="ascii").splitlines()
    own = {controller: path for _, controller, path in (line.split(":", 2) for line in lines)}
    top = Path("/sys/fs/cgroup")
    hierarchies = (("name=systemd", top / "systemd"), ("", top / "unified"))
    return [folder / own[name].lstrip("/") for name, folder in hierarchies if name in own and folder.is_dir()]
