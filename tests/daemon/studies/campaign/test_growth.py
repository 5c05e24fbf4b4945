"""If something grows that must not, the campaign notices."""

from collections import deque

import pytest

from daemon.studies.campaign.draw import draw_schedule
from daemon.studies.campaign.growth import GrowthCheck


@pytest.mark.parametrize(
    ("left", "trackers", "leaks"),
    [
        (lambda: [object() for _ in range(100)], 1, False),
        (lambda: [[] for _ in range(5000)], 1, True),
        (lambda: deque(range(5000)), 1, True),
        (lambda: set(range(5000)), 1, True),
        (lambda: set(range(5000)), 3, False),
    ],
    ids=["little", "objects", "a queue", "a set", "a set of three trackers"],
)
def test_many_objects_or_a_long_queue_or_set_left_in_memory_are_reported_as_a_leak(left, trackers, leaks):
    bounded, failed, schedule = GrowthCheck(lambda: 0.0), [], draw_schedule(1, 2, trackers=trackers)
    bounded.note_memory_baseline([])
    kept = left()
    bounded.check(schedule, [], lambda promise, text: failed.append((promise, text)))
    assert len(kept) >= 100
    assert [promise for promise, _ in failed] == ["leak"] * leaks
