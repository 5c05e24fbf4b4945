"""Planes under a closed overcast sky, against the integral over the dome."""

import numpy as np
import pytest

from solar.skies.overcast import ISOTROPIC, STANDARD, overcast_factor


@pytest.mark.parametrize("brightening", [ISOTROPIC, STANDARD, 0.5])
@pytest.mark.parametrize("tilt_deg", [0.0, 20.0, 57.0, 75.0, 90.0])
def test_the_overcast_factor_is_the_integral_of_the_radiance_over_the_dome(brightening, tilt_deg):
    zenith = (np.arange(900) + 0.5) * np.pi / 1800
    azimuth = ((np.arange(720) + 0.5) * np.pi / 360)[:, None]
    radiance = (1 + brightening * np.cos(zenith)) * np.sin(zenith)
    tilt = np.radians(tilt_deg)
    incidence = np.cos(zenith) * np.cos(tilt) + np.sin(zenith) * np.sin(tilt) * np.cos(azimuth)
    seen = np.sum(radiance * np.maximum(incidence, 0)) / np.sum(radiance * np.cos(zenith) * np.ones_like(azimuth))
    assert overcast_factor(tilt_deg, brightening, albedo=0.0) == pytest.approx(seen, abs=2e-5)


def test_the_overcast_factor_of_a_vertical_plane_matches_a_calculation_by_hand():
    # 1/2 + 4/(7 pi) (1 - pi/2) = 0.3962, and half of the ground's 0.2.
    assert overcast_factor(90.0) == pytest.approx(0.39618 + 0.1, abs=1e-5)
    assert overcast_factor(0.0) == 1.0
