"""A copy of the tree, to change at will."""

import shutil
import subprocess
import sys
from pathlib import Path

from tests.support import ROOT, SHARED


def copy_into(folder: Path) -> Path:
    """Copy the files that git knows or does not ignore, and return the tree's path."""
    tree = folder / "tree"
    listed = ["git", "ls-files", "-z", "--cached", "--others", "--exclude-standard"]
    for name in subprocess.run(listed, cwd=ROOT, check=True, capture_output=True, text=True).stdout.split("\0"):
        if name and (ROOT / name).is_file():
            target = tree / name
            target.parent.mkdir(parents=True, exist_ok=True)
            shutil.copy2(ROOT / name, target)
    # The measured weather lies beside the tree.
    if SHARED.is_dir():
        (folder / SHARED.name).symlink_to(SHARED)
    return tree


def begin_afresh() -> None:
    """Make the tests import the tree of the current folder, and nothing of this one."""
    for name in [name for name in sys.modules if name.partition(".")[0] in {"tests", "solar", "drivers", "daemon"}]:
        del sys.modules[name]
    sys.path[:] = [str(Path.cwd()), *(path for path in sys.path if Path(path or ".").resolve() != ROOT)]
