"""Delays between tries."""

from random import Random

import pytest

from daemon.base.reconnect import Backoff


def test_delays_grow_to_the_cap_and_start_again_after_success():
    backoff = Backoff(Random(1), first_s=0.5, factor=2.0, cap_s=10.0)
    delays = [backoff.next_s() for _ in range(12)]
    assert 0.4 <= delays[0] <= 0.5
    assert all(8.0 <= delay <= 10.0 for delay in delays[5:])
    backoff.reset()
    assert 0.4 <= backoff.next_s() <= 0.5


@pytest.mark.parametrize(("drawn", "share"), [(0.0, 1.0), (0.5, 0.9), (1.0, 0.8)])
def test_pauses_grow_by_four_fifths_from_half_a_second_to_eight_and_are_shortened_by_a_fifth_at_most(drawn, share):
    class Drawn(Random):
        def random(self):
            return drawn

    backoff = Backoff(Drawn())
    # 0.5 s x 1.8^n, until that is more than 8 s.
    longest = [0.5, 0.9, 1.62, 2.916, 5.2488, 8.0, 8.0]
    assert [backoff.next_s() for _ in longest] == pytest.approx([share * delay_s for delay_s in longest])


def test_two_devices_lost_together_do_not_retry_in_step():
    first, second = Backoff(Random(1)), Backoff(Random(2))
    assert [first.next_s() for _ in range(5)] != [second.next_s() for _ in range(5)]
