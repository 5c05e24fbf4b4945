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


def test_ended_within_waits_for_a_sleeping_process_beyond_the_limit():
    assert ended_within(begun(lambda: time.sleep(2 * LIMIT_S)), LIMIT_S) == 0


def test_ended_within_gives_up_on_a_process_that_computes_without_end():
    def compute():
        while True:
            pass

    child = begun(compute)
    assert ended_within(child, LIMIT_S) is None
    os.kill(child, signal.SIGKILL)
    os.waitpid(child, 0)
