import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from solar.agreement import agreement


def test_statistics_as_in_the_papers_table_1_match_a_calculation_by_hand():
    found = agreement([110.0, 90.0, 205.0], [100.0, 100.0, 200.0])
    assert found == pytest.approx((3, 5 / 3, 1.25, 25 / 3, 6.25))


def test_pairs_with_nan_are_left_out_and_no_pair_or_a_negative_reference_mean_is_refused():
    assert agreement([np.nan, 90.0, 110.0], [100.0, np.nan, 100.0]).mbe == pytest.approx(10.0)
    with pytest.raises(ValueError, match="no pair"):
        agreement([np.nan], [100.0])
    with pytest.raises(ValueError, match="mean is -1"):
        agreement([1.0], [-1.0])


@given(st.lists(st.tuples(st.floats(0, 1500), st.floats(1, 1500)), min_size=1, max_size=30))
def test_the_mean_absolute_error_is_never_below_the_bias(pairs):
    found = agreement(*np.array(pairs).T)
    assert found.mae >= abs(found.mbe) - 1e-9


def test_bias_and_mean_absolute_error_of_a_few_pairs_match_a_calculation_by_hand():
    found = agreement([98.0, 205.0, 297.0], [100.0, 200.0, 300.0])
    assert found.pairs == 3
    assert found.mbe == pytest.approx(0.0)
    assert found.mae == pytest.approx(10 / 3)
    assert found.rmae_percent == pytest.approx(100 * (10 / 3) / 200)
    low = agreement([97.64, 195.28], [100.0, 200.0])
    assert low.mbe == pytest.approx(-3.54)
    assert low.rmbe_percent == pytest.approx(-2.36)


@pytest.mark.parametrize(("reference", "why"), [([], "no pair"), ([0.0, 0.0], "mean is 0")])
def test_a_comparison_with_no_pairs_or_a_reference_mean_of_zero_is_refused(reference, why):
    with pytest.raises(ValueError, match=why):
        agreement(reference, reference)


def test_readings_and_references_of_different_length_are_refused():
    with pytest.raises(ValueError, match="one shape"):
        agreement([1.0, 2.0], [1.0])
