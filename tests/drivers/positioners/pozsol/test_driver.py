"""Which settings of a POZSOL box fit together."""

from types import SimpleNamespace

import pytest
from pydantic import ValidationError

from drivers.positioners.pozsol.driver import PozsolSettings


def limits(a_min_deg, a_max_deg, b_min_deg, b_max_deg):
    return SimpleNamespace(a_min_deg=a_min_deg, a_max_deg=a_max_deg, b_min_deg=b_min_deg, b_max_deg=b_max_deg)


@pytest.mark.parametrize(
    ("a_axis", "limits_deg", "wrong"),
    [
        ({}, (-50.0, 50.0), False),
        # The triangle's angle at the low end, at each limit, and mirrored: more than 0 and less than 180 deg.
        ({"apex_deg": 50.5, "low_deg": -50.0}, (-49.0, 50.0), False),
        ({"apex_deg": 50.0, "low_deg": -50.0}, (-49.0, 50.0), True),
        ({"apex_deg": 50.5, "low_deg": -40.0}, (-50.0, 50.0), False),
        ({"apex_deg": 50.5, "low_deg": -40.0}, (-51.0, 50.0), True),
        ({"apex_deg": 129.5, "low_deg": -50.0}, (-49.0, 50.0), False),
        ({"apex_deg": 130.0, "low_deg": -50.0}, (-49.0, 50.0), True),
        ({"apex_deg": 129.5, "low_deg": 50.0, "sense": "lowers"}, (-51.0, 50.0), True),
        ({"apex_deg": 129.5, "low_deg": 50.0, "sense": "lowers"}, (-49.0, 50.0), False),
        ({"apex_deg": 50.5, "low_deg": 51.0, "sense": "lowers"}, (-50.0, 50.0), True),
        ({"apex_deg": 51.5, "low_deg": 51.0, "sense": "lowers"}, (-50.0, 50.0), False),
    ],
)
def test_an_axis_whose_triangle_is_flat_at_some_angle_of_its_range_is_a_settings_conflict(a_axis, limits_deg, wrong):
    settings = PozsolSettings.model_validate({"driver": "pozsol", "position_unit": "mm", "a_axis": a_axis})
    found = list(settings.conflicts(limits(*limits_deg, 15.0, 90.0)))
    assert [conflict.key for conflict in found] == (["a_axis.apex_deg"] if wrong else [])
    assert not list(settings.model_copy(update={"position_unit": "deg"}).conflicts(limits(-90.0, 90.0, 0.0, 90.0)))


def test_telemetry_stale_s_is_at_least_0_5_s_because_screens_are_gathered_before_reading():
    assert PozsolSettings(driver="pozsol", telemetry_stale_s=0.5).telemetry_stale_s == 0.5
    with pytest.raises(ValidationError, match=r"greater than or equal to 0\.5"):
        PozsolSettings(driver="pozsol", telemetry_stale_s=0.4)
