"""Whether a clock that was just set wrong is held against a move, and one that was not is left alone."""

from daemon.base.records import Mode
from tests.daemon.studies.campaign.watch.scripted import promises


def test_a_move_by_a_clock_that_was_just_set_wrong_is_seen(plant):
    plant.clock.step_s = 43200.0
    plant.watch.steps.note(43200.0, plant.now_s)
    plant.wait(60)
    plant.control.mode = Mode.NIGHT
    plant.order(1, 60)
    assert promises(plant) == ["clock"]
    plant.watch.violations.clear()
    plant.wait(60)
    plant.sun_deg = -5.0
    plant.order(0, 60)
    assert promises(plant) == [], "it is night in truth"


def test_a_clock_that_is_set_to_the_wrong_time_it_shows_already_is_no_news(plant):
    plant.clock.step_s = 40.0
    plant.watch.steps.note(40.0, plant.now_s)
    plant.wait(800)
    plant.watch.steps.note(40.0, plant.now_s)
    plant.wait(200)
    plant.control.mode = Mode.FALLBACK
    plant.order(1, 60)
    assert promises(plant) == []
    plant.watch.steps.note(0.0, plant.now_s)
    plant.watch.steps.note(40.0, plant.now_s)
    plant.wait(60)
    plant.order(2, 60)
    assert promises(plant) == ["clock"]
