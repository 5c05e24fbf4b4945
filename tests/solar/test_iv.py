import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from solar.iv import LEAST_SWEEP_POINTS, measured_maximum, sweep_voltages
from solar.pv_module import Q_PEAK_G4_1_305, curve, maximum_power

pytestmark = pytest.mark.slow

MODULE = Q_PEAK_G4_1_305
irradiances = st.floats(20.0, 1300.0)
temperatures = st.floats(-10.0, 75.0)
seeds = st.integers(0, 2**32 - 1)


def swept(irradiance, temperature, points=30, least_v=3.0):
    truth = maximum_power(MODULE, irradiance, temperature)
    voltage = np.concatenate([[truth.voc_v], sweep_voltages(float(truth.voc_v), least_v, points)])
    return truth, voltage, curve(MODULE, irradiance, temperature, voltage)


@given(irradiances, temperatures, st.integers(20, 100))
def test_a_clean_curve_gives_its_maximum_within_two_thousandths(irradiance, temperature, points):
    truth, voltage, current = swept(irradiance, temperature, points)
    found = measured_maximum(voltage, current)
    assert found.pmpp_w == pytest.approx(truth.pmpp_w, rel=2e-3)
    assert found.vmpp_v == pytest.approx(truth.vmpp_v, rel=0.02)
    assert found.impp_a * found.vmpp_v == pytest.approx(found.pmpp_w)
    assert found.voc_v == pytest.approx(truth.voc_v, rel=5e-3)
    assert found.isc_a == pytest.approx(truth.isc_a, rel=5e-3)


@given(st.floats(200.0, 1300.0), temperatures, seeds)
def test_noise_of_0_3_percent_changes_the_maximum_power_by_less_than_1_percent(irradiance, temperature, seed):
    truth, voltage, current = swept(irradiance, temperature)
    noise = np.random.default_rng(seed).normal(0.0, 0.003, current.size) * truth.isc_a
    found = measured_maximum(voltage, current + noise)
    assert found.pmpp_w == pytest.approx(truth.pmpp_w, rel=0.01)


def test_the_stated_uncertainty_of_the_maximum_power_is_of_the_size_of_its_error():
    truth, voltage, current = swept(800.0, 40.0)
    random = np.random.default_rng(7)
    pulls = []
    for _ in range(300):
        found = measured_maximum(voltage, current + random.normal(0.0, 0.01, current.size))
        pulls.append((found.pmpp_w - truth.pmpp_w) / found.pmpp_sigma_w)
    assert 0.7 < np.std(pulls) < 1.6


def test_the_short_circuit_current_of_a_leaky_module_is_that_at_zero_voltage():
    truth, voltage, current = swept(800.0, 25.0, 40)
    leaky = measured_maximum(voltage, current - 0.03 * voltage)
    assert leaky.isc_a == pytest.approx(truth.isc_a, rel=5e-4)


@given(irradiances, temperatures, st.integers(0, 30), st.floats(-3.0, 3.0))
def test_one_outlier_changes_the_maximum_power_by_less_than_2_percent(irradiance, temperature, place, wildness):
    truth, voltage, current = swept(irradiance, temperature)
    current[place] += wildness * truth.isc_a
    assert measured_maximum(voltage, current).pmpp_w == pytest.approx(truth.pmpp_w, rel=0.02)


def test_points_that_are_not_of_one_curve_have_no_maximum():
    # Voltages were read before they had changed, currents after it: 401 W from a module of 305 W.
    voltage = [40.1, 39.6, 40.1, 34.6, 34.6, 30.2, 28.0, 15.5, 3.0]
    found = measured_maximum(voltage, [0.0, 0.86, 5.94, 8.35, 9.4, 9.72, 9.4, 9.83, 9.84])
    assert np.isnan(found.pmpp_w)
    assert "not of one curve" in found.why_not


@pytest.mark.parametrize("points", [19, 20, 30])
def test_a_sparse_curve_is_fitted_through_seven_points_or_more(points):
    _, voltage, current = swept(800.0, 0.0, points)
    assert measured_maximum(voltage, current).points >= 7


def test_a_fit_of_very_few_points_uses_exactly_two_on_either_side_of_the_highest_however_low():
    voltage = np.array([3.0, 8.0, 20.0, 30.0, 33.0, 38.5, 39.3, 39.7])
    power = voltage * curve(MODULE, 1000.0, 25.0, voltage)
    assert np.argmax(power) == 4
    assert (np.delete(power, [3, 4]) < 0.7 * power[4]).all()
    assert measured_maximum(voltage, power / voltage).points == 5


@given(irradiances, temperatures, seeds)
def test_the_maximum_does_not_depend_on_the_order_of_the_points(irradiance, temperature, seed):
    _, voltage, current = swept(irradiance, temperature)
    shuffled = np.random.default_rng(seed).permutation(voltage.size)
    assert measured_maximum(voltage[shuffled], current[shuffled]) == measured_maximum(voltage, current)


@pytest.mark.parametrize(("lowest", "highest"), [(3.0, 25.0), (37.0, 40.0)])
def test_a_curve_without_its_knee_has_no_maximum(lowest, highest):
    voltage = np.linspace(lowest, highest, 30)
    found = measured_maximum(voltage, curve(MODULE, 1000.0, 25.0, voltage))
    assert np.isnan([found.pmpp_w, found.vmpp_v, found.impp_a]).all()
    assert "the knee is not in it" in found.why_not


@pytest.mark.parametrize(("lowest", "highest", "end"), [(3.0, 25.0, 25.0), (37.0, 40.0, 37.0)])
def test_a_curve_without_its_knee_has_no_maximum_even_if_its_end_was_measured_twice(lowest, highest, end):
    voltage = np.append([end], np.linspace(lowest, highest, 30))
    current = curve(MODULE, 1000.0, 25.0, voltage)
    # Whichever measurement of that end comes first, the one with more power has nothing beyond it.
    for less in (0, 1 if end == lowest else 30):
        weaker = current - 1e-3 * (np.arange(31) == less)
        assert "the knee is not in it" in measured_maximum(voltage, weaker).why_not


def noisy(irradiance, temperature, points, seed, noise_a, wild=()):
    _, voltage, current = swept(irradiance, temperature, points)
    current = current + np.random.default_rng(seed).normal(0.0, noise_a, current.size)
    for place, by_a in wild:
        current[place] += by_a
    return voltage, current


# Pmpp, Vmpp, its uncertainty, Voc, Isc and the points used, for curves with scatter and wild points, as this program
# computes them. Its windows, its bounds for wild points and the order of its polynomial show nowhere else.
@pytest.mark.parametrize(("how", "numbers", "points"), [
    ((800, 40, 30, 1, 0.02), (231.46822, 30.940388, 0.14820755, 37.872609, 7.9699393), 11),
    ((300, 10, 20, 2, 0.01, ((5, 1.0), (12, -0.8))), (97.890352, 34.823174, 0.38794264, 40.121927, 2.9348308), 7),
    ((1100, 60, 60, 3, 0.05, ((0, 0.4), (60, 2.0))), (289.59851, 28.154132, 0.58303473, np.nan, 11.84593), 21),
    ((150, 0, 19, 4, 0.02, ((9, -0.3),)), (49.153502, 34.711554, 0.47077979, 40.399119, 1.4262298), 7),
    ((20, 25, 24, 5, 0.05), (6.3372918, 28.820037, 0.64934144, 32.955926, 0.23090018), 7),
    ((900, 25, 12, 6, 0.0), (275.51676, 32.674142, 0.17498667, 39.889423, 8.8561032), 7),
])  # fmt: skip
@pytest.mark.parametrize("scale", [1.0, 1e-3])
def test_the_maxima_of_curves_with_scatter_have_the_pinned_values_however_small_the_cell_is(
    how, numbers, points, scale
):
    voltage, current = noisy(*how)
    found = measured_maximum(
        np.append(scale * voltage, [-1e9, 1.0, np.inf, 1e9]), np.append(current, [1.0, -1e9, 1.0, 1.0])
    )
    got = (found.pmpp_w / scale, found.vmpp_v / scale, found.pmpp_sigma_w / scale, found.voc_v / scale, found.isc_a)
    assert got == pytest.approx(numbers, rel=1e-5, nan_ok=True)
    assert (found.points, found.why_not) == (points, "")
    assert found.impp_a == pytest.approx(found.pmpp_w / found.vmpp_v)


def test_with_too_few_points_the_reason_says_how_many_are_needed():
    found = measured_maximum([10.0, 20.0, 30.0, np.nan, 35.0], [9.0, 9.0, 8.0, 7.0, np.inf])
    assert np.isnan(found.pmpp_w)
    assert found.why_not == "3 usable points, 5 are needed"


def test_a_module_in_the_dark_has_no_maximum():
    found = measured_maximum(np.linspace(0.0, 1e-3, 20), np.zeros(20))
    assert np.isnan(found.pmpp_w)
    assert found.why_not == "no power"


def test_noise_alone_gives_no_maximum():
    random = np.random.default_rng(3)
    found = measured_maximum(np.linspace(0.1, 0.2, 30), random.normal(0.0, 1.0, 30))
    assert np.isnan(found.pmpp_w)


numbers = st.floats(allow_nan=True, allow_infinity=True)


@given(
    st.integers(0, 12).flatmap(
        lambda n: st.tuples(arrays(float, n, elements=numbers), arrays(float, n, elements=numbers))
    )
)
def test_any_points_give_a_finite_maximum_or_a_reason_and_never_raise(points):
    with np.errstate(all="ignore"):
        found = measured_maximum(*points)
    assert np.isfinite([found.pmpp_w, found.vmpp_v, found.impp_a]).all() == (not found.why_not)


@given(st.floats(1.0, 80.0), st.floats(0.0, 0.6), st.integers(LEAST_SWEEP_POINTS, 200))
def test_a_sweep_goes_down_from_near_open_circuit_to_its_least_voltage(voc_v, share, points):
    voltage = sweep_voltages(voc_v, share * voc_v, points)
    assert voltage.shape == (points,)
    assert (np.diff(voltage) < 0).all()
    assert voltage[0] == pytest.approx(0.99 * voc_v)
    assert voltage[-1] == pytest.approx(share * voc_v)


@pytest.mark.parametrize(
    ("voc_v", "least_v", "points"), [(40.0, 3.0, 7), (4.0, 3.0, 30), (np.nan, 3.0, 30), (40.0, -1.0, 30)]
)
def test_a_sweep_with_impossible_voltages_or_too_few_points_is_refused(voc_v, least_v, points):
    with pytest.raises(ValueError, match="sweep"):
        sweep_voltages(voc_v, least_v, points)
