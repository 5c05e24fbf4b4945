"""Four faces that no light explains, and which of them is wrong."""

import numpy as np
import pytest

from solar.energy import arrange_daylight, build_sky, face_irradiances
from solar.ephemeris import Site
from solar.faces.contradiction import PAIRS, bounded_face_irradiances, misfits
from solar.laws.light import Light

SITE = Site(48.7176, 2.2090, 156.0)
MORNING_UTC_S = 1655283600.0  # 2022-06-15 09:00


def half_hour(model="perez1990", beam_w_m2=700.0, albedo=0.2, at_utc_s=MORNING_UTC_S):
    """Return faces with gains 2 % off, with a cloud, and the sun's directions."""
    utc_s = at_utc_s + 60.0 * np.arange(30)
    beam = beam_w_m2 * np.where(np.abs(np.arange(30) - 15) < 4, 0.3, 1.0)
    weather = arrange_daylight(utc_s, beam, np.full(30, 150.0), SITE, 60.0)
    gains = np.array([1.02, 0.98, 1.02, 0.98])
    return gains * face_irradiances(build_sky(weather, model), albedo), weather.sun


def unexplained(**otherwise):
    """Return misfits that are all large except for the named ones."""
    found = misfits(*half_hour())
    large = {"without": np.full(4, 0.4), "least_without": np.full(4, 0.3), "doubled": np.full(4, 0.4)}
    large |= {"whole": 0.4, "least": 0.3, "swapped": np.full(len(PAIRS), 0.4), "without_snow": 0.4}
    for name, share in (large | otherwise).items():
        setattr(found, name, share)
    return found


@pytest.mark.parametrize("albedo", [0.05, 0.2, 0.8])
@pytest.mark.parametrize("beam_w_m2", [0.0, 300.0, 800.0])
@pytest.mark.parametrize("model", ["isotropic", "haydavies", "perez1990", "perez1993"])
def test_sound_faces_agree_under_every_sky_and_over_every_ground(model, beam_w_m2, albedo):
    found = misfits(*half_hour(model, beam_w_m2, albedo))
    assert found.whole < 0.11
    assert not found.is_contradictory
    assert found.suspect_faces == ()


@pytest.mark.parametrize(("face", "at_w_m2"), [(0, 60.0), (1, 900.0), (2, 700.0), (3, 150.0)])
def test_the_face_that_the_others_contradict_is_accused(face, at_w_m2):
    faces, sun = half_hour(at_utc_s=MORNING_UTC_S + 3600.0)
    faces[:, face] = at_w_m2
    found = misfits(faces, sun)
    assert found.is_contradictory
    assert found.whole > 0.15
    assert found.suspect_faces == (face,)


@pytest.mark.parametrize("pair", PAIRS)
def test_two_swapped_faces_are_never_found_in_order_and_are_accused_at_some_hour_and_no_others_are(pair):
    named = set()
    for hours in range(-3, 7):
        faces, sun = half_hour(at_utc_s=MORNING_UTC_S + 3600.0 * hours)
        one, other = pair
        faces[:, [one, other]] = faces[:, [other, one]]
        found = misfits(faces, sun)
        assert not found.rules_out_swaps(pair)
        named.add(found.suspect_faces)
    assert pair in named
    assert named <= {pair, ()}


def test_two_faces_are_accused_as_swapped_only_if_no_single_face_explains_the_readings_as_well():
    swapped = np.array([0.05, 0.4, 0.4, 0.4, 0.4, 0.4])
    assert unexplained(without=np.array([0.4, 0.15, 0.101, 0.4]), swapped=swapped).suspect_faces == (0, 1)
    # Two faces might be wrong and cannot be told apart; then other faces are not called swapped either.
    assert unexplained(without=np.array([0.4, 0.15, 0.099, 0.4]), swapped=swapped).suspect_faces == ()


def test_readings_that_only_snow_or_a_bright_horizon_explains_do_not_fit_ordinary_light():
    faces, sun = half_hour(beam_w_m2=0.0)
    faces[:, 3] *= 0.45
    found = misfits(faces, sun)
    assert found.whole < 0.08 < found.without_snow
    assert misfits(*half_hour()).without_snow < 0.08
    assert misfits(*half_hour(albedo=0.8)).without_snow > 0.15


def test_faces_are_found_in_order_only_where_the_light_can_tell_them_apart():
    sound = misfits(*half_hour())
    assert sound.rules_out_swaps((0, 1))
    assert not sound.rules_out_swaps((0, 3)), "the sun stands as much in the east as it stands high"
    assert not sound.rules_out_swaps((0, 1, 3))
    assert not misfits(*half_hour(beam_w_m2=0.0)).rules_out_swaps((0, 1)), "an even sky lights vertical faces alike"


def test_a_fault_of_the_last_minutes_only_is_no_contradiction_yet():
    faces, sun = half_hour()
    faces[15:, 3] = 20.0
    found = misfits(faces, sun)
    assert found.whole > 0.15
    assert not found.is_contradictory


@pytest.mark.parametrize(("share", "missing", "known"), [(1.0, 6, True), (1.0, 7, False), (0.02, 0, False)])
def test_seven_missing_minutes_or_dusk_give_no_verdict_on_the_faces_and_six_missing_minutes_do(share, missing, known):
    faces, sun = half_hour()
    faces[:missing, 1] = np.nan
    assert (misfits(share * faces, sun) is not None) is known


def test_a_sun_at_the_horizon_gives_no_verdict_on_the_faces():
    faces, sun = half_hour()
    assert misfits(faces, sun * [1.0, 1.0, 0.05]) is None


@pytest.mark.parametrize(
    ("without", "accused"),
    [
        # Without the wrong face 6 % are left at most; without any other face twice as much, and at least 8 %.
        ((0.059, 0.13, 0.4, 0.4), (0,)),
        ((0.4, 0.061, 0.4, 0.4), ()),
        ((0.4, 0.4, 0.05, 0.099), ()),
        ((0.4, 0.4, 0.05, 0.101), (2,)),
        ((0.079, 0.4, 0.4, 0.02), ()),
        ((0.081, 0.4, 0.4, 0.02), (3,)),
    ],
)
def test_a_face_is_accused_if_without_it_little_is_unexplained_and_without_any_other_clearly_more(without, accused):
    assert unexplained(without=np.array(without), least=0.151).suspect_faces == accused
    assert unexplained(without=np.array(without), least=0.149).suspect_faces == ()


@pytest.mark.parametrize(
    ("whole", "swapped", "in_order"), [(0.079, 0.151, True), (0.081, 0.151, False), (0.079, 0.149, False)]
)
def test_faces_are_found_in_order_if_they_agree_and_would_contradict_each_other_when_swapped(whole, swapped, in_order):
    found = unexplained(whole=whole, swapped=np.array([swapped, *[0.0] * 5]))
    assert found.rules_out_swaps((0, 1)) == in_order
    # A single face cannot be swapped.
    assert found.rules_out_swaps((0,)) == (whole < 0.08)


@pytest.mark.parametrize(
    ("without_snow", "doubled", "in_full"), [(0.079, 0.081, True), (0.081, 0.3, False), (0.079, 0.079, False)]
)
def test_a_face_is_found_to_read_in_full_if_all_agree_and_would_not_if_it_read_twice_as_much(
    without_snow, doubled, in_full
):
    found = unexplained(without_snow=without_snow, doubled=np.array([0.0, 0.0, doubled, 0.0]))
    assert found.rules_out_half_gain(2) == in_full


@pytest.mark.parametrize("face", [0, 1, 3])
def test_a_face_at_half_its_gain_agrees_with_the_others_when_its_readings_are_doubled(face):
    faces, sun = half_hour()
    assert misfits(faces, sun).doubled[face] > 0.1
    faces[:, face] *= 0.5
    assert misfits(faces, sun).doubled[face] < 0.06


def test_a_face_can_be_blamed_alone_only_if_the_three_others_agree():
    faces, sun = half_hour()
    faces[:, 1] *= 0.3
    found = misfits(faces, sun)
    assert [found.others_agree_without(face) for face in range(4)] == [False, True, False, False]
    assert [found.other_wrong_face(face) for face in range(4)] == [1, None, 1, 1]
    sound = misfits(*half_hour())
    assert [sound.others_agree_without(face) for face in range(4)] == [True] * 4
    assert [sound.other_wrong_face(face) for face in range(4)] == [None] * 4


@pytest.mark.parametrize(("share", "bears"), [(0.079, True), (0.081, False)])
def test_three_faces_agree_if_they_leave_less_than_8_percent_unexplained(share, bears):
    found = unexplained(without=np.full(4, share))
    assert found.others_agree_without(0) == bears


@pytest.mark.parametrize(("least", "instead"), [(0.149, None), (0.151, 2)])
def test_another_face_is_blamed_instead_only_if_the_rest_contradicts_itself_without_this_one(least, instead):
    without = np.array([0.4, 0.4, 0.02, 0.4])
    found = unexplained(without=without, least_without=np.array([least, 0.2, 0.01, 0.2]))
    assert found.other_wrong_face(0) == instead


def test_no_other_face_is_blamed_instead_where_two_faces_may_be_swapped():
    found = unexplained(swapped=np.array([0.01, *[0.4] * 5]))
    assert found.suspect_faces == (0, 1)
    assert found.other_wrong_face(2) is None


def test_misfits_do_not_depend_on_the_brightness_of_the_light():
    faces, sun = half_hour()
    bright, dim = misfits(faces, sun), misfits(0.15 * faces, sun)
    assert (dim.without.shape, dim.swapped.shape) == ((4,), (6,))
    for name in ("without", "least_without", "swapped"):
        np.testing.assert_allclose(getattr(dim, name), getattr(bright, name), rtol=1e-9)


@pytest.mark.parametrize(
    ("faces_w_m2", "enough"), [((400.0, 10.0, 10.0, 10.0), False), ((400.0, 10.0, 10.0, 400.0), True)]
)
def test_light_on_two_faces_is_enough_for_a_verdict_and_light_on_one_alone_is_not(faces_w_m2, enough):
    _, sun = half_hour()
    assert (misfits(np.full((30, 4), faces_w_m2), sun) is not None) is enough


@pytest.mark.parametrize(("horizon", "vertical"), [(-50.0, 30.0), (-10.0, 40.0), (60.0, 110.0), (90.0, 120.0)])
def test_the_light_of_the_horizon_is_bounded_to_minus_0_2_and_plus_0_7_of_that_of_the_sky(horizon, vertical):
    light = Light(np.array(0.0), np.array(100.0), np.array(horizon))
    np.testing.assert_allclose(
        bounded_face_irradiances(light, np.array([0.6, 0.0, 0.8]), 0.0), [vertical] * 3 + [100.0]
    )
