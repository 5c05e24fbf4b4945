"""Delays between tries."""

from random import Random

from daemon.base.reconnect import Backoff


def test_delays_grow_to_the_cap_and_start_again_after_success():
    backoff = Backoff(Random(1), first_s=0.5, factor=2.0, cap_s=10.0)
    delays = [backoff.next_s() for _ in range(12)]
    assert 0.4 <= delays[0] <= 0.5
    assert all(8.0 <= delay <= 10.0 for delay in delays[5:])
    backoff.reset()
    assert 0.4 <= backoff.next_s() <= 0.5


def test_two_devices_lost_together_do_not_come_back_in_step():
    first, second = Backoff(Random(1)), Backoff(Random(2))
    assert [first.next_s() for _ in range(5)] != [second.next_s() for _ in range(5)]
