"""What the cube teaches of its site."""

import numpy as np
import pytest

from solar.ephemeris import sun_direction
from solar.laws.light import light_from_faces, usable_faces
from solar.laws.site import ALBEDO_RANGE, GAIN_RANGE, Learned, SiteLearning
from solar.sky import sky

pytestmark = pytest.mark.slow

SITE = (48.7176, 2.2090, 156.0)
MIDNIGHT = 1655596800.0  # 2022-06-19
NORMALS = np.array([[0.0, 1, 0], [1, 0, 0], [0, -1, 0], [0, 0, 1]])


def learn(days, albedo, gains=(1.0, 1.0, 1.0, 1.0), dni=800.0):
    site = SiteLearning()
    utc_s = MIDNIGHT + 60.0 * np.arange(1440)
    sun = sun_direction(utc_s, *SITE)
    utc_s, sun = utc_s[sun[:, 2] > 0], sun[sun[:, 2] > 0]
    light = sky("isotropic", sun, np.full(len(sun), dni), np.full(len(sun), 90.0), np.full(len(sun), 1360.0))
    faces = light.irradiance_on(NORMALS[:, None], albedo).T * np.array(gains)
    for _ in range(days):
        for row in range(0, len(sun), 10):
            corrected = site.corrected(faces[row])
            usable = usable_faces(corrected, sun[row])
            beam = light_from_faces(corrected, sun[row], site.learned.albedo, usable).beam
            site.observe(corrected, sun[row], usable, beam, 600.0)
        site.end_of_day()
    return site.learned


@pytest.mark.parametrize("albedo", [0.05, 0.2, 0.7])
def test_clear_days_teach_the_albedo(albedo):
    assert float(learn(30, albedo).albedo) == pytest.approx(albedo, abs=0.06)


def test_gains_are_learned_relative_to_each_other():
    learned = learn(30, 0.2, gains=(1.03, 0.99, 1.0, 1.0))
    gains = np.array([learned.gain_east, learned.gain_south, learned.gain_west])
    assert gains.prod() == pytest.approx(1.0, abs=1e-6)
    np.testing.assert_allclose(gains / gains[1], [1.03 / 0.99, 1.0, 1.0 / 0.99], atol=4e-3)


def test_learning_is_slow_and_bounded():
    once = learn(1, 0.7)
    assert 0.2 < float(once.albedo) <= 0.2 + 0.2 * 0.55
    wild = learn(60, 0.2, gains=(1.5, 1.0, 1.0, 1.0))
    assert GAIN_RANGE[0] <= float(wild.gain_east) <= GAIN_RANGE[1]
    assert ALBEDO_RANGE[0] <= float(wild.albedo) <= ALBEDO_RANGE[1]


def test_an_overcast_day_teaches_nothing():
    assert learn(3, 0.7, dni=0.0) == Learned(0.2, 1.0, 1.0, 1.0)


def test_what_was_learned_can_be_forgotten():
    site = SiteLearning(learned=learn(2, 0.5))
    site.reset()
    assert site.learned == Learned()
