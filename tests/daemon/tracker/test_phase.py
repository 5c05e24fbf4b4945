"""The trackers of a process take turns: none waits for all the others, and each keeps its rhythm."""

import pytest

from daemon.base.records import Decision, Mode
from daemon.tracker.phase import ALONE, Phase

FOUR = [{"name": f"t{number}"} for number in range(4)]


def test_a_single_tracker_counts_its_interval_from_its_last_turn_and_waits_for_no_other():
    assert ALONE.next_s(123.4, 300.0) == 423.4
    assert ALONE.delay_s(60.0) == 0.0


@pytest.mark.parametrize("now_s", [0.0, 7.4, 7.6, 100.0, 102.5, -3.0, 1e6 + 0.3])
def test_the_next_turn_is_at_the_trackers_own_place_and_at_least_half_an_interval_away(now_s):
    for place in range(4):
        turn_s = Phase(place, 4).next_s(now_s, 10.0)
        assert 5.0 <= turn_s - now_s <= 15.0
        assert turn_s % 10.0 == pytest.approx(2.5 * place)


def test_a_tracker_that_is_less_than_half_an_interval_late_keeps_its_turn():
    phase, now_s, turns = Phase(1, 4), 12.5, []
    for late_s in (0.003, 2.0, 0.0, 4.9):
        now_s = phase.next_s(now_s + late_s, 10.0)
        turns.append(now_s)
    assert turns == [22.5, 32.5, 42.5, 52.5]


def test_all_trackers_decide_soon_after_the_first_scan_and_then_one_after_the_other(run_rig):
    async def scenario(rig):
        trackers = rig.service.trackers
        await rig.until(lambda: all(one.control.mode is Mode.TRACKING for one in trackers), 60, "tracking")
        begun = rig.records_of(Decision)
        assert {decision.tracker for decision in begun} == {"t0", "t1", "t2", "t3"}
        assert max(each.time_monotonic_s for each in begun) - min(each.time_monotonic_s for each in begun) <= 3.0
        # The first turn comes after half to one and a half intervals.
        await rig.until(lambda: len(rig.records_of(Decision)) >= 16, 1700, "three decisions more of each")
        for place in range(4):
            own = [each for each in rig.records_of(Decision) if each.tracker == f"t{place}"]
            for decision in own[1:4]:
                assert decision.time_monotonic_s % 300.0 == pytest.approx(75.0 * place, abs=0.1)

        assert all(one.control.preview_decision() is not None for one in trackers)

    run_rig(scenario, tracker=FOUR, law={"driver": "mu-prime"}, rest_look_s=5.0)
