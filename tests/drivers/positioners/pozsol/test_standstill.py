"""What counts as standing, as a reference run that ended well, and as knowing where B's bits are."""

import pytest

from drivers.positioners.pozsol.end_switches import AxisBBitDetector, SwitchCheck
from drivers.positioners.pozsol.geometry import AxisSetup, Triangle
from drivers.positioners.pozsol.homing import AxisObservation, HomingRun
from drivers.positioners.pozsol.reference import Reference
from drivers.positioners.pozsol.standstill import Standstill
from drivers.positioners.pozsol.wire import B_OUT_BIT_LPC, B_OUT_BIT_STM, parse_status

A = AxisSetup(Triangle(300.0, 300.0, 90.0, -52.0), -50.0, 50.0)
QUIET, HOMING, LOW = parse_status("0"), parse_status(str(1 << 13)), parse_status(str(1 << 19))


def standing(places, destination=None, begin_s=0.0):
    still = Standstill(begin_s, (0.016, 0.016))
    for index, place in enumerate(places):
        aim = place if destination is None else destination
        still.update((place, 5.0), (aim, 5.0), 0.12 * (index + 1))
    return still


def test_an_axis_counts_as_standing_once_fresh_positions_have_not_changed_for_a_while():
    assert not standing([1.0, 1.0, 1.0]).reached
    assert standing([1.0, 1.0, 1.0, 1.0]).reached
    assert standing([1.0, 1.0133, 1.0, 1.0133]).reached, "one Hall count is jitter"
    assert not standing([1.0, 1.0, 1.0, 1.1]).reached
    assert not standing([1.0, 1.01, 1.02, 1.03, 1.04, 1.05]).still, "slow is not still"
    assert not standing([1.0] * 6, begin_s=0.5).reached, "what was heard before does not count"
    assert not standing([1.0] * 9, destination=20.0).reached, "it has somewhere to go"
    assert not standing([1.0] * 9, destination=-20.0).reached, "on either side"
    assert not standing([float("nan")] * 9).reached


def run(*looks, before=100.0, trusted=True, stood=None):
    homing = HomingRun("a", A, before, 1.0, trusted, before if trusted else stood)
    for time_s, position, destination, remain, status in looks:
        homing.update(AxisObservation(position, destination, remain, time_s, status, time_s))
    return homing


UNDER_WAY = ((1.2, 99.0, 89.0, 0.0, QUIET), (5.0, 80.0, 70.0, 0.0, HOMING), (9.0, 60.0, 50.0, 0.0, HOMING))


def test_a_reference_run_is_over_when_the_homing_bit_is_gone_and_the_axis_rests():
    assert run(*UNDER_WAY).begun
    assert not run(*UNDER_WAY, (40.0, -0.3, -0.3, 0.0, HOMING), (41.0, -0.3, -0.3, 0.0, HOMING)).over
    good = run(*UNDER_WAY, (40.0, -0.3, -0.3, 0.0, LOW), (41.0, -0.3, -0.3, 0.0, LOW))
    assert (good.over, good.failure, good.mismatch) == (True, "", "")


@pytest.mark.parametrize(
    ("place", "remain", "status", "why"),
    [
        (43.0, 0.0, QUIET, "ended at 43, not on its end switch"),
        (0.0, 0.0, QUIET, "low end switch does not show as closed"),
        (-0.9, 0.0, parse_status(str(1 << 1)), "ended with a_hall_fault"),
    ],
)
def test_a_reference_run_fails_if_it_ends_off_its_switch_with_the_switch_open_or_with_a_fault(
    place, remain, status, why
):
    ended = run(*UNDER_WAY, (40.0, place, place, remain, status), (41.0, place, place, remain, status))
    assert ended.over
    assert why in ended.failure


def test_a_reference_run_reports_an_end_switch_that_contradicts_the_count():
    slipped = ((40.0, 0.0, 0.0, 12.0, LOW), (41.0, 0.0, 0.0, 12.0, LOW))
    assert "met its end switch where its count was 12" in run(*UNDER_WAY, *slipped).mismatch
    assert run(*UNDER_WAY, *slipped, trusted=False).mismatch == ""
    stuck = run((1.2, 0.0, 0.0, 100.0, LOW), (2.0, 0.0, 0.0, 100.0, LOW), trusted=False)
    assert "did not move on its reference run although it stood at 100" in stuck.mismatch
    both = parse_status(str(1 << 19 | 1 << 20))
    assert "both of its end switches" in run(
        *UNDER_WAY, (40.0, 0.0, 0.0, 0.0, both), (41.0, 0.0, 0.0, 0.0, both)
    ).mismatch  # fmt: skip


@pytest.mark.parametrize("start", [B_OUT_BIT_STM, B_OUT_BIT_LPC])
@pytest.mark.parametrize(("way", "bits"), [(1.0, (0,)), (-1.0, (1,)), (-1.0, (1, 2))])
def test_the_place_of_the_status_bits_of_axis_b_is_found_only_when_b_moves(start, way, bits):
    layout, word = AxisBBitDetector(None), sum(1 << start + bit for bit in bits)
    for index in range(6):
        layout.update(100.0, 0.12 * index, word, 0.12 * index)
    assert layout.bit is None, "nothing is guessed of an axis that stands"
    for index in range(6, 12):
        layout.update(100.0 + way * index, 0.12 * index, word, 0.12 * index)
    assert layout.bit == start


def test_a_low_end_switch_shown_closed_far_from_its_position_is_reported_at_the_second_status():
    check = SwitchCheck("a", A)
    assert check.update(200.0, LOW, 1.0) == ""
    assert check.update(200.0, LOW, 1.0) == ""
    assert "shows its low end switch closed although its count is 200" in check.update(200.0, LOW, 4.0)
    assert check.update(-0.3, LOW, 7.0) == ""


def test_a_doubt_lasts_until_good_reference_runs_or_until_exactly_that_doubt_is_forgiven():
    reference = Reference()
    reference.note("reset", "it has restarted")
    reference.proven("a", travelled=True)
    assert reference.text == "it has restarted"
    reference.proven("b", travelled=False)
    assert reference.text == ""
    reference.note("jump 1", "it has jumped")
    seen = reference.kinds
    reference.note("jump 2", "it has jumped")
    reference.forgive(seen)
    assert reference.text == "it has jumped"
    reference = Reference()
    reference.note("a switch", "stuck", "a", needs_travel=True)
    reference.proven("a", travelled=False)
    assert reference.doubts("a")
    assert not reference.doubts("b")
    reference.note("b switch", "stuck too", "b", needs_travel=True)
    assert reference.doubts("a")
    assert reference.doubts("b")
    reference.proven("a", travelled=True)
    assert (reference.doubts("a"), reference.text) == (False, "stuck too")
