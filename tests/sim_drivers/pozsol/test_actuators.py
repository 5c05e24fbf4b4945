"""How long an actuator has to be for each angle of its axis."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.positioners.pozsol.wire import Field
from sim_drivers.pozsol.core import PositionerCore
from sim_drivers.pozsol.setup import A_ACTUATOR, Actuator, Setup
from tests.sim_drivers.pozsol.exchange import number, point


@given(st.floats(-52, 52))
def test_the_triangle_turns_angles_into_positions_and_back(angle_deg):
    assert A_ACTUATOR.angle_deg(A_ACTUATOR.position_mm(angle_deg)) == pytest.approx(angle_deg, abs=1e-9)


def test_near_mid_travel_one_millimetre_is_about_a_quarter_of_a_degree():
    assert A_ACTUATOR.angle_deg(A_ACTUATOR.position_mm(0.0) + 1.0) == pytest.approx(0.27, abs=0.01)


@pytest.mark.parametrize(("low", "high"), [(-95.0, 52.0), (-52.0, 95.0), (10.0, -10.0)])
def test_a_triangle_that_cannot_be_built_is_refused(low, high):
    with pytest.raises(ValueError, match=r"triangle|low end"):
        Actuator(300.0, 300.0, 90.0, low, high)


def test_a_holder_and_a_zero_offset_change_the_position_that_belongs_to_an_angle():
    held = Actuator(300.0, 300.0, 90.0, -52.0, 52.0, holder_mm=39.6)
    assert abs(held.position_mm(20.0) - A_ACTUATOR.position_mm(20.0)) > 1.0
    assert held.angle_deg(held.position_mm(20.0)) == pytest.approx(20.0)
    offset = Actuator(300.0, 300.0, 90.0, -52.0, 52.0, zero_offset_mm=2.0)
    core = PositionerCore(setup=Setup(a_actuator=offset))
    point(core, 0.0, a_deg=20.0)
    assert number(core, Field.A_DESTINATION, 0.1) == int(A_ACTUATOR.position_mm(20.0)) + 2


def test_an_actuator_on_the_other_side_lowers_the_angle_by_extension():
    lowers = Actuator(300.0, 300.0, 60.0, 40.0, -30.0, extension_raises_angle=False)
    assert lowers.position_mm(10.0) > lowers.position_mm(30.0) > 0
    assert lowers.angle_deg(lowers.position_mm(10.0)) == pytest.approx(10.0)
