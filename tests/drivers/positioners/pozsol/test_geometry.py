"""Angles and positions of an axis, the packets for a target, and the unit's own settings that contradict them."""

import math
import re
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.positioners.pozsol.geometry import AxisSetup, Proportional, Triangle
from drivers.positioners.pozsol.unit_setup import SETUP_FIELDS, conflicts, count_step, missing_fields

A = AxisSetup(Triangle(300.0, 300.0, 90.0, -52.0), -50.0, 50.0)
B = AxisSetup(Triangle(300.0, 300.0, 37.5, 13.0), 15.0, 90.0)
# As public firmware prints them when it is set up with these triangles.
FIELDS = dict(zip(range(70, 78), ("195.3", "300.0", "300.0", "0.0", "0.0", "1.0", "-90.0", "0.0"), strict=True)) | {
    78: "75.0", 79: "376", 80: "2", 83: "3", 110: "0", 111: "0", 192: "0.00", 193: "0.00", 104: "75.0", 105: "286",
    106: "2", 107: "3",
}  # fmt: skip
FIELDS |= dict(zip(range(96, 104), ("255.9", "300.0", "300.0", "0.0", "0.0", "1.0", "-37.5", "0.0"), strict=True))


@given(st.sampled_from([A, B]), st.floats(0, 1))
def test_a_destination_is_within_the_limits_and_half_a_unit_from_the_target_unless_at_a_limit(setup, share):
    target_deg = setup.minimum_deg + share * (setup.maximum_deg - setup.minimum_deg)
    target_deg = min(target_deg, setup.maximum_deg)
    sent = setup.destination(target_deg)
    lowest, highest = (setup.geometry.position(end) for end in (setup.minimum_deg, setup.maximum_deg))
    assert lowest <= sent <= highest
    at_a_limit = sent - lowest < 1.2 or highest - sent < 1.2
    assert abs(sent - setup.geometry.position(target_deg)) <= (1.2 if at_a_limit else 0.5)


@pytest.mark.parametrize(("geometry", "units"), [
    # 600 mm sin(theta/2) between the arms: 195.34 at 38 deg, 219.90 at 43, 170.41 at 33.
    (A.geometry, 24.93),
    (replace(A.geometry, apex_deg=-90.0, low_deg=52.0), 24.93),
    (Triangle(300.0, 300.0, 90.0, 52.0, sense="lowers"), 24.93),
    (Proportional(-3.7, 50.0), 18.5),
    (Proportional(12.0, 0.0), 60.0),
    # With its holder subtracted, the actuator would have a negative length.
    (Triangle(300.0, 300.0, 4.0, 6.0, holder_mm=50.0), 5.0),
])  # fmt: skip
def test_an_angle_at_the_beginning_of_the_travel_is_converted_into_position_units(geometry, units):
    assert AxisSetup(geometry, -50.0, 50.0).units(5.0) == pytest.approx(units, abs=0.01)


@pytest.mark.parametrize(("setup", "within_deg"), [
    # 600 mm sin(theta/2) between the arms: 538.12 at 127.5 deg, 2.32 a deg. Half a unit and 0.15 of run-out.
    (B, 0.28),
    # For the limit 281 is sent, not 282.18.
    (replace(B, zero_offset=0.33), 0.37),
    (AxisSetup(Proportional(1.0, 13.05), 15.0, 90.0), 0.95),
    (AxisSetup(Proportional(-1.0, 90.0), 15.0, 90.0), 0.5),
    (AxisSetup(Proportional(59.5, 13.0), 15.0, 90.0), 0.5 / 59.5),
    (replace(B, minimum_deg=89.9), math.nan),
])  # fmt: skip
def test_rests_within_is_the_largest_angle_error_that_whole_units_and_run_out_leave(setup, within_deg):
    assert setup.rests_within() == pytest.approx(within_deg, abs=0.01, nan_ok=True)


@pytest.mark.parametrize("setup", [A, B, replace(B, zero_offset=0.33), AxisSetup(Proportional(1.0, 13.05), 15.0, 90.0)])
def test_no_angle_is_further_than_rests_within_from_where_the_axis_comes_to_rest(setup):
    angles_deg = np.linspace(setup.minimum_deg, setup.maximum_deg, 2000)
    rests_deg = [setup.geometry.angle(setup.destination(angle) + setup.zero_offset) for angle in angles_deg]
    assert np.abs(rests_deg - angles_deg).max() <= setup.rests_within()


def test_a_target_at_a_limit_is_rounded_inwards():
    assert A.geometry.angle_at_length(A.geometry.low_length_mm + A.destination(-50.0)) > -50.0
    assert A.geometry.angle_at_length(A.geometry.low_length_mm + A.destination(50.0)) < 50.0
    assert B.geometry.angle_at_length(B.geometry.low_length_mm + B.destination(90.0)) < 90.0


@pytest.mark.parametrize("sense", ["raises", "lowers"])
def test_a_triangle_with_a_holder_converts_angles_to_lengths_and_back_in_either_sense(sense):
    apex_deg, low_deg = (90.0, -52.0) if sense == "raises" else (90.0, 52.0)
    triangle = Triangle(300.0, 290.0, apex_deg, low_deg, 39.6, sense)
    for angle_deg in (-50.0, -10.0, 0.0, 33.3, 50.0):
        length_mm = triangle.low_length_mm + triangle.position(angle_deg)
        assert triangle.angle_at_length(length_mm) == pytest.approx(angle_deg)
    setup = AxisSetup(triangle, -50.0, 50.0)
    assert 0 < setup.destination(-50.0 if sense == "raises" else 50.0) < 20


@pytest.mark.parametrize(
    ("length_mm", "angle_deg"),
    [(600.0, 90.0), (600.1, math.nan), (900.0, math.nan), (1.0, -89.809), (0.0, -90.0), (300.0, -30.0)],
)
def test_a_length_that_two_arms_cannot_span_has_no_angle(length_mm, angle_deg):
    assert A.geometry.angle_at_length(length_mm) == pytest.approx(angle_deg, abs=1e-3, nan_ok=True)


def test_an_actuator_may_fold_to_zero_length_beside_its_holder_and_has_no_position_beyond():
    stretched = Triangle(300.0, 300.0, 90.0, 90.0, 600.0)
    assert stretched.low_length_mm == 0.0
    assert math.isnan(stretched.position(89.0))


def test_the_zero_offset_of_the_unit_is_subtracted_from_the_destination():
    assert replace(A, zero_offset=2.5).destination(0.0) == round(A.geometry.position(0.0) - 2.5)


def test_destination_raises_for_an_impossible_geometry_and_for_an_angle_that_is_not_a_number():
    for setup in (
        replace(A, geometry=Triangle(300.0, 300.0, 90.0, -52.0, 290.0)),
        replace(A, geometry=Proportional(math.nan, 0.0)),
    ):
        with pytest.raises(ValueError, match="no position"):
            setup.destination(-49.0)
    with pytest.raises(ValueError, match="no position for nan"):
        A.destination(math.nan)


def test_a_unit_set_as_configured_and_a_unit_that_reports_no_settings_cause_no_conflicts():
    assert conflicts(FIELDS, A, B) == ()
    assert missing_fields(FIELDS) == ()
    assert conflicts({}, A, B) == ()
    assert missing_fields({}) == tuple(sorted(SETUP_FIELDS))
    assert count_step(FIELDS, "a") == pytest.approx(1 / 75)
    assert count_step({}, "a") is None


@pytest.mark.parametrize(
    ("code", "text", "sentence"),
    [
        (70, "197.3", "field 70.*low_deg is -52,.*set it to -51.60"),
        (71, "280.0", "field 71.*says 280, but instruments.positioner.a_axis.arm_1_mm is 300: set it to 280"),
        (98, "310.0", "field 98.*b_axis.arm_2_mm"),
        (100, "39.6", "field 100.*b_axis.holder_mm is 0"),
        (75, "0.0", r'field 75.*\(extension lowers the angle\), but.*is "raises": set it to "lowers"'),
        (76, "-88.0", r"field 76 \+ 77.*says 88, but .*a_axis.apex_deg is 90"),
        (103, "5.0", r"field 102 \+ 103.*b_axis.apex_deg"),
        (83, "1", "field 83.*geometry 1 for axis A, which has no positions in mm"),
        (79, "300", r"range of axis A ends at 300 \(field 79\), but limits.a_min_deg to a_max_deg need 11 to 368"),
        (111, "20", "range of axis B begins at 20"),
        (192, "1.50", "field 192.*a_axis.zero_offset is 0: set it to 1.5"),
    ],
)
def test_each_differing_unit_setting_is_reported_with_field_both_values_and_remedy(code, text, sentence):
    (found,) = conflicts(FIELDS | {code: text}, A, B)
    assert re.search(sentence, found), found


def test_geometry_modes_1_2_and_13_of_the_firmware_are_understood():
    # Mode 13 counts from the zenith; mode 2 has arms, holder and length in another order.
    lowers = replace(A, geometry=Triangle(300.0, 300.0, 90.0, 52.0, 0.0, "lowers"))
    assert conflicts(FIELDS | {83: "13", 76: "0.0"}, lowers, B) == ()
    etop = dict(zip(range(70, 78), ("300.0", "300.0", "0.0", "195.3", "0.0", "0.0", "0.0", "0.0"), strict=True))
    assert conflicts(FIELDS | etop | {83: "2"}, A, B) == ()
    drive = AxisSetup(Proportional(1.0, -60.0), -50.0, 50.0)
    assert conflicts(FIELDS | {70: "120.0", 83: "1", 80: "3"}, drive, B) == ()
    (found,) = conflicts(FIELDS | {70: "130.0", 83: "1", 80: "3"}, drive, B)
    assert "field 70 of the positioner says -50, but instruments.positioner.a_axis.low_deg is -60" in found
