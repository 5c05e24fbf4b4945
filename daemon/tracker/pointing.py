"""The laws by name: from the window's mean and the sun to a target inside the limits."""

from dataclasses import dataclass

import numpy as np

from daemon.base.records import NO_ESTIMATE, Estimate, Irradiances, Target
from daemon.config.sections import Law, LawName, SiteSettings
from solar.ephemeris import SunPosition, sun_position
from solar.frames import Array, Limits, angles_within, azimuth_from_direction, direction_from_azimuth
from solar.laws import paper as laws


@dataclass(frozen=True, slots=True)
class Aim:
    """What a law says.

    Attributes
    ----------
    azimuth_deg, elevation_deg
        Of the direction before limits; NaN when there is none.
    sun
        Ephemeris of the same instant.
    target
        Inside the limits; None when there is no direction.
    why
        In words.
    estimate
        What the law made of the light.
    """

    azimuth_deg: float
    elevation_deg: float
    sun: SunPosition[float]
    target: Target | None
    why: str
    estimate: Estimate = NO_ESTIMATE


class Pointing:
    """Applies a law at a site.

    Parameters
    ----------
    site
        Where the tracker stands.
    law
        Parameters of the laws.
    limits
        Of the tracker.
    """

    def __init__(self, site: SiteSettings, law: Law, limits: Limits) -> None:
        self._site = site
        self._law = law
        self._limits = limits

    def sun(self, utc_s: float) -> SunPosition[float]:
        """Return the sun's position at this UTC [s]."""
        return sun_position(utc_s, self._site.latitude_deg, self._site.longitude_deg, self._site.altitude_m)

    def aim(self, name: LawName, mean: Irradiances | None, utc_s: float, *, sun_known: bool = True) -> Aim:
        """Return what the law `name` says of the window's mean at this UTC [s].

        Unless `sun_known`, as while the clock is in doubt, the ephemeris directs nothing.
        """
        sun = self.sun(utc_s)
        direction = self._direction(name, mean, sun, sun_known=sun_known)
        if not np.isfinite(direction).all():
            return Aim(np.nan, np.nan, sun, None, f"{name} has no direction")
        a_deg, b_deg = angles_within(direction, self._limits)
        azimuth, elevation = azimuth_from_direction(direction, self._site.latitude_deg)
        return Aim(float(azimuth), float(elevation), sun, Target(float(a_deg), float(b_deg), name), name)

    def _direction(self, name: LawName, mean: Irradiances | None, sun: SunPosition[float], *, sun_known: bool) -> Array:
        if name == "flat":
            return laws.ZENITH
        to_sun = direction_from_azimuth(sun.azimuth_deg, sun.elevation_deg, self._site.latitude_deg)
        if name == "chronometric":
            return laws.chronometric(to_sun) if sun_known else np.full(3, np.nan)
        if mean is None:
            return np.full(3, np.nan)
        faces = (mean.east_w_m2, mean.south_w_m2, mean.west_w_m2, mean.zenith_w_m2)
        law = self._law
        if name == "mu-prime":
            return laws.mu_prime(faces, uniform_threshold=law.uniform_threshold)
        seen = laws.sun_vector(
            faces,
            albedo=law.albedo,
            uniform_threshold=law.uniform_threshold,
            gain_uncertainty=law.gain_uncertainty,
        )
        return laws.complete_poleward(seen, to_sun) if sun_known else seen
