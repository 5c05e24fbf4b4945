"""What a simulation of both trackers writes into a store."""

import sqlite3
from contextlib import closing

from daemon.base.records import Event
from daemon.config.links import StoreSettings
from daemon.config.settings import Settings
from daemon.store.schema import FILE_NAME
from daemon.studies.compare.stored import open_simulation_stores

T0 = 1665532800.0
DAY_S = 86400.0


def test_a_simulation_removes_no_day_that_an_earlier_one_has_left_in_the_store(tmp_path):
    settings = Settings(store=StoreSettings(keep_days=1))
    for day in range(3):
        start_utc_s = T0 + day * DAY_S
        with open_simulation_stores(settings, ["T-Cube"], tmp_path, start_utc_s) as keep:
            keep("T-Cube", Event(start_utc_s, 0.0, "test", "a line"))
    with closing(sqlite3.connect(tmp_path / FILE_NAME)) as store:
        assert store.execute("SELECT count(*) FROM events").fetchone() == (3,)
