"""The law `flat`: up, whatever the sky does."""

from solar.energy import DaylightWeather, Steer, steer_fixed_tilt
from solar.frames import Array, Limits
from solar.laws.law import DirectionLaw, LawSettings, Moment, TrackerFacts
from solar.laws.paper import ZENITH
from solar.laws.three_faces import ThreeFacesLaw


class FlatSettings(LawSettings):
    """flat: up."""


class FlatLaw(ThreeFacesLaw, DirectionLaw):
    """Points at the zenith.

    Parameters
    ----------
    settings, tracker
        Nothing but the tracker's limits counts.
    """

    def __init__(self, _settings: FlatSettings, tracker: TrackerFacts) -> None:
        super().__init__(tracker)

    def direction(self, _now: Moment, _to_sun: Array) -> Array:
        """Return the zenith."""
        return ZENITH

    def reason(self, _azimuth_deg: float, _elevation_deg: float) -> str:
        """Return that it lies flat."""
        return "flat, whatever the sky does"


SETTINGS = FlatSettings
build = FlatLaw


def steer(_settings: FlatSettings, weather: DaylightWeather, _faces: Array, _limits: Limits) -> Steer:
    """Lie flat all day."""
    return steer_fixed_tilt(weather, 0.0)
