"""`deploy/test-boot` with options that boot nothing; `.ci/run` starts the real boot."""

import sys

import pytest

from tests.system.test_deploy import DEPLOY, run

pytestmark = pytest.mark.system


@pytest.mark.parametrize("option", [None, "--prepare", "--prepared"])
def test_on_a_machine_that_cannot_boot_a_container_the_boot_test_says_so_and_exits_with_0(tmp_path, option):
    options = ["--cache", tmp_path / "cache", *([option, tmp_path / "boot"] if option else [])]
    done = run(sys.executable, DEPLOY / "test-boot", *options, env={"PATH": str(tmp_path)})
    assert done.returncode == 0, done.stderr
    assert done.stdout.startswith("test-boot: left out: a boot needs ")
    assert done.stdout.count("\n") == 1
    assert not list(tmp_path.iterdir()), "nothing is made before it is known what there is"


def test_the_boot_test_refuses_to_prepare_a_boot_in_an_existing_folder(tmp_path):
    done = run(sys.executable, DEPLOY / "test-boot", "--prepare", tmp_path)
    assert done.returncode == 2
    assert "--prepare makes a new folder" in done.stderr
