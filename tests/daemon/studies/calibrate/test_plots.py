"""What the figure of a calibration beside a reference shows."""

import numpy as np

from daemon.base.records import FACES
from daemon.config.sections import CubeSettings
from daemon.studies.calibrate.plots import comparison_figure
from daemon.studies.calibrate.readings import FaceReadings, ReferenceReadings
from daemon.studies.calibrate.reference_comparison import compare
from solar.calibration.selection import clear_sky_ghi
from solar.ephemeris import DAY_S, Site

SIRTA = Site(48.7176, 2.2090, 156.0)
MARCH = 1_646_092_800.0
"""2022-03-01T00:00Z."""


def test_every_reading_is_inside_the_axes_of_the_calibration_figure_however_wrong_the_old_gains():
    utc_s = MARCH + np.arange(0.0, 2 * DAY_S, 60.0)
    ghi = clear_sky_ghi(SIRTA, utc_s)[0]
    cube = CubeSettings()
    told = np.array([getattr(cube, face).gain_w_m2_per_mv for face in FACES])
    true = told * [0.8, 0.95, 1.0, 1.3]
    found = compare(
        ReferenceReadings("reference", utc_s, ghi, "", simulated=True),
        FaceReadings("sensors", utc_s, ghi[:, None] / true, in_mv=True, calibrations=frozenset({""})),
        SIRTA,
        cube,
        lag=0.0,
        reference_uncertainty_percent=1.5,
    )
    figure = comparison_figure(found, simulated=True)
    for axes in figure.axes:
        (left, right), (low, high) = axes.get_xlim(), axes.get_ylim()
        for dots in axes.collections:
            x, y = dots.get_offsets().data.T
            assert (left <= x.min()) & (x.max() <= right) & (low <= y.min()) & (y.max() <= high), axes.get_ylabel()
