"""The sun's path over a solar day, as the dashboard draws it."""

from functools import lru_cache
from typing import Any

import numpy as np

from daemon.base.clock import iso_utc
from solar.ephemeris import DAY_S, Site, solar_days, sun_day, sun_position

_EVERY_S = 600.0


def sun_json(site: Site, utc_s: float) -> dict[str, Any]:
    """Return the solar day that `utc_s` [s UTC] falls in: rise, noon, set, and the path in steps of 10 minutes.

    The path begins and ends at the sun's lowest points; each point is a time, the azimuth from north and the apparent
    elevation [deg]. Rise and set are None on a day without, one of them alone where the polar day begins or ends.
    """
    return _day(site, solar_days(utc_s, site.longitude_deg))


@lru_cache(maxsize=16)
def _day(site: Site, mean_solar_day: float) -> dict[str, Any]:
    noon_s = (mean_solar_day + 0.5) * DAY_S - site.longitude_deg * 240.0
    day = sun_day(noon_s, *site)
    instants = np.round(day.noon_utc_s) + np.arange(-DAY_S / 2, DAY_S / 2 + 1, _EVERY_S)
    sun = sun_position(instants, *site)
    points = zip(instants.tolist(), sun.azimuth_deg.tolist(), sun.elevation_deg.tolist(), strict=True)
    return {
        "sunrise": None if day.sunrise_utc_s is None else iso_utc(day.sunrise_utc_s),
        "noon": iso_utc(day.noon_utc_s),
        "sunset": None if day.sunset_utc_s is None else iso_utc(day.sunset_utc_s),
        "highest_elevation_deg": day.highest_elevation_deg,
        "path": [
            {"time": iso_utc(at_s), "azimuth_deg": round(azimuth, 3), "elevation_deg": round(elevation, 3)}
            for at_s, azimuth, elevation in points
        ],
    }
