"""Reference runs: what they set anew, what interrupts them, and what they do to the other axis."""

import pytest

from drivers.positioners.pozsol.wire import Field
from sim_drivers.pozsol.core import PositionerCore
from sim_drivers.pozsol.setup import A_ACTUATOR, B_ACTUATOR, AxisDrive, Setup
from solar.frames import Angles
from tests.sim_drivers.pozsol.exchange import HOME_A, HOME_B, STOP, number, point, status


def test_homing_runs_past_the_low_switch_and_starts_the_count_anew_there():
    core = PositionerCore()
    core.feed(HOME_A, 0.0)
    assert not status(core, 0.03).homing
    assert status(core, 0.2).homing
    assert number(core, Field.A_DESTINATION, 5.0) == pytest.approx(number(core, Field.A_POSITION, 5.0) - 10.0)
    assert not status(core, 200.0).homing
    assert number(core, Field.A_POSITION, 200.0) == pytest.approx(-0.4, abs=0.03)
    assert number(core, Field.A_DESTINATION, 200.0) == number(core, Field.A_POSITION, 200.0)
    assert number(core, Field.A_REMAIN, 200.0) == pytest.approx(0.0, abs=0.02)
    assert "a_low" in status(core, 200.0).end_switches
    assert core.truth(200.0).a_deg == pytest.approx(-52.0, abs=0.2)


def test_homing_b_while_a_moves_leaves_a_without_control():
    core = PositionerCore(setup=Setup(start=Angles(0.0, 20.0)))
    point(core, 0.0, a_deg=40.0)
    counted = number(core, Field.A_POSITION, 10.0)
    core.feed(HOME_B, 10.0)
    assert status(core, 11.0).homing
    # A stays driven while B is, and nothing of its way is counted.
    gone_mm = A_ACTUATOR.position_mm(core.truth(13.0).a_deg) - counted
    assert gone_mm == pytest.approx(1.7, abs=0.2)
    assert number(core, Field.A_POSITION, 13.0) == pytest.approx(counted, abs=0.1)
    assert status(core, 13.5).faults == ("a_hall_fault",)


def test_homing_an_axis_that_moves_outwards_ends_early_short_of_its_switch():
    core = PositionerCore()
    point(core, 0.0, a_deg=40.0)
    before = number(core, Field.A_POSITION, 3.0)
    core.feed(HOME_A, 3.0)
    assert status(core, 3.5).homing
    assert not status(core, 10.0).homing
    assert number(core, Field.A_POSITION, 100.0) == pytest.approx(before + 3.1 - 10.0, abs=0.3)


def test_homing_refuses_targets_of_its_axis_and_loses_those_taken_by_the_other_axis_at_its_end():
    core = PositionerCore()
    core.feed(HOME_A, 0.0)
    point(core, 1.0, a_deg=20.0, b_deg=50.0)
    assert number(core, Field.A_DESTINATION, 2.0) < number(core, Field.A_POSITION, 2.0)
    assert number(core, Field.B_DESTINATION, 2.0) == int(B_ACTUATOR.position_mm(50.0))
    assert core.truth(200.0).a_deg == pytest.approx(-52.0, abs=0.2)
    assert core.truth(200.0).b_deg == pytest.approx(90.0)
    point(core, 200.0, a_deg=20.0)
    assert core.truth(400.0).a_deg == pytest.approx(20.0, abs=0.4)


def test_a_supply_dip_breaks_homing_off_without_any_report_in_the_status():
    core = PositionerCore()
    core.feed(HOME_A, 0.0)
    core.inject("undervoltage", 5.0)
    core.repair("undervoltage", 5.8)
    broken_off = core.truth(6.5)
    shown = status(core, 10.0)
    assert not shown.homing
    assert shown.faults == ()
    assert not shown.was_reset
    assert core.truth(100.0) == broken_off


def test_stop_ends_a_homing_run():
    core = PositionerCore()
    core.feed(HOME_A, 0.0)
    core.feed(STOP, 5.0)
    assert not status(core, 5.1).homing
    assert core.truth(6.0) == core.truth(700.0)


def test_homing_gives_up_after_600_s():
    core = PositionerCore(setup=Setup(drive=AxisDrive(speed_mm_s=0.2)))
    core.feed(HOME_A, 0.0)
    assert status(core, 600.0).homing
    late = status(core, 600.1)
    assert not late.homing
    assert late.faults == ("a_homing_too_long",)
    assert core.truth(601.0) == core.truth(800.0)


def test_the_remain_field_tells_after_homing_how_far_the_count_had_slipped():
    core = PositionerCore()
    core.inject("reset_position_lost", 0.0)
    assert number(core, Field.A_POSITION, 0.1) == 0.0
    core.feed(HOME_A, 1.0)
    assert number(core, Field.A_REMAIN, 200.0) == pytest.approx(-A_ACTUATOR.position_mm(0.0), abs=0.03)


def test_an_automatic_re_reference_homes_axis_b_but_not_axis_a_although_both_are_due():
    core = PositionerCore()
    core.inject("re_reference", 0.0)
    assert status(core, 5.0).homing
    assert core.truth(400.0) == pytest.approx((0.0, 13.0), abs=0.2)
