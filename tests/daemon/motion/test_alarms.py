"""When motor currents are wrong."""

import math
from dataclasses import replace

import pytest

from daemon.motion.alarms import Currents
from drivers.interfaces import Telemetry


def look(time_s, a=0.0, b=0.0):
    return Telemetry(time_s, 0.0, 90.0, 50.0, 280.0, 50.0, 280.0, a_motor_current_a=a, b_motor_current_a=b)


@pytest.mark.parametrize(("axis", "name"), [("a", "A"), ("b", "B")])
def test_a_high_motor_current_of_two_seconds_is_reported_until_an_hour_later(axis, name):
    currents = Currents(3.0)
    told = []
    for time_s, current_a in ((0.0, 3.0), (1.0, 3.1), (2.9, 3.1), (3.0, 3.1), (4.0, 0.0), (3603.0, 0.0), (3603.1, 0.0)):
        currents.update(look(time_s, **{axis: current_a}), None)
        told.append(currents.text)
    assert told[:3] == [None] * 3
    assert told[3].startswith(f"axis {name} draws more than 3 A: ")
    assert told[4:] == [told[3], told[3], None]


def test_a_high_motor_current_is_reported_for_each_axis_separately_and_for_its_own_hour():
    currents = Currents(3.0)
    for time_s in (0.0, 2.0):
        currents.update(look(time_s, a=3.1, b=3.1), None)
    assert "axis A draws more than 3 A" in currents.text
    assert "axis B draws more than 3 A" in currents.text
    for time_s in (3000.0, 3002.0):
        currents.update(look(time_s, b=3.1), None)
    currents.update(look(3603.0), None)
    assert currents.text.startswith("axis B draws more than 3 A")


def test_high_currents_that_alternate_between_the_axes_do_not_count_as_lasting():
    currents = Currents(3.0)
    for time_s, a, b in ((0.0, 3.1, 0.0), (1.0, 0.0, 3.1), (2.0, 3.1, 0.0), (3.0, 0.0, 3.1)):
        currents.update(look(time_s, a=a, b=b), None)
    assert currents.text is None


def test_a_high_current_must_last_without_a_break():
    currents = Currents(3.0)
    for time_s, current_a in ((0.0, 3.1), (1.9, 3.1), (2.0, 2.9), (2.1, 3.1), (4.0, 3.1)):
        currents.update(look(time_s, a=current_a), None)
        assert currents.text is None
    currents.update(look(4.2, a=3.1), None)
    assert currents.text
    currents.forget()
    assert currents.text is None
    currents.update(look(5.0, a=3.1), None)
    assert currents.text is None, "it has to last anew"


@pytest.mark.parametrize(("axis", "name"), [("a", "A"), ("b", "B")])
@pytest.mark.parametrize(
    ("current_a", "stood_s", "told"),
    [(0.31, 3.1, True), (0.30, 3.1, False), (0.31, 3.0, False), (math.nan, 9.0, False)],
)
def test_a_current_into_a_standing_axis_is_reported_once_the_motor_has_run_out(axis, name, current_a, stood_s, told):
    currents = Currents(3.0)
    for time_s in (100.0, 102.0):
        currents.update(look(time_s, **{axis: current_a}), time_s - stood_s)
    expected = (
        f"axis {name} draws current although it stands, and is stopped again: it is driven against something, or moves"
        " without being counted; look at it"
    )
    assert currents.text == (expected if told else None)
    assert currents.wants_stop is told
    moving = Currents(3.0)
    for time_s in (100.0, 102.0):
        moving.update(look(time_s, **{axis: current_a}), None)
    assert moving.text is None
    assert not moving.wants_stop


def test_a_motor_that_stays_on_is_stopped_at_once_and_again_after_ever_longer_pauses():
    currents, stops_s = Currents(3.0), []
    for time_s in range(10, 400):
        currents.update(look(float(time_s), b=0.5), 0.0)
        if currents.wants_stop:
            stops_s.append(time_s)
            currents.note_stop(float(time_s))
    assert stops_s == [11, 13, 17, 25, 41, 73, 137, 201, 265, 329, 393]
    currents.update(look(500.0), 0.0)
    for time_s in (501.0, 501.9, 502.0, 503.9, 504.0):
        currents.update(look(time_s, b=0.5), 0.0)
        assert currents.wants_stop is (time_s in (502.0, 504.0)), time_s
        currents.note_stop(time_s)


def test_an_axis_that_a_person_drives_by_the_button_is_not_stopped_for_its_current():
    currents = Currents(3.0)
    for time_s in (10.0, 11.0, 12.0):
        currents.update(replace(look(time_s, a=0.5), button_pressed=True), 0.0)
        assert not currents.wants_stop
    for time_s in (13.0, 14.0):
        currents.update(look(time_s, a=0.5), 0.0)
    assert currents.wants_stop
