"""What the figures of `heliocube gain` show where there is nothing to gain, or less than nothing."""

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg

from daemon.studies.gain.choices import Device
from daemon.studies.gain.evaluate import evaluate
from daemon.studies.gain.plots import gain_map
from daemon.studies.gain.request import Request

WHITE = [255, 255, 255]


def gains_of_day(day, latitudes_deg, changed=None):
    """Return the map of the vertical axis on a day, and a function that gives its colour at a latitude and a tilt."""
    request = Request(
        latitudes_deg=np.array(latitudes_deg),
        tilts_deg=np.arange(0.0, 91.0, 10.0),
        azimuths_deg=np.zeros(1),
        days=np.array([day]),
        against=(Device.VERTICAL,),
        printed=False,
    )
    columns = evaluate(request)
    if changed is not None:
        columns["K_DV"] = changed(columns["K_DV"])
    figure = gain_map(request, columns, None)
    canvas = FigureCanvasAgg(figure)
    canvas.draw()
    pixels, panel = np.asarray(canvas.buffer_rgba()), figure.axes[0]

    def colour(latitude_deg, tilt_deg):
        x, y = panel.transData.transform((latitude_deg, tilt_deg)).astype(int)
        return pixels[pixels.shape[0] - 1 - y, x, :3].tolist()

    return panel, colour


def test_a_map_is_blank_where_the_sun_does_not_rise():
    panel, colour = gains_of_day(355.0, np.arange(50.0, 91.0, 5.0))
    assert [colour(latitude, 45.0) for latitude in (71.0, 78.0, 89.0)] == [WHITE] * 3
    assert WHITE not in [colour(latitude, 45.0) for latitude in (51.0, 62.0)]
    (best,) = (line for line in panel.lines if line.get_linestyle() == "--")
    assert np.isfinite(best.get_ydata()).tolist() == [True] * 4 + [False] * 5


def test_a_map_is_not_blank_where_the_dual_axis_loses():
    _, colour = gains_of_day(172.0, [10.0, 20.0, 30.0], changed=lambda ratios: ratios * 0.0 + 0.9)
    assert colour(21.0, 45.0) != WHITE


def test_a_map_of_nothing_but_night_is_blank():
    _, colour = gains_of_day(355.0, [70.0, 80.0, 90.0])
    assert colour(80.0, 45.0) == WHITE
