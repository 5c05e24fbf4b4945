"""Which faces can be true, and which follow the light."""

import numpy as np
import pytest

from solar.ephemeris import sun_direction
from solar.plausible import Response, responses
from solar.sky import sky

SITE = (48.7176, 2.2090, 156.0)
NORMALS = np.array([[0.0, 1, 0], [1.0, 0, 0], [0.0, -1, 0], [0.0, 0, 1]])
MORNING_UTC_S = 1655283600.0  # 2022-06-15 09:00
ALL = [True] * 4


def half_hour(model="perez1990", beam_w_m2=700.0, at_utc_s=MORNING_UTC_S):
    """Return the faces of thirty minutes, with a cloud in their middle, and the sun's directions."""
    utc_s = at_utc_s + 60.0 * np.arange(30)
    sun = sun_direction(utc_s, *SITE)
    cloud = np.where(np.abs(np.arange(30) - 15) < 4, 0.3, 1.0)
    light = sky(model, sun, beam_w_m2 * cloud, np.full(30, 150.0), np.full(30, 1330.0))
    noise = np.random.default_rng(1).normal(0.0, 0.3, (30, 4))
    return np.stack([light.irradiance_on(normal[None, :]) for normal in NORMALS], axis=-1) + noise, sun


@pytest.mark.parametrize("model", ["isotropic", "haydavies", "perez1990"])
def test_the_faces_that_the_sun_reaches_follow_the_light(model):
    faces, sun = half_hour(model)
    assert responses(faces, sun, ALL).tolist() == [
        Response.FOLLOWS,
        Response.FOLLOWS,
        Response.UNKNOWN,
        Response.FOLLOWS,
    ]


@pytest.mark.parametrize("stuck_w_m2", [0.0, 80.0, 600.0])
@pytest.mark.parametrize("face", [0, 1, 3])
def test_a_face_that_stays_while_the_light_changes_is_named_and_no_other(face, stuck_w_m2):
    faces, sun = half_hour()
    faces[:, face] = stuck_w_m2 + np.random.default_rng(2).normal(0.0, 0.3, 30)
    found = responses(faces, sun, ALL)
    assert np.flatnonzero(found == Response.STAYS).tolist() == [face]


def test_nothing_is_known_of_a_face_in_its_own_shade_without_another_that_is_lit_or_under_an_even_sky():
    faces, sun = half_hour()
    faces[:, 2] = 40.0
    assert responses(faces, sun, ALL)[2] == Response.UNKNOWN
    faces, sun = half_hour(at_utc_s=1655280000.0 + 5 * 3600)
    faces[:, 1] = 40.0
    believed = [True, True, True, False]
    assert responses(faces, sun, believed)[1] == Response.UNKNOWN
    faces, sun = half_hour(beam_w_m2=0.0)
    assert (responses(faces, sun, ALL) == Response.UNKNOWN).all()


def test_a_gap_in_a_face_and_a_low_sun_tell_nothing():
    faces, sun = half_hour()
    faces[3, 1] = np.nan
    assert (responses(faces, sun, ALL) == Response.UNKNOWN).all()
    faces, sun = half_hour(at_utc_s=1655265600.0)
    assert (responses(faces, sun, ALL) == Response.UNKNOWN).all()
