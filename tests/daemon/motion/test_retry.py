"""When a failed move is tried again."""

import math

from daemon.base.alarms.alarms import Alarms
from daemon.base.clock import SystemClock
from daemon.motion.retry import Retries


def retries():
    alarms = Alarms(SystemClock(), lambda _record: None)
    return Retries(30.0, alarms), alarms


def test_the_pauses_after_failed_moves_grow_and_those_of_a_stow_only_up_to_ten_minutes():
    ours, _ = retries()
    assert ours.due_s(stow=True) == ours.due_s(stow=False) == -math.inf
    pauses = []
    for _ in range(7):
        ours.note_failure(1000.0, "stalled", stow=True)
        pauses.append(ours.due_s(stow=True) - 1000.0)
    assert pauses == [60.0, 120.0, 300.0, 600.0, 600.0, 600.0, 600.0]
    assert ours.due_s(stow=False) == -math.inf, "a stow that failed keeps no other move"
    pauses = []
    for _ in range(7):
        ours.note_failure(2000.0, "stalled", stow=False)
        pauses.append(ours.due_s(stow=False) - 2000.0)
    assert pauses == [30.0, 60.0, 120.0, 240.0, 480.0, 480.0, 480.0]
    assert ours.due_s(stow=True) == 1600.0


def test_the_1st_2nd_4th_8th_and_16th_failure_of_moves_in_a_row_is_worth_a_warning():
    ours, _ = retries()
    told = [ours.note_failure(float(count), "stalled", stow=count % 2 == 0) for count in range(1, 18)]
    assert [count for count, is_told in enumerate(told, 1) if is_told] == [1, 2, 4, 8, 16]


def test_a_failed_move_is_an_alarm_until_it_is_forgotten():
    ours, alarms = retries()
    ours.note_failure(1.0, "no movement for 7 s", stow=True)
    assert ours.text == "no movement for 7 s"
    again = "failed and waits to be tried again"
    assert alarms.active[0].text == f"the stow {again}: no movement for 7 s"
    ours.note_failure(2.0, "refused", stow=False)
    assert alarms.active[0].text == f"a move {again}: refused"
    ours.forget()
    assert ours.text is None
    assert not alarms.active
    assert ours.due_s(stow=True) == ours.due_s(stow=False) == -math.inf
    assert ours.note_failure(5.0, "again", stow=False)
    assert ours.due_s(stow=False) == 35.0


def test_the_third_move_in_a_row_that_loses_the_link_is_an_alarm_and_the_next_has_no_pause():
    ours, alarms = retries()
    for stow in (False, True):
        ours.note_link_loss("link lost", stow=stow)
    assert (ours.text, alarms.active) == (None, ())
    ours.note_link_loss("link lost", stow=True)
    assert alarms.active[0].text == "the stow failed and waits to be tried again: link lost"
    ours.note_link_loss("link lost", stow=False)
    assert alarms.active[0].text == "a move failed and waits to be tried again: link lost"
    assert ours.due_s(stow=True) == ours.due_s(stow=False) == -math.inf
    ours.forget()
    ours.note_link_loss("link lost", stow=False)
    assert not alarms.active
