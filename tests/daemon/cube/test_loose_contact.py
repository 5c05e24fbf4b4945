"""A face with a loose contact in measured weather: the sound ones beside it are believed."""

from datetime import UTC, datetime

import pytest

from daemon.base.alarms.alarms import Alarms
from daemon.config.settings import Settings
from daemon.cube.face_watch import FaceWatch
from tests.measurements.face_weeks import LYNGBY, Week
from tests.support.watched_day import Hand

ZENITH = 3
DAWN = datetime(2016, 6, 9, 4, 45, tzinfo=UTC).timestamp()


@pytest.fixture(scope="module")
def week(measured):
    return Week(measured / "dtu_lyngby_2016", 6, 8, 60.0, 12.0)


@pytest.mark.parametrize("late_min", range(5))
def test_jumps_of_the_zenith_face_accuse_no_other_whenever_the_faces_are_compared(week, late_min):
    clock, doubted = Hand(DAWN), set()
    site = Settings().site.model_copy(update=LYNGBY._asdict())
    watch = FaceWatch(site, Settings().cube, clock, Alarms(clock, lambda _record: None))
    faces = week.spoilt("loose", ZENITH)
    for utc_s, row in zip(week.utc_s.tolist(), faces.tolist(), strict=True):
        if DAWN + 60.0 * late_min <= utc_s < DAWN + 9000.0:
            clock.utc_s = utc_s
            watch.note(row, [value / 10.0 for value in row])
            doubted |= {face for face in range(4) if watch.implausible(face)}
    assert doubted == {ZENITH}
