"""A face that lies, or is not read, is said on the tracker's machine, since when, and as long as it is so."""

import math

import pytest

from daemon.base.alarms.alarms import Alarms
from daemon.base.clock import SystemClock
from daemon.base.records import FaceReading, Quality, Scan
from daemon.cube.told_faces import ToldFaces, UnreadFaces

GOOD = FaceReading(400.0, Quality.OK, 0.0, 0.0)
LIES = GOOD._replace(quality=Quality.IMPLAUSIBLE)
LOST = GOOD._replace(irradiance_w_m2=math.nan, quality=Quality.OVER_RANGE)


@pytest.fixture
def alarms():
    return Alarms(SystemClock(), lambda _event: None)


def listening(alarms, faces):
    """Return what hands in scans and returns the texts that are on then."""
    number = iter(range(1000))

    def scans(count, **faces_now):
        for _ in range(count):
            readings = {name: faces_now.get(name, GOOD) for name in ("east", "south", "west", "zenith")}
            faces.note(Scan("cube", "s", next(number), 0.0, 0.0, **readings))
        return [alarm.text for alarm in alarms.active]

    return scans


@pytest.fixture
def told():
    events = []
    alarms = Alarms(SystemClock(), events.append)
    scans = listening(alarms, ToldFaces(alarms))
    scans.raised = lambda: sum(event.text.startswith("raised ") for event in events)
    return scans


@pytest.fixture
def unread(alarms):
    return listening(alarms, UnreadFaces(alarms))


def test_it_is_named_after_a_minute_and_until_it_agrees_again(told):
    assert told(9, south=LIES) == []
    assert told(1, south=LIES) == [
        "the south face reads what cannot be true and is not used; the cube's own alarms say why"
    ]
    assert told.raised() == 1
    (both,) = told(10, south=LIES, zenith=LIES)
    assert told.raised() == 2, "a second face is news"
    assert both.startswith("the south, zenith faces read")
    assert len(told(9)) == 1
    assert told(1) == []
    assert told.raised() == 2


def test_a_reading_now_and_then_is_no_lie(told):
    for _ in range(30):
        assert told(1, west=LIES) == []
        assert told(1) == []
        assert told(1, west=GOOD._replace(quality=Quality.STALE)) == []


def test_a_face_without_a_reading_is_named_with_what_is_wrong_until_it_has_one(unread):
    assert unread(9, west=LOST) == []
    assert unread(1, west=LOST) == ["no reading of west (over-range) while other faces are read"]
    gone = LOST._replace(quality=Quality.MISSING)
    assert unread(10, west=LOST, zenith=gone) == [
        "no reading of west (over-range), zenith (missing) while other faces are read"
    ]
    assert len(unread(9)) == 1
    assert unread(1) == []


def test_no_face_is_named_where_none_is_read(unread):
    assert unread(30, east=LOST, south=LOST, west=LOST, zenith=LOST) == []


def test_a_face_whose_sensor_has_said_so_itself_is_not_named_again(alarms, unread):
    alarms.set("cube-sensor", "the west sensor is silent")
    assert unread(30, west=LOST) == ["the west sensor is silent"]
    assert unread(10, west=LOST, zenith=LOST)[1:] == ["no reading of zenith (over-range) while other faces are read"]
    assert len(unread(10, west=LOST)) == 1
    alarms.set("cube-sensor", None)
    assert unread(1, west=LOST) == ["no reading of west (over-range) while other faces are read"]
