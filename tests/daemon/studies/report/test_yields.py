"""What a report adds up: the module's energy, and the hours of each sky."""

import re

import numpy as np
import pandas as pd
import pytest

from daemon.base.records import FACES
from daemon.studies.report.formatting import summary
from daemon.studies.report.material import split_by_tracker
from daemon.studies.report.page import findings_of
from daemon.studies.report.span import ReportSpan
from daemon.studies.report.yields import module_kwh
from solar.calibration.selection import clear_sky_ghi
from solar.energy import arrange_daylight, build_sky, face_irradiances
from solar.ephemeris import DAY_S, Site, sun_direction

SITE = Site(48.7, 0.0, 0.0)
T0 = 1655164800.0
"""2022-06-14T00:00Z."""
EMPTY = pd.DataFrame(index=pd.DatetimeIndex([], tz="UTC", name="time"))


def material(**tables):
    """Return the material of the day in June; tables that are not given are empty."""
    kinds = ("scans", "decisions", "moves", "poses", "modes", "events", "curves")
    (found,) = split_by_tracker(
        {kind: tables.get(kind, EMPTY) for kind in kinds},
        ReportSpan(T0, T0 + DAY_S, "day"),
        SITE,
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


def clear_day():
    """Return the scans of a day without a cloud, one a minute."""
    minutes = T0 + np.arange(0.0, DAY_S, 60.0)
    utc_s = minutes[sun_direction(minutes, *SITE)[:, 2] > 0.0]
    _, dni, dhi = clear_sky_ghi(SITE, utc_s)
    weather = arrange_daylight(utc_s, dni, dhi, SITE)
    readings = face_irradiances(build_sky(weather, "isotropic"), 0.2)
    return table(
        weather.utc_s,
        **{f"{face}_w_m2": readings[:, number] for number, face in enumerate(FACES)},
        **{f"{face}_quality": "ok" for face in FACES},
    )


def told_of_the_sky(scans):
    found = findings_of(material(scans=scans), None)
    sky, *_ = summary(found.material, found.light, found.gained, found.motion, found.quality, found.alarms)
    daylight, *hours = (float(text) for text in re.findall(r"([\d.]+) h\b", sky))
    assert sum(hours) == pytest.approx(daylight, abs=0.11)
    return sky


def test_the_summary_of_a_clear_day_names_its_clear_hours_and_those_with_a_low_sun():
    assert "h of daylight: 14.3 h clear, 1.8 h with the sun below 7 deg;" in told_of_the_sky(clear_day())


def test_the_summary_of_a_day_names_daylight_without_scans_as_not_known():
    scans = clear_day()
    hours = (scans.index.hour >= 10) & (scans.index.hour < 13)
    assert ": 11.3 h clear, 3.0 h not known, 1.8 h with the sun below 7 deg;" in told_of_the_sky(scans[~hours])
