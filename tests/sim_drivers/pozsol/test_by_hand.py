"""Axes that are driven by hand: jogs from the host, and buttons at the unit."""

import pytest

from sim_drivers.pozsol.core import PositionerCore
from sim_drivers.pozsol.setup import B_ACTUATOR, Actuator, Setup
from solar.frames import Angles
from tests.sim_drivers.pozsol.exchange import JOG_A_OUT, moves, point, status


def test_a_jog_ends_280_ms_after_its_last_repetition():
    core = PositionerCore()
    for i in range(10):
        core.feed(JOG_A_OUT, i * 0.2)
    assert moves(core, 1.82 + 0.27)
    assert not moves(core, 1.82 + 0.29)
    end = core.truth(1.82 + 0.28 + 0.6)
    assert end.a_deg > 0.5
    assert core.truth(100.0) == end


def test_an_angle_command_takes_over_from_a_jog():
    core = PositionerCore()
    core.feed(JOG_A_OUT, 0.0)
    point(core, 0.1, a_deg=20.0)
    assert core.truth(60.0).a_deg == pytest.approx(20.0, abs=0.4)


def test_a_jog_of_axis_b_ends_at_the_end_point_of_axis_a():
    shorter = Actuator(300.0, 300.0, 90.0, -52.0, 10.0)
    core = PositionerCore(setup=Setup(start=Angles(0.0, 20.0), a_actuator=shorter))
    for i in range(1000):
        core.feed(b"$91\r", i * 0.2)
    assert B_ACTUATOR.position_mm(core.truth(300.0).b_deg) == pytest.approx(int(shorter.travel_mm), abs=0.2)


def test_an_unknown_action_ends_a_move_as_a_jog_that_is_not_repeated():
    core = PositionerCore()
    point(core, 0.0, a_deg=40.0)
    core.feed(b"$9x\r", 5.0)
    assert moves(core, 5.25)
    assert core.truth(6.0) == core.truth(100.0)


def test_a_held_button_drives_an_axis_and_shows_in_the_status_until_it_is_released():
    core = PositionerCore()
    core.inject("button", 10.0)
    assert status(core, 10.1).button_pressed
    assert core.truth(10.3).a_deg == pytest.approx(0.0)
    assert core.truth(12.0).a_deg > 0.5
    core.repair("button", 12.0)
    assert not status(core, 12.1).button_pressed
    assert core.truth(13.0) == core.truth(100.0)


def test_a_short_press_of_a_button_does_not_stop_a_move():
    core = PositionerCore()
    point(core, 0.0, a_deg=40.0)
    core.inject("button_in", 10.0)
    core.repair("button_in", 10.2)
    assert core.truth(100.0).a_deg == pytest.approx(40.0, abs=0.4)


def test_pressing_both_buttons_selects_the_other_axis():
    core = PositionerCore()
    core.inject("buttons_both", 0.0)
    core.repair("buttons_both", 0.5)
    core.inject("button_in", 1.0)
    core.repair("button_in", 5.0)
    assert core.truth(10.0).a_deg == pytest.approx(0.0)
    assert core.truth(10.0).b_deg < 89.0
