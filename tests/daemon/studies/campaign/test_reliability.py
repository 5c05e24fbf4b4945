"""The page of faults: measured cells are compared with declared ones, and nothing is left out in silence."""

import math
from dataclasses import replace

import pytest

from daemon.base.errors import UserError
from daemon.base.records import Mode
from daemon.rigs.campaign.faults import FAULTS
from daemon.studies.campaign.declared import REASONS_WITHOUT_DRILL, declared_drills, faults_without_drill
from daemon.studies.campaign.drills import WorstSeen
from daemon.studies.campaign.many import run_all
from daemon.studies.campaign.matrix import CELLS, COMPONENTS, FAULT_KINDS, cell, chosen_faults
from daemon.studies.campaign.pairs import Pair, declared_pairs, measure_pairs
from daemon.studies.campaign.reliability import exceeded_bounds, page
from daemon.studies.spread.workers import THIS_PROCESS
from tests.support import ROOT

MEASURED = {6: (3, 5), 9: (5, 8)}
UNPLUGGED = next(drill for drill in declared_drills() if drill.fault == "unplug_positioner")


def test_every_fault_has_a_declared_row_or_a_reason_for_having_none():
    assert faults_without_drill() == set(REASONS_WITHOUT_DRILL)


def test_every_cell_of_the_fault_matrix_has_known_faults_or_is_refused_with_a_sentence():
    for component in COMPONENTS:
        for kind in FAULT_KINDS:
            found = cell(component, kind)
            if isinstance(found, str):
                assert len(found) > 10
                with pytest.raises(UserError, match="cannot be simulated"):
                    chosen_faults([f"{component}:{kind}"])
            else:
                assert set(found) <= set(FAULTS)
                assert chosen_faults([f"{component}:{kind}"]) == found
    assert {name for names in CELLS.values() for name in names} >= set(FAULTS) - {
        "button", "button_in", "buttons_both", "switch_fails"
    }  # fmt: skip


def test_an_unknown_fault_name_is_refused():
    with pytest.raises(UserError, match="there is no thunder"):
        chosen_faults(["thunder"])


def test_a_drill_of_an_unplugged_positioner_measures_times_within_the_declared_bounds():
    schedules = list(UNPLUGGED.schedules())[:1]
    outcomes = run_all(schedules, THIS_PROCESS, lambda _: None)
    measured = UNPLUGGED.measure(schedules, outcomes)
    assert list(exceeded_bounds(UNPLUGGED, measured)) == []
    assert 0 < measured.reached_s < 1
    assert 0 < measured.recovery_s < 15
    assert replace(UNPLUGGED, mode=(Mode.SNOW,)).measure(schedules, outcomes).reached_s == math.inf


def test_each_bound_or_promise_that_a_drill_does_not_keep_is_reported():
    assert [*exceeded_bounds(UNPLUGGED, WorstSeen(0.5, 5.0, (), 3))] == []
    assert [*exceeded_bounds(UNPLUGGED, WorstSeen(math.inf, math.nan, ("limits",), 3))] == [
        "unplug_positioner at rest: fault after inf s, 1 s are declared",
        "unplug_positioner at rest: back after nan s, 15 s are declared",
        "unplug_positioner at rest: breaks limits",
    ]


def test_docs_reliability_md_has_the_faults_and_pairs_that_are_declared_now():
    written = (ROOT / "docs" / "reliability.md").read_text()
    pairs = declared_pairs(declared_drills())
    fresh = page(
        declared_drills(),
        [WorstSeen(0.0, 0.0, (), 3)] * len(declared_drills()),
        pairs,
        [WorstSeen(0.0, 0.0, (), 1)] * len(pairs),
    )
    assert _declared_rows(written) == _declared_rows(fresh)
    assert written.count("Every bound is kept, and no promise was broken.") == 2


def test_the_reliability_page_has_each_kind_of_fault_of_each_component_once():
    matrix = page([], [], [], []).partition("Component by component")[2]
    rows = [line.strip("| ").split(" | ") for line in matrix.splitlines() if line.startswith("| ")][1:]
    for component in COMPONENTS:
        kinds = [kind for name, alike, _ in rows if name == component for kind in alike.split(", ")]
        assert sorted(kinds) == sorted(FAULT_KINDS)
        answers = [answer for name, _, answer in rows if name == component]
        assert len(answers) == len(set(answers))


def _declared_rows(text: str) -> list[list[str]]:
    """Return the cells of the tables without those that were measured."""
    rows = [line.split(" | ") for line in text.splitlines() if line.startswith("| ")]
    return [[cell for at, cell in enumerate(row) if at not in MEASURED.get(len(row), ())] for row in rows]


def _pair(first: str, second: str, phase: str = "at rest") -> Pair:
    return next(
        pair
        for pair in declared_pairs(declared_drills())
        if (pair.first.fault, pair.second.fault, pair.first.phase) == (first, second, phase)
    )


def test_for_a_pair_of_faults_the_mode_of_the_stronger_one_is_expected():
    assert _pair("unplug_voltmeter", "face_stuck").modes == {Mode.FALLBACK}
    assert _pair("unplug_positioner", "unplug_voltmeter").modes == {Mode.FAULT}
    assert _pair("wind", "unplug_voltmeter").modes == {Mode.STOW, Mode.FAULT}
    assert _pair("button", "wind").modes == {Mode.HOLD, Mode.FAULT}
    assert Mode.TRACKING in _pair("meter_restart", "bridge_replayed").modes
    assert Mode.FAULT not in _pair("meter_restart", "bridge_replayed").modes


def test_the_person_gives_the_commands_that_both_faults_of_a_pair_need():
    assert _pair("button", "a_overcurrent").commands == ("auto", "clear")
    assert _pair("unplug_positioner", "button_in").commands == ("auto", "clear")
    assert _pair("a_overcurrent", "b_pulse_loss").commands == ("clear", "home", "home", "home")
    assert _pair("wind_silent", "unplug_voltmeter").commands == ()


def test_faults_that_contradict_or_hide_each_other_form_no_pair():
    names = {(pair.first.fault, pair.second.fault) for pair in declared_pairs(declared_drills())}
    assert not names & {("kill", "end"), ("a_switch_closed", "a_switch_open"), ("a_slip", "kill")}
    assert ("a_switch_closed", "b_switch_open") in names


@pytest.mark.parametrize(("first", "second"), [("unplug_voltmeter", "face_stuck"), ("bridge_lost", "end")])
def test_a_measured_pair_of_faults_keeps_its_declared_bounds(first, second):
    pair = _pair(first, second)
    (seen,) = measure_pairs([pair], THIS_PROCESS, lambda _: None)
    assert list(pair.exceeded_bounds(seen)) == []
    assert seen.reached_s > 0


def test_each_bound_or_promise_that_a_pair_of_faults_does_not_keep_is_reported():
    seen = WorstSeen(math.inf, math.nan, ("limits",), 1)
    assert [*_pair("unplug_voltmeter", "bridge_lost").exceeded_bounds(seen)] == [
        "unplug_voltmeter and bridge_lost at rest: fallback after inf s, 70 s are declared",
        "unplug_voltmeter and bridge_lost at rest: back after nan s, 120 s are declared",
        "unplug_voltmeter and bridge_lost at rest: breaks limits",
    ]
