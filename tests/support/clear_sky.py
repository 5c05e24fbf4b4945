import numpy as np

from sim_drivers.weather import Conditions
from solar.calibration.selection import clear_sky_ghi
from solar.ephemeris import DAY_S, Site, sun_direction
from solar.frames import Array


class ClearSky:
    """Cloudless weather with a haze that changes daily, whose GHI, DNI and DHI agree."""

    def __init__(self, site: Site, aod700: tuple[float, ...] = (0.03, 0.07, 0.05)) -> None:
        self._site = site
        self._aod = np.array(aod700)

    def covers(self, utc_s: Array) -> Array:
        return np.ones(np.shape(utc_s), dtype=np.bool_)

    def at(self, utc_s: Array) -> Conditions:
        utc_s = np.asarray(utc_s, dtype=np.float64)
        aod = self._aod[np.floor(utc_s / DAY_S).astype(np.int64) % self._aod.size]
        sine = np.maximum(sun_direction(utc_s, *self._site)[:, 2], 0.0)
        ghi, dni, _ = (np.where(sine > 0.0, part, 0.0) for part in clear_sky_ghi(self._site, utc_s, aod))
        calm = np.zeros(utc_s.shape)
        return Conditions(ghi, dni, np.maximum(ghi - dni * sine, 0.0), calm, calm + 15.0)
