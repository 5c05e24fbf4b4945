"""Whether the packages that Python finds under our names are ours (docs/decisions/0001).

Other distributions install packages of the same names: python-daemon has a `daemon`. In one environment, the one that
is installed later overwrites files of the earlier one, and nothing says so.
"""

import hashlib
import sys
from base64 import urlsafe_b64encode
from collections.abc import Sequence
from importlib import metadata
from importlib.util import find_spec
from pathlib import Path

DISTRIBUTION = "heliocube"
PACKAGES = ("daemon", "solar", "drivers", "sim_drivers", "heliocube")
_REMEDY = "give heliocube an environment of its own (python -m venv, or pipx) and install it there again"


def overwritten_package_text() -> str | None:
    """Return one sentence on the first of our packages that another one has taken, with the remedy, or None.

    Each package has to stand beside the one that this module was loaded from, and its `__init__.py` has to be the one
    that was installed.
    """
    home = Path(__file__).resolve().parents[2]
    recorded = _recorded_digests(home, sys.path)
    for package in PACKAGES:
        spec = find_spec(package)
        found = None if spec is None or spec.origin is None else Path(spec.origin).resolve().parent
        if found is not None and found != home / package:
            return f"the package '{package}' is found at {found} and not at {home / package}: {_REMEDY}"
        name = f"{package}/__init__.py"
        if not (home / name).is_file() or recorded.get(name, "") not in ("", _digest(home / name)):
            return (
                f"the package '{package}' at {home} has been overwritten{_overwriter_clause(name, sys.path)}: {_REMEDY}"
            )
    return None


def release() -> str:
    """Return what tells this installation from any other of the same version, such as ``0.1.0+3f9a02c1d4e7``.

    After the plus stands a digest of the files of our packages as the installation recorded them. An editable
    installation records none and is known by its version alone.
    """
    home = Path(__file__).resolve().parents[2]
    digests = sorted(
        f"{name} {digest}"
        for name, digest in _recorded_digests(home, sys.path).items()
        if digest and name.partition("/")[0] in PACKAGES
    )
    version = metadata.version(DISTRIBUTION)
    if not digests:
        return version
    return f"{version}+{hashlib.sha256(chr(10).join(digests).encode()).hexdigest()[:12]}"


def _recorded_digests(home: Path, path: Sequence[str]) -> dict[str, str]:
    """Return the digest of each file as our installation recorded it; empty for an editable one, which records none."""
    for distribution in metadata.distributions(name=DISTRIBUTION, path=list(path)):
        if Path(str(distribution.locate_file(""))).resolve() == home:
            lines = (line.split(",") for line in (distribution.read_text("RECORD") or "").splitlines())
            return {cells[0]: cells[1].removeprefix("sha256=") for cells in lines if len(cells) == 3}
    return {}


def _overwriter_clause(name: str, path: Sequence[str]) -> str:
    """Return who else has installed a file of that name, as the end of a clause."""
    others = {
        distribution.metadata["Name"]
        for distribution in metadata.distributions(path=list(path))
        if any(str(file) == name for file in distribution.files or ())
    } - {DISTRIBUTION}
    return f" by {', '.join(sorted(others))}" if others else ""


def _digest(file: Path) -> str:
    """Return the SHA-256 as RECORD has it: base64 for URLs, without padding."""
    return urlsafe_b64encode(hashlib.sha256(file.read_bytes()).digest()).rstrip(b"=").decode()
