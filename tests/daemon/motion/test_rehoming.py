"""Automatic reference runs are few, whatever the unit does."""

from daemon.motion.rehoming import Rehoming

DOUBT = "the positioner has restarted"
GOOD = [(0.0, DOUBT), (70.0, DOUBT)]
"""The runs that end their doubt, in the tests where a doubt ends."""


def runs(rehoming, doubts):
    """Return the times at which a run is due, of (time, doubt) pairs."""
    found = []
    for now_s, doubt in doubts:
        if rehoming.due(doubt, now_s):
            rehoming.began(now_s)
            found.append(now_s)
            rehoming.ended(good=(now_s, doubt) in GOOD)
    return found


def test_reference_runs_that_do_not_end_the_doubt_are_repeated_after_ever_longer_pauses():
    day = [(float(now_s), DOUBT) for now_s in range(0, 86400, 10)]
    day[0] = (1.0, DOUBT)
    assert runs(Rehoming(enabled=True), day) == [1, 610, 4210, 25810, 47410, 69010]


def test_a_second_restart_soon_after_a_good_run_is_homed_at_once_and_the_third_waits():
    restarts = [
        (0.0, DOUBT),
        (60.0, None),
        (70.0, DOUBT),
        (130.0, None),
        (140.0, DOUBT),
        (3669.0, DOUBT),
        (3670.0, DOUBT),
    ]
    assert runs(Rehoming(enabled=True), restarts) == [0, 70, 3670]


def test_after_a_quiet_time_as_long_as_the_pause_a_new_doubt_is_homed_at_once():
    assert runs(
        Rehoming(enabled=True), [(0.0, DOUBT), (60.0, None), (601.0, None), (700.0, DOUBT), (1299.0, DOUBT)]
    ) == [0, 700]


def test_no_automatic_reference_run_is_due_where_a_person_is_to_decide():
    assert runs(Rehoming(enabled=False), [(0.0, DOUBT), (86400.0, DOUBT)]) == []
