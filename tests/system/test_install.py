"""What installing again does, with a stand-in for Python that installs nothing; test_deploy.py really installs."""

import os
import re
import shutil
import subprocess
import sys

import pytest

from daemon.api.token import load_token
from daemon.bridge.signing import load_key
from tests.support import ROOT
from tests.system.test_deploy import DEPLOY, run

pytestmark = pytest.mark.system
needs_root = pytest.mark.skipif(
    os.geteuid() != 0 or shutil.which("systemd-sysusers") is None, reason="installing needs root and systemd-sysusers"
)

PYTHON = """#!/bin/sh
[ "$1" != --version ] || echo heliocube 0.2.0
[ "$2" != pip ] || eval "${AT_PIP-}"
[ "$2" = venv ] || exit 0
mkdir -p "$3/bin"
for name in python heliocube; do cp "$0" "$3/bin/$name"; done
"""


def test_installing_a_release_again_keeps_the_release_before_it(tmp_path):
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


def test_an_old_release_that_a_process_runs_from_is_kept_but_no_longer_marked_complete(tmp_path):
    releases = tmp_path / "opt" / "heliocube" / "releases"
    program = releases / "1" / "bin" / "heliocube"
    program.parent.mkdir(parents=True)
    program.symlink_to("/bin/cat")

    def use(name):
        (releases / name).mkdir(exist_ok=True)
        (releases / name / ".complete").touch()
        done = run("sh", "-euc", '. deploy/steps.sh; use_release "$0"', name, cwd=ROOT, env={"root": str(tmp_path)})
        assert (done.returncode, done.stderr) == (0, "")
        return {path.parent.name for path in releases.glob("*/.complete")}

    use("1")
    with subprocess.Popen([program], stdin=subprocess.PIPE):
        use("2")
        assert use("3") == {"2", "3"}
        assert program.exists()
    use("4")
    assert {path.name for path in releases.iterdir()} == {"3", "4"}


def test_a_package_of_the_same_version_replaces_the_release_only_once_it_is_copied_completely(tmp_path):
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
    # As if the power failed, or the disk were full.
    assert lay_down("cp() { return 1; };").returncode == 1
    assert (release / ".complete").exists()
    assert (release / "bin" / "heliocube").read_text() == "newer"


@pytest.fixture
def tree(tmp_path):
    """Return an empty tree that `install` installs into."""
    folder = tmp_path / "tree"
    folder.mkdir()
    return folder


@pytest.fixture
def install(tmp_path, tree):
    """Return a function that installs a wheel into the tree; Python is a stand-in, and a folder is put before PATH."""
    python, wheel, path = tmp_path / "python", tmp_path / "heliocube-0.2.0-py3-none-any.whl", tmp_path / "path"
    python.write_text(PYTHON)
    python.chmod(0o755)
    wheel.touch()
    path.mkdir()

    def run_it(*options, **environment):
        env = os.environ | {"PATH": f"{path}:{os.environ['PATH']}"} | environment
        command = ("sh", DEPLOY / "install.sh", "--root", tree, "--python", python, "--from", wheel, *options)
        return run(*command, env=env, start_new_session=True)

    return run_it


@needs_root
def test_the_installation_syncs_to_disk_before_it_marks_a_release_complete_and_again_at_the_end(
    tmp_path, tree, install
):
    sync, told = tmp_path / "path" / "sync", tmp_path / "told"
    there = "find . -name .complete -o -name current -o -name tracker.toml -o -name heliocube.conf | wc -l"
    sync.write_text(f"#!/bin/sh\ncd {tree}\n{there} >>{told}\n")
    sync.chmod(0o755)
    assert install("--role", "tracker").returncode == 0
    # Three files are called heliocube.conf: for modules, for the user and for the folders.
    assert told.read_text().split() == ["0", "1", "6"]


@needs_root
def test_a_unit_with_world_readable_state_runs_as_a_user_that_the_installation_creates(tree, install):
    assert install("--role", "archive").returncode == 0
    made = {line.partition(":")[0] for line in (tree / "etc/passwd").read_text().splitlines()}
    texts = [unit.read_text() for unit in (tree / "etc/systemd/system").glob("*.service")]
    assert {user for text in texts for user in re.findall(r"^User=(.*)$", text, re.MULTILINE)} <= made
    open_to_all = [text for text in texts if "\nStateDirectoryMode=0755\n" in text]
    assert open_to_all
    # systemd keeps the state of a dynamic user behind a folder that only root may open.
    assert not [text for text in open_to_all if "\nDynamicUser=yes\n" in text]


@needs_root
def test_installing_again_repairs_files_that_a_power_cut_has_left_empty(tree, install):
    assert install("--role", "tracker").returncode == 0
    assert "building" not in install().stdout
    (release,) = (tree / "opt/heliocube/releases").iterdir()
    mine = tree / "etc/heliocube/dashboard.toml"
    mine.write_text("# mine\n")
    emptied = [release / "bin/heliocube", release / "bin/python", tree / "etc/heliocube/tracker.toml"]
    for path in emptied:
        os.truncate(path, 0)
    done = install()
    assert (done.returncode, done.stderr) == (0, "")
    assert all(path.stat().st_size for path in emptied)
    assert mine.read_text() == "# mine\n"


@needs_root
def test_an_installation_into_a_folder_with_a_blank_in_its_name_works(tmp_path, install):
    folder = tmp_path / "image of a rig"
    folder.mkdir()
    done = install("--role", "tracker", "--root", folder)
    assert done.returncode == 0, done.stderr
    assert (folder / "opt/heliocube/current/bin/heliocube").exists()


def test_a_token_and_a_key_that_a_power_cut_has_left_empty_are_created_anew(tmp_path):
    programs, etc = tmp_path / "opt/heliocube/current/bin", tmp_path / "etc/heliocube"
    programs.mkdir(parents=True)
    for name, does in {"python": f'exec {sys.executable} "$@"', "heliocube": "exit 0"}.items():
        (programs / name).write_text(f"#!/bin/sh\n{does}\n")
        (programs / name).chmod(0o755)

    def secrets():
        configure = '. deploy/steps.sh; configure deploy/examples "cube tracker"'
        done = run("sh", "-euc", configure, cwd=ROOT, env=os.environ | {"root": str(tmp_path)})
        assert (done.returncode, done.stderr) == (0, "")
        return load_token(etc / "api.token"), load_key(etc / "bridge.key")

    first = secrets()
    assert secrets() == first
    for name in ("api.token", "bridge.key"):
        os.truncate(etc / name, 0)
    token, key = secrets()
    assert token != first[0]
    assert key != first[1]


@needs_root
@pytest.mark.parametrize(("at_pip", "code"), [("exit 1", 2), ("kill -TERM 0", 143)])
def test_an_installation_that_fails_or_is_interrupted_leaves_nothing_of_the_release(tree, install, at_pip, code):
    assert install(AT_PIP=at_pip).returncode == code
    assert not list((tree / "opt/heliocube/releases").iterdir())
    assert install().returncode == 0


@needs_root
@pytest.mark.parametrize(("at_pip", "code"), [("exit 1", 2), ("kill -TERM 0", 143), ("kill -KILL 0", -9)])
def test_a_release_that_does_not_answer_is_kept_until_its_replacement_is_built(tree, install, at_pip, code):
    assert install("--role", "tracker").returncode == 0
    releases = tree / "opt/heliocube/releases"
    (release,) = releases.iterdir()
    (release / "bin/heliocube").write_text("")
    (release / "for a service that runs").touch()
    done = install(AT_PIP=at_pip)
    assert done.returncode == code
    if code == 2:
        assert "see above; nothing has been changed" in done.stderr
    # A kill, like a power cut, leaves the release set aside. The next installation puts it back, or does without it.
    assert install(AT_PIP="exit 1").returncode == 2
    assert list(releases.iterdir()) == [release]
    assert {path.name for path in release.iterdir()} == {".complete", "bin", "for a service that runs"}
    assert install().returncode == 0
    assert list(releases.iterdir()) == [release]
    assert {path.name for path in release.iterdir()} == {".complete", "bin"}


@needs_root
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
def test_an_upgrade_keeps_the_roles_that_a_machine_has(tmp_path, tree, install, before, units):
    for role in before:
        assert install("--role", role).returncode == 0
    (tmp_path / "heliocube-0.2.0-py3-none-any.whl").write_text("newer")
    done = install()
    assert done.returncode == 0, done.stderr
    roles = ("cube", "tracker", "archive")
    laid_down = {role for role in roles if (tree / f"etc/systemd/system/heliocube-{role}.service").exists()}
    assert laid_down == units
    assert {role for role in roles if f"systemctl enable --now heliocube-{role} " in done.stdout} == units
    restarted = re.search(r"systemctl try-restart (.*)", done.stdout)[1].split()
    assert set(restarted) == {f"heliocube-{name}" for name in (*units, "dashboard", "notify")}
