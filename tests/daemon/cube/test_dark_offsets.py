"""Dark offsets and the calibration of one voltage."""

import pytest

from daemon.config.sections import FaceSettings
from daemon.cube.calibration import DarkOffsets, calibrated_irradiance


def test_irradiance_is_the_gain_times_voltage_less_offset():
    assert calibrated_irradiance(47.0, FaceSettings(channel=0, gain_w_m2_per_mv=9.8, offset_mv=2.0)) == pytest.approx(
        441.0
    )


def learnt(elevation_deg, voltage_mv, readings):
    dark = DarkOffsets(lambda _utc_s: elevation_deg)
    for _ in range(readings):
        offset = dark.learn(0, voltage_mv, 0.0)
    return offset


def test_an_offset_is_learnt_slowly_at_night():
    assert learnt(-10.0, 0.3, 1) == pytest.approx(0.001), "one reading is noise"
    assert learnt(-10.0, 0.3, 300) == pytest.approx(0.3 * (1 - 1 / 2.7183), rel=0.01)
    assert learnt(-10.0, 0.3, 3000) == pytest.approx(0.3, rel=0.001)


def test_no_dark_offset_is_learnt_by_day_or_in_twilight():
    assert learnt(20.0, 0.3, 3000) == 0.0
    assert learnt(-5.0, 0.3, 3000) == 0.0


@pytest.mark.parametrize("voltage_mv", [0.6, -0.6, 20.0])
def test_no_dark_offset_is_learnt_from_a_voltage_too_large_for_darkness(voltage_mv):
    assert learnt(-30.0, voltage_mv, 3000) == 0.0
