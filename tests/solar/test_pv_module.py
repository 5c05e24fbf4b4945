import math
from dataclasses import astuple, replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pvlib import pvsystem

from solar.pv_module import Q_PEAK_G4_1_305, cell_temperature, curve, maximum_power, single_diode

irradiances = st.floats(1.0, 1400.0)
temperatures = st.floats(-20.0, 90.0)


def test_the_example_module_gives_what_its_data_sheet_says_at_standard_conditions():
    points = maximum_power(Q_PEAK_G4_1_305, 1000.0, 25.0)
    given = (points.pmpp_w, points.vmpp_v, points.impp_a, points.voc_v, points.isc_a)
    assert given == pytest.approx((305.0, 32.62, 9.35, 40.05, 9.84), rel=1e-3)


def test_the_parameters_of_the_example_module_are_those_of_the_cec_module_database():
    entry = pvsystem.retrieve_sam("CECMod")["Hanwha_Q_Cells_Q_PEAK_G4_1_305"]
    module = Q_PEAK_G4_1_305
    ours = (module.photocurrent_a, module.saturation_current_a, module.series_resistance_ohm, module.ideality_v)
    assert ours == tuple(entry[["I_L_ref", "I_o_ref", "R_s", "a_ref"]])
    assert (module.shunt_resistance_ohm, module.isc_per_k_a, module.adjust_pct) == tuple(
        entry[["R_sh_ref", "alpha_sc", "Adjust"]]
    )


def test_a_warm_module_loses_about_as_much_as_its_data_sheet_says():
    cool, warm = maximum_power(Q_PEAK_G4_1_305, 1000.0, [25.0, 45.0]).pmpp_w
    assert (warm / cool - 1.0) / 20.0 == pytest.approx(-0.0039, abs=3e-4)


@given(irradiances, temperatures)
def test_the_iv_curve_passes_through_its_characteristic_points_and_never_rises(irradiance, temperature):
    points = maximum_power(Q_PEAK_G4_1_305, irradiance, temperature)
    steps = np.linspace(0.0, float(points.voc_v), 200)
    current = curve(Q_PEAK_G4_1_305, irradiance, temperature, steps)
    assert current[[0, -1]] == pytest.approx([points.isc_a, 0.0], rel=1e-6, abs=1e-6)
    assert (np.diff(current) <= 1e-9).all()
    assert curve(Q_PEAK_G4_1_305, irradiance, temperature, points.vmpp_v) == pytest.approx(points.impp_a, rel=1e-6)
    assert (steps * current).max() <= points.pmpp_w * (1 + 1e-9)


@given(irradiances, temperatures, st.floats(0.0, 0.95))
def test_the_voltage_found_for_a_current_lies_on_the_iv_curve(irradiance, temperature, share):
    points = maximum_power(Q_PEAK_G4_1_305, irradiance, temperature)
    wanted = share * points.isc_a
    one = single_diode(Q_PEAK_G4_1_305, irradiance, temperature)
    found = one.voltage(float(wanted))
    assert curve(Q_PEAK_G4_1_305, irradiance, temperature, found) == pytest.approx(wanted, rel=1e-6, abs=1e-9)
    assert one.voltage(0.0) == pytest.approx(points.voc_v)


def test_arguments_of_any_shape_broadcast():
    irradiance, temperature = np.array([[0.0], [500.0], [1000.0]]), np.array([10.0, 40.0])
    points = maximum_power(Q_PEAK_G4_1_305, irradiance, temperature)
    assert points.pmpp_w.shape == (3, 2)
    assert points.pmpp_w[2, 1] == maximum_power(Q_PEAK_G4_1_305, 1000.0, 40.0).pmpp_w
    assert curve(Q_PEAK_G4_1_305, irradiance[..., None], temperature[:, None], np.zeros(7)).shape == (3, 2, 7)


def test_no_light_gives_zeros_and_nan_gives_nan():
    points = maximum_power(Q_PEAK_G4_1_305, [0.0, -3.0, np.nan, 800.0], [20.0, 20.0, 20.0, np.nan])
    for each in (points.pmpp_w, points.vmpp_v, points.impp_a, points.voc_v, points.isc_a):
        assert each[:2].tolist() == [0.0, 0.0]
        assert np.isnan(each[2:]).all()
    dark = curve(Q_PEAK_G4_1_305, [0.0, -3.0, np.nan, 800.0], [20.0, 20.0, 20.0, np.nan], 30.0)
    assert dark[:2].tolist() == [0.0, 0.0]
    assert np.isnan(dark[2:]).all()


def test_the_cell_temperature_matches_faimans_model_by_hand():
    # 20 + 800 / (25 + 6.84 * 2)
    assert cell_temperature(800.0, 20.0, 2.0) == pytest.approx(20.0 + 800.0 / 38.68)
    assert cell_temperature([0.0, 800.0], [5.0, 20.0]).shape == (2,)


@pytest.mark.parametrize("module", [Q_PEAK_G4_1_305, replace(Q_PEAK_G4_1_305, series_resistance_ohm=1.5)])
@pytest.mark.parametrize("irradiance", [0.01, 5.0, 200.0, 1000.0, 1400.0])
@pytest.mark.parametrize("cell_c", [-20.0, 25.0, 80.0])
def test_the_scalar_single_diode_model_agrees_with_the_array_model(module, irradiance, cell_c):
    one = single_diode(module, irradiance, cell_c)
    volts = np.array([-20.0, 0.0, 1.0, 20.0, 32.0, 36.0, 40.0, 60.0, 240.0])
    assert [one.current(each) for each in volts] == pytest.approx(curve(module, irradiance, cell_c, volts), abs=1e-8)
    amperes = np.linspace(-5.0, 0.99 * one.current(0.0), 12)
    assert [one.current(one.voltage(each)) for each in amperes] == pytest.approx(amperes, abs=1e-9)
    ours, theirs = (
        list(map(float, astuple(each))) for each in (one.maximum(), maximum_power(module, irradiance, cell_c))
    )
    # pvlib searches for the highest point, where the curve is level: it finds the height more exactly than the place.
    assert ours == pytest.approx(theirs, rel=1e-6)
    assert ours[0] == pytest.approx(theirs[0], rel=1e-9)


def test_the_scalar_model_gives_zeros_in_the_dark_and_nan_for_nan():
    for irradiance in (0.0, -3.0):
        one = single_diode(Q_PEAK_G4_1_305, irradiance, 10.0)
        assert (one.current(20.0), one.voltage(0.0)) == (0.0, 0.0)
        assert astuple(one.maximum()) == (0.0, 0.0, 0.0, 0.0, 0.0)
    unknown = single_diode(Q_PEAK_G4_1_305, math.nan, 10.0)
    assert np.isnan([unknown.current(20.0), unknown.voltage(0.0), *astuple(unknown.maximum())]).all()
