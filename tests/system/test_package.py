"""The Debian package, without building it: deploy/test-boot builds, installs, upgrades and purges it."""

import shutil
import sys

import pytest
from typer.main import get_command

from daemon.commands.main import app
from tests.support import ROOT
from tests.system.test_deploy import run

DEB = ROOT / "deploy" / "deb"
SCRIPTS = ("build", "postinst", "prerm", "postrm")
pytestmark = pytest.mark.system


def leaves(words, command):
    below = {name: one for name, one in getattr(command, "commands", {}).items() if not one.hidden}
    return [leaf for name, one in below.items() for leaf in leaves([*words, name], one)] if below else ["-".join(words)]


@pytest.fixture(scope="module")
def manual(tmp_path_factory):
    folder = tmp_path_factory.mktemp("man")
    done = run(sys.executable, DEB / "pages.py", "1.2", "1790000000", folder, cwd=ROOT)
    assert (done.returncode, done.stderr) == (0, "")
    return folder


def test_every_command_has_a_manual_page_with_its_options(manual):
    commands = leaves(["heliocube"], get_command(app))
    assert len(commands) > 30
    assert [name for name in commands if not (manual / f"{name}.1").exists()] == []
    stop = (manual / "heliocube-stop.1").read_text()
    assert "\\fB\\-\\-why\\fR \\fITEXT\\fR" in stop
    assert '"2026-09-21" "heliocube 1.2"' in stop


@pytest.mark.skipif(shutil.which("man") is None, reason="man is not installed")
def test_man_gives_no_warning_about_the_manual_pages(manual):
    done = run("man", "--warnings", "-E", "UTF-8", "-l", *sorted(manual.iterdir()), env={"PATH": "/usr/bin:/bin"})
    assert (done.returncode, done.stderr) == (0, "")
    assert "HELIOCUBE-STOP(1)" in done.stdout


@pytest.mark.parametrize("name", SCRIPTS)
def test_the_scripts_of_the_debian_package_have_valid_shell_syntax(name):
    assert run("sh", "-n", DEB / name).stderr == ""


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        (["--python", "/nowhere/python"], "there is no /nowhere/python: apt-get install python3 python3-venv"),
        (["--frm", "x"], "'--frm' is no option; see --help"),
        (["--version", "not a version"], "--version not a version: no version that Debian can have"),
        (["--out"], "--out needs a value"),
    ],
)
@pytest.mark.skipif(shutil.which("dpkg-deb") is None, reason="dpkg-deb is not installed")
def test_a_mistaken_option_of_the_package_build_is_refused_with_a_sentence(arguments, sentence):
    done = run("sh", DEB / "build", *arguments)
    assert done.returncode == 2
    assert sentence in done.stderr
    assert "Traceback" not in done.stderr


@pytest.mark.parametrize("action", ["remove", "purge"])
def test_a_purge_after_the_removal_keeps_what_install_sh_has_installed_since(action):
    # dpkg remembers a removed package until somebody purges it, by hand or when clearing up what packages left.
    told = "rm() { echo rm $*; }; rmdir() { echo rmdir $*; }; systemctl() { :; }"
    done = run("sh", "-euc", f'{told}; set -- "$0"; . "{DEB}/postrm"', action)
    assert (done.returncode, done.stderr) == (0, "")
    assert ("/opt/heliocube" in done.stdout) is (action == "remove")
    assert ("/var/lib/systemd/timers" in done.stdout) is (action == "remove")
