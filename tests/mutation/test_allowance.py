"""Tests of the time that a change is given."""

import os
import signal
import time

from tests.mutation.allowance import ended_within

LIMIT_S = 0.2


def begun(work):
    child = os.fork()
    if child == 0:
        work()
        os._exit(0)
    return child


def test_a_process_that_waits_is_waited_for():
    assert ended_within(begun(lambda: time.sleep(2 * LIMIT_S)), LIMIT_S) == 0


def test_one_that_computes_without_end_is_not():
    def compute():
        while True:
            pass

    child = begun(compute)
    assert ended_within(child, LIMIT_S) is None
    os.kill(child, signal.SIGKILL)
    os.waitpid(child, 0)
