"""The law `chronometric`: towards the sun by ephemeris, without a cube."""

import numpy as np

from solar.energy import DaylightWeather, Steer
from solar.ephemeris import sun_direction
from solar.frames import Array, Limits, angles_within
from solar.laws import paper
from solar.laws.law import NO_DIRECTION, DirectionLaw, LawSettings, Moment, TrackerFacts
from solar.laws.reasons import describe_direction
from solar.laws.steer import known_pose_or_present
from solar.laws.three_faces import ThreeFacesLaw
from solar.rows.backtrack import backtracked_poses
from solar.rows.group import TrackerGroup


class ChronometricSettings(LawSettings):
    """chronometric: towards the sun by ephemeris."""


class ChronometricLaw(ThreeFacesLaw, DirectionLaw):
    """Points at the sun while it is up.

    Parameters
    ----------
    settings, tracker
        Nothing but the tracker's place counts.
    """

    needs_sun = True

    def __init__(self, _settings: ChronometricSettings, tracker: TrackerFacts) -> None:
        super().__init__(tracker)

    def direction(self, now: Moment, to_sun: Array) -> Array:
        """Return the sun's direction; none below the horizon or while it is in doubt."""
        return paper.chronometric(to_sun) if now.sun_known else NO_DIRECTION

    def reason(self, azimuth_deg: float, elevation_deg: float) -> str:
        """Return where the sun is."""
        return f"by the clock the sun is in {describe_direction(azimuth_deg, elevation_deg)}"


SETTINGS = ChronometricSettings
build = ChronometricLaw


def steer(
    _settings: ChronometricSettings,
    weather: DaylightWeather,
    _faces: Array,
    limits: Limits,
    group: TrackerGroup | None = None,
) -> Steer:
    """Follow the sun itself, at every step, and out of the shade of a group's neighbours."""
    sun = weather.gridded(weather.sun, np.nan)
    a_deg, b_deg = angles_within(sun, limits)
    if group is not None:
        later = weather.gridded(sun_direction(weather.utc_s + weather.step_s, *weather.site), np.nan)
        a_deg, b_deg = backtracked_poses(group, [sun, later], a_deg, b_deg, limits)
    return lambda step, a, b: known_pose_or_present(a_deg[step], b_deg[step], a, b)
