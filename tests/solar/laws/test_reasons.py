import pytest

from solar.laws import reasons


@pytest.mark.parametrize(
    ("azimuth_deg", "name"), [(0.0, "north"), (359.0, "north"), (22.4, "north"), (22.6, "north-east"), (201.0, "south")]
)
def test_an_azimuth_is_named_by_the_nearest_of_eight_compass_points(azimuth_deg, name):
    assert reasons.point_of_compass(azimuth_deg) == name


def test_a_direction_within_5_degrees_of_the_zenith_is_described_as_an_even_sky_or_no_sun():
    assert reasons.light_reason(140.0, 85.0) == "the sky is even: lying flat collects most"
    assert reasons.sun_reason(140.0, 90.0) == "no sun is seen, or it is overhead: lying flat collects most"
    assert reasons.light_reason(140.0, 84.0) == "most light comes from the south-east, 84 deg up"
    assert reasons.light_reason(140.0, -0.4) == "most light comes from the south-east, 0 deg up"
    assert reasons.sun_reason(140.0, 40.4) == "the faces see the sun in the south-east, 40 deg up"


def test_the_reason_for_a_move_or_none_gives_its_gain_and_its_cost_or_what_hinders_it():
    assert reasons.move_reason(7.04, 1.16, moves=True) == "7.0 W/m2 to gain, more than the wear of a move costs (1.2)"
    assert reasons.move_reason(0.24, 0.2, moves=False) == "0.2 W/m2 to gain, not worth a move (from 0.2)"
    assert reasons.move_reason(7.04, 1.16, moves=False, hindered="it is late") == "7.0 W/m2 to gain, but it is late"
