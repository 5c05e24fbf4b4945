"""The days of a report of more than one: days of the site, at whatever instants it begins and ends."""

import numpy as np
import pandas as pd
import pytest

from daemon.base.records import FACES
from daemon.studies.report.material import split_by_tracker
from daemon.studies.report.page import findings_of, page_of
from daemon.studies.report.pictures import days_picture
from daemon.studies.report.span import ReportSpan
from solar.ephemeris import DAY_S, Site, sun_direction

T0 = 1665705600.0
"""2022-10-14T00:00Z."""
KINDS = ("scans", "decisions", "moves", "poses", "modes", "events", "curves")
EAST, PARIS, DATE_LINE = Site(-33.9, 151.2, 0.0), Site(48.7, 2.2, 0.0), Site(-17.8, -180.0, 0.0)


def table(utc_s, **columns):
    index = pd.to_datetime(np.asarray(utc_s, dtype=np.float64), unit="s", utc=True).rename("time")
    return pd.DataFrame(columns, index=index)


def findings(site, begin_s, end_s, moves_utc_s=()):
    """Return the findings for a tracker that lies flat under a uniform sky of 100 W/m2 on the zenith face."""
    minutes = np.arange(begin_s, end_s, 60.0)
    minutes = minutes[sun_direction(minutes, *site)[:, 2] > 0.0]
    uniform = {f"{face}_w_m2": 100.0 if face == "zenith" else 60.0 for face in FACES}
    tables = dict.fromkeys(KINDS, table([])) | {
        "scans": table(minutes, **uniform, **{f"{face}_quality": "ok" for face in FACES}),
        "poses": table(np.arange(begin_s, end_s, 300.0), a_deg=0.0, b_deg=90.0, moving=0.0),
        "moves": table(moves_utc_s, from_a_deg=0.0, end_a_deg=10.0, from_b_deg=0.0, end_b_deg=0.0, outcome="done"),
    }
    (material,) = split_by_tracker(tables, ReportSpan(begin_s, end_s, "aT_b"), site, "here", "tables")
    return findings_of(material, None)


def dates_in(page):
    """Return the first cells of the table of days."""
    rows = page.partition("<h2>Day by day</h2>")[2].partition("</table>")[0].split("<tr>")[2:]
    return [row.partition(">")[2].partition("<")[0] for row in rows]


def test_a_span_between_two_instants_is_divided_at_the_midnights_of_the_site():
    found = findings(EAST, T0, T0 + 3 * DAY_S, [T0 + 3600.0, T0 + 22 * 3600.0])
    lit_h = [each.daylight_s / 3600.0 for each in found.by_day]
    # From ten in the morning of the 14th to ten of the 17th: whole days, and a part at each end.
    assert lit_h == pytest.approx([7.9, 12.9, 12.9, 4.9], abs=0.3)
    assert found.motion.by_day == ((1, 10.0), (1, 10.0), (0, 0.0), (0, 0.0))
    assert dates_in(page_of(found)) == ["2022-10-14", "2022-10-15", "2022-10-16", "2022-10-17"]
    assert sum(each.actual_kwh_m2 for each in found.by_day) == pytest.approx(found.gained.actual_kwh_m2, rel=1e-3)


def test_the_picture_of_days_names_their_year():
    found = findings(EAST, T0, T0 + 3 * DAY_S)
    label = days_picture(found.days, found.by_day, simulated=False).axes[-1].get_xlabel()
    assert label == "day of the site in 2022, from solar midnight (month-day)"


def test_night_minutes_at_either_end_of_a_span_do_not_make_a_day_of_their_own():
    found = findings(PARIS, T0, T0 + 3 * DAY_S)
    assert dates_in(page_of(found)) == ["2022-10-14", "2022-10-15", "2022-10-16"]
    found = findings(PARIS, T0 - 3600.0, T0 + 2 * DAY_S - 3600.0)
    assert dates_in(page_of(found)) == ["2022-10-14", "2022-10-15"]


def test_a_day_is_called_after_the_date_of_its_noon_at_the_date_line():
    begins_s = T0 + DAY_S / 2.0
    found = findings(DATE_LINE, begins_s, begins_s + 2 * DAY_S)
    assert dates_in(page_of(found)) == ["2022-10-14", "2022-10-15"]


def test_a_span_of_24_hours_counts_as_one_day_wherever_it_begins():
    found = findings(EAST, T0, T0 + DAY_S)
    assert len(found.by_day) == len(found.motion.by_day) == 1
    assert "Day by day" not in page_of(found)
