"""The law `mu-prime`: towards sun and bright sky, equation (12) of the paper (:func:`solar.laws.paper.mu_prime`)."""

import numpy as np
from pydantic import Field

from solar.energy import DaylightWeather, Steer
from solar.frames import Array, Limits
from solar.laws import paper
from solar.laws.law import NO_DIRECTION, DirectionLaw, LawSettings, Moment, TrackerFacts
from solar.laws.reasons import light_reason
from solar.laws.steer import steer_by_mean
from solar.laws.three_faces import ThreeFacesLaw, fill_missing_face
from solar.rows.group import TrackerGroup


class MuPrimeSettings(LawSettings):
    """mu-prime: towards sun and bright sky, the paper's (12)."""

    uniform_threshold: float = Field(
        0.01,
        ge=0,
        le=0.5,
        description="Differences between faces below this share of the zenith count as noise of a uniform sky.",
    )


class MuPrimeLaw(ThreeFacesLaw, DirectionLaw):
    """Points along mu' of the mean; a face that tells nothing is replaced by what the others lead to expect.

    Parameters
    ----------
    settings, tracker
        Its parameters and what it points.
    """

    def __init__(self, settings: MuPrimeSettings, tracker: TrackerFacts) -> None:
        super().__init__(tracker)
        self._settings = settings

    def direction(self, now: Moment, to_sun: Array) -> Array:
        """Return mu'; none without a mean, nor by three faces while the sun's position is in doubt."""
        if now.mean_w_m2 is None:
            return NO_DIRECTION
        faces = fill_missing_face(now.mean_w_m2, to_sun) if now.sun_known else np.asarray(now.mean_w_m2)
        return paper.mu_prime(faces, uniform_threshold=self._settings.uniform_threshold)

    def reason(self, azimuth_deg: float, elevation_deg: float) -> str:
        """Return where the light comes from."""
        return light_reason(azimuth_deg, elevation_deg)


SETTINGS = MuPrimeSettings
build = MuPrimeLaw


def steer(
    settings: MuPrimeSettings,
    weather: DaylightWeather,
    faces: Array,
    limits: Limits,
    group: TrackerGroup | None = None,
) -> Steer:
    """Run the law on many days at once, in the paper's rhythm, and out of the shade of a group's neighbours."""
    sun = weather.gridded(weather.sun, np.nan)

    def direction(mean: Array) -> Array:
        return paper.mu_prime(fill_missing_face(mean, sun), uniform_threshold=settings.uniform_threshold)

    return steer_by_mean(weather, faces, limits, direction, group=group)
