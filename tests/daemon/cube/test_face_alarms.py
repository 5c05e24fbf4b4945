"""A face that lies, or is not read, is reported on the tracker's machine, since when, and as long as it lasts."""

import math

import pytest

from daemon.base.alarms.alarms import Alarms
from daemon.base.records import FaceReading, Quality, Scan
from daemon.cube.face_alarms import RemoteFaceAlarm, UnreadFaceAlarm

GOOD = FaceReading(400.0, Quality.OK, 0.0, 0.0)
LIES = GOOD._replace(quality=Quality.IMPLAUSIBLE)
FIRST_UTC_S = 1665569940.0  # 2022-10-12 10:19, a scan before 10:20
LOST = GOOD._replace(irradiance_w_m2=math.nan, quality=Quality.OVER_RANGE)


class Hand:
    """A clock that each scan advances by 6 s."""

    now_s = 0.0

    def monotonic(self):
        return self.now_s

    def utc(self):
        return FIRST_UTC_S + self.now_s


@pytest.fixture
def clock():
    return Hand()


@pytest.fixture
def alarms(clock):
    return Alarms(clock, lambda _event: None)


def listening(alarms, clock, faces):
    """Return a function that hands in scans and returns the texts of the active alarms."""
    number = iter(range(1000))

    def scans(count, **faces_now):
        for _ in range(count):
            readings = {name: faces_now.get(name, GOOD) for name in ("east", "south", "west", "zenith")}
            clock.now_s += 6.0
            faces.note(Scan("cube", "s", next(number), 0.0, 0.0, **readings))
        return [alarm.text for alarm in alarms.active]

    return scans


@pytest.fixture
def told(clock):
    events = []
    alarms = Alarms(clock, events.append)
    scans = listening(alarms, clock, RemoteFaceAlarm(alarms, clock))
    scans.raised = lambda: sum(event.text.startswith("raised ") for event in events)
    return scans


@pytest.fixture
def unread(alarms, clock):
    return listening(alarms, clock, UnreadFaceAlarm(alarms, clock))


def test_an_implausible_face_is_reported_after_a_minute_and_until_it_agrees_again(told):
    assert told(9, south=LIES) == []
    assert told(1, south=LIES) == [
        "the south face reads what cannot be true; not used since 2022-10-12 10:20 UTC; the cube's own alarms say why"
    ]
    assert told.raised() == 1
    (both,) = told(10, south=LIES, zenith=LIES)
    assert told.raised() == 2, "a second face is news"
    assert both == (
        "the south and zenith faces read what cannot be true; not used since 2022-10-12 10:20 UTC (south) and"
        " 2022-10-12 10:21 UTC (zenith); the cube's own alarms say why"
    )
    assert len(told(9)) == 1
    assert told(1) == []
    assert told.raised() == 2


def test_an_implausible_reading_now_and_then_raises_no_alarm(told):
    for _ in range(30):
        assert told(1, west=LIES) == []
        assert told(1) == []
        assert told(1, west=GOOD._replace(quality=Quality.STALE)) == []


def test_a_face_that_is_not_read_is_reported_with_the_reason_until_it_is_read_again(unread):
    assert unread(9, west=LOST) == []
    assert unread(1, west=LOST) == [
        "no reading of west (over-range since 2022-10-12 10:20 UTC) while other faces are read"
    ]
    gone = LOST._replace(quality=Quality.MISSING)
    (both,) = unread(10, west=LOST, zenith=gone)
    assert both == (
        "no reading of west (over-range since 2022-10-12 10:20 UTC) and zenith (missing since 2022-10-12 10:21 UTC)"
        " while other faces are read"
    )
    assert len(unread(9)) == 1
    assert unread(1) == []


def test_a_silent_digital_sensor_on_another_machine_is_reported(unread):
    silent = LOST._replace(quality=Quality.LATE)
    (told,) = unread(10, west=silent)
    assert told == "no reading of west (late since 2022-10-12 10:20 UTC) while other faces are read"
    assert unread(10) == []


def test_no_face_is_reported_as_unread_when_no_face_at_all_is_read(unread):
    assert unread(30, east=LOST, south=LOST, west=LOST, zenith=LOST) == []


def test_an_unread_face_is_not_reported_again_while_the_alarm_of_its_own_sensor_is_active(alarms, unread):
    alarms.set("cube-sensor", "the west sensor is silent")
    assert unread(30, west=LOST) == ["the west sensor is silent"]
    assert unread(10, west=LOST, zenith=LOST)[1].startswith("no reading of zenith (over-range since ")
    assert len(unread(10, west=LOST)) == 1
    alarms.set("cube-sensor", None)
    assert unread(1, west=LOST)[0].startswith("no reading of west (over-range since ")
