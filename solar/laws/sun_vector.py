"""The law `sun-vector`: towards the sun as the cube sees it, equation (11) (:func:`solar.laws.paper.sun_vector`)."""

import numpy as np
from pydantic import Field

from solar.energy import DaylightWeather, Steer
from solar.frames import Array, Limits
from solar.laws import paper
from solar.laws.law import NO_DIRECTION, DirectionLaw, LawSettings, Moment, TrackerFacts
from solar.laws.reasons import sun_reason
from solar.laws.steer import steer_by_mean
from solar.laws.three_faces import ThreeFacesLaw, fill_missing_face


class SunVectorSettings(LawSettings):
    """sun-vector: towards the sun as the cube sees it."""

    albedo: float = Field(
        0.2,
        ge=0,
        le=1,
        description="Share of the irradiance that the ground reflects; optimal begins with it and learns its own.",
    )
    uniform_threshold: float = Field(
        0.01,
        ge=0,
        le=0.5,
        description="Differences between faces below this share of the zenith count as noise of a uniform sky.",
    )
    gain_uncertainty: float = Field(
        0.03,
        ge=0,
        le=0.2,
        description="Standard error of a face's gain, as a share; a beam that such errors may explain is ignored.",
    )

    def direction_from_faces(self, faces: Array | tuple[float, ...]) -> Array:
        """Return the direction that the faces show, shape (..., 3)."""
        return paper.sun_vector(
            faces,
            albedo=self.albedo,
            uniform_threshold=self.uniform_threshold,
            gain_uncertainty=self.gain_uncertainty,
        )


class SunVectorLaw(ThreeFacesLaw, DirectionLaw):
    """Points along s of the mean, completed by the ephemeris where no face can see or one tells nothing.

    Parameters
    ----------
    settings, tracker
        Its parameters and what it points.
    """

    def __init__(self, settings: SunVectorSettings, tracker: TrackerFacts) -> None:
        super().__init__(tracker)
        self._settings = settings

    def direction(self, now: Moment, to_sun: Array) -> Array:
        """Return s; none without a mean, and not completed while the sun's position is in doubt."""
        if now.mean_w_m2 is None:
            return NO_DIRECTION
        if not now.sun_known:
            return self._settings.direction_from_faces(now.mean_w_m2)
        return _seen_direction(self._settings, np.asarray(now.mean_w_m2), to_sun)

    def reason(self, azimuth_deg: float, elevation_deg: float) -> str:
        """Return where the sun is seen."""
        return sun_reason(azimuth_deg, elevation_deg)


SETTINGS = SunVectorSettings
build = SunVectorLaw


def steer(settings: SunVectorSettings, weather: DaylightWeather, faces: Array, limits: Limits) -> Steer:
    """Run the law on many days at once, in the paper's rhythm."""
    sun = weather.gridded(weather.sun, np.nan)
    return steer_by_mean(weather, faces, limits, lambda mean: _seen_direction(settings, mean, sun))


def _seen_direction(settings: SunVectorSettings, faces: Array, sun: Array) -> Array:
    whole = fill_missing_face(faces, sun, settings.albedo)
    return paper.complete_poleward(settings.direction_from_faces(whole), sun)
