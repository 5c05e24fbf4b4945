"""The paper's own forms: equal to what it prints and computes, and kept apart from the correct ones."""

import csv

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from solar import gain
from solar.gain import printed


@pytest.fixture(scope="module")
def theory(measured):
    folder = measured / "theory"
    if not folder.is_dir():
        pytest.skip(f"the reference tables of the theory are not at {folder}")

    def table(name):
        with (folder / name).open(newline="") as file:
            rows = list(csv.DictReader(file))
        return {name: np.array([float(row[name] or "nan") for row in rows]) for name in rows[0]}

    return table


@pytest.mark.shared_data
def test_the_printed_forms_agree_with_the_reference_and_are_nan_where_it_is(theory):
    points = theory("paper_formulas_points.csv")
    phi, beta, n, deviation = (points[name] for name in ("phi_deg", "beta_deg", "n", "lambda_deg"))
    ours = {
        "KDS_eq11": printed.k_ds_eq11(phi, beta, n, deviation),
        "KDV_eq25": printed.k_dv_eq25(phi, beta, n),
        "KDV_script2": printed.script2(phi, beta, n),
        "KDH_eq49": printed.k_dh_eq49(phi, beta, n, deviation),
        "KDH_script3": printed.script3(phi, beta, n, deviation),
    }
    for name, values in ours.items():
        np.testing.assert_allclose(values, points[name], rtol=1e-9, err_msg=name)
    limit = ~np.isnan(points["KDS_lam0_limit"])
    np.testing.assert_allclose(printed.k_ds_eq13(phi, beta, n)[limit], points["KDS_lam0_limit"][limit], rtol=1e-9)


@pytest.mark.shared_data
@pytest.mark.parametrize(
    ("name", "ratio"),
    [
        ("script1_min_eta_lam5_coarse.csv", lambda phi, beta: printed.script1(phi, beta, gain.DAYS, 5.0).k_ds),
        ("script2_min_eta_lam0_coarse.csv", lambda phi, beta: printed.script2(phi, beta, gain.DAYS)),
        ("script3_min_eta_lam4_coarse.csv", lambda phi, beta: printed.script3(phi, beta, gain.DAYS, 4.0)),
    ],
)
def test_the_tables_of_the_papers_three_scripts_are_reproduced(theory, name, ratio):
    table = theory(name)
    eta = printed.least_eta(ratio(table["phi_deg"][:, None], table["beta_deg"][:, None]))
    np.testing.assert_allclose(eta, table["min_eta_re"], rtol=1e-9)
    assert not table["min_eta_im"].any()


def test_the_printed_equation_11_matches_a_calculation_by_hand():
    # Latitude 45, equinox, azimuth 90: cot = 0, so tan(g pi/24) = sqrt(1/2)/(1/2 sqrt 2) = 1, g = 6 h = T0, h = -6 h.
    # Tilt 90: C1 = C2 = 0, C3 = 1; rows of (3): 0, (12/pi)(cos(pi/2) - cos(pi/2)) = 0, 0: nothing at all.
    # Tilt 45: C2 = 1/2, C3 = sqrt(1/2): rows 12/pi, 12/pi, 12/pi, so K = 12/(36/pi) = pi/3.
    assert printed.k_ds_eq11(45.0, 45.0, 81, 90.0) == pytest.approx(np.pi / 3)


def test_an_azimuth_deviation_of_zero_is_nan_in_the_first_script():
    k_ds, is_complex = printed.script1(np.array([0.0, 30.0, 60.0]), 35.0, 172, 0.0)
    assert np.isnan(k_ds).all()
    assert not is_complex.any()


def test_the_first_script_does_not_notice_complex_times():
    k_ds, is_complex = printed.script1(10.0, 60.0, 172, 90.0)
    assert is_complex
    assert np.isfinite(k_ds)
    assert np.isnan(printed.k_ds_eq11(10.0, 60.0, 172, 90.0))


def test_beyond_the_polar_circle_the_printed_forms_are_nan():
    for n in (172, 355):
        ratios = (printed.k_ds_eq11(70.0, 40.0, n, 5.0), printed.k_dv_eq25(70.0, 40.0, n),
                  printed.k_dh_eq49(70.0, 40.0, n, 5.0), printed.script3(70.0, 40.0, n, 5.0))  # fmt: skip
        assert np.isnan(ratios).all()


@given(st.floats(-65.0, 65.0), st.floats(1.0, 365.0))
def test_without_tilt_the_printed_ratio_of_the_vertical_axis_is_right(phi, n):
    assert printed.k_dv_eq25(phi, 0.0, n) == pytest.approx(float(gain.k_dv(phi, 0.0, n)))


@given(st.floats(24.0, 65.0), st.floats(0.0, 60.0), st.floats(0.5, 60.0), st.floats(1.0, 365.0))
def test_the_first_script_counts_the_middle_of_the_day_three_times(phi, beta, deviation, n):
    # Where cos(theta) > 0 all day: the denominator is R plus twice the energy between T2 and T1.
    energy = gain.static_energy(phi, beta, n, deviation)
    g = _g(phi, n, deviation)
    assume(energy.abs_h - energy.signed_h < 1e-12)
    assume(abs(g) <= float(gain.half_day_h(phi, n)) * np.pi / 12.0)
    dual = 2.0 * gain.half_day_h(phi, n)
    denominator = dual / printed.k_ds_eq11(phi, beta, n, deviation)
    w = np.linspace(-g, g, 20_001)
    p, d, b, turned = np.radians(phi), np.radians(gain.declination_deg(n)), np.radians(beta), np.radians(deviation)
    cosine = np.sin(d) * (np.cos(b) * np.sin(p) - np.sin(b) * np.cos(p) * np.cos(turned)) + np.cos(d) * np.cos(w) * (
        np.cos(b) * np.cos(p) + np.sin(b) * np.sin(p) * np.cos(turned)
    )
    middle = 12.0 / np.pi * np.trapezoid(cosine, w)
    assert denominator == pytest.approx(float(energy.abs_h) + 2.0 * middle, rel=1e-6)


def _g(phi, n, deviation):
    """(9) as an hour angle [rad]; positive where T1 is after noon."""
    p, tangent = np.radians(phi), np.tan(np.radians(gain.declination_deg(n)))
    cotangent = 1.0 / np.tan(np.radians(deviation))
    root = np.sqrt(cotangent**2 + np.sin(p) ** 2 - np.cos(p) ** 2 * tangent**2)
    return 2.0 * np.arctan((root - cotangent) / (np.sin(p) + np.cos(p) * tangent))


def test_the_smallest_eta_ignores_nan_days():
    assert printed.least_eta([np.nan, 1.5, 1.2]) == pytest.approx(0.2)
    assert np.isnan(printed.least_eta([np.nan, np.nan]))


def test_the_first_script_gives_many_cases_at_once_the_results_of_each_alone_complex_or_not():
    cases = np.array([(2.0, 10.0, 172, 85.0), (50.0, 30.0, 80, 20.0), (5.0, 10.0, 1, 80.0), (2.0, 10.0, 80, 85.0)])
    together = printed.script1(*cases.T)
    alone = [printed.script1(*case) for case in cases]
    assert together.k_ds == pytest.approx([float(one.k_ds) for one in alone])
    assert together.complex_breakpoints.tolist() == [True, False, True, False]
    assert together.k_ds[:2] == pytest.approx([0.209822, 1.110998], abs=1e-6)


def test_the_printed_equation_13_is_positive_for_a_panel_that_faces_away_from_the_sun():
    assert printed.k_ds_eq13(10.0, 80.0, 172) > 0.0


def test_on_the_equator_at_the_equinox_the_first_script_has_a_ratio_to_the_west_and_nan_to_the_east():
    # The root of (9) is |cot| and the denominator 0: g = 12 h, so (3) has the rows C2 + C3, 0 and C2 - C3, times 12/pi;
    # to the east 0/0 is no number.
    k_ds, is_complex = printed.script1(0.0, 30.0, 81, np.array([-10.0, 10.0]))
    np.testing.assert_allclose(k_ds, [np.pi / 2.0 / np.cos(np.radians(30.0)), np.nan])
    assert not is_complex.any()


@pytest.mark.parametrize("deviation", [5.0, 90.0])
def test_at_the_poles_the_printed_horizontal_axis_is_nan_without_a_warning(deviation):
    assert np.isnan([form(90.0, 40.0, 172, deviation) for form in (printed.k_dh_eq49, printed.script3)]).all()


def test_the_printed_equation_49_is_never_nan_where_the_sun_passes_through_the_zenith():
    days = gain.DAYS
    assert not np.isnan(printed.k_dh_eq49(gain.declination_deg(days), 0.0, days, 0.0)).any()
