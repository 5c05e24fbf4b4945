"""The light that four faces show, and the pose that collects most of it."""

import numpy as np
import pvlib
import pytest
from hypothesis import given
from hypothesis import strategies as st

from solar.frames import Limits, angles_within, direction_from_azimuth, normal_from_angles
from solar.laws.light import (
    Light,
    aim_vector,
    dot_with_normal,
    is_beam_observable,
    is_zenith_usable,
    light_from_faces,
    usable_faces,
)

LIMITS = Limits()
LATITUDE = 50.0
FACES = {"east": (90.0, 90.0), "south": (90.0, 180.0), "west": (90.0, 270.0), "zenith": (0.0, 180.0)}

reading = st.floats(min_value=0.0, allow_nan=False, allow_infinity=False)
direction = st.tuples(st.floats(0, 360), st.floats(-20, 90)).map(
    lambda angles: direction_from_azimuth(*angles, LATITUDE)
)


def test_the_light_found_from_a_hand_worked_morning_is_right():
    # Sun due south-east at 30 deg: cosines 0.6124 on east and south, 0.5 on the zenith face, none on west.
    sun = direction_from_azimuth(135.0, 30.0, LATITUDE)
    # B 800, D 100, H 10, albedo 0.2: GHI 500, vertical diffuse 50 + 10 + 50.
    faces = [800 * 0.612372 + 110, 800 * 0.612372 + 110, 110.0, 500.0]
    light = light_from_faces(faces, sun, 0.2)
    assert light.beam == pytest.approx(800, rel=2e-3)
    assert light.uniform == pytest.approx(100, abs=1)
    assert light.horizon == pytest.approx(10, abs=0.6)


@given(st.lists(st.floats(-50.0, 2100.0) | st.just(np.nan), min_size=4, max_size=4), direction)
def test_whether_the_zenith_face_is_usable_does_not_depend_on_the_suns_position(faces, sun):
    assert is_zenith_usable(faces) == usable_faces(faces, sun)[3]


def test_the_aim_vector_matches_a_calculation_by_hand():
    # Due south at 45 deg: M = 500 (1, 0, 1) + 30 i + (200 - 0.2 * 700)/2 k.
    sun = np.array([1.0, 0.0, 1.0]) / np.sqrt(2.0)
    light = Light(np.array(500 * np.sqrt(2.0)), np.array(200.0), np.array(30.0))
    np.testing.assert_allclose(aim_vector(light, sun, 0.2), [530.0, 0.0, 530.0])


def test_under_a_uniform_sky_no_beam_is_found_and_the_best_pose_is_flat():
    sun = direction_from_azimuth(200.0, 20.0, LATITUDE)
    light = light_from_faces([60.0, 60.0, 60.0, 100.0], sun, 0.2)
    assert light.beam == pytest.approx(0, abs=0.5)
    _, b_deg = angles_within(aim_vector(light, sun, 0.2), LIMITS)
    assert b_deg == pytest.approx(90, abs=1)


@pytest.mark.parametrize("model", ["isotropic", "haydavies", "perez"])
@pytest.mark.parametrize(("azimuth", "elevation"), [(75.0, 12.0), (110.0, 30.0), (180.0, 62.0), (300.0, 8.0)])
def test_the_light_found_from_pvlibs_faces_predicts_pvlibs_irradiance_on_tilted_planes(model, azimuth, elevation):
    dni, dhi, extra = 600.0, 140.0, 1360.0
    ghi = dhi + dni * np.sin(np.radians(elevation))

    def plane(tilt, facing):
        return pvlib.irradiance.get_total_irradiance(
            tilt, facing, 90 - elevation, azimuth, dni, ghi, dhi, dni_extra=extra,
            airmass=pvlib.atmosphere.get_relative_airmass(90 - elevation), albedo=0.2, model=model,
        )["poa_global"]  # fmt: skip

    sun = direction_from_azimuth(azimuth, elevation, LATITUDE)
    light = light_from_faces([plane(*angles) for angles in FACES.values()], sun, 0.2)
    vector = aim_vector(light, sun, 0.2)
    # M tells how much more one plane receives than another, in the sun's vertical plane.
    for tilt in (20.0, 50.0):
        up, out = np.cos(np.radians(tilt)), np.sin(np.radians(tilt))
        around = direction_from_azimuth(azimuth, 0.0, LATITUDE)
        normal = out * around + np.array([0.0, 0.0, up])
        horizon = light.horizon * (np.sqrt(1 - up * up) - out)
        assert vector @ normal - vector[2] + horizon == pytest.approx(plane(tilt, azimuth) - plane(0, azimuth), abs=2.5)


@pytest.mark.parametrize("missing", range(4))
@pytest.mark.parametrize(("azimuth", "elevation"), [(75.0, 12.0), (110.0, 30.0), (250.0, 25.0)])
def test_beam_and_diffuse_light_are_found_from_any_three_faces_and_the_suns_position(missing, azimuth, elevation):
    sun = direction_from_azimuth(azimuth, elevation, LATITUDE)
    beam, uniform = 600.0, 120.0
    shares = np.maximum([sun[1], sun[0], -sun[1]], 0)
    ghi = beam * sun[2] + uniform
    faces = np.array([*(beam * shares + uniform / 2 + 0.1 * ghi), ghi])
    faces[missing] = np.nan
    light = light_from_faces(faces, sun, 0.2)
    assert light.beam == pytest.approx(beam, rel=0.05)
    assert light.uniform == pytest.approx(uniform, rel=0.25)


def test_missing_dark_and_impossibly_bright_faces_are_not_usable():
    sun = direction_from_azimuth(100.0, 30.0, LATITUDE)
    assert usable_faces([600.0, 200.0, 90.0, 420.0], sun).all()
    assert list(usable_faces([np.nan, 200.0, 90.0, 420.0], sun)) == [False, True, True, True]
    assert list(usable_faces([0.0, 200.0, 90.0, 420.0], sun)) == [False, True, True, True]
    assert list(usable_faces([600.0, 200.0, 90.0, 2.0], sun)) == [True, True, True, False]
    assert list(usable_faces([600.0, 200.0, 1e4, 420.0], sun)) == [True, True, False, True]


@given(st.lists(reading, min_size=4, max_size=4), direction, st.floats(0, 1))
def test_any_finite_faces_give_finite_angles_inside_the_limits(faces, sun, albedo):
    light = light_from_faces(faces, sun, albedo)
    assert all(np.isfinite(part) for part in light)
    assert light.beam >= 0
    assert light.uniform >= 0
    a_deg, b_deg = angles_within(aim_vector(light, sun, albedo), LIMITS)
    assert LIMITS.contain(float(a_deg), float(b_deg))


@given(st.lists(st.one_of(reading, st.just(np.nan), st.just(np.inf)), min_size=4, max_size=4), direction)
def test_nan_and_infinite_faces_give_finite_light(faces, sun):
    assert all(np.isfinite(part) for part in light_from_faces(faces, sun))


@given(
    st.tuples(st.floats(-500, 1000), st.floats(-1000, 1000), st.floats(1, 1000)),
    st.floats(-50, 50),
    st.floats(15, 90),
)
def test_no_pose_inside_the_limits_beats_the_closed_form(vector, a_deg, b_deg):
    best_a, best_b = angles_within(np.array(vector), LIMITS)
    assert dot_with_normal(vector, best_a, best_b) >= dot_with_normal(vector, a_deg, b_deg) - 1e-6
    assert dot_with_normal(vector, a_deg, b_deg) == pytest.approx(
        np.dot(vector, normal_from_angles(a_deg, b_deg)), abs=1e-6
    )


SOUTH = direction_from_azimuth(180.0, 40.0, 50.0)


@pytest.mark.parametrize(("face", "faces", "believed"), [
    (1, (400.0, 2000.0, 400.0, 600.0), True),
    (1, (400.0, 2001.0, 400.0, 600.0), False),
    # Two fifths of another face on which the sun shines no more than on this one, less 1 W/m2 of noise.
    (0, (160.0, 600.0, 400.0, 500.0), True),
    (0, (158.0, 600.0, 400.0, 500.0), False),
    (2, (400.0, 600.0, 160.0, 500.0), True),
    (2, (400.0, 600.0, 158.0, 500.0), False),
    (1, (400.0, 160.0, 400.0, 500.0), True),
    (1, (400.0, 158.0, 400.0, 500.0), False),
    # A dead face at dawn, when the others receive little light themselves.
    (0, (0.3, 9.0, 8.0, 14.0), False),
    (0, (2.5, 9.0, 8.0, 14.0), True),
    # The sun on the other face only is no reason to doubt this one.
    (0, (75.0, 1900.0, 60.0, 500.0), True),
    # Without any other reading nothing says that a face reads too little.
    (0, (-0.9, np.nan, np.nan, np.nan), True),
    # 3 % of the zenith.
    (0, (30.0, 30.0, 30.0, 1000.0), True),
    (0, (28.0, 30.0, 30.0, 1000.0), False),
    # The zenith face, by a fifth of the darkest other.
    (3, (400.0, 600.0, 500.0, 80.0), True),
    (3, (400.0, 600.0, 500.0, 78.0), False),
    (3, (400.0, 600.0, np.nan, 78.0), False),
    (0, (np.nan, 600.0, 400.0, 500.0), False),
])  # fmt: skip
def test_a_face_is_usable_only_within_absolute_bounds_and_those_set_by_the_other_faces(face, faces, believed):
    assert usable_faces(faces, SOUTH)[face] == believed


@pytest.mark.parametrize(("azimuth", "shaded", "lit"), [(90.0, 2, 0), (270.0, 0, 2)])
def test_a_sunlit_face_that_is_much_darker_than_a_shaded_one_is_not_usable(azimuth, shaded, lit):
    faces = np.array([100.0, 100.0, 100.0, 100.0])
    faces[shaded], faces[lit] = 400.0, 75.0
    assert not usable_faces(faces, direction_from_azimuth(azimuth, 40.0, 50.0))[lit]
    faces[shaded], faces[lit] = 75.0, 400.0
    assert usable_faces(faces, direction_from_azimuth(azimuth, 40.0, 50.0))[shaded]


@pytest.mark.parametrize(("azimuth", "elevation", "missing", "told"), [
    (80.0, 1.5, [], True),
    (0.0, 1.5, [], True),
    (80.0, 1.5, [0], False),
    (80.0, 2.8, [0], False),
    (80.0, 2.9, [0], True),
    (80.0, 1.5, [2], True),
    (95.0, 1.5, [0], True),
    (280.0, 1.5, [2], False),
    (280.0, 1.5, [0, 3], True),
    (80.0, 30.0, [0, 3], False),
    (80.0, -1.0, [0], False),
])  # fmt: skip
def test_the_beam_of_a_low_sun_can_be_told_only_with_the_face_that_looks_towards_it(azimuth, elevation, missing, told):
    usable = ~np.isin(np.arange(4), missing)
    assert is_beam_observable(usable, direction_from_azimuth(azimuth, elevation, LATITUDE)) == told


def test_the_product_with_a_pose_equals_that_with_the_normal_of_the_pose():
    random = np.random.default_rng(5)
    vectors, a_deg, b_deg = random.normal(size=(50, 3)), random.uniform(-90, 90, 50), random.uniform(5, 90, 50)
    expected = (vectors * normal_from_angles(a_deg, b_deg)).sum(axis=-1)
    np.testing.assert_allclose(dot_with_normal(vectors, a_deg, b_deg), expected, atol=1e-12)


def test_the_zenith_face_is_judged_by_the_vertical_faces_of_its_own_instant():
    # Beside its own vertical faces the second zenith face is as dark as a dead one; beside the first ones it is not.
    faces = np.array([[5.0, 6.0, 7.0, 4.0], [400.0, 500.0, 450.0, 4.0], [np.nan] * 4])
    assert is_zenith_usable(faces).tolist() == [is_zenith_usable(row).tolist() for row in faces] == [True, False, False]


def test_the_aim_vector_points_slightly_up_even_where_the_ground_gives_more_light_than_the_sky():
    sun = np.array([1.0, 0.0, 0.0])
    vector = aim_vector(Light(np.array(500.0), np.array(100.0), np.array(0.0)), sun, 1.0)
    np.testing.assert_allclose(vector, [500.0, 0.0, 0.1])


DAY, HIGH = (300.0, 410.0, 60.0, 470.0), (0.6, 0.5, 0.62)


# Readings that no light explains, with the faces that count, and this program's results (beam, vault and horizon, and
# where to aim): the weights and the bounds in force show only in such cases.
@pytest.mark.parametrize(("faces", "sun", "counts", "expected"), [
    (DAY, HIGH, (1, 1, 1, 1), (549.692, 128.522, -38.5567, 300.195, 250.163, 358.137)),
    (DAY, HIGH, (0, 1, 1, 1), (583.375, 107.821, -32.3464, 325.176, 270.98, 368.652)),
    (DAY, HIGH, (1, 1, 1, 0), (549.997, 34.8303, 0.00290252, 330.001, 275.001, 320.831)),
    (DAY, HIGH, (1, 0, 0, 1), (94.9657, 411.12, -0.0420866, 56.9471, 47.4559, 217.439)),
    ((5.0, 8.0, 4.0, 20.0), (0.9, -0.3, 0.3), (1, 1, 1, 1), (3.72423, 18.7967, -5.63902, 0, -0, 8.52423)),
    ((5.0, 800.0, 4.0, 20.0), (0.99, 0.05, 0.02), (1, 1, 1, 1), (822.529, 3.32155, -0.996466, 813.309, 41.076, 16.134)),
    ((30.0, 40.0, 50.0, 10.0), (0.8, 0.5, -0.1), (1, 1, 1, 1), (0, 10.4024, 7.28169, 6.17486, 3.85929, 4.16096)),
    ((100.0, 90.0, 110.0, 240.0), (0.1, -0.9, 0.42), (1, 1, 1, 1), (16.2086, 232.648, -45.3698, 0, -0, 99.1859)),
    ((200.0, 20.0, 10.0, 40.0), (-0.3, 0.9, 0.3), (1, 1, 0, 1), (134.351, 0, 0, -40.3054, 120.916, 36.2749)),
    ((0.0, 0.0, 0.0, 0.0), (0.6, 0.5, 0.62), (1, 1, 1, 1), (0, 0, 0, 0, 0, 1e-09)),
])  # fmt: skip
def test_light_and_aim_from_contradictory_readings_have_the_pinned_values(faces, sun, counts, expected):
    light = light_from_faces(faces, sun, 0.2, np.array(counts, dtype=np.bool_))
    assert [*light, *aim_vector(light, sun, 0.2)] == pytest.approx(expected, rel=2e-5, abs=1e-10)


# As B = -20, D = 112.8, H = 0 and albedo 0.2 would read: the lit faces are darker than the one in the shade.
LESS_THAN_NO_BEAM, ASIDE = (56.8, 54.4, 66.4, 100.0), (0.6, 0.48, 0.64)


def test_light_found_without_a_beam_keeps_the_mean_of_the_vertical_faces():
    light = light_from_faces(LESS_THAN_NO_BEAM, ASIDE, 0.2)
    # Their mean of 59.2 less the 10 of the ground is 0.8 less than half of the 100 on the zenith face.
    assert [*light] == pytest.approx([0.0, 100.0, -0.8], abs=1e-3)


def test_the_light_of_many_readings_at_once_equals_that_of_each_alone():
    faces = np.array([DAY, (5.0, 8.0, 4.0, 20.0), (100.0, 90.0, 110.0, 240.0), LESS_THAN_NO_BEAM])
    suns = np.array([HIGH, (0.9, -0.3, 0.3), (0.1, -0.9, 0.42), ASIDE])
    counts = np.array([(1, 1, 0, 1), (1, 1, 1, 1), (0, 1, 1, 1), (1, 1, 1, 1)], dtype=np.bool_)
    together = np.stack(light_from_faces(faces, suns, 0.2, counts), axis=-1)
    alone = [light_from_faces(*one, 0.2, counted) for *one, counted in zip(faces, suns, counts, strict=True)]
    np.testing.assert_allclose(together, alone)
