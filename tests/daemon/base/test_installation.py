import base64
import hashlib
import re
import shutil
import subprocess
import sys

import pytest

from tests.support import PATIENCE_S, ROOT

PACKAGES = ("daemon", "solar", "drivers", "sim_drivers", "heliocube")
RUN = """
import sys
sys.path[:] = [{site!r}, *(place for place in sys.path if place != {root!r})]
from daemon.entry import main
sys.argv = ["heliocube", *{words!r}]
main()
"""


@pytest.fixture
def site(tmp_path):
    """A folder into which heliocube has been installed."""
    folder = tmp_path / "site"
    for package in PACKAGES:
        shutil.copytree(ROOT / package, folder / package, ignore=shutil.ignore_patterns("__pycache__"))
    install(folder, "heliocube", sorted(file for file in folder.rglob("*") if file.is_file()))
    return folder


def install(folder, name, files):
    """Record files as a distribution's, as an installer does."""
    about = folder / f"{name.replace('-', '_')}-0.1.0.dist-info"
    about.mkdir()
    (about / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {name}\nVersion: 0.1.0\n")
    lines = []
    for file in files:
        digest = base64.urlsafe_b64encode(hashlib.sha256(file.read_bytes()).digest()).rstrip(b"=").decode()
        lines.append(f"{file.relative_to(folder).as_posix()},sha256={digest},{file.stat().st_size}")
    (about / "RECORD").write_text("\n".join(lines) + "\n")


def another_daemon(folder):
    """Install what python-daemon installs, over our package."""
    first, module = folder / "daemon" / "__init__.py", folder / "daemon" / "daemon.py"
    first.write_text(
        '"""Library to implement a well-behaved Unix daemon process."""\nfrom .daemon import DaemonContext\n'
    )
    module.write_text("class DaemonContext: ...\n")
    install(folder, "python-daemon", [first, module])


def heliocube(site, *words):
    return subprocess.run(
        [sys.executable, "-c", RUN.format(root=str(ROOT), site=str(site), words=words)],
        cwd=site.parent,
        capture_output=True,
        text=True,
        timeout=PATIENCE_S,
        check=False,
    )


def test_the_program_runs_from_an_intact_installation(site):
    done = heliocube(site, "--version")
    assert (done.returncode, done.stdout, done.stderr) == (0, "heliocube 0.1.0\n", "")


def test_a_daemon_package_overwritten_by_another_distribution_is_refused_by_name(site):
    another_daemon(site)
    done = heliocube(site, "--version")
    assert done.returncode == 2
    assert done.stderr == (
        f"heliocube: the package 'daemon' at {site} has been overwritten by python-daemon: give heliocube an"
        " environment of its own (python -m venv, or pipx) and install it there again\n"
    )


def test_an_installation_that_lost_files_with_the_removal_of_another_distribution_is_refused(site):
    (site / "daemon" / "__init__.py").unlink()
    done = heliocube(site, "--version")
    assert done.returncode == 2
    assert f"the package 'daemon' at {site} has been overwritten: give heliocube" in done.stderr
    assert "Traceback" not in done.stderr


def test_a_foreign_package_earlier_on_the_import_path_is_named_and_refused(site, tmp_path):
    before = tmp_path / "before" / "solar"
    before.mkdir(parents=True)
    (before / "__init__.py").touch()
    code = RUN.format(root=str(ROOT), site=str(site), words=["--version"]).replace(
        "from daemon.entry", f"sys.path.insert(0, {str(before.parent)!r})\nfrom daemon.entry"
    )
    done = subprocess.run([sys.executable, "-c", code], cwd=tmp_path, capture_output=True, text=True, check=False)
    assert done.returncode == 2
    assert f"the package 'solar' is found at {before} and not at {site / 'solar'}" in done.stderr


def test_a_damaged_installation_still_tries_to_give_a_stop(site, tmp_path):
    another_daemon(site)
    done = heliocube(site, "stop", "--api", "http://127.0.0.1:9", "--token-file", str(tmp_path / "none"))
    assert "overwritten" not in done.stderr
    assert str(tmp_path / "none") in done.stderr or "127.0.0.1:9" in done.stderr


def test_two_installations_of_one_version_are_told_apart_by_what_was_installed(site):
    def program():
        # The version of the program is printed even without a configuration file.
        return heliocube(site, "self-check", "-c", "nothing.toml").stdout.splitlines()[0].split()[-1]

    before = program()
    assert before.startswith("0.1.0+")
    assert program() == before
    record = site / "heliocube-0.1.0.dist-info" / "RECORD"
    record.write_text(re.sub(r"(solar/skies/overcast.py,sha256=)\w", r"\1_", record.read_text()))
    assert program() != before
