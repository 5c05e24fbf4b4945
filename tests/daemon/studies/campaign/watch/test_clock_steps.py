"""Whether the watch faults a move that follows a clock that was set wrong, and no other move."""

import pytest

from daemon.base.records import Mode
from tests.daemon.studies.campaign.watch.scripted import promises


@pytest.mark.parametrize("later_s", [60, 3000])
def test_the_watch_notices_a_move_by_a_clock_that_was_set_wrong_however_late(plant, later_s):
    plant.clock.step_s = 43200.0
    plant.watch.decision_check.steps.note(43200.0, plant.now_s)
    plant.wait(later_s)
    plant.control.mode = Mode.NIGHT
    plant.order(0, 90)
    assert promises(plant) == ["clock"]
    plant.watch.violations.clear()
    plant.wait(60)
    plant.sun_deg = -5.0
    plant.order(0, 90)
    assert promises(plant) == [], "it is night in truth"


def test_the_watch_accepts_a_night_by_the_clock_of_the_start_after_another_step_of_the_clock(plant):
    plant.service.sun_elevation_deg = lambda utc_s: -20.0 if utc_s < plant.now_s - 40_000.0 else 30.0
    plant.clock.step_s = -43200.0
    plant.watch.decision_check.steps.note(-43200.0, plant.now_s)
    plant.watch.note_service_start()
    plant.wait(60)
    plant.control.mode, plant.clock.step_s = Mode.NIGHT, 43200.0
    plant.clock.utc = lambda: plant.now_s + plant.clock.step_s
    plant.watch.decision_check.steps.note(43200.0, plant.now_s)
    plant.wait(60)
    plant.order(0, 90)
    assert promises(plant) == []


def test_the_watch_does_not_blame_a_service_for_a_clock_that_was_wrong_from_its_start(plant):
    plant.clock.step_s = 40.0
    plant.watch.decision_check.steps.note(40.0, plant.now_s)
    plant.watch.note_service_start()
    plant.wait(200)
    plant.control.mode = Mode.FALLBACK
    for off_s, blamed in ((40.0, False), (7200.0, True), (50.0, False), (0.0, False)):
        plant.clock.step_s = off_s
        plant.watch.decision_check.steps.note(off_s, plant.now_s)
        plant.wait(60)
        plant.order(1 + off_s / 1e4, 60)
        assert promises(plant) == ["clock"] * blamed
        plant.watch.violations.clear()
