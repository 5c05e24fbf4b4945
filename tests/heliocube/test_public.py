import ast
import re
import subprocess
import sys
from importlib import import_module
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

import heliocube

SOUTH_AT_45_DEG = [100.0, 600.0, 100.0, 600.0]
EAST_AND_UP = [500.0, 100.0, 100.0, 400.0]
TAKE_DIRECTIONS = (
    heliocube.angles_from_direction,
    heliocube.chronometric,
    lambda vector: heliocube.angles_within(vector, heliocube.Limits()),
    lambda vector: heliocube.separation_deg(vector, vector),
)


def test_every_public_name_is_there_and_documented():
    for name in heliocube.__all__:
        assert (getattr(heliocube, name).__doc__ or "").strip(), name
    assert set(heliocube.__all__) <= set(dir(heliocube))


def test_the_type_checking_imports_name_the_same_objects_as_the_package_loads():
    tree = ast.parse(Path(heliocube.__file__).read_text())
    (typed,) = (node for node in tree.body if isinstance(node, ast.If))
    homes = {alias.name: node.module for node in typed.body if isinstance(node, ast.ImportFrom) for alias in node.names}
    assert homes.keys() == set(heliocube.__all__) - {"__version__"}
    for name, home in homes.items():
        assert getattr(heliocube, name) is getattr(import_module(home), name)


def test_an_unknown_attribute_of_heliocube_is_refused_with_the_names_that_exist():
    with pytest.raises(AttributeError, match=r"heliocube has no 'sun'; it has Angles, .*sun_position"):
        _ = heliocube.sun


def test_the_import_loads_no_large_library():
    code = "import heliocube, sys; print(*sorted({'numpy', 'pandas', 'pvlib', 'scipy', 'daemon'} & set(sys.modules)))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout == "\n"


def test_whole_arrays_of_faces_are_converted_to_angles_at_once():
    faces = np.array([[SOUTH_AT_45_DEG, EAST_AND_UP], [[0.0] * 4, [np.nan] * 4]])
    a_deg, b_deg = heliocube.angles_within(heliocube.mu_prime(faces), heliocube.Limits())
    assert a_deg.shape == b_deg.shape == (2, 2)
    assert (a_deg[0, 0], b_deg[0, 0]) == pytest.approx((0.0, np.degrees(np.arctan2(600.0, 500.0))))
    assert (a_deg[0, 1], b_deg[0, 1]) == pytest.approx((-45.0, 90.0))
    assert np.isnan([a_deg[1], b_deg[1]]).all()


@pytest.mark.parametrize("latitude_deg", [148.0, -90.001, np.nan, np.inf, "48.7", None, np.array([48.0, 49.0])])
def test_a_latitude_that_is_not_on_earth_is_refused(latitude_deg):
    place = (latitude_deg, 2.0, 0.0)
    for asked in (heliocube.sun_position, heliocube.sun_direction, heliocube.sun_day):
        with pytest.raises(ValueError, match="-90 to 90 degrees north"):
            asked(0.0, *place)
    with pytest.raises(ValueError, match="-90 to 90 degrees north"):
        heliocube.Site(*place)


@pytest.mark.parametrize("place", [(90.0, np.nan, 0.0), (90.0, 2.0, -np.inf), (48.0, 2.0, 50000.0), (48.0, "2", "0")])
def test_a_site_with_an_impossible_longitude_or_altitude_is_refused(place):
    with pytest.raises(ValueError, match="degrees east and -430 to 9000 metres above sea level"):
        heliocube.Site(*place)


@pytest.mark.parametrize("ends", [{"a_min_deg": 60.0}, {"b_max_deg": 14.0}, {"b_min_deg": np.nan}])
def test_limits_that_permit_no_angle_are_refused(ends):
    with pytest.raises(ValueError, match="the lowest angle must not be above the highest, as in A"):
        heliocube.Limits(**ends)


@pytest.mark.parametrize("ends", [("-50", "50"), ((-50.0, 50.0), (15.0, 90.0)), (None,), ([-50.0, 50.0],)])
def test_limits_that_are_no_numbers_are_refused(ends):
    with pytest.raises(ValueError, match="limits are four numbers, a_min_deg, a_max_deg, b_min_deg and b_max_deg"):
        heliocube.Limits(*ends)


@pytest.mark.parametrize("limits", [None, (-50.0, 50.0, 15.0, 90.0), heliocube.Limits])
def test_angles_within_refuses_limits_that_are_not_a_limits_object(limits):
    with pytest.raises(ValueError, match=r"the limits must be Limits\(a_min_deg, a_max_deg, b_min_deg, b_max_deg\)"):
        heliocube.angles_within([1.0, 2.0, 3.0], limits)


@pytest.mark.parametrize("albedo", [2.0, -0.1, np.nan, "0.2", None, (0.2, 0.3), np.array([0.2, 0.3])])
def test_an_albedo_that_is_not_a_share_from_0_to_1_is_refused(albedo):
    with pytest.raises(ValueError, match=re.escape(f"the albedo must be a share from 0 to 1, not {albedo}")):
        heliocube.sun_vector(SOUTH_AT_45_DEG, albedo=albedo)


@pytest.mark.parametrize("law", ["mu_prime", "sun_vector"])
def test_the_laws_take_the_faces_of_a_data_frame_by_column_name(law):
    direction = getattr(heliocube, law)
    frame = pd.DataFrame({"zenith": [540.0, None], "ghi": 1.0, "west": 150, "south": 620.0, "east": 310.0})
    expected = direction([[310.0, 620.0, 150.0, 540.0], [310.0, 620.0, 150.0, np.nan]])
    np.testing.assert_array_equal(direction(frame), expected)
    np.testing.assert_array_equal(direction(frame.convert_dtypes()), expected)
    np.testing.assert_array_equal(direction(frame.iloc[0]), expected[0])


@pytest.mark.parametrize("law", [heliocube.mu_prime, heliocube.sun_vector])
def test_a_data_frame_without_columns_named_after_the_faces_is_refused_with_the_missing_names(law):
    # Four columns, as an array has, but two of the names are unknown: nobody can say which face is which.
    frame = pd.DataFrame({"zenith": [540.0], "west_w_m2": [150.0], "south": [620.0], "east_w_m2": [310.0]})
    why = "no column east, west: east, south, west and zenith are needed; found: zenith, west_w_m2, south, east_w_m2"
    for faces in (frame, frame.iloc[0]):
        with pytest.raises(ValueError, match=why):
            law(faces)
    assert law(pd.DataFrame([[310.0, 620.0, 150.0, 540.0]])) == pytest.approx(law([[310.0, 620.0, 150.0, 540.0]]))


@pytest.mark.parametrize(
    "wrong", [["a", 1, 2, 3], {"east": 1.0}, [[1, 2, 3, 4], [1, 2]], pd.DataFrame([["x", 1, 2, 3]])]
)
def test_faces_that_are_no_numbers_are_refused(wrong):
    for law in (heliocube.mu_prime, heliocube.sun_vector):
        with pytest.raises(ValueError, match=r"the faces must be numbers \[W/m2\], NaN where one is missing"):
            law(wrong)


@pytest.mark.parametrize("wrong", [-1.0, np.nan, None])
def test_a_uniform_threshold_that_is_not_a_share_is_refused_by_both_laws_of_the_paper(wrong):
    for law in (heliocube.mu_prime, heliocube.sun_vector):
        with pytest.raises(ValueError, match=f"the uniform threshold must be a share from 0 to 1, not {wrong}"):
            law([1.0, 2.0, 3.0, 4.0], uniform_threshold=wrong)


@pytest.mark.parametrize("wrong", [[1.0, 2.0], np.ones((3, 5))], ids=["two", "turned"])
def test_directions_without_exactly_three_components_are_refused_and_not_truncated(wrong):
    sentence = "directions are south, east, up along the last axis, not an array of"
    for call in TAKE_DIRECTIONS:
        with pytest.raises(ValueError, match=sentence):
            call(wrong)


@pytest.mark.parametrize("times", [1.6e9, [1.6e9, 1.61e9, 1.62e9]])
def test_a_sun_position_is_refused_where_a_direction_is_needed(times):
    for call in TAKE_DIRECTIONS:
        with pytest.raises(ValueError, match="not a SunPosition: take them from sun_direction"):
            call(heliocube.sun_position(times, 48.7, 2.2))


def test_angles_and_directions_that_are_no_numbers_are_refused():
    for call in (*TAKE_DIRECTIONS, lambda angle: heliocube.normal_from_angles(angle, 30.0)):
        for wrong in (["a", "b", "c"], {"south": 1.0}):
            with pytest.raises(ValueError, match="angles and directions must be numbers, NaN where one is missing"):
                call(wrong)


def test_angles_in_two_pandas_series_are_paired_by_their_order_and_not_by_index():
    a_deg, b_deg = pd.Series([10.0, 40.0], index=[1, 0]), pd.Series([30.0, 60.0], index=[0, 1])
    expected = heliocube.normal_from_angles([10.0, 40.0], [30.0, 60.0])
    np.testing.assert_array_equal(heliocube.normal_from_angles(a_deg, b_deg), expected)


def test_an_unknown_kind_of_record_is_refused_with_the_kinds_that_exist(tmp_path):
    for kinds in ("scan", ["poses", "scan"]):
        with pytest.raises(heliocube.UserError, match="kinds: 'scan' is not one of scans, decisions, moves, poses"):
            heliocube.read_store(tmp_path, kinds=kinds)


def test_a_refusal_names_no_option_of_the_command_line(tmp_path):
    refused = [
        (lambda: heliocube.simulate("2022-10-14", law="muprime"), r"(?s)^what was asked for has 1 .* did you mean"),
        (lambda: heliocube.simulate("1900-01-01"), "choose another start or fewer days$"),
        (lambda: heliocube.simulate("2022-12-21", days=0.1, site=(80, 9, 0)), "another start or another site$"),
        (lambda: heliocube.read_store(tmp_path), "no store at .*; name the folder that the service has as"),
        (lambda: heliocube.read_store(tmp_path, start="2022-10-14", end="2022-10-13"), "^the first instant .* the end"),
    ]
    for call, sentence in refused:
        with pytest.raises(heliocube.UserError, match=sentence):
            call()


def test_a_value_that_is_not_three_numbers_is_refused_as_a_site():
    readings = heliocube.read_faces(heliocube.sample("clear")).iloc[600:610]
    for site in ((48.7, 2.2), "48.7,2.2,156", (48.7, "E", 156.0), 48.7):
        with pytest.raises(heliocube.UserError, match=r"is not a place; write heliocube\.Site\("):
            heliocube.replay(readings, site=site)


def test_a_site_may_be_given_as_three_numbers():
    readings = heliocube.read_faces(heliocube.sample("clear")).iloc[600:604]
    place = (48.7176, 2.209, 156.0)
    same = [heliocube.replay(readings, site=site, law="chronometric") for site in (place, heliocube.Site(*place))]
    assert same[0].equals(same[1])
