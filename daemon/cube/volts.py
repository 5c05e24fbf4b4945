"""From sensor voltages to irradiances."""

from collections.abc import Callable

from daemon.base.records import FACES
from daemon.config.sections import Face

# The whole night of civil twilight and darker is dark to a sensor of 0.1 mV per W/m2.
_DARK_BELOW_DEG = -6.0
# About 25 minutes at one scan every 5 s: slow against noise, quick against the night.
_LEARNING_RATE = 1 / 300
_LARGEST_MV = 0.5


def calibrated(voltage_mv: float, face: Face) -> float:
    """Return the irradiance [W/m2] of a face from its sensor's voltage [mV]: gain x (voltage - offset)."""
    return face.gain_w_m2_per_mv * (voltage_mv - face.offset_mv)


class DarkOffsets:
    """Each face's voltage in the dark, learnt at night and bounded to half a millivolt (5 W/m2).

    Parameters
    ----------
    sun_elevation_deg
        Of UTC [s].
    """

    def __init__(self, sun_elevation_deg: Callable[[float], float]) -> None:
        self._sun_elevation_deg = sun_elevation_deg
        self._offsets_mv = [0.0] * len(FACES)

    def learn(self, index: int, voltage_mv: float, utc_s: float) -> float:
        """Take in one face's voltage [mV] and return the offset [mV] to subtract from it.

        A voltage beyond the bound teaches nothing: at night it is a lamp or a fault, not an offset.
        """
        if self._sun_elevation_deg(utc_s) < _DARK_BELOW_DEG and abs(voltage_mv) <= _LARGEST_MV:
            self._offsets_mv[index] += _LEARNING_RATE * (voltage_mv - self._offsets_mv[index])
        return self._offsets_mv[index]
