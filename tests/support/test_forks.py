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
def test_a_copy_answers_as_a_process_from_nothing_does(words, tmp_path):
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


def test_a_copy_is_ended_by_signals_and_waited_for(tmp_path):
    with (tmp_path / "said").open("wb") as said:
        running = forks.start(["run"], said, said)
    with pytest.raises(subprocess.TimeoutExpired):
        running.wait(0.1)
    running.kill()
    assert running.wait(PATIENCE_S) == -signal.SIGKILL


def test_what_is_read_at_the_start_of_an_interpreter_is_read_by_one(tmp_path):
    (tmp_path / "sitecustomize.py").write_text("print('begun')")
    with (tmp_path / "said").open("wb") as said:
        begun = forks.start(["--version"], said, env=os.environ | {"PYTHONPATH": str(tmp_path)})
    assert begun.wait(PATIENCE_S) == 0
    assert (tmp_path / "said").read_text().startswith("begun\n")


def parent(pid):
    return int(Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[1])


def test_another_process_of_tests_has_copies_of_the_same_one_which_end_with_it(tmp_path):
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
