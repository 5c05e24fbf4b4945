"""The exact ratios against hand-worked cases, invariants, quadrature and the reference tables."""

import csv

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from solar import gain
from solar.gain.geometry import declination_deg, energy_ratio, sun_path
from solar.gain.vertical import half_day_cosine

latitudes = st.floats(-90.0, 90.0)
tilts = st.floats(-90.0, 90.0)
days = st.integers(1, 365)
deviations = st.floats(-180.0, 180.0)
EQUINOX = 81


@pytest.fixture(scope="module")
def theory(measured):
    folder = measured / "theory"
    if not folder.is_dir():
        pytest.skip(f"the reference tables of the theory are not at {folder}")

    def table(name):
        with (folder / name).open(newline="") as file:
            rows = list(csv.DictReader(file))
        names = [name for name in rows[0] if name not in ("tag", "note")]
        return {name: np.array([float(row[name] or "nan") for row in rows]) for name in names}

    return table


def sun_at(phi, n, w):
    """East, north and up of the sun, by the spherical triangle."""
    p, d = np.radians(phi), np.radians(declination_deg(n))
    east = -np.cos(d) * np.sin(w)
    north = np.sin(d) * np.cos(p) - np.cos(d) * np.sin(p) * np.cos(w)
    return east, north, np.sin(d) * np.sin(p) + np.cos(d) * np.cos(p) * np.cos(w)


def panel(beta, deviation):
    """East, north and up of a static panel's normal."""
    b, turned = np.radians(beta), np.radians(deviation)
    return np.sin(b) * np.sin(turned), -np.sin(b) * np.cos(turned), np.cos(b)


def quadrature(phi, n, integrand, points=40_000):
    """Return the integral of `integrand(w)` over the day, in hours, by the midpoint rule."""
    w0 = float(sun_path(phi, n).w0)
    step = 2.0 * w0 / points
    w = -w0 + (np.arange(points) + 0.5) * step
    return 12.0 / np.pi * step * integrand(w).sum()


def test_on_the_equator_at_the_equinox_a_flat_panel_gets_two_over_pi_of_a_dual_axis_tracker():
    # cos(theta) = cos w over 12 h: 24/pi h of 12 h.
    assert gain.k_ds(0.0, 0.0, EQUINOX) == pytest.approx(np.pi / 2)
    assert gain.k_dv(0.0, 0.0, EQUINOX) == pytest.approx(np.pi / 2)


def test_on_the_equator_at_the_equinox_the_papers_horizontal_axis_faces_the_sun_all_day():
    assert gain.k_dh(0.0, 0.0, EQUINOX) == pytest.approx(1.0)


def test_an_upright_panel_that_faces_east_receives_the_energy_of_the_morning():
    # Equator, equinox, upright: sin(-w) from -pi/2 to 0 is 12/pi h; twice that if its back counts too.
    energy = gain.static_energy(0.0, 90.0, EQUINOX, 90.0)
    assert energy.clip_h == pytest.approx(12.0 / np.pi)
    assert energy.abs_h == pytest.approx(24.0 / np.pi)
    assert energy.signed_h == pytest.approx(0.0, abs=1e-12)


def test_at_the_pole_the_ratios_are_those_of_a_sun_that_circles_at_its_declination():
    n = 172
    height = np.radians(declination_deg(n))
    assert gain.half_day_h(90.0, n) == 12.0
    assert gain.k_ds(90.0, 0.0, n) == pytest.approx(1.0 / np.sin(height))
    assert gain.k_dv(90.0, 90.0 - declination_deg(n), n) == pytest.approx(1.0)
    # An upright panel is lit for half the circle: 24/pi cos(delta) h of 24 h.
    assert gain.k_ds(90.0, 90.0, n, 33.0) == pytest.approx(np.pi / np.cos(height))
    # OM.OQ = cos^2(delta) |sin w| + sin^2(delta) for beta = 0.
    expected = np.cos(height) ** 2 * 2.0 / np.pi + np.sin(height) ** 2
    assert gain.k_dh(90.0, 0.0, n) == pytest.approx(1.0 / expected)


def test_polar_night_has_no_ratio_and_no_energy():
    assert gain.half_day_h(80.0, 355) == 0.0
    for ratio in (gain.k_ds(80.0, 40.0, 355), gain.k_dv(80.0, 40.0, 355), gain.k_dh(80.0, 40.0, 355)):
        assert np.isnan(ratio)
    assert gain.static_energy(80.0, 40.0, 355).clip_h == 0.0


def test_a_panel_that_the_sun_never_sees_makes_the_ratio_infinite():
    # Facing north, upright, in the northern winter.
    assert gain.k_ds(50.0, -90.0, 355) == np.inf
    assert np.isfinite(gain.k_ds(50.0, -90.0, 355, rear_face=True))
    assert gain.eta_vs(50.0, -90.0, 60.0, 355) == np.inf


def test_at_the_equinox_the_integral_of_the_cosine_is_the_complete_elliptic_integral():
    # I_c = E(cos^2 phi): pi/2 at the poles, 1 on the equator.
    assert half_day_cosine(sun_path(0.0, EQUINOX)) == pytest.approx(1.0, rel=1e-12)
    assert half_day_cosine(sun_path(89.999999, EQUINOX)) == pytest.approx(np.pi / 2, rel=1e-9)


@pytest.mark.parametrize("phi", [-90.0, -80.0, -66.5, -10.0, 0.0, 23.0, 45.0, 66.6, 70.0, 85.0, 90.0])
@pytest.mark.parametrize("n", [1, 81, 100, 172, 200, 300])
def test_the_integral_of_the_cosine_of_the_elevation_is_that_of_quadrature(phi, n):
    expected = quadrature(phi, n, lambda w: np.hypot(*sun_at(phi, n, w)[:2])) / (24.0 / np.pi)
    assert half_day_cosine(sun_path(phi, n)) == pytest.approx(expected, rel=1e-7, abs=1e-12)


@settings(max_examples=60)
@given(latitudes, tilts, days, deviations)
def test_daily_energies_agree_with_quadrature(phi, beta, n, deviation):
    cosine = lambda w: sum(u * v for u, v in zip(sun_at(phi, n, w), panel(beta, deviation), strict=True))  # noqa: E731
    static = gain.static_energy(phi, beta, n, deviation)
    assert static.clip_h == pytest.approx(quadrature(phi, n, lambda w: np.maximum(cosine(w), 0.0)), abs=5e-6)
    assert static.abs_h == pytest.approx(quadrature(phi, n, lambda w: np.abs(cosine(w))), abs=5e-6)
    assert static.signed_h == pytest.approx(quadrature(phi, n, cosine), abs=5e-6)

    def horizontal(w):
        east, north, up = sun_at(phi, n, w)
        across = np.cos(np.radians(deviation)) * east + np.sin(np.radians(deviation)) * north
        turned = np.sign(-w) * np.hypot(east, north) * across
        return turned + up * cosine(w)

    assert gain.horizontal_energy_h(phi, beta, n, deviation) == pytest.approx(quadrature(phi, n, horizontal), abs=5e-6)

    def vertical(w):
        east, north, up = sun_at(phi, n, w)
        return np.sin(np.radians(abs(beta))) * np.hypot(east, north) + np.cos(np.radians(beta)) * up

    assert gain.vertical_energy_h(phi, beta, n) == pytest.approx(quadrature(phi, n, vertical), abs=5e-6)


@given(latitudes, tilts, days, deviations)
def test_no_panel_or_single_axis_receives_more_than_a_dual_axis(phi, beta, n, deviation):
    for ratio in (gain.k_ds(phi, beta, n, deviation), gain.k_ds(phi, beta, n, deviation, rear_face=True),
                  gain.k_dv(phi, beta, n), gain.k_dh(phi, beta, n, deviation)):  # fmt: skip
        assert np.isnan(ratio) or ratio >= 1.0 - 1e-12


@given(latitudes, tilts, days, deviations)
def test_an_azimuth_deviation_to_the_east_is_as_good_as_one_to_the_west(phi, beta, n, deviation):
    east, west = gain.daily(phi, beta, n, deviation), gain.daily(phi, beta, n, -deviation)
    for name in ("static", "static_abs", "horizontal"):
        assert getattr(east, name) == pytest.approx(getattr(west, name), abs=1e-12)


@given(latitudes, tilts, st.floats(1.0, 182.5), deviations)
def test_the_hemispheres_mirror_each_other_half_a_year_apart(phi, beta, n, deviation):
    # Cooper's declination changes its sign after half of its 365 days.
    north, south = gain.daily(phi, beta, n, deviation), gain.daily(-phi, -beta, n + 182.5, deviation)
    for name in ("dual", "static", "static_abs", "vertical", "horizontal"):
        assert getattr(north, name) == pytest.approx(getattr(south, name), abs=1e-7)


@given(latitudes, tilts, days, deviations)
def test_the_energy_of_the_lit_face_is_the_mean_of_the_absolute_and_the_signed_energy(phi, beta, n, deviation):
    energy = gain.static_energy(phi, beta, n, deviation)
    assert energy.clip_h == pytest.approx((energy.abs_h + energy.signed_h) / 2.0, abs=1e-12)
    back = gain.static_energy(phi, -beta, n, deviation)
    flat = gain.static_energy(phi, 0.0, n)
    # The normals at beta and -beta add up to 2 cos(beta) up, and so do the signed sums.
    assert energy.signed_h + back.signed_h == pytest.approx(2 * np.cos(np.radians(beta)) * flat.signed_h, abs=1e-11)


@given(st.floats(-66.0, 66.0), st.floats(1.0, 182.5), st.floats(-1.0, 1.0), st.floats(-np.pi, np.pi))
def test_turning_a_two_sided_panel_about_the_earths_axis_keeps_its_energy_over_opposite_days(phi, n, axial, turned):
    # Summed over opposite declinations, only the part of its normal along the axis counts.
    p, equatorial = np.radians(phi), np.sqrt(1.0 - axial**2)
    up = axial * np.sin(p) + equatorial * np.cos(p) * np.cos(turned)
    assume(up >= 0.0)
    north = axial * np.cos(p) - equatorial * np.sin(p) * np.cos(turned)
    east = -equatorial * np.sin(turned)
    beta, deviation = np.degrees(np.arctan2(np.hypot(north, east), up)), np.degrees(np.arctan2(east, -north))

    def both(tilt, azimuth):
        return sum(float(gain.static_energy(phi, tilt, day, azimuth).abs_h) for day in (n, n + 182.5))

    facing = float(np.degrees(p - np.arcsin(axial)))
    assume(abs(facing) <= 90.0)
    assert both(min(beta, 90.0), deviation) == pytest.approx(both(facing, 0.0), abs=1e-6)


@given(latitudes, tilts, tilts, tilts, days, deviations)
def test_the_gains_over_static_are_quotients_of_the_ratios(phi, beta, beta_v, beta_h, n, deviation):
    static = gain.k_ds(phi, beta, n, deviation)
    assume(np.isfinite(static))
    vertical, horizontal = gain.k_dv(phi, beta_v, n), gain.k_dh(phi, beta_h, n, deviation)
    assert gain.eta_vs(phi, beta, beta_v, n, deviation) == pytest.approx(float(static / vertical - 1.0))
    assert gain.eta_hs(phi, beta, beta_h, n, deviation, deviation) == pytest.approx(float(static / horizontal - 1.0))


def test_arguments_broadcast_and_a_years_energy_is_the_sum_of_its_days():
    phi, beta, deviation = np.array([-30.0, 48.7, 80.0])[:, None, None], np.array([10.0, 50.0])[:, None], np.zeros(4)
    year = gain.yearly(phi, beta, deviation)
    assert year.static.shape == (3, 2, 4)
    by_hand = sum(gain.daily(48.7, 50.0, day).vertical for day in gain.DAYS)
    assert year.vertical[1, 1, 0] == pytest.approx(by_hand)
    assert year.k_dv[1, 1, 0] == pytest.approx(sum(gain.daily(48.7, 50.0, day).dual for day in gain.DAYS) / by_hand)


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        ((91.0, 0.0, 1), r"latitude must be in -90\.\.90 deg, not 91"),
        ((np.nan, 0.0, 1), r"latitude must be in -90\.\.90 deg, not nan"),
        (([10.0, -95.0], 0.0, 1), r"latitude must be in -90\.\.90 deg, not -95"),
        ((0.0, 90.5, 1), r"tilt must be in -90\.\.90 deg, not 90\.5"),
        ((0.0, 0.0, 366), r"day must be in 1\.\.365, not 366"),
        ((0.0, 0.0, 1, np.inf), r"azimuth must be in -360\.\.360 deg, not inf"),
    ],
)
def test_a_latitude_tilt_day_or_azimuth_out_of_range_is_refused_by_name(arguments, sentence):
    with pytest.raises(ValueError, match=sentence):
        gain.daily(*arguments)


def test_an_energy_ratio_is_infinite_by_zero_or_less_and_nan_of_zero_by_zero():
    assert np.array_equal(
        energy_ratio([2.0, 2.0, 2.0, 0.0], [1.0, 0.0, -1.0, 0.0]), [2.0, np.inf, np.inf, np.nan], True
    )


@pytest.mark.shared_data
def test_ratios_agree_with_quadrature_to_thirty_digits(theory):
    points = theory("exact_points.csv")
    phi, beta, n, deviation = (points[name] for name in ("phi_deg", "beta_deg", "n", "lambda_deg"))
    ours = {
        "KDS_abs": gain.k_ds(phi, beta, n, deviation, rear_face=True),
        "KDS_clip": gain.k_ds(phi, beta, n, deviation),
        "KDV": gain.k_dv(phi, beta, n),
        "KDH_day_signed": gain.k_dh(phi, beta, n, deviation),
        "T0_h": gain.half_day_h(phi, n),
    }
    for name, values in ours.items():
        expected = np.where(points[name] > 1e15, np.inf, points[name])
        np.testing.assert_allclose(values, expected, rtol=1e-12, err_msg=name)


@pytest.mark.shared_data
def test_yearly_energies_agree_with_the_reference_table(theory):
    table = theory("annual_exact.csv")
    year = gain.yearly(table["phi_deg"], table["beta_deg"], table["lambda_deg"])
    for name, field in {"Rmax_h": "dual", "RS_abs_h": "static_abs", "RS_clip_h": "static", "RV_h": "vertical",
                        "RH_day_signed_h": "horizontal"}.items():  # fmt: skip
        np.testing.assert_allclose(getattr(year, field), table[name], rtol=1e-12, atol=1e-9, err_msg=name)


@pytest.mark.parametrize(
    ("ratio", "arguments"),
    [
        (gain.k_dv, (0.0, 90.5, 1)),
        (gain.k_dh, (0.0, 90.5, 1)),
        (gain.k_dh, (0.0, 0.0, 1, 360.5)),
        (gain.k_ds, (0.0, 90.5, 1)),
        (gain.k_ds, (0.0, 0.0, 1, 360.5)),
    ],
)
def test_each_ratio_refuses_a_tilt_or_azimuth_out_of_range_by_itself(ratio, arguments):
    with pytest.raises(ValueError, match=r"(tilt|azimuth) must be in .* not (90|360)\.5"):
        ratio(*arguments)


@pytest.mark.parametrize(
    ("what", "arguments"),
    [
        (gain.static_energy, (45.0, 60.0, 172)),
        (gain.k_ds, (45.0, 60.0, 172)),
        (gain.horizontal_energy_h, (45.0, 60.0, 172)),
        (gain.k_dh, (45.0, 60.0, 172)),
        (gain.eta_vs, (45.0, 60.0, 60.0, 172)),
        (gain.best_tilt_static, (45.0,)),
        (gain.best_tilt_horizontal, (45.0,)),
    ],
)
def test_without_an_azimuth_each_energy_ratio_and_best_tilt_is_for_a_panel_towards_the_equator(what, arguments):
    said = {"lambda_deg": 0.0}
    np.testing.assert_array_equal(what(*arguments), what(*arguments, **said))


def test_without_an_azimuth_daily_yearly_and_eta_hs_are_for_panels_towards_the_equator():
    for whole, arguments in ((gain.daily, (45.0, 60.0, 172)), (gain.yearly, (45.0, 60.0))):
        assert whole(*arguments).static == whole(*arguments, 0.0).static
    both = (45.0, 60.0, 30.0, 172)
    assert gain.eta_hs(*both) == gain.eta_hs(*both, 0.0, 0.0)


def test_ratios_and_gains_of_energies_match_a_calculation_by_hand():
    some = gain.Energies(*(np.array(hours) for hours in (12.0, 6.0, 8.0, 9.0, 10.0)))
    assert (some.k_ds_clip, some.k_ds_abs, some.k_dh) == pytest.approx((2.0, 1.5, 1.2))
    assert (some.k_dv, some.eta_vs, some.eta_hs) == pytest.approx((4.0 / 3.0, 0.5, 2.0 / 3.0))


def test_a_horizontal_axis_with_its_back_to_the_sun_has_a_gain_of_minus_1_over_a_static_panel():
    # Upright and turned to the north in the northern winter, neither receives anything.
    assert gain.eta_hs(50.0, 30.0, -90.0, 355, 0.0, 180.0) == -1.0
    assert np.isnan(gain.eta_hs(50.0, -90.0, -90.0, 355, 0.0, 180.0))


def test_a_few_minutes_of_sun_have_an_energy_ratio_and_a_rounding_error_counts_as_zero():
    assert energy_ratio([0.5, 1.0, 1.0], [0.25, 1.5e-15, 0.5e-15]) == pytest.approx([2.0, 1.0 / 1.5e-15, np.inf])


def test_the_gain_over_a_static_panel_in_the_dark_is_nan_without_a_warning():
    energies = gain.daily(0.0, 90.0, 80.0, -180.0)
    assert energies.static == 0.0
    assert energies.horizontal < 0.0
    assert np.isnan(energies.eta_hs)
