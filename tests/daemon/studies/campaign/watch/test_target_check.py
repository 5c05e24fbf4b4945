"""Whether the watch sees a target that nobody asks for any more, and a wish to stow that is ignored."""

from types import SimpleNamespace

import pytest

from daemon.base.records import Mode, MoveOutcome
from daemon.tracker.wishes import Wish, Wishes
from tests.daemon.studies.campaign.watch.scripted import promises


@pytest.mark.parametrize(("mode", "goto_deg", "target", "broken"), [
    (Mode.STOW, None, (0.0, 90.0), []),
    (Mode.STOW, None, (10.0, 60.0), ["superseded"]),
    (Mode.STOW, (10.0, 60.0), (10.0, 60.0), ["superseded"]),
    (Mode.NIGHT, None, (10.0, 60.0), ["superseded"]),
    (Mode.SNOW, None, (10.0, 60.0), ["superseded"]),
    (Mode.HOLD, (10.0, 60.0), (10.0, 60.0), []),
    (Mode.HOLD, (10.0, 61.0), (10.0, 60.0), ["superseded"]),
    (Mode.HOLD, None, (10.0, 60.0), ["superseded"]),
    (Mode.TRACKING, None, (10.0, 60.0), []),
])  # fmt: skip
def test_the_watch_notices_a_target_that_a_parking_mode_does_not_ask_for(plant, mode, goto_deg, target, broken):
    plant.control.mode = mode
    plant.control.wishes = Wishes(hold=Wish(why="a look", goto_deg=goto_deg))
    plant.order(*target)
    assert promises(plant) == broken


def in_a_storm(plant):
    plant.control.mode, plant.wind_m_s = Mode.STOW, 25.0
    return plant


def test_the_watch_notices_a_stow_delayed_without_reason_after_two_decisions(plant):
    in_a_storm(plant).wait(11)
    assert promises(plant) == []
    plant.wait(3)
    assert promises(plant) == ["stow"]


@pytest.mark.parametrize("why", ["it is under way", "it has failed", "it stands there", "another fault is on"])
def test_the_watch_accepts_a_stow_that_is_done_under_way_failed_or_prevented_by_another_fault(plant, why):
    if why == "it is under way":
        plant.motion.target = (0.0, 90.0)
    elif why == "it has failed":
        plant.motion.last_move = SimpleNamespace(outcome=MoveOutcome.STALLED)
    elif why == "it stands there":
        plant.at = {"a": 0.5, "b": 89.5}
    else:
        plant.watch.active_faults = 2
    in_a_storm(plant).wait(100)
    assert promises(plant) == []


def test_the_watch_gives_a_stow_its_time_again_after_it_was_under_way_or_a_person_intervened(plant):
    plant.motion.last_move = SimpleNamespace(outcome=MoveOutcome.INTERRUPTED)
    in_a_storm(plant).wait(10)
    plant.motion.target = (0.0, 90.0)
    plant.wait(5)
    plant.motion.target = None
    plant.wait(11)
    plant.watch.note_disturbance()
    plant.wait(11)
    assert promises(plant) == []
    plant.wait(3)
    assert promises(plant) == ["stow"]
