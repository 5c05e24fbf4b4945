"""Chain bias, energy and equation (16), by hand."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from solar.agreement import agreement
from solar.compare import ChainBias, energy_wh, fit_chain_bias, gain_pct, lies_flat, longest_gap_s


def test_the_polynomial_of_the_chain_bias_passes_through_three_points():
    # Through (100, 103), (200, 208), (300, 315): differences 105 and 107, so c2 = 2/2/100^2, c1 = 1.02, c0 = 0.
    found = fit_chain_bias([100.0, 200.0, 300.0], [103.0, 208.0, 315.0])
    assert found.constant_w == pytest.approx(0.0, abs=1e-9)
    assert found.linear == pytest.approx(1.02)
    assert found.quadratic_per_w == pytest.approx(1e-4)
    assert (found.lowest_w, found.highest_w) == (100.0, 300.0)
    assert found.corrected([150.0]) == pytest.approx([155.25])


def test_a_fit_takes_the_bias_away_and_leaves_the_scatter():
    random = np.random.default_rng(1)
    true = random.uniform(5, 250, 5000)
    cube = true * (0.985 - 5e-5 * true) * (1 + 0.01 * random.standard_normal(true.size))
    found = fit_chain_bias(cube, true)
    assert agreement(cube, true).rmbe_percent < -2.0
    assert agreement(found.corrected(cube), true).rmbe_percent == pytest.approx(0.0, abs=1e-6)
    assert agreement(found.corrected(cube), true).rmae_percent == pytest.approx(0.8, abs=0.3)


def test_a_fit_of_the_chain_bias_to_two_different_powers_is_refused():
    with pytest.raises(ValueError, match="3 different powers"):
        fit_chain_bias([1.0, 2.0, 2.0], [1.0, 2.0, 2.0])


def test_corrected_power_is_never_negative_nan_stays_nan_and_powers_beyond_the_fit_are_marked():
    bias = ChainBias(-2.0, 1.0, 0.0, 5.0, 100.0)
    assert bias.corrected([0.0, 1.0, 10.0]).tolist() == [0.0, 0.0, 8.0]
    assert np.isnan(bias.corrected([np.nan])).all()
    assert bias.is_extrapolated([4.0, 6.0, 99.0, 101.0]).tolist() == [True, False, False, True]


@given(
    st.floats(-2, 2), st.floats(0.9, 1.1), st.floats(-2e-4, 2e-4),
    st.lists(st.integers(1, 300), min_size=3, max_size=40, unique=True),
)  # fmt: skip
def test_a_fit_finds_the_polynomial_that_was_there(constant, linear, quadratic, powers):
    power = np.array(powers, float)
    reference = constant + linear * power + quadratic * power**2
    found = fit_chain_bias(power, reference)
    again = found.constant_w + found.linear * power + found.quadratic_per_w * power**2
    assert again == pytest.approx(reference, abs=1e-6)


def test_energy_is_the_integral_by_the_trapezoidal_rule():
    # 100 W for an hour, then rising to 200 W over another: 100 + 150 Wh.
    assert energy_wh([0, 3600, 7200], [100, 100, 200], longest_gap_s=3600) == pytest.approx(250.0)


def test_a_gap_has_no_energy():
    assert energy_wh([0, 5, 10, 3600, 3605], [360, 360, 360, 360, 360]) == pytest.approx(1.5)


@pytest.mark.parametrize(
    ("utc_s", "gap_s"),
    [
        ([], 60.0),
        ([7.0], 60.0),
        ([0, 5, 10, 3600, 3605], 60.0),
        ([0, 59.8, 120.1, 180], 89.85),
        ([0, 300, 600], 450.0),
        ([0, 28800], 3600.0),
    ],
)
def test_the_longest_step_that_is_no_gap_follows_from_the_median_step(utc_s, gap_s):
    assert longest_gap_s(utc_s) == pytest.approx(gap_s)


@pytest.mark.parametrize("power_w", [[1.0, 2.0, 3.0], [[1.0, 2.0], [3.0, 4.0]]])
@pytest.mark.parametrize("utc_s", [[0.0, 5.0], [[0.0, 5.0], [10.0, 15.0]]])
def test_the_energy_of_series_of_different_length_or_of_two_dimensions_is_refused(utc_s, power_w):
    with pytest.raises(ValueError, match="two rows of numbers of one length are needed"):
        energy_wh(utc_s, power_w)


def test_the_gain_matches_equation_16_by_hand():
    # 0.5 W more than 40 W for one hour.
    time = np.arange(0, 3601, 5.0)
    cube, chrono = (energy_wh(time, np.full(time.shape, power)) for power in (40.5, 40.0))
    assert gain_pct(cube, chrono) == pytest.approx(1.25)
    assert gain_pct(99.0, 100.0) == pytest.approx(-1.0)
    assert np.isnan(gain_pct(1.0, 0.0))


def test_a_tracker_counts_as_flat_within_two_degrees_of_the_horizontal():
    a_deg, b_deg = [0.0, 1.9, 2.1, 0.0, 0.0, np.nan], [90.0, 90.0, 90.0, 88.1, 87.9, 90.0]
    assert lies_flat(a_deg, b_deg).tolist() == [True, True, False, True, False, False]
