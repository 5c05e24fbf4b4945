"""A report with more rows than fit on a page, and with rows that occur twice."""

import re

import numpy as np
import pandas as pd

from daemon.base.records import FACES
from daemon.store.runs import StoredRun
from daemon.store.store import Origin
from daemon.studies.report.material import split_by_tracker
from daemon.studies.report.page import findings_of, page_of
from daemon.studies.report.span import ReportSpan
from solar.ephemeris import DAY_S, Site

T0 = 1665705600.0
"""2022-10-14T00:00Z."""
MANY = 301


def table(utc_s, **columns):
    index = pd.to_datetime(np.asarray(utc_s, dtype=np.float64), unit="s", utc=True).rename("time")
    return pd.DataFrame(columns, index=index)


def test_a_report_table_that_is_cut_short_says_how_many_rows_there_are():
    site = Site(48.7, 2.2, 0.0)
    changes_s = T0 + 120.0 * np.arange(1, 2 * MANY + 1)
    holds = [("tracking", "hold"), ("hold", "tracking")] * MANY
    tables = dict.fromkeys(("scans", "decisions", "moves", "curves"), table([])) | {
        "poses": table(np.arange(T0, T0 + DAY_S, 60.0), a_deg=0.0, b_deg=90.0, moving=0.0),
        "modes": table(
            changes_s, before=[before for before, _ in holds], after=[after for _, after in holds], why="a person"
        ),
        "events": table(changes_s[:MANY], subject="configuration", text="[budget] moves: 10 is 20 now"),
    }
    run = StoredRun(1, Origin(T0, "both", "0.1.0", False, "here", *site))
    (material,) = split_by_tracker(
        tables, ReportSpan(T0, T0 + DAY_S, "2022-10-14"), site, "here", "tables", runs=(run,)
    )
    captions = re.findall(r"<caption>(.*?)</caption>", page_of(findings_of(material, None)))
    assert "When it neither tracked nor slept: the first 300 of 301" in captions
    assert "Changes of the configuration, found at a start: the first 300 of 301" in captions
    assert "Messages of the service: the first 300 of 301" in captions


def test_scans_that_were_recorded_twice_do_not_change_the_interval_that_the_report_expects():
    site = Site(48.7, 2.2, 0.0)
    utc_s = np.repeat(np.arange(T0, T0 + DAY_S, 300.0), 2)
    faces = {f"{face}_w_m2": 100.0 for face in FACES} | {f"{face}_quality": "ok" for face in FACES}
    tables = dict.fromkeys(("decisions", "moves", "curves", "modes", "events"), table([])) | {
        "scans": table(utc_s, **faces),
        "poses": table(utc_s[::2], a_deg=0.0, b_deg=90.0, moving=0.0),
    }
    (material,) = split_by_tracker(tables, ReportSpan(T0, T0 + DAY_S, "2022-10-14"), site, "here", "tables")
    assert "one is expected every 300 s" in page_of(findings_of(material, None))
