"""What every law that says a direction leaves to its parent."""

import math

import numpy as np
import pytest

from solar.ephemeris import Site, sun_position
from solar.frames import Limits, direction_from_azimuth, normal_from_angles
from solar.laws import chronometric
from solar.laws.law import DirectionLaw, Moment, TrackerFacts

FORENOON = 1665565200.0  # 2022-10-12 09:00 UTC
PALAISEAU = Site(48.7, 2.2, 0.0)


def tracker(site=PALAISEAU):
    return TrackerFacts(site, Limits(), scan_every_s=5.0, decide_every_s=300.0, utc_s=FORENOON)


@pytest.mark.parametrize("site", [Site(-33.9, 18.4, 0.0), Site(48.7, -2.2, 0.0)])
def test_the_angles_and_the_azimuth_are_those_of_the_direction_in_either_hemisphere(site):
    aim = chronometric.build(chronometric.SETTINGS(), tracker(site)).aim(Moment(FORENOON, None, None))
    sun = sun_position(FORENOON, *site)
    assert (aim.azimuth_deg, aim.elevation_deg) == (pytest.approx(sun.azimuth_deg), pytest.approx(sun.elevation_deg))
    to_sun = direction_from_azimuth(sun.azimuth_deg, sun.elevation_deg, site.latitude_deg)
    np.testing.assert_allclose(normal_from_angles(*aim.target), to_sun, atol=1e-9)


class HalfBlind(DirectionLaw):
    """Says a direction of which one part is no number."""

    def direction(self, _now, _to_sun):
        """Return what a law must not."""
        return np.array([math.nan, 0.5, 0.5])


def test_half_a_direction_is_none():
    aim = HalfBlind(tracker()).aim(Moment(FORENOON, None, None))
    assert aim.target is None
    assert math.isnan(aim.elevation_deg)
    assert aim.why == "the readings tell no direction"
