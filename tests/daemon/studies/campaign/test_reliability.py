"""The page of faults: what is measured is compared with what is declared, and nothing is left out in silence."""

import math
from dataclasses import replace

import pytest

from daemon.base.errors import UserError
from daemon.base.records import Mode
from daemon.rigs.campaign.faults import FAULTS
from daemon.studies.campaign.declared import UNSEEN, declared, without_row
from daemon.studies.campaign.drills import WorstSeen
from daemon.studies.campaign.many import run_all
from daemon.studies.campaign.matrix import CELLS, COMPONENTS, FAULT_KINDS, cell, chosen_faults
from daemon.studies.campaign.reliability import beyond, page
from daemon.studies.spread.workers import HERE
from tests.support import ROOT

UNPLUGGED = next(drill for drill in declared() if drill.fault == "unplug_positioner")


def test_every_fault_has_a_row_or_a_reason():
    assert without_row() == set(UNSEEN)


def test_every_cell_is_done_by_faults_that_there_are_or_refused_in_a_sentence():
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


def test_a_word_that_names_nothing_is_refused():
    with pytest.raises(UserError, match="there is no thunder"):
        chosen_faults(["thunder"])


def test_what_a_drill_measures_is_what_happens():
    schedules = list(UNPLUGGED.schedules())[:1]
    outcomes = run_all(schedules, HERE, lambda _: None)
    measured = UNPLUGGED.measure(schedules, outcomes)
    assert list(beyond(UNPLUGGED, measured)) == []
    assert 0 < measured.reached_s < 1
    assert 0 < measured.back_s < 15
    assert replace(UNPLUGGED, mode=(Mode.SNOW,)).measure(schedules, outcomes).reached_s == math.inf


def test_what_is_not_kept_is_said():
    assert [*beyond(UNPLUGGED, WorstSeen(0.5, 5.0, (), 3))] == []
    assert [*beyond(UNPLUGGED, WorstSeen(math.inf, math.nan, ("limits",), 3))] == [
        "unplug_positioner at rest: fault after inf s, 1 s are declared",
        "unplug_positioner at rest: back after nan s, 15 s are declared",
        "unplug_positioner at rest: breaks limits",
    ]


def test_the_page_has_what_is_declared_now():
    written = (ROOT / "docs" / "reliability.md").read_text()
    fresh = page(declared(), [WorstSeen(0.0, 0.0, (), 3)] * len(declared()))
    rows = [line for line in fresh.splitlines() if line.startswith("| ")]
    # What was measured is left out of the comparison.
    declared_only = [[part for at, part in enumerate(row.split(" | ")) if at not in (5, 8)] for row in rows]
    found = [
        [part for at, part in enumerate(line.split(" | ")) if at not in (5, 8)]
        for line in written.splitlines()
        if line.startswith("| ")
    ]
    assert found == declared_only
    assert "Every bound is kept, and no promise was broken." in written
