"""A copy is like a process started from nothing: arguments, environment, streams, signals and exit code."""

import os
import select
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from tests.support import PATIENCE_S, forks

pytestmark = pytest.mark.live
WORDS = (["--version"], ["config", "check", "nowhere.toml"], ["config", "--help"])


@pytest.mark.parametrize("words", WORDS, ids=" ".join)
def test_a_forked_copy_gives_the_output_and_exit_code_of_a_fresh_process(words, tmp_path):
    surroundings = os.environ | {"COLUMNS": "70"}
    copied = forks.run(*words, env=surroundings, cwd=tmp_path)
    fresh = subprocess.run(
        [Path(sys.executable).with_name("heliocube"), *words],
        capture_output=True,
        text=True,
        env=surroundings,
        cwd=tmp_path,
        check=False,
    )
    assert (copied.returncode, copied.stdout, copied.stderr) == (fresh.returncode, fresh.stdout, fresh.stderr)


def test_a_forked_copy_can_be_waited_for_and_killed_by_a_signal(tmp_path):
    with (tmp_path / "said").open("wb") as said:
        running = forks.start(["run"], said, said)
    with pytest.raises(subprocess.TimeoutExpired):
        running.wait(0.1)
    running.kill()
    assert running.wait(PATIENCE_S) == -signal.SIGKILL


def test_with_a_pythonpath_of_its_own_a_fresh_interpreter_is_started_that_reads_sitecustomize(tmp_path):
    (tmp_path / "sitecustomize.py").write_text("print('begun')")
    with (tmp_path / "said").open("wb") as said:
        begun = forks.start(["--version"], said, env=os.environ | {"PYTHONPATH": str(tmp_path)})
    assert begun.wait(PATIENCE_S) == 0
    assert (tmp_path / "said").read_text().startswith("begun\n")


def parent(pid):
    return int(Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[1])


def test_copies_for_two_test_processes_have_one_parent_and_end_with_their_own_test_process(tmp_path):
    with (tmp_path / "said").open("wb") as said:
        own = forks.start(["run"], said, said)
        other = forks._Origin(forks.begin().told())
        its = other.start(["run"], dict(os.environ), str(tmp_path), [said.fileno()] * 3)
        assert parent(its) == parent(own.pid)
        assert (list(forks.running()), list(other.running())) == ([own.pid], [its])
        # It disconnects without having read of an end.
        other.start(["--version"], dict(os.environ), str(tmp_path), [said.fileno()] * 3)
    assert select.select([other], [], [], PATIENCE_S)[0]
    watched = os.pidfd_open(its)
    other.close()
    ended, _, _ = select.select([watched], [], [], PATIENCE_S)
    os.close(watched)
    assert ended
    assert own.poll() is None
    own.kill()
    assert own.wait(PATIENCE_S) == -signal.SIGKILL
