"""What installing again does, with a stand-in for Python that installs nothing; test_deploy.py does it in earnest."""

import os
import shutil

import pytest

from tests.support import ROOT
from tests.system.test_deploy import DEPLOY, run

pytestmark = pytest.mark.system

PYTHON = """#!/bin/sh
[ "$2" = venv ] || exit 0
mkdir -p "$3/bin"
for name in python heliocube; do cp "$0" "$3/bin/$name"; done
"""


def test_installing_a_release_again_leaves_the_one_before_it(tmp_path):
    releases = tmp_path / "opt" / "heliocube" / "releases"

    def use(name):
        (releases / name).mkdir(parents=True, exist_ok=True)
        done = run("sh", "-euc", '. deploy/steps.sh; use_release "$0"', name, cwd=ROOT, env={"root": str(tmp_path)})
        assert (done.returncode, done.stderr) == (0, "")
        return (releases.parent / "current").resolve().name, {path.name for path in releases.iterdir()}

    assert use("1") == ("1", {"1"})
    assert use("2") == ("2", {"1", "2"})
    assert use("2") == ("2", {"1", "2"})
    assert use("3") == ("3", {"2", "3"})


def test_a_package_of_the_same_version_takes_nothing_away_before_it_is_whole(tmp_path):
    opt = tmp_path / "opt" / "heliocube"
    program, release = opt / "package" / "bin" / "heliocube", opt / "releases" / "1"
    program.parent.mkdir(parents=True)

    def lay_down(before=""):
        return run(
            "sh", "-euc", f'. deploy/steps.sh; {before} lay_down "$0"', "1", cwd=ROOT, env={"root": str(tmp_path)}
        )

    for text in ("older", "newer"):
        program.unlink(missing_ok=True)
        program.write_text(text)
        done = lay_down()
        assert (done.returncode, done.stderr) == (0, "")
        assert (release / "bin" / "heliocube").samefile(program)
        assert [path.name for path in release.parent.iterdir()] == ["1"]
    # As where the supply fails, or the disk is full.
    assert lay_down("cp() { return 1; };").returncode == 1
    assert (release / ".complete").exists()
    assert (release / "bin" / "heliocube").read_text() == "newer"


@pytest.mark.skipif(os.geteuid() != 0, reason="installing needs root")
@pytest.mark.skipif(shutil.which("systemd-sysusers") is None, reason="systemd-sysusers is not installed")
@pytest.mark.parametrize(
    ("before", "units"),
    [
        ([], {"cube", "tracker"}),
        (["tracker"], {"tracker"}),
        (["archive"], {"archive"}),
        (["cube", "archive"], {"cube", "archive"}),
        (["both"], {"cube", "tracker"}),
    ],
)
def test_an_upgrade_leaves_a_machine_the_roles_that_it_has(tmp_path, before, units):
    python, wheel, tree = tmp_path / "python", tmp_path / "heliocube-0.2.0-py3-none-any.whl", tmp_path / "tree"
    python.write_text(PYTHON)
    python.chmod(0o755)
    wheel.touch()
    tree.mkdir()
    install = ("sh", DEPLOY / "install.sh", "--root", tree, "--python", python, "--from", wheel)
    for role in before:
        assert run(*install, "--role", role).returncode == 0
    wheel.write_text("newer")
    done = run(*install)
    assert done.returncode == 0, done.stderr
    roles = ("cube", "tracker", "archive")
    laid_down = {role for role in roles if (tree / f"etc/systemd/system/heliocube-{role}.service").exists()}
    assert laid_down == units
    assert {role for role in roles if f"systemctl enable --now heliocube-{role} " in done.stdout} == units
