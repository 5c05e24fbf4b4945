"""When motor currents are wrong."""

import math

import pytest

from daemon.motion.alarms import Currents
from drivers.interfaces import Telemetry


def look(time_s, a=0.0, b=0.0):
    return Telemetry(time_s, 0.0, 90.0, 50.0, 280.0, 50.0, 280.0, a_motor_current_a=a, b_motor_current_a=b)


@pytest.mark.parametrize(("axis", "name"), [("a", "A"), ("b", "B")])
def test_a_high_current_that_lasts_two_seconds_is_told_and_ends_an_hour_later(axis, name):
    currents = Currents(3.0)
    told = []
    for time_s, current_a in ((0.0, 3.0), (1.0, 3.1), (2.9, 3.1), (3.0, 3.1), (4.0, 0.0), (3603.0, 0.0), (3603.1, 0.0)):
        currents.update(look(time_s, **{axis: current_a}), None)
        told.append(currents.text)
    assert told[:3] == [None] * 3
    assert told[3].startswith(f"axis {name} draws more than 3 A: ")
    assert told[4:] == [told[3], told[3], None]


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
def test_a_current_into_a_standing_axis_is_told_once_the_motor_has_run_out(axis, name, current_a, stood_s, told):
    currents = Currents(3.0)
    for time_s in (100.0, 102.0):
        currents.update(look(time_s, **{axis: current_a}), time_s - stood_s)
    expected = f"axis {name} draws current although it stands: it is driven against something; look at it"
    assert currents.text == (expected if told else None)
    moving = Currents(3.0)
    for time_s in (100.0, 102.0):
        moving.update(look(time_s, **{axis: current_a}), None)
    assert moving.text is None
