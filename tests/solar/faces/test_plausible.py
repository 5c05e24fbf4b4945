"""Which faces may be right, and which follow the light."""

import numpy as np
import pytest

from solar.ephemeris import sun_direction
from solar.faces.plausible import Doubt, Response, doubts, is_lit, lit_at_night, responses
from solar.skies.sky import sky

SITE = (48.7176, 2.2090, 156.0)
NORMALS = np.array([[0.0, 1, 0], [1.0, 0, 0], [0.0, -1, 0], [0.0, 0, 1]])
MORNING_UTC_S = 1655283600.0  # 2022-06-15 09:00
ALL = [True] * 4


def half_hour(model="perez1990", beam_w_m2=700.0, at_utc_s=MORNING_UTC_S, cloud_minutes=range(12, 19)):
    """Return the faces of thirty minutes, with a cloud in their middle, and the sun's directions."""
    utc_s = at_utc_s + 60.0 * np.arange(30)
    sun = sun_direction(utc_s, *SITE)
    cloud = np.where(np.isin(np.arange(30), cloud_minutes), 0.3, 1.0)
    light = sky(model, sun, beam_w_m2 * cloud, np.full(30, 150.0), np.full(30, 1330.0))
    noise = np.random.default_rng(1).normal(0.0, 0.3, (30, 4))
    return np.stack([light.irradiance_on(normal[None, :]) for normal in NORMALS], axis=-1) + noise, sun


def those(response, found):
    return [face for face, each in enumerate(found) if each is response]


@pytest.mark.parametrize("model", ["isotropic", "haydavies", "perez1990"])
def test_the_faces_that_the_sun_reaches_follow_the_light(model):
    faces, sun = half_hour(model)
    assert responses(faces, sun, ALL) == [
        Response.FOLLOWS,
        Response.FOLLOWS,
        Response.UNKNOWN,
        Response.FOLLOWS,
    ]


@pytest.mark.parametrize("stuck_w_m2", [0.0, 80.0, 600.0])
@pytest.mark.parametrize("face", [0, 1, 3])
def test_a_face_that_stays_constant_while_the_light_changes_is_found_and_no_other_is(face, stuck_w_m2):
    faces, sun = half_hour()
    faces[:, face] = stuck_w_m2 + np.random.default_rng(2).normal(0.0, 0.3, 30)
    assert those(Response.STAYS, responses(faces, sun, ALL)) == [face]


@pytest.mark.parametrize("face", range(4))
def test_after_one_wrong_minute_of_a_face_no_face_is_found_to_stay_constant(face):
    utc_s = MORNING_UTC_S + 60.0 * np.arange(30)
    sun = sun_direction(utc_s, *SITE)
    light = sky("isotropic", sun, np.full(30, 850.0), np.full(30, 60.0), np.full(30, 1330.0))
    faces = np.stack([light.irradiance_on(normal[None, :]) for normal in NORMALS], axis=-1)
    faces[12, face] += 800.0
    assert Response.STAYS not in responses(faces, sun, ALL)


@pytest.mark.parametrize(("minutes", "expected"), [(1, Response.UNKNOWN), (2, Response.STAYS)])
def test_a_constant_face_is_found_by_a_change_of_two_minutes_and_not_of_one(minutes, expected):
    bright = range(12, 12 + minutes)
    faces, sun = half_hour(cloud_minutes=[minute for minute in range(30) if minute not in bright])
    faces[:, 3] = 300.0
    assert responses(faces, sun, ALL)[3] == expected


def test_a_face_is_not_judged_in_shade_without_another_lit_vertical_face_or_under_an_even_sky():
    faces, sun = half_hour()
    faces[:, 2] = 40.0
    assert responses(faces, sun, ALL)[2] == Response.UNKNOWN
    faces, sun = half_hour(at_utc_s=1655280000.0 + 5 * 3600)
    faces[:, 1] = 40.0
    believed = [True, True, True, False]
    assert responses(faces, sun, believed)[1] == Response.UNKNOWN
    faces, sun = half_hour(beam_w_m2=0.0)
    assert responses(faces, sun, ALL) == [Response.UNKNOWN] * 4


def test_the_only_vertical_face_in_the_sun_is_not_judged():
    faces, sun = half_hour(at_utc_s=1655283600.0 + 2.5 * 3600)
    found = responses(faces, sun, ALL)
    assert found == [Response.UNKNOWN, Response.UNKNOWN, Response.UNKNOWN, Response.FOLLOWS]


@pytest.mark.parametrize("face", [0, 1, 3])
def test_a_face_that_is_not_believed_is_judged_by_the_other_three_that_are(face):
    faces, sun = half_hour()
    believed = [other != face for other in range(4)]
    assert those(Response.FOLLOWS, responses(faces, sun, believed)) == [face]


def test_faces_are_not_judged_with_a_gap_in_one_of_them_or_under_a_low_sun():
    faces, sun = half_hour()
    faces[3, 1] = np.nan
    assert responses(faces, sun, ALL) == [Response.UNKNOWN] * 4
    faces, sun = half_hour(at_utc_s=1655265600.0)
    assert responses(faces, sun, ALL) == [Response.UNKNOWN] * 4


def towards_south(elevation_deg):
    return np.array([np.cos(np.radians(elevation_deg)), 0.0, np.sin(np.radians(elevation_deg))])


OK, DEAD, DARK, SAME, OVER = Doubt.NONE, Doubt.DEAD, Doubt.DARK, Doubt.SAME, Doubt.TOO_BRIGHT
DIFFERENT_MV = (1.0, 5.0, 2.0, 7.0)


@pytest.mark.parametrize(
    ("faces_w_m2", "elevation_deg", "expected"),
    [
        ((100.0, 300.0, 80.0, 400.0), 40.0, (OK, OK, OK, OK)),
        # A hundredth of the second brightest face, which counts as lit above 30 W/m2.
        ((2.99, 300.0, 80.0, 400.0), 40.0, (DEAD, OK, OK, OK)),
        ((3.01, 300.0, 80.0, 400.0), 40.0, (OK, OK, OK, OK)),
        ((80.0, -5.0, 300.0, 400.0), 40.0, (OK, DEAD, OK, OK)),
        ((0.0, 31.0, 20.0, 40.0), 40.0, (DEAD, OK, OK, OK)),
        ((0.0, 29.0, 20.0, 40.0), 40.0, (OK, OK, OK, OK)),
        ((0.0, 0.0, 20.0, 400.0), 40.0, (OK, OK, OK, OK)),
        # Less than 1 W/m2 everywhere with the sun above 10 deg.
        ((0.9, -0.9, 0.5, 0.9), 10.1, (DARK, DARK, DARK, DARK)),
        ((0.9, -0.9, 0.5, 0.9), 9.9, (OK, OK, OK, OK)),
        ((0.9, -1.1, 0.5, 0.9), 10.1, (OK, OK, OK, OK)),
        ((0.9, 0.9, 1.1, 0.9), 10.1, (OK, OK, OK, OK)),
        # 1.3 solar constants at the sun's angle and 100 W/m2: 1137.3 + 100 for the zenith face.
        ((100.0, 300.0, 80.0, 1237.0), 40.0, (OK, OK, OK, OK)),
        ((100.0, 300.0, 80.0, 1238.0), 40.0, (OK, OK, OK, OVER)),
        # For a vertical face also the zenith face and 60 W/m2: 1355.4 + 100 + 60, and 400 + 60 away from the sun.
        ((80.0, 1515.0, 80.0, 100.0), 40.0, (OK, OK, OK, OK)),
        ((80.0, 1516.0, 80.0, 100.0), 40.0, (OK, OVER, OK, OK)),
        ((459.0, 300.0, 80.0, 400.0), 40.0, (OK, OK, OK, OK)),
        ((461.0, 300.0, 80.0, 400.0), 40.0, (OVER, OK, OK, OK)),
        ((80.0, 300.0, 461.0, 400.0), 40.0, (OK, OK, OVER, OK)),
        ((461.0, 300.0, 461.0, 400.0), 40.0, (OK, OK, OK, OVER)),
        ((1310.0, 300.0, 80.0, 1240.0), 40.0, (OVER, OK, OK, OVER)),
        ((461.0, 300.0, 461.0, 0.0), 40.0, (OK, OK, OK, DEAD)),
        # By itself this rule would accuse the west face.
        ((40.0, 300.0, 461.0, 0.0), 40.0, (OK, OK, OK, DEAD)),
        ((261.0, 300.0, 0.0, 200.0), 5.1, (OVER, OK, DEAD, OK)),
        ((261.0, 300.0, 0.0, 200.0), 4.9, (OK, OK, OK, OK)),
        ((np.nan, 300.0, 0.0, 400.0), 40.0, (OK, OK, DEAD, OK)),
    ],
)
def test_readings_beyond_their_bounds_are_doubted_as_dead_dark_or_too_bright(faces_w_m2, elevation_deg, expected):
    assert tuple(doubts(faces_w_m2, DIFFERENT_MV, towards_south(elevation_deg), NORMALS)) == expected


@pytest.mark.parametrize(
    ("voltages_mv", "same"),
    [
        # Within 0.015 mV and two thousandths.
        ((5.0, 2.0, 2.0, 5.0249), True),
        ((5.0, 2.0, 2.0, 5.0260), False),
        # The larger of both counts: 5.015/0.998 = 5.02505.
        ((5.0, 2.0, 2.0, 5.02503), True),
        ((5.02503, 2.0, 2.0, 5.0), True),
        ((-5.0, -2.0, -2.0, -5.02503), True),
        ((-5.02503, -2.0, -2.0, -5.0), True),
        ((5.0, 2.0, 2.0180, 5.0), True),
        ((5.0, 2.0, 2.0200, 5.0), False),
        ((-5.02, -2.0, -2.0, -5.0), True),
        ((2.0, 5.0, 2.0, 5.0), True),
        ((2.0, 2.0, 5.0, 5.0), True),
        ((5.0, 5.0, 5.0, 2.0), False),
        ((5.0, 2.0, 5.0, 2.0), True),
        ((0.09, 0.09, 0.09, 0.09), False),
        ((0.11, 0.11, 0.11, 0.11), True),
        ((0.0, 5.0, 0.0, 5.0), True),
        ((-0.11, -0.11, -0.11, -0.11), True),
        ((5.0, 2.0, 2.0, np.nan), False),
    ],
)
def test_voltages_that_are_equal_in_pairs_are_doubted_as_two_inputs_taken_for_one(voltages_mv, same):
    found = doubts((100.0, 300.0, 80.0, 400.0), voltages_mv, towards_south(40.0), NORMALS)
    assert tuple(found) == (SAME if same else OK,) * 4


def test_of_several_reasons_to_doubt_a_face_the_gravest_is_reported():
    dark_and_same = doubts((0.5, 0.5, 0.5, 0.5), (0.2, 0.2, 0.2, 0.2), towards_south(40.0), NORMALS)
    over_same_and_dead = doubts((461.0, 300.0, 0.0, 400.0), (5.0, 2.0, 2.0, 5.0), towards_south(40.0), NORMALS)
    assert tuple(dark_and_same) == (DARK,) * 4
    assert tuple(over_same_and_dead) == (SAME, SAME, DEAD, SAME)


@pytest.mark.parametrize(
    ("faces_w_m2", "elevation_deg", "expected"),
    [
        ((0.0, 31.0, 0.0, 40.0), 5.1, True),
        ((0.0, 29.0, 0.0, 40.0), 5.1, False),
        ((0.0, 31.0, 0.0, 40.0), 4.9, False),
        ((np.nan, 31.0, np.nan, 40.0), 5.1, True),
        ((np.nan, np.nan, np.nan, 40.0), 5.1, False),
    ],
)
def test_faces_count_as_lit_from_30_w_m2_on_the_second_brightest_with_the_sun_5_degrees_up(
    faces_w_m2, elevation_deg, expected
):
    assert is_lit(faces_w_m2, towards_south(elevation_deg)) is expected


@pytest.mark.parametrize(
    ("faces_w_m2", "sine", "named"),
    [
        ((0.1, 300.0, -0.2, 0.0), -0.2, [1]),
        ((0.1, 21.0, -0.2, 0.0), -0.2, [1]),
        ((0.1, 300.0, -0.2, 0.0), -0.08, []),
        ((0.1, 19.0, -0.2, 0.0), -0.2, []),
        ((8.0, 300.0, -0.2, 0.0), -0.2, []),
        ((0.1, 300.0, -8.0, 0.0), -0.2, []),
        ((np.nan, 300.0, -0.2, 0.0), -0.2, []),
    ],
)
def test_a_face_that_alone_reads_light_at_night_is_found_wrong(faces_w_m2, sine, named):
    assert np.flatnonzero(lit_at_night(faces_w_m2, (0.9, 0.1, sine))).tolist() == named


def test_in_the_afternoon_south_and_west_follow_the_light():
    faces, sun = half_hour(at_utc_s=MORNING_UTC_S + 5.5 * 3600.0)
    assert responses(faces, sun, ALL) == [
        Response.UNKNOWN,
        Response.FOLLOWS,
        Response.FOLLOWS,
        Response.FOLLOWS,
    ]


def test_a_face_that_the_sun_leaves_during_the_half_hour_is_not_judged():
    faces, sun = half_hour(at_utc_s=MORNING_UTC_S + 110.0 * 60.0)
    assert sun[0, 1] > 0.15 > sun[-1, 1]
    assert responses(faces, sun, ALL)[0] == Response.UNKNOWN


@pytest.mark.parametrize(("minutes", "judged"), [(0, False), (17, True)])
def test_faces_are_judged_only_if_the_sun_is_five_degrees_up_for_the_whole_half_hour(minutes, judged):
    # A December morning, with the sun in the south-east: it rises through 5 degrees at 08:22.
    faces, sun = half_hour(beam_w_m2=1500.0, at_utc_s=1671062400.0 + 8.12 * 3600.0 + 60.0 * minutes)
    assert sun[-1, 2] > np.sin(np.radians(5.0))
    follows = [Response.FOLLOWS, Response.FOLLOWS, Response.UNKNOWN, Response.FOLLOWS]
    assert responses(faces, sun, ALL) == (follows if judged else [Response.UNKNOWN] * 4)
