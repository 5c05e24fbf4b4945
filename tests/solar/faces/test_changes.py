"""Faces that do not follow the changes of the light when clouds pass before the sun."""

import numpy as np
import pytest

from solar.energy import arrange_daylight, build_sky, face_irradiances
from solar.ephemeris import Site
from solar.faces.changes import ChangeMisfits, change_misfits
from solar.faces.contradiction import PAIRS, misfits

SITE = Site(55.79064, 12.52505, 50.0)
JUNE_UTC_S = 1655283600.0  # 2022-06-15 09:00
DECEMBER_UTC_S = 1671098400.0  # 2022-12-15 10:00
MINUTES = np.arange(30)
PASSING = np.where(MINUTES % 7 < 3, 0.2, 1.0)
SOUND = np.array([0.05, 0.4, 0.4, 0.4])
AS_MUCH = np.full(6, 0.4)


def half_hour(at_utc_s=JUNE_UTC_S, model="perez1990", beam_w_m2=700.0, albedo=0.2, clouds=PASSING, off=0.03):
    """Return faces with gain errors under passing clouds, the same without beam, and the sun's directions."""
    utc_s = at_utc_s + 60.0 * MINUTES
    gains = 1.0 + off * np.array([1.0, -1.0, 1.0, -1.0])
    beam, dull = (
        arrange_daylight(utc_s, share * beam_w_m2 * clouds, np.full(30, 100.0), SITE, 60.0) for share in (1.0, 0.0)
    )
    faces, shaded = (gains * face_irradiances(build_sky(weather, model), albedo) for weather in (beam, dull))
    return faces, shaded, beam.sun


@pytest.mark.parametrize("albedo", [0.05, 0.2, 0.8])
@pytest.mark.parametrize("at_utc_s", [JUNE_UTC_S, DECEMBER_UTC_S])
@pytest.mark.parametrize("model", ["isotropic", "haydavies", "perez1990", "perez1993", "cie"])
def test_sound_faces_change_together_under_every_sky_and_over_every_ground(model, at_utc_s, albedo):
    faces, _, sun = half_hour(at_utc_s, model, albedo=albedo)
    found = change_misfits(faces, sun)
    assert found.without_fault < 0.2
    assert not found.is_contradictory
    assert np.isinf([*found.single, *found.swapped]).all(), "no fault is sought"
    assert found.suspect_faces == ()


def test_under_an_isotropic_sky_with_exact_gains_almost_no_change_is_left_unexplained():
    faces, _, sun = half_hour(model="isotropic", off=0.0)
    assert change_misfits(faces, sun).without_fault < 0.02


@pytest.mark.parametrize("beam_w_m2", [250.0, 700.0])
def test_a_south_face_in_shade_under_a_low_sun_is_accused_though_a_weaker_beam_would_explain_it(beam_w_m2):
    faces, shaded, sun = half_hour(DECEMBER_UTC_S, beam_w_m2=beam_w_m2)
    faces[:, 1] = shaded[:, 1]
    assert misfits(faces, sun).suspect_faces == ()
    assert change_misfits(faces, sun).suspect_faces == (1,)


@pytest.mark.parametrize(("face", "hours"), [(0, -1.0), (1, 2.0), (2, 5.0)])
def test_a_face_that_does_not_change_except_for_noise_is_accused(face, hours):
    faces, _, sun = half_hour(JUNE_UTC_S + 3600.0 * hours)
    faces[:, face] = np.random.default_rng(1).normal(300.0, 0.3, 30)
    assert change_misfits(faces, sun).suspect_faces == (face,)


def test_a_face_that_changes_half_as_much_as_the_light_is_accused():
    faces, _, sun = half_hour(DECEMBER_UTC_S - 3600.0)
    faces[:, 1] *= 0.5
    assert change_misfits(faces, sun).suspect_faces == (1,)


@pytest.mark.parametrize("pair", PAIRS)
def test_two_swapped_faces_are_accused_at_some_hour_and_no_other_face_ever_is(pair):
    named = set()
    for hours in range(-3, 7):
        faces, _, sun = half_hour(JUNE_UTC_S + 3600.0 * hours)
        faces[:, list(pair)] = faces[:, list(pair[::-1])]
        named.add(change_misfits(faces, sun).suspect_faces)
    assert pair in named
    assert named <= {pair, ()}


def test_too_few_passing_clouds_give_no_verdict_on_the_faces():
    for clouds in (np.ones(30), np.where(MINUTES < 15, 1.0, 0.2), np.where(MINUTES < 10, PASSING, 1.0)):
        faces, _, sun = half_hour(clouds=clouds)
        assert change_misfits(faces, sun) is None


def test_missing_minutes_are_left_out_and_a_face_without_readings_gives_no_verdict():
    faces, shaded, sun = half_hour(DECEMBER_UTC_S)
    faces[:, 1] = shaded[:, 1]
    faces[[4, 11], [0, 2]] = np.nan
    assert change_misfits(faces, sun).suspect_faces == (1,)
    faces[:, 3] = np.nan
    assert change_misfits(faces, sun) is None


def test_a_sun_lower_than_five_degrees_gives_no_verdict_on_the_faces():
    faces, _, sun = half_hour(DECEMBER_UTC_S + 4 * 3600.0)
    assert sun[-1, 2] < np.sin(np.radians(5.0))
    assert change_misfits(faces, sun) is None


@pytest.mark.parametrize(
    ("found", "accused"),
    [
        (ChangeMisfits(0.3, SOUND, AS_MUCH), (0,)),
        (ChangeMisfits(0.24, SOUND, AS_MUCH), ()),
        (ChangeMisfits(0.3, SOUND + 0.05, AS_MUCH), ()),
        (ChangeMisfits(0.3, SOUND, np.array([0.4, 0.4, 0.07, 0.4, 0.4, 0.4])), ()),
        (ChangeMisfits(0.3, SOUND + 0.3, np.array([0.4, 0.4, 0.07, 0.4, 0.4, 0.4])), (1, 2)),
    ],
)
def test_faces_are_accused_only_of_a_contradiction_that_nothing_else_explains_about_as_well(found, accused):
    assert found.suspect_faces == accused
