import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from solar import gain

latitudes = st.floats(-90.0, 90.0)


@settings(max_examples=25)
@given(latitudes, st.floats(0.0, 90.0))
def test_a_vertical_axis_receives_the_cosine_of_its_distance_from_the_best_tilt(phi, tilt):
    best = gain.best_tilt_vertical(phi)
    expected = best.energy_h * np.cos(np.radians(tilt - best.tilt_deg))
    assert gain.yearly(phi, tilt).vertical == pytest.approx(expected, rel=1e-12)


@settings(max_examples=25)
@given(latitudes, st.floats(-90.0, 90.0), st.floats(-90.0, 90.0))
def test_no_tilt_receives_more_than_the_best(phi, tilt, deviation):
    year = gain.yearly(phi, tilt, deviation)
    assert year.static <= gain.best_tilt_static(phi, deviation).energy_h * (1 + 1e-9)
    assert year.horizontal <= gain.best_tilt_horizontal(phi, deviation).energy_h * (1 + 1e-9) + 1e-9


@settings(max_examples=25)
@given(latitudes, st.floats(-90.0, 90.0))
def test_the_energy_stated_with_the_best_tilt_is_what_that_tilt_receives(phi, deviation):
    static, horizontal = gain.best_tilt_static(phi, deviation), gain.best_tilt_horizontal(phi, deviation)
    assert gain.yearly(phi, static.tilt_deg, deviation).static == pytest.approx(static.energy_h)
    assert gain.yearly(phi, horizontal.tilt_deg, deviation).horizontal == pytest.approx(
        float(horizontal.energy_h), abs=1e-8
    )


def test_a_static_panel_leans_a_little_less_than_the_latitude_and_towards_the_equator():
    tilts = gain.best_tilt_static(np.array([-40.0, 0.0, 40.0])).tilt_deg
    assert tilts == pytest.approx([-37.675, 0.0, 37.675], abs=1e-3)


def test_at_the_poles_the_best_tilt_of_a_static_panel_is_given_towards_the_equator():
    assert gain.best_tilt_static(90.0).tilt_deg > 0.0
    assert gain.best_tilt_static(-90.0).tilt_deg < 0.0


def test_on_the_equator_at_the_equinox_the_best_tilt_of_a_vertical_axis_is_45_degrees():
    # Integrals of cos and sin of the elevation over the day are both 1.
    best = gain.best_tilt_vertical(0.0, days=[81])
    assert best.tilt_deg == pytest.approx(45.0)
    assert best.energy_h == pytest.approx(24.0 / np.pi * np.sqrt(2.0))


def test_without_sun_there_is_no_best_tilt():
    for best in (gain.best_tilt_vertical(85.0, days=[355]), gain.best_tilt_static(85.0, days=[355]),
                 gain.best_tilt_horizontal(85.0, days=[355])):  # fmt: skip
        assert np.isnan(best.tilt_deg)
        assert best.energy_h == 0.0


def test_a_loss_of_1_percent_allows_8_degrees_from_the_best_tilt_at_every_latitude():
    assert gain.tilt_tolerance_deg(0.01) == pytest.approx(8.1096, abs=1e-4)
    phi = np.array([0.0, 30.0, 60.0, 85.0])
    best = gain.best_tilt_vertical(phi)
    off = gain.yearly(phi, best.tilt_deg - gain.tilt_tolerance_deg(0.01)).vertical
    assert off / best.energy_h == pytest.approx(np.full(4, 0.99))


def test_a_nan_loss_is_refused():
    with pytest.raises(ValueError, match=r"a loss is a share in 0\.\.1, not nan"):
        gain.tilt_tolerance_deg(float("nan"))


@pytest.mark.parametrize(("loss", "tolerance_deg"), [(0.0, 0.0), (0.5, 60.0), (1.0, 90.0)])
def test_the_tilt_tolerance_is_right_for_losses_of_nothing_half_and_all(loss, tolerance_deg):
    assert gain.tilt_tolerance_deg(loss) == pytest.approx(tolerance_deg)


@pytest.mark.parametrize("loss", [-0.01, 1.01])
def test_a_loss_outside_0_to_1_is_refused(loss):
    with pytest.raises(ValueError, match=r"0\.\.1"):
        gain.tilt_tolerance_deg(loss)


@pytest.mark.parametrize("best_tilt", [gain.best_tilt_vertical, gain.best_tilt_horizontal, gain.best_tilt_static])
def test_best_tilts_of_many_latitudes_at_once_equal_those_of_each_alone(best_tilt):
    phi, days = np.array([[-30.0, 48.7], [10.0, 80.0]]), [172, 200, 300]
    together = best_tilt(phi, days=days)
    alone = [[best_tilt(float(one), days=days) for one in row] for row in phi]
    np.testing.assert_allclose(together.tilt_deg, [[float(one.tilt_deg) for one in row] for row in alone])
    np.testing.assert_allclose(together.energy_h, [[float(one.energy_h) for one in row] for row in alone])


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_the_best_tilt_for_a_day_of_less_than_an_hour_is_right(side):
    # The panel is lit all day: the best one faces along the sum of the sun's directions.
    n, p, d = (355 if side > 0 else 172), np.radians(66.4), np.radians(-23.4498)
    w0 = np.arccos(-np.tan(p) * np.tan(d))
    assert 24.0 / np.pi * w0 < 1.0
    upward = 24.0 / np.pi * (w0 * np.sin(d) * np.sin(p) + np.sin(w0) * np.cos(d) * np.cos(p))
    towards = 24.0 / np.pi * (-w0 * np.sin(d) * np.cos(p) + np.sin(w0) * np.cos(d) * np.sin(p))
    tilt_deg, energy_h = np.degrees(np.arctan2(towards, upward)), np.hypot(towards, upward)
    for best in (gain.best_tilt_static(side * 66.4, days=[n]), gain.best_tilt_vertical(side * 66.4, days=[n])):
        assert abs(best.tilt_deg) == pytest.approx(tilt_deg, abs=2e-3)
        assert best.energy_h == pytest.approx(energy_h, rel=3e-3)
