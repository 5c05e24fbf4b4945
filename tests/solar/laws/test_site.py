"""What the cube's readings teach about its site."""

import numpy as np
import pytest

from solar.ephemeris import sun_direction
from solar.laws.light import light_from_faces, usable_faces
from solar.laws.site import ALBEDO_RANGE, LearnedSite, SiteLearning, update_learned, zero_sums
from solar.skies.sky import sky

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
        for row in range(0, len(sun), 30):
            corrected = site.corrected(faces[row])
            usable = usable_faces(corrected, sun[row])
            beam = light_from_faces(corrected, sun[row], site.learned.albedo, usable).beam
            site.observe(corrected, sun[row], usable, beam, 1800.0)
        site.end_of_day()
    return site.learned


@pytest.mark.parametrize("albedo", [0.05, 0.2, 0.7])
def test_the_albedo_is_learned_from_clear_days(albedo):
    assert float(learn(30, albedo).albedo) == pytest.approx(albedo, abs=0.06)


def test_gains_are_learned_relative_to_each_other():
    learned = learn(30, 0.2, gains=(1.03, 0.99, 1.0, 1.0))
    gains = np.array([learned.gain_east, learned.gain_south, learned.gain_west])
    assert gains.prod() == pytest.approx(1.0, abs=1e-6)
    np.testing.assert_allclose(gains / gains[1], [1.03 / 0.99, 1.0, 1.0 / 0.99], atol=4e-3)


def test_the_albedo_is_learned_slowly_and_stays_within_its_range():
    once = learn(1, 0.7)
    assert 0.2 < float(once.albedo) <= 0.2 + 0.2 * 0.55
    wild = learn(60, 0.2, gains=(1.5, 1.0, 1.0, 1.0))
    assert ALBEDO_RANGE[0] <= float(wild.albedo) <= ALBEDO_RANGE[1]


@pytest.mark.parametrize(("log_east", "gains"), [(0.5, (1.07, 0.93, 0.93)), (-0.5, (0.93, 1.07, 1.07))])
def test_no_sensor_is_believed_to_be_off_by_more_than_seven_percent(log_east, gains):
    day = zero_sums(())._replace(east_s=np.array(3600.0), east=np.array(3600.0 * log_east))
    learned = LearnedSite()
    for _ in range(10):
        learned = update_learned(learned, day)
    assert (learned.gain_east, learned.gain_south, learned.gain_west) == gains


def test_overcast_days_change_neither_the_learned_albedo_nor_the_learned_gains():
    assert learn(3, 0.7, dni=0.0) == LearnedSite(0.2, 1.0, 1.0, 1.0)


@pytest.mark.parametrize(("missing", "seconds", "learns"), [
    ([3], 600.0, True), ([3], 615.0, False), ([0, 1, 2], 615.0, False), ([0, 1, 2, 3], 3600.0, True),
])  # fmt: skip
def test_a_day_is_not_learned_from_if_some_but_not_all_faces_are_missing_for_more_than_600_s(missing, seconds, learns):
    sun = np.array([0.6, 0.5, np.sqrt(1.0 - 0.61)])
    faces = np.array([500.0, 560.0, 150.0, 1.2 * 800.0 * sun[2]])
    unread = faces.copy()
    unread[missing] = np.nan
    site = SiteLearning()
    site.observe(faces, sun, np.ones(4, dtype=bool), np.array(800.0), 3600.0)
    site.observe(unread, sun, ~np.isnan(unread), np.array(800.0), seconds)
    site.end_of_day()
    assert (site.learned != LearnedSite(0.2, 1.0, 1.0, 1.0)) == learns
    before = site.learned
    site.observe(faces, sun, np.ones(4, dtype=bool), np.array(800.0), 3600.0)
    site.end_of_day()
    assert site.learned != before, "the next day teaches again"


def test_a_reset_restores_the_initial_albedo_and_gains():
    site = SiteLearning(learned=learn(2, 0.5))
    site.reset()
    assert site.learned == LearnedSite()


def test_faces_of_many_instants_and_trackers_are_divided_by_their_learned_gains():
    gains = np.array([[1.02, 1.0, 0.98], [1.01, 0.99, 1.0], [1.0, 1.05, 0.95]])
    site = SiteLearning((3,), LearnedSite(0.2, *gains))
    corrected = site.corrected(np.ones((2, 3, 4)))
    np.testing.assert_allclose(corrected, 1.0 / np.broadcast_to([*gains, [1.0] * 3], (2, 4, 3)).transpose(0, 2, 1))


@pytest.mark.parametrize(("seconds", "share"), [(0.0, 0.0), (1800.0, 0.1), (3600.0, 0.2), (7200.0, 0.2)])
def test_a_day_moves_albedo_and_gains_a_fifth_of_the_way_and_less_with_under_an_hour_of_readings(seconds, share):
    sums = zero_sums(())._replace(albedo_s=np.array(seconds), albedo=np.array(0.6 * seconds))
    assert float(update_learned(LearnedSite(0.2), sums).albedo) == pytest.approx(0.2 + share * 0.4)
    sums = zero_sums(())._replace(west_s=np.array(seconds), west=np.array(0.06 * seconds))
    learned = update_learned(LearnedSite(), sums)
    assert float(learned.gain_west / learned.gain_south) == pytest.approx(np.exp(0.06 * share))
    assert float(learned.gain_east / learned.gain_south) == pytest.approx(1.0)
    assert float(learned.gain_east * learned.gain_south * learned.gain_west) == pytest.approx(1.0)


def test_albedo_and_gains_learned_from_one_reading_agree_with_the_equations():
    # The sun in the south-east: the west face is in the shade.
    sun = np.array([0.6, 0.5, np.sqrt(1.0 - 0.61)])
    beam, diffuse, albedo = 800.0, 100.0, 0.3
    zenith = beam * sun[2] + diffuse
    # The horizon's light is a tenth of the diffuse light; `shaded` is what a face without beam reads.
    shaded = (albedo * zenith + diffuse) / 2.0 + 0.1 * diffuse
    faces = np.array([1.04 * beam * 0.5 + shaded, beam * 0.6 + shaded, shaded, zenith])
    for turned in (False, True):
        site = SiteLearning()
        here = sun * [1.0, -1.0, 1.0] if turned else sun
        site.observe(faces[[2, 1, 0, 3]] if turned else faces, here, np.ones(4, dtype=bool), np.array(beam), 3600.0)
        site.end_of_day()
        assert float(site.learned.albedo) == pytest.approx(0.2 + 0.2 * 0.1)
        ratio = site.learned.gain_west if turned else site.learned.gain_east
        assert float(ratio / site.learned.gain_south) == pytest.approx(1.04**0.2)


@pytest.mark.parametrize(("change", "learns"), [
    ({}, True), ({"usable": [True, True, True, False]}, False), ({"beam": 299.0}, False), ({"beam": 301.0}, True),
    ({"zenith": 1.43}, False), ({"zenith": 1.42}, True),
])  # fmt: skip
def test_only_readings_with_all_faces_usable_and_a_strong_dominant_beam_are_learned_from(change, learns):
    sun = np.array([0.6, 0.5, np.sqrt(1.0 - 0.61)])
    beam = change.get("beam", 800.0)
    faces = np.array([500.0, 560.0, 150.0, change.get("zenith", 1.2) * beam * sun[2]])
    site = SiteLearning()
    site.observe(faces, sun, np.array(change.get("usable", [True] * 4)), np.array(beam), 3600.0)
    site.end_of_day()
    assert (site.learned != LearnedSite(0.2, 1.0, 1.0, 1.0)) == learns
