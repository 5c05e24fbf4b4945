"""The laws as the service calls them: with the settings' parameters and the ephemeris."""

from datetime import UTC, datetime

import numpy as np
import pytest

from daemon.base.files import StateFolder
from daemon.base.plugins import LAWS, load, names
from daemon.base.records import Irradiances
from daemon.config.settings import Settings
from daemon.tracker import pointing
from solar.ephemeris import Site, sun_position
from solar.frames import Limits, azimuth_from_direction, direction_from_azimuth
from solar.laws.law import TrackerFacts
from solar.laws.paper import sun_vector

NOON = datetime(2022, 10, 12, 11, 50, tzinfo=UTC).timestamp()
JUNE_MORNING = datetime(2022, 6, 21, 5, 0, tzinfo=UTC).timestamp()
SITE = Site(48.717607, 2.209002, 156.0)


def built(name, **settings):
    module = load(LAWS, name)
    return module.build(module.SETTINGS(**settings), TrackerFacts(SITE, Limits(), 5.0, 300.0, NOON))


def aim(name, faces, utc_s=NOON, *, sun_known=True, **settings):
    mean = None if faces is None else Irradiances(*faces, 1.0)
    return pointing.aim(built(name, **settings), mean, None, utc_s, sun_known=sun_known)


@pytest.mark.parametrize("name", names(LAWS))
def test_every_law_can_be_asked_before_anything_is_known_and_says_why_it_stays(name):
    says = aim(name, None)
    assert says.target is None or Limits().contain(*says.target)
    assert says.target is not None or says.why


def test_the_albedo_of_the_settings_is_that_of_sun_vector():
    faces = (100.0, 500.0, 100.0, 450.0)
    angles = [aim("sun-vector", faces, albedo=albedo).target.b_deg for albedo in (0.0, 0.2, 0.6)]
    up = [450 - 200 + albedo * 450 for albedo in (0.0, 0.2, 0.6)]
    assert angles == pytest.approx([np.degrees(np.arctan2(z, 400)) for z in up])


@pytest.mark.parametrize("law", ["mu-prime", "sun-vector"])
def test_the_threshold_of_the_settings_is_that_of_the_law(law):
    faces = (200.0, 240.0, 200.0, 420.0)
    sure = {"gain_uncertainty": 0.0} if law == "sun-vector" else {}
    found = [aim(law, faces, uniform_threshold=share, **sure).target.b_deg for share in (0.0, 0.05, 0.2, 0.5)]
    assert found[0] == found[1] < 90.0
    assert found[2] == found[3] == 90.0


def test_the_gain_uncertainty_of_the_settings_is_that_of_sun_vector():
    faces = (200.0, 240.0, 200.0, 420.0)
    assert aim("sun-vector", faces, gain_uncertainty=0.0).target.b_deg < 90.0
    assert aim("sun-vector", faces, gain_uncertainty=0.2).target.b_deg == 90.0


def beyond_the_east_west_plane():
    """Return the faces of a June morning, with the sun in the north-east, and its azimuth."""
    sun = sun_position(JUNE_MORNING, *SITE)
    south, east, up = direction_from_azimuth(sun.azimuth_deg, sun.elevation_deg, SITE.latitude_deg)
    assert south < 0
    return (600 * east + 40.0, 40.0, 40.0, 600 * up + 60.0), sun.azimuth_deg


def test_sun_vector_is_completed_by_the_ephemeris_beyond_the_east_west_plane():
    faces, azimuth = beyond_the_east_west_plane()
    assert azimuth < 90
    assert aim("sun-vector", faces, JUNE_MORNING).azimuth_deg == pytest.approx(azimuth, abs=0.5)


def test_with_the_clock_in_doubt_nothing_comes_from_the_ephemeris():
    faces, _ = beyond_the_east_west_plane()
    seen, _ = azimuth_from_direction(sun_vector(faces), SITE.latitude_deg)
    assert aim("sun-vector", faces, JUNE_MORNING, sun_known=False).azimuth_deg == pytest.approx(float(seen)) == 90.0
    assert aim("chronometric", None, sun_known=False).target is None
    assert aim("chronometric", None).target is not None
    for law in ("mu-prime", "flat"):
        known, unknown = (aim(law, (100.0, 500.0, 100.0, 450.0), sun_known=known).target for known in (True, False))
        assert known == unknown


def test_without_a_mean_the_laws_of_the_faces_have_no_direction():
    assert aim("mu-prime", None).target is None
    assert aim("sun-vector", None).target is None


def test_law_and_fallback_turn_out_of_the_shade_of_the_group_of_the_file():
    group = {"east_m": (0.0, 5.0), "north_m": (0.0, 0.0), "module_width_m": 2.0, "module_height_m": 2.0}
    group["turn_back"] = "always"
    low = datetime(2022, 9, 23, 6, 0, tzinfo=UTC).timestamp()
    alone, among = (
        pointing.build_pointing(Settings(law={"driver": "chronometric"}, rows=rows), low, StateFolder(None))
        for rows in ({}, group)
    )
    for before, after in ((alone.law, among.law), (alone.fallback.law, among.fallback.law)):
        targets = [pointing.aim(law, None, None, low).target for law in (before, after)]
        assert targets[0].a_deg == pytest.approx(-50.0)
        assert targets[1].a_deg > -40.0
