"""What a report counts together: the module's energy."""

import numpy as np
import pandas as pd
import pytest

from daemon.studies.report.material import of_tables
from daemon.studies.report.span import ReportSpan
from daemon.studies.report.yields import module_kwh
from solar.ephemeris import DAY_S, Site

T0 = 1655164800.0
"""2022-06-14T00:00Z."""
EMPTY = pd.DataFrame(index=pd.DatetimeIndex([], tz="UTC", name="time"))


def material(**tables):
    """Return that of the day of June, all tables but the given ones empty."""
    kinds = ("scans", "decisions", "moves", "poses", "modes", "events", "curves")
    (found,) = of_tables(
        {kind: tables.get(kind, EMPTY) for kind in kinds},
        ReportSpan(T0, T0 + DAY_S, "day"),
        Site(48.7, 0.0, 0.0),
        "here",
        "tables",
    )
    return found


def table(utc_s, **columns):
    index = pd.to_datetime(np.asarray(utc_s, dtype=np.float64), unit="s", utc=True).rename("time")
    return pd.DataFrame(columns, index=index)


@pytest.mark.parametrize("every_s", [20.0, 60.0, 300.0, 1200.0])
def test_the_module_s_energy_is_the_same_however_often_its_curves_are_measured(every_s):
    utc_s = T0 + np.arange(10 * 3600.0, 14 * 3600.0, every_s)
    found = material(curves=table(utc_s, quality="ok", pmpp_w=250.0))
    assert module_kwh(found, T0, T0 + DAY_S) == pytest.approx((1.0, 4 * 3600.0))


def test_a_curve_does_not_stand_for_the_hours_in_which_none_was_measured():
    utc_s = T0 + np.arange(10 * 3600.0, 14 * 3600.0, 300.0)
    utc_s = utc_s[(utc_s < T0 + 11 * 3600.0) | (utc_s >= T0 + 13 * 3600.0)]
    _, known_s = module_kwh(material(curves=table(utc_s, quality="ok", pmpp_w=250.0)), T0, T0 + DAY_S)
    assert known_s == pytest.approx(2 * 3600.0 + 150.0)
