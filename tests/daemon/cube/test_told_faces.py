"""A face that lies is said on the tracker's machine too, since when, and as long as it lies."""

import pytest

from daemon.base.alarms.alarms import Alarms
from daemon.base.clock import SystemClock
from daemon.base.records import FaceReading, Quality, Scan
from daemon.cube.told_faces import ToldFaces

GOOD = FaceReading(400.0, Quality.OK, 0.0, 0.0)
LIES = GOOD._replace(quality=Quality.IMPLAUSIBLE)


@pytest.fixture
def told():
    events = []
    alarms = Alarms(SystemClock(), events.append)
    faces, number = ToldFaces(alarms), iter(range(1000))

    def scans(count, **faces_now):
        for _ in range(count):
            readings = {name: faces_now.get(name, GOOD) for name in ("east", "south", "west", "zenith")}
            faces.note(Scan("cube", "s", next(number), 0.0, 0.0, **readings))
        return [alarm.text for alarm in alarms.active]

    scans.raised = lambda: sum(event.text.startswith("raised ") for event in events)
    return scans


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
