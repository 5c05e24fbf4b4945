"""A face with a loose contact in measured weather: the sound faces beside it are believed."""

from datetime import UTC, datetime

import pytest

from daemon.base.alarms.alarms import Alarms
from daemon.config.settings import Settings
from daemon.cube.face_watch import FaceWatch
from tests.measurements import face_weeks
from tests.measurements.face_weeks import LYNGBY, Week
from tests.support.watched_day import SettableClock

WEST, ZENITH = 2, 3
DAWN = datetime(2016, 6, 9, 4, 45, tzinfo=UTC).timestamp()
NOON = datetime(2016, 11, 17, 11, 15, tzinfo=UTC).timestamp()


@pytest.fixture(scope="module")
def week(measured):
    return Week(measured / "dtu_lyngby_2016", 6, 8, 60.0, 12.0)


def doubted(week, faces, from_utc_s, until_utc_s):
    """Return the faces that a watch doubts at any time."""
    clock, found = SettableClock(from_utc_s), set()
    site = Settings().site.model_copy(update=LYNGBY._asdict())
    watch = FaceWatch(site, Settings().cube, clock, Alarms(clock, lambda _record: None))
    for utc_s, row in zip(week.utc_s.tolist(), faces.tolist(), strict=True):
        if from_utc_s <= utc_s < until_utc_s:
            clock.utc_s = utc_s
            watch.note(row, [value / 10.0 for value in row])
            found |= {face for face in range(4) if watch.implausible(face)}
    return found


@pytest.mark.parametrize("late_min", range(5))
def test_only_a_zenith_face_that_jumps_is_doubted_whenever_the_faces_are_compared(week, late_min):
    faces = week.spoilt("loose", ZENITH)
    assert doubted(week, faces, DAWN + 60.0 * late_min, DAWN + 9000.0) == {ZENITH}


def test_a_dead_west_face_that_shows_no_cloud_is_the_only_face_doubted(measured, monkeypatch):
    monkeypatch.setattr(face_weeks, "DAYS", 1)
    week = Week(measured / "dtu_lyngby_2016", 11, 17, 60.0, 12.0, sky="haydavies")
    assert doubted(week, week.spoilt("dead", WEST), NOON, NOON + 5400.0) == {WEST}
