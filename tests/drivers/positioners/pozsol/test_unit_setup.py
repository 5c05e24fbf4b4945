"""Each setting of the unit against the configuration, at the bounds within which they count as equal."""

import math
import re
from dataclasses import replace

import pytest

from drivers.positioners.pozsol.geometry import AxisSetup, Proportional, Triangle
from drivers.positioners.pozsol.unit_setup import conflicts, count_step, missing_fields
from drivers.positioners.pozsol.wire import Field
from tests.drivers.positioners.pozsol.test_geometry import FIELDS, A, B
from tests.drivers.positioners.pozsol.test_opening import on_unit


def told(fields, a=A, b=B):
    return conflicts(FIELDS | fields, a, b)


@pytest.mark.parametrize(
    ("same", "other"),
    [
        ({71: "300.1"}, {71: "300.2"}),
        ({72: "299.9"}, {72: "299.8"}),
        ({74: "0.1"}, {74: "0.2"}),
        ({100: "0.1"}, {100: "0.2"}),
        ({70: "195.4"}, {70: "195.5"}),
        ({96: "256.0"}, {96: "256.1"}),
        ({76: "-90.2"}, {76: "-90.3"}),
        ({77: "0.2"}, {77: "0.3"}),
        ({102: "-37.3"}, {102: "-37.2"}),
        ({192: "0.01"}, {192: "0.02"}),
        ({193: "-0.01"}, {193: "-0.02"}),
        ({110: "11"}, {110: "12"}),
        ({79: "368"}, {79: "367"}),
    ],
)
def test_a_unit_setting_off_by_its_rounding_is_no_conflict_and_off_by_twice_that_is_one(same, other):
    assert told(same) == ()
    (sentence,) = told(other)
    (code,) = other
    # Of two fields that are added up, the first is named.
    assert re.search(rf"field ({code}|{code - 1} \+ {code}|{code} \+ {code + 1})\b", sentence)


def test_the_unit_may_print_its_two_arms_in_either_order_without_a_conflict():
    unequal = replace(A, geometry=Triangle(300.0, 290.0, 90.0, -52.0))
    length = {70: f"{unequal.geometry.low_length_mm:.1f}"}
    assert told(length | {71: "290.0", 72: "300.0"}, unequal) == ()
    assert told(length | {71: "300.0", 72: "290.0"}, unequal) == ()
    (sentence,) = told(length | {71: "285.0", 72: "300.0"}, unequal)
    assert "field 71 of the positioner says 285, but instruments.positioner.a_axis.arm_2_mm is 290" in sentence
    (sentence,) = told(
        length | {71: "285.0", 72: "290.0"}, replace(A, geometry=replace(unequal.geometry, arm_1_mm=280.0))
    )
    assert "field 71 of the positioner says 285, but instruments.positioner.a_axis.arm_1_mm is 280" in sentence
    (sentence,) = told(length | {71: "295.0", 72: "290.0"}, unequal)
    assert "field 71 of the positioner says 295, but instruments.positioner.a_axis.arm_1_mm is 300" in sentence


@pytest.mark.parametrize(
    ("mode", "side", "fixed", "sense", "apex_deg"),
    [
        ("3", "1.0", "-90.0", "raises", 90.0),
        ("3", "-1.0", "-90.0", "raises", 90.0),
        ("3", "0.0", "90.0", "lowers", 90.0),
        ("13", "0.0", "0.0", "raises", 90.0),
        ("13", "1.0", "0.0", "lowers", 90.0),
        ("13", "1.0", "10.0", "lowers", 80.0),
    ],
)
def test_side_and_fixed_angle_are_compared_with_sense_and_apex_according_to_the_geometry_mode(
    mode, side, fixed, sense, apex_deg
):
    low_deg = {"raises": -52.0, "lowers": 52.0}[sense]
    setup = replace(A, geometry=Triangle(300.0, 300.0, apex_deg, low_deg, 0.0, sense))
    unit = {70: f"{setup.geometry.low_length_mm:.1f}", 83: mode, 75: side, 76: fixed, 79: "1000"}
    assert told(unit, setup) == ()
    other = {"1.0": "0.0", "-1.0": "0.0", "0.0": "1.0"}[side]
    (sentence,) = told(unit | {75: other}, setup)
    wrong = "lowers" if sense == "raises" else "raises"
    assert sentence == (
        f"field 75 of the positioner says {float(other):g} (extension {wrong} the angle), but"
        f' instruments.positioner.a_axis.sense is "{sense}": set it to "{wrong}" if the unit is right'
    )
    (sentence,) = told(unit | {77: "5.0"}, setup)
    assert f"field 76 + 77 of the positioner says {apex_deg - 5:g}, but" in sentence


def test_geometry_mode_2_is_read_with_arms_holder_and_length_in_its_own_order():
    unit = dict(zip(range(96, 104), ("300.0", "290.0", "0.0", "0.0", "0.0", "0.0", "52.5", "0.0"), strict=True))
    setup = replace(B, geometry=Triangle(300.0, 290.0, 37.5, 13.0))
    unit |= {99: f"{setup.geometry.low_length_mm:.1f}", 107: "2"}
    assert told(unit, b=setup) == ()
    for code, key in ((96, "arm_1_mm"), (97, "arm_2_mm"), (98, "holder_mm"), (99, "low_deg")):
        (sentence,) = told(unit | {code: str(float(unit[code]) + 2)}, b=setup)
        assert f"field {code} of the positioner says" in sentence
        assert f"b_axis.{key} is" in sentence


def test_a_differing_actuator_length_is_reported_with_the_low_angle_that_it_implies():
    (sentence,) = told({70: "197.3"})
    assert sentence == (
        "field 70 of the positioner says the actuator is 197.3 mm long at its low end, but"
        " instruments.positioner.a_axis.low_deg is -52, which makes it 195.3 mm: set it to -51.60 if the unit is right"
    )


@pytest.mark.parametrize("axis", ["a", "b"])
def test_a_unit_range_that_is_too_small_for_the_limits_is_reported_at_both_ends(axis):
    low, high = {"a": (110, 79), "b": (111, 105)}[axis]
    name = axis.upper()
    begins, ends = told({low: "100", high: "200"})
    assert f"the positioner's range of axis {name} begins at 100 (field {low}), but limits.{axis}_min_deg" in begins
    assert f"the positioner's range of axis {name} ends at 200 (field {high}), but limits.{axis}_min_deg" in ends


DRIVE = AxisSetup(Proportional(1.0, -60.0), -50.0, 50.0)
DRIVES = {70: "120.0", 79: "200", 80: "3", 83: "1"}


@pytest.mark.parametrize(
    ("unit", "count"),
    [
        ({}, 0),
        ({70: "120.1"}, 0),
        ({70: "120.2"}, 1),
        ({80: "2"}, 1),
        ({80: "2", 70: "30.0"}, 0),
        ({80: "4", 70: "30.0"}, 0),
        ({80: "6", 70: "30.0"}, 0),
        ({80: "5", 70: "120.0"}, 0),
        ({80: "7", 70: "30.0"}, 1),
        ({80: "none", 70: "10.0"}, 0),
        ({83: "11", 70: "10.0"}, 0),
        ({83: "none", 70: "10.0"}, 0),
        ({83: "3"}, 1),
        ({83: "2"}, 1),
    ],
)
def test_the_low_angle_of_a_slew_drive_is_compared_according_to_its_coordinate_field(unit, count):
    assert len(told(DRIVES | unit, DRIVE)) == count


def test_a_unit_with_another_position_unit_is_reported_and_impulse_counts_are_not_compared():
    (sentence,) = told(DRIVES | {83: "3"}, DRIVE)
    assert 'has no positions in deg, but instruments.positioner.position_unit is "deg": set it' in sentence
    for mode in ("1", "11", "4"):
        (sentence,) = told({83: mode})
        assert f"field 83 of the positioner says geometry {mode} for axis A, which has no positions in mm" in sentence
    assert told(DRIVES | {83: "3", 79: "5000"}, replace(DRIVE, geometry=Proportional(12.0, -60.0))) == ()
    assert told({83: "none", 71: "10.0"}) == ()


def test_a_setup_field_that_was_not_received_is_no_conflict():
    for code in (75, 76, 77, 70, 71, 72, 74, 79, 110, 192):
        assert conflicts({known: text for known, text in FIELDS.items() if known != code}, A, B) == ()


@pytest.mark.parametrize(("text", "step"), [("1.0", 1.0), ("0.9", None), ("75.0", 1 / 75), ("-75", None), ("?", None)])
def test_the_size_of_a_hall_count_is_derived_from_the_gear_field(text, step):
    assert count_step({78: text}, "a") == step
    assert count_step({104: text}, "b") == step
    assert count_step({104: text}, "a") is None


@pytest.mark.parametrize(("text", "missing"), [("999999", ()), ("-999999", ()), ("1000000", (79,)), ("nan", (79,))])
def test_a_setup_field_that_is_not_a_possible_number_counts_as_missing(text, missing):
    assert missing_fields(FIELDS | {79: text}) == missing


def test_a_missing_setup_field_is_waited_for_only_once_per_unit_and_anew_for_another_unit():
    async def scenario(positioner, unit, now):
        took_s = []
        for serial in (b"1", b"1", b"2"):
            unit.says[Field.SERIAL] = serial
            begin_s = now()
            await positioner.open()
            took_s.append(now() - begin_s)
        assert took_s == pytest.approx([4.5, 0.0, 4.5], abs=0.05)

    on_unit(scenario, comes_s={192: math.inf})
