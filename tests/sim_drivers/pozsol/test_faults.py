"""Injected faults: what the unit shows of each, what it refuses meanwhile, and how they end."""

import pytest

from drivers.positioners.pozsol.wire import Field, TokenStream, encode_command
from sim_drivers.pozsol import screens
from sim_drivers.pozsol.core import PositionerCore
from sim_drivers.pozsol.setup import A_ACTUATOR, Setup
from sim_drivers.pozsol.unit import SELF_CLEAR_S
from tests.sim_drivers.pozsol.exchange import CLEAR, HOME_A, HOME_B, STOP, fields, moves, number, point, status


def test_overcurrent_discards_the_target_of_its_axis_and_the_pending_move_of_the_other_begins():
    core = PositionerCore()
    point(core, 0.0, a_deg=40.0, b_deg=50.0)
    core.inject("a_overcurrent", 5.0)
    assert number(core, Field.A_DESTINATION, 6.0) == number(core, Field.A_POSITION, 6.0)
    stopped = core.truth(6.0).a_deg
    assert status(core, 20.0).faults == ("a_overcurrent",)
    core.feed(CLEAR, 20.0)
    assert status(core, 20.1).faults == ()
    assert core.truth(200.0).a_deg == stopped
    assert core.truth(200.0).b_deg == pytest.approx(50.0, abs=0.4)


def test_a_stop_before_clearing_an_overcurrent_leaves_no_move_pending():
    core = PositionerCore()
    point(core, 0.0, a_deg=40.0)
    core.inject("a_overcurrent", 10.0)
    core.feed(STOP, 20.0)
    core.feed(CLEAR, 20.06)
    assert core.truth(200.0).a_deg < 15.0


def test_a_faulted_axis_refuses_targets_and_the_other_one_takes_them():
    core = PositionerCore()
    core.inject("a_overcurrent", 0.0)
    before = number(core, Field.A_DESTINATION, 0.0)
    point(core, 1.0, a_deg=20.0, b_deg=50.0)
    assert number(core, Field.A_DESTINATION, 2.0) == before
    assert core.truth(200.0).b_deg == pytest.approx(50.0, abs=0.4)


def test_a_latched_fault_clears_itself_once_15_minutes_after_power_up():
    core = PositionerCore()
    core.inject("a_overcurrent", 855.0)
    assert status(core, 899.9).faults
    assert not status(core, 900.1).faults
    core.inject("a_overcurrent", 905.0)
    assert status(core, 90_000.0).faults


def test_a_destination_error_of_each_axis_shows_in_the_status_until_it_is_cleared():
    core = PositionerCore()
    core.inject("a_destination", 0.0)
    core.inject("b_destination", 0.0)
    word = int(fields(core, 1.0)[Field.STATUS])
    assert word < 0
    assert word & 0xFFFF_FFFF == 1 << 28 | 1 << 31
    core.feed(CLEAR, 2.0)
    assert fields(core, 3.0)[Field.STATUS] == b"0000"


def test_a_lost_hall_signal_latches_after_two_seconds_of_driving_blind():
    core = PositionerCore()
    point(core, 0.0, a_deg=40.0)
    core.inject("a_hall_loss", 10.0)
    counted = number(core, Field.A_POSITION, 10.0)
    assert not moves(core, 10.5)
    assert status(core, 11.9).faults == ()
    assert status(core, 12.1).faults == ("a_hall_fault",)
    assert number(core, Field.A_POSITION, 12.1) == counted
    assert number(core, Field.A_DESTINATION, 12.1) == counted
    blind_mm = A_ACTUATOR.position_mm(core.truth(13.0).a_deg) - counted
    assert blind_mm == pytest.approx(2.125 * 235 / 75, abs=0.05)
    core.repair("a_hall_loss", 13.0)
    core.feed(CLEAR, 13.0)
    point(core, 14.0, a_deg=40.0)
    assert number(core, Field.A_POSITION, 200.0) == pytest.approx(int(A_ACTUATOR.position_mm(40.0)), abs=0.2)
    assert core.truth(200.0).a_deg > 41.0


def test_a_hall_signal_lost_at_rest_shows_at_the_next_move():
    core = PositionerCore()
    core.inject("b_hall_loss", 0.0)
    assert status(core, 100.0).faults == ()
    point(core, 100.0, b_deg=50.0)
    assert status(core, 103.0).faults == ("b_hall_fault",)


def test_a_broken_cable_latches_again_however_often_it_is_cleared():
    core = PositionerCore()
    core.inject("b_cable", 0.0)
    core.feed(CLEAR, 1.0)
    assert status(core, 2.0).faults == ("b_cable",)
    core.repair("b_cable", 3.0)
    assert status(core, 4.0).faults == ("b_cable",)
    core.feed(CLEAR, 5.0)
    assert status(core, 6.0).faults == ()


def test_an_end_switch_stuck_closed_stops_inward_moves_and_ends_a_reference_run_on_the_spot():
    core = PositionerCore()
    core.inject("a_switch_closed", 0.0)
    here = core.truth(0.0).a_deg
    point(core, 1.0, a_deg=-20.0)
    assert core.truth(60.0).a_deg == pytest.approx(here)
    assert number(core, Field.A_DESTINATION, 60.0) == number(core, Field.A_POSITION, 60.0)
    point(core, 60.0, a_deg=20.0)
    assert core.truth(120.0).a_deg == pytest.approx(20.0, abs=0.4)
    core.feed(HOME_A, 120.0)
    assert number(core, Field.A_POSITION, 121.0) == 0.0
    assert core.truth(121.0).a_deg == pytest.approx(20.0, abs=0.4)


def test_a_switch_that_does_not_close_lets_homing_run_into_the_hard_stop():
    core = PositionerCore()
    core.inject("a_switch_open", 0.0)
    core.feed(HOME_A, 1.0)
    assert status(core, 200.0).faults == ("a_hall_fault",)
    assert A_ACTUATOR.position_mm(core.truth(200.0).a_deg) == pytest.approx(-1.0)
    assert not status(core, 200.0).homing


def test_a_move_that_meets_its_high_end_switch_ends_there_unless_the_build_has_none():
    for has_one in (True, False):
        core = PositionerCore(setup=Setup(high_switches=has_one))
        core.inject("reset_position_lost", 0.0)
        core.feed(CLEAR, 0.5)
        core.feed(encode_command(Field.A_DESTINATION, 372), 1.0)
        beyond_mm = A_ACTUATOR.position_mm(core.truth(300.0).a_deg) - A_ACTUATOR.travel_mm
        assert beyond_mm == pytest.approx(0.39 if has_one else 1.0, abs=0.03)
        assert ("a_high" in status(core, 300.0).end_switches) is has_one
        assert number(core, Field.A_DESTINATION, 300.0) == number(core, Field.A_POSITION, 300.0)


def test_undervoltage_cuts_a_move_off_and_refuses_targets_until_five_seconds_after_it():
    core = PositionerCore()
    point(core, 0.0, a_deg=40.0)
    core.inject("undervoltage", 10.0)
    stopped = core.truth(10.5)
    point(core, 11.0, a_deg=20.0)
    core.feed(HOME_A, 12.0)
    assert number(core, Field.SUPPLY, 13.0) == 15.0
    assert not status(core, 13.0).homing
    core.repair("undervoltage", 60.0)
    point(core, 64.5, a_deg=20.0)
    assert core.truth(120.0) == stopped
    point(core, 120.0, a_deg=20.0)
    assert core.truth(180.0).a_deg == pytest.approx(20.0, abs=0.4)


def test_a_power_cycle_stops_everything_sets_the_reset_mark_and_keeps_the_count():
    core = PositionerCore()
    point(core, 0.0, a_deg=40.0, b_deg=50.0)
    core.inject("b_overcurrent", 5.0)
    position = number(core, Field.A_POSITION, 10.0)
    core.power_cycle(10.0)
    assert status(core, 10.0).was_reset
    assert status(core, 10.0).faults == ()
    assert number(core, Field.A_POSITION, 500.0) == position
    assert number(core, Field.A_DESTINATION, 500.0) == position
    core.feed(CLEAR, 500.0)
    assert status(core, 501.0).was_reset, "it has enumerated anew, so the first packet is lost"
    core.feed(CLEAR, 502.0)
    assert not status(core, 503.0).was_reset


def test_the_reset_mark_clears_itself_15_minutes_after_power_up():
    core = PositionerCore()
    core.power_cycle(100.0, keep_position=False)
    assert status(core, 100.0 + SELF_CLEAR_S - 1.0).was_reset
    assert not status(core, 100.0 + SELF_CLEAR_S + 1.0).was_reset


def test_an_axis_disabled_by_a_fault_takes_no_target_after_a_power_cycle_until_status_is_cleared():
    core = PositionerCore()
    point(core, 0.0, a_deg=40.0)
    core.inject("a_hall_loss", 10.0)
    core.repair("a_hall_loss", 15.0)
    core.power_cycle(20.0)
    assert status(core, 20.0).faults == ()
    core.feed(STOP, 21.0)
    position = number(core, Field.A_POSITION, 22.0)
    point(core, 22.0, a_deg=40.0)
    assert number(core, Field.A_DESTINATION, 23.0) == number(core, Field.A_POSITION, 60.0) == position
    core.feed(CLEAR, 60.0)
    point(core, 61.0, a_deg=40.0)
    assert number(core, Field.A_POSITION, 120.0) > position


def test_a_fresh_unit_has_no_reset_mark():
    assert not status(PositionerCore(), 0.0).was_reset


def test_a_deaf_unit_shows_telemetry_and_takes_no_command_until_it_is_repaired():
    core = PositionerCore()
    point(core, 0.0, a_deg=20.0)
    core.inject("deaf", 5.0)
    core.feed(STOP, 5.0)
    stream = b"".join(core.next_screen(60.0) for _ in range(screens.SLOTS))
    shown = dict(TokenStream().feed(stream + b"$"))
    assert float(shown[Field.A_ANGLE]) == pytest.approx(20.0, abs=0.4)
    point(core, 60.0, a_deg=40.0)
    assert core.truth(120.0).a_deg == pytest.approx(20.0, abs=0.4)
    core.repair("deaf", 120.0)
    point(core, 120.0, a_deg=40.0)
    assert core.truth(180.0).a_deg > 39.0


def test_injected_faults_make_an_axis_ignore_its_targets_or_its_count_slip():
    core = PositionerCore()
    core.inject("a_ignores_targets", 0.0)
    before = number(core, Field.A_DESTINATION, 0.0)
    point(core, 1.0, a_deg=20.0, b_deg=50.0)
    assert number(core, Field.A_DESTINATION, 2.0) == before
    assert core.truth(200.0).b_deg == pytest.approx(50.0, abs=0.4)
    counted = number(core, Field.B_POSITION, 200.0)
    core.inject("b_slip", 200.0)
    assert number(core, Field.B_POSITION, 200.0) == pytest.approx(counted + 5.0)
    core.feed(HOME_B, 201.0)
    assert number(core, Field.B_REMAIN, 400.0) == pytest.approx(5.0, abs=0.03)


def test_unknown_faults_repairs_of_what_cannot_be_ended_and_backward_times_are_refused():
    core = PositionerCore()
    with pytest.raises(ValueError, match=r"no fault 'melt'.*a_overcurrent"):
        core.inject("melt", 0.0)
    with pytest.raises(ValueError, match="nothing to end"):
        core.repair("a_overcurrent", 0.0)
    with pytest.raises(ValueError, match="nothing to end"):
        core.repair("re_reference", 0.0)
    with pytest.raises(ValueError, match="cannot go back"):
        core.advance(-1.0)
    with pytest.raises(ValueError, match="cannot go back"):
        core.advance(float("nan"))
