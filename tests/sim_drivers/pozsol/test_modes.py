"""The unit's own modes: it tracks, follows a master, and stows in wind and snow."""

import pytest

from drivers.positioners.pozsol.wire import Field
from sim_drivers.pozsol.core import PositionerCore
from sim_drivers.pozsol.setup import A_ACTUATOR
from solar.frames import Angles
from tests.sim_drivers.pozsol.exchange import STOP, TRACKING_OFF, fields, number, own, point, status


def test_own_tracking_moves_the_axes_and_ignores_the_host_until_it_is_switched_off():
    core = PositionerCore(setup=own())
    core.inject("own_tracking", 0.0)
    assert status(core, 0.1).own_tracking
    assert fields(core, 0.1)[Field.MODE] == b"Micro tracking"
    point(core, 100.0, a_deg=40.0)
    assert core.truth(200.0).a_deg == pytest.approx(-30.0, abs=0.4)
    assert core.truth(1000.0).a_deg == pytest.approx(-21.0, abs=0.4)
    core.feed(STOP, 1000.0)
    assert core.truth(1400.0).a_deg == pytest.approx(-18.0, abs=0.4)
    core.feed(TRACKING_OFF, 1400.0)
    assert not status(core, 1401.0).own_tracking
    point(core, 1401.0, a_deg=40.0)
    assert core.truth(3000.0).a_deg == pytest.approx(40.0, abs=0.6)


def test_switching_own_tracking_off_does_not_stop_a_running_motor():
    core = PositionerCore(setup=own())
    core.inject("own_tracking", 0.0)
    core.feed(TRACKING_OFF, 5.0)
    assert core.truth(100.0).a_deg == pytest.approx(-30.0, abs=0.4)


def test_a_slave_unit_takes_targets_and_the_tracking_off_command_puts_it_on_standby():
    core = PositionerCore(setup=own())
    core.inject("slave_mode", 0.0)
    assert fields(core, 1.0)[Field.MODE] == b"sigma tracking"
    assert status(core, 1.0).own_tracking
    point(core, 1.0, a_deg=40.0)
    assert number(core, Field.A_DESTINATION, 2.0) == int(A_ACTUATOR.position_mm(40.0))
    for now in (3.0, 5.0):
        core.feed(TRACKING_OFF, now)
        assert fields(core, now + 1.0)[Field.MODE] == b"sigma standby"
        assert not status(core, now + 1.0).own_tracking
    core.repair("slave_mode", 7.0)
    assert fields(core, 8.0)[Field.MODE] == b"tracker ok"


def test_wind_stow_begins_after_half_a_second_of_wind_and_ends_after_its_hold_time():
    core = PositionerCore(setup=own(wind_stow=Angles(0.0, 90.0), wind_hold_s=120.0))
    core.inject("own_tracking", 0.0)
    core.inject("wind", 200.0)
    assert not status(core, 200.4).wind
    assert status(core, 200.6).wind
    assert fields(core, 201.0)[Field.MODE] == b"wind mode"
    assert core.truth(300.0) == pytest.approx((0.0, 90.0), abs=0.5)
    core.repair("wind", 300.0)
    assert status(core, 419.0).wind
    assert not status(core, 421.0).wind
    assert core.truth(599.0).b_deg == pytest.approx(60.0, abs=0.5)


def test_a_gust_shorter_than_half_a_second_and_wind_without_a_stow_position_do_nothing():
    core = PositionerCore(setup=own(wind_stow=Angles(0.0, 90.0)))
    core.inject("own_tracking", 0.0)
    core.inject("wind", 200.0)
    core.repair("wind", 200.3)
    assert not status(core, 299.0).wind
    bare = PositionerCore(setup=own())
    bare.inject("own_tracking", 0.0)
    bare.inject("wind", 200.0)
    assert not status(bare, 299.0).wind


def test_snow_stow_begins_only_while_own_tracking_is_on():
    core = PositionerCore(setup=own(snow_stow=Angles(0.0, 20.0)))
    core.inject("snow", 0.0)
    assert core.truth(100.0).b_deg == pytest.approx(90.0)
    assert not status(core, 100.0).autonomous
    core.inject("own_tracking", 100.0)
    assert status(core, 101.0).snow
    assert core.truth(300.0).b_deg == pytest.approx(20.0, abs=0.5)


def test_snow_stow_begins_after_ten_seconds_of_snow_and_ends_after_its_hold_time():
    core = PositionerCore(setup=own(snow_stow=Angles(0.0, 20.0), snow_hold_s=60.0))
    core.inject("own_tracking", 0.0)
    core.inject("snow", 200.0)
    assert not status(core, 209.9).snow
    assert status(core, 210.1).snow
    assert fields(core, 211.0)[Field.MODE] == b"snow mode"
    core.repair("snow", 300.0)
    assert status(core, 359.0).snow
    assert not status(core, 361.0).snow
    assert core.truth(599.0).b_deg == pytest.approx(60.0, abs=0.5)
