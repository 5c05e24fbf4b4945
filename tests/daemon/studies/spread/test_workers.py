"""Tasks in this process and in several: the same results, whichever process dies."""

import os
import signal
import subprocess
import sys
import textwrap
import time
from pathlib import Path

import pytest

from daemon.base.errors import ExitCode, InterruptedEarlyError, UserError
from daemon.base.process import signals_as_ctrl_c
from daemon.studies.spread.errors import WorkersError
from daemon.studies.spread.workers import THIS_PROCESS, Workers, gather, run_tasks
from tests.system.processes import wait_until


def square(number):
    return number * number


def square_or_die_once(task):
    number, died = task
    if number == 2 and not died.exists():
        died.touch()
        os.kill(os.getpid(), signal.SIGKILL)
    return number * number


def die(_task):
    os.kill(os.getpid(), signal.SIGKILL)


def refuse(number):
    raise WorkersError(f"not {number}")


def refuse_two(number):
    if number == 2:
        raise UserError(f"not {number}")
    return number


def interrupt(number):
    if number == 2:
        raise KeyboardInterrupt
    return number


def sleep_unless_interrupted(folder):
    (folder / "sleeps").touch()
    try:
        time.sleep(600)
    except KeyboardInterrupt:
        (folder / "interrupted").touch()


def sleep_or_wait_for_who_sleeps(task):
    folder, sleeps = task
    if sleeps:
        sleep_unless_interrupted(folder)
    wait_until((folder / "sleeps").exists, "a worker that sleeps")


def test_each_result_comes_with_the_place_of_its_task_in_whichever_order_they_end():
    numbers = list(range(20))
    for workers in (THIS_PROCESS, Workers(3)):
        assert dict(run_tasks(square, numbers, workers)) == {place: place**2 for place in numbers}
        assert gather(square, numbers, workers, lambda _share: None) == ([number**2 for number in numbers], None)


def test_no_result_is_lost_when_a_worker_is_killed(tmp_path):
    died = tmp_path / "died"
    tasks = [(number, died) for number in range(6)]
    assert gather(square_or_die_once, tasks, Workers(2), lambda _share: None) == ([0, 1, 4, 9, 16, 25], None)
    assert died.exists()


def test_a_task_that_kills_every_worker_that_takes_it_ends_the_study_with_one_sentence():
    with pytest.raises(WorkersError, match=r"every worker that took task 1 of 1 has died: look whether") as raised:
        gather(die, [1], Workers(2), lambda _share: None)
    assert raised.value.exit_code is ExitCode.UNREACHABLE


def test_an_error_that_a_task_raises_in_a_worker_is_raised_in_this_process():
    with pytest.raises(WorkersError, match="not 7"):
        gather(refuse, [7, 7], Workers(2), lambda _share: None)


def test_a_task_that_fails_leaves_the_results_that_were_done_before_it():
    results, ended = gather(refuse_two, [0, 1, 2, 3], THIS_PROCESS, lambda _share: None)
    assert (results, str(ended)) == ([0, 1], "not 2")


def test_ctrl_c_keeps_the_results_that_are_done_and_reports_the_interruption():
    results, ended = gather(interrupt, [0, 1, 2, 3], THIS_PROCESS, lambda _share: None)
    assert results == [0, 1]
    assert isinstance(ended, InterruptedEarlyError)
    with pytest.raises(KeyboardInterrupt):
        gather(interrupt, [2], THIS_PROCESS, lambda _share: None)


@pytest.mark.skipif(sys.platform == "win32", reason="no such signals")
@pytest.mark.parametrize("number", ["SIGTERM", "SIGHUP"])
def test_sigterm_and_sighup_keep_the_results_that_are_done_and_end_the_workers_in_mid_task(tmp_path, number):
    tasks = [(tmp_path, False), (tmp_path, True)]
    with signals_as_ctrl_c():
        results, ended = gather(
            sleep_or_wait_for_who_sleeps,
            tasks,
            Workers(2),
            lambda _share: signal.raise_signal(getattr(signal, number)),
        )
    assert results == [None]
    assert isinstance(ended, InterruptedEarlyError)
    assert [path.name for path in tmp_path.iterdir()] == ["sleeps"]


@pytest.mark.system
@pytest.mark.skipif(sys.platform != "linux", reason="looks at /proc")
def test_no_worker_outlives_the_process_that_began_it(tmp_path):
    program = """
        import os, sys, time
        from daemon.studies.spread.workers import Workers, run_tasks

        def say_and_sleep(folder):
            open(f"{folder}/{os.getpid()}", "w").close()
            time.sleep(600)

        list(run_tasks(say_and_sleep, sys.argv[1:] * 2, Workers(2)))
    """
    with subprocess.Popen([sys.executable, "-c", textwrap.dedent(program), tmp_path]) as process:
        wait_until(lambda: len(list(tmp_path.iterdir())) == 2, "two workers")
        process.kill()
    wait_until(lambda: not any(Path("/proc", path.name).exists() for path in tmp_path.iterdir()), "their end")
