"""When a notice is held back."""

from datetime import time

import pytest

from daemon.notify.backlog import QuietHours


@pytest.mark.parametrize(
    ("begin", "end", "quiet", "loud"),
    [
        ("22:00", "06:30", ["22:00", "00:00", "06:29"], ["06:30", "21:59"]),
        ("12:00", "13:00", ["12:00"], ["11:59", "13:00"]),
        (None, None, [], ["00:00"]),
    ],
)
def test_quiet_hours_may_go_over_midnight(begin, end, quiet, loud):
    hours = QuietHours(begin, end)
    assert all(hours.holds(time.fromisoformat(at)) for at in quiet)
    assert not any(hours.holds(time.fromisoformat(at)) for at in loud)
