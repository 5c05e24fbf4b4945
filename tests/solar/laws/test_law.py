"""What every law that gives a direction leaves to its parent class."""

import math

import numpy as np
import pytest

from solar.ephemeris import Site, sun_position
from solar.frames import Limits, direction_from_azimuth, normal_from_angles
from solar.laws import chronometric, mu_prime, sun_vector
from solar.laws.law import NO_DIRECTION, DirectionLaw, LawSettings, Moment, Reading, TrackerFacts

FORENOON = 1665565200.0  # 2022-10-12 09:00 UTC
PALAISEAU = Site(48.7, 2.2, 0.0)


def tracker(site=PALAISEAU):
    return TrackerFacts(site, Limits(), scan_every_s=5.0, decide_every_s=300.0, utc_s=FORENOON)


@pytest.mark.parametrize("site", [Site(-33.9, 18.4, 0.0), Site(48.7, -2.2, 0.0)])
def test_the_angles_and_the_azimuth_of_an_aim_are_those_of_its_direction_in_either_hemisphere(site):
    aim = chronometric.build(chronometric.SETTINGS(), tracker(site)).aim(Moment(FORENOON, None, None))
    sun = sun_position(FORENOON, *site)
    assert (aim.azimuth_deg, aim.elevation_deg) == (pytest.approx(sun.azimuth_deg), pytest.approx(sun.elevation_deg))
    to_sun = direction_from_azimuth(sun.azimuth_deg, sun.elevation_deg, site.latitude_deg)
    np.testing.assert_allclose(normal_from_angles(*aim.target), to_sun, atol=1e-9)


class Nowhere(DirectionLaw):
    """Gives a direction without a length."""

    def direction(self, _now, _to_sun):
        """Return the sum of directions that cancel."""
        return np.zeros(3)


class HalfBlind(DirectionLaw):
    """Gives a direction one part of which is NaN."""

    def direction(self, _now, _to_sun):
        """Return what a law may not return."""
        return np.array([math.nan, 0.5, 0.5])


@pytest.mark.parametrize("law", [HalfBlind, Nowhere])
def test_a_direction_that_is_partly_nan_or_has_no_length_gives_no_target(law):
    aim = law(tracker()).aim(Moment(FORENOON, None, None))
    assert aim.target is None
    assert math.isnan(aim.elevation_deg)
    assert aim.why == "the readings give no direction"


def test_a_law_that_gives_only_a_direction_keeps_no_state_and_allows_every_move():
    law = HalfBlind(tracker())
    law.observe(Reading(FORENOON, 0.0, (1.0, 1.0, 1.0, 1.0)))
    law.book(1.0)
    assert (law.faces_needed, law.needs_sun, law.decide_every_s) == (4, False, 300.0)
    assert (law.learned, law.to_dict(), law.shown(), law.turn(FORENOON + 86400.0)) == (None, None, {}, False)
    assert law.affords(1e6)
    assert law.believes_zenith((1.0, 1.0, 1.0, 0.0), FORENOON)
    found = law.estimates(np.ones((5, 4)), np.ones((5, 3)), None)
    assert [part.shape for part in found] == [(5,)] * 3
    assert np.isnan(found).all()


@pytest.mark.parametrize("law", [chronometric, mu_prime, sun_vector])
def test_a_law_without_a_direction_returns_nan_in_all_three_components(law):
    made = law.build(law.SETTINGS(), tracker())
    np.testing.assert_array_equal(
        made.direction(Moment(FORENOON, None, None, sun_known=False), NO_DIRECTION), [math.nan] * 3
    )


def test_the_sun_vector_is_completed_by_the_ephemeris_only_while_the_suns_position_is_known():
    # In June the morning sun stands north of east, where no face sees it: south and west read alike.
    morning = 1655614800.0
    law = sun_vector.build(sun_vector.SETTINGS(), tracker())
    sure, unsure = (
        law.aim(Moment(morning, (600.0, 100.0, 100.0, 300.0), None, sun_known=known)) for known in (True, False)
    )
    assert sure.azimuth_deg == pytest.approx(law.sun(morning).azimuth_deg)
    assert sure.azimuth_deg < 80.0
    assert unsure.azimuth_deg == pytest.approx(90.0)


@pytest.mark.parametrize(("name", "usual", "greatest"), [
    ("albedo", 0.2, 1.0), ("uniform_threshold", 0.01, 0.5), ("gain_uncertainty", 0.03, 0.2),
])  # fmt: skip
def test_the_parameters_of_the_sun_vector_law_are_accepted_within_their_bounds_only(name, usual, greatest):
    assert getattr(sun_vector.SETTINGS(), name) == usual
    for value in (0.0, greatest):
        assert getattr(sun_vector.SETTINGS(**{name: value}), name) == value
    for value in (-1e-3, greatest + 1e-3, math.nan):
        with pytest.raises(ValueError, match=name):
            sun_vector.SETTINGS(**{name: value})


class OwnSettings(LawSettings):
    """Settings of a law that somebody adds, without bounds of their own."""

    lead_deg: float = 0.0


class WrongFromTheStart(LawSettings):
    """Has a default that nobody could write into a file."""

    lead_deg: float = math.inf


@pytest.mark.parametrize("wrong", [{"lead_deg": math.inf}, {"lead_deg": math.nan}, {"lead_deg": "1"}, {"lead": 1.0}])
def test_a_law_parameter_with_an_unknown_name_or_no_finite_number_is_refused(wrong):
    assert OwnSettings(lead_deg=1.0).lead_deg == 1.0
    with pytest.raises(ValueError, match="lead"):
        OwnSettings(**wrong)


def test_an_infinite_default_of_a_law_parameter_is_refused_and_parameters_cannot_be_changed_later():
    with pytest.raises(ValueError, match="lead_deg"):
        WrongFromTheStart()
    with pytest.raises(ValueError, match="frozen"):
        OwnSettings().lead_deg = 2.0
