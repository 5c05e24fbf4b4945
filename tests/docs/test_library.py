import re
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest

import heliocube
from daemon.base.clock import SystemClock
from daemon.store.store import Store
from tests.daemon.store.test_store import ORIGIN
from tests.daemon.store.test_tables import scan
from tests.support import DOCS

pytestmark = pytest.mark.slow

NOON_UTC_S = 1665576000.0  # 2022-10-12T12:00Z

PAGE = (DOCS / "library.md").read_text()
BLOCKS = re.findall(r"```python\n(.*?)```", PAGE, re.DOTALL)


@pytest.fixture(scope="module")
def names(tmp_path_factory):
    """The names that the page's examples define, run one after the other in one notebook."""
    defined = {}
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(tmp_path_factory.mktemp("notebook"))
        for block in BLOCKS:
            exec(compile(block, "docs/library.md", "exec"), defined)
    return defined


def test_the_sun_is_in_the_south_at_noon_and_highest_then(names):
    assert names["sun"].azimuth_deg[4] == pytest.approx(180.0, abs=0.01)
    assert names["sun"].elevation_deg.argmax() == 4


def test_the_library_page_examples_give_the_angles_that_the_page_describes(names):
    a_deg, b_deg = names["a_deg"], names["b_deg"]
    assert -50.0 < a_deg[0] < 0.0  # East
    assert 15.0 < b_deg[0] < 90.0
    assert b_deg[1] == 90.0
    assert names["between_deg"].shape == (2,)


def test_a_simulated_day_is_returned_as_data_frames_with_a_utc_index(names):
    tables = names["tables"]
    assert tables.keys() == {"scans", "decisions", "moves", "poses", "modes", "events", "curves"}
    for table in tables.values():
        assert isinstance(table.index, pd.DatetimeIndex)
        assert table.index.name == "time"
        assert str(table.index.tz) == "UTC"
    assert len(tables["scans"]) > 700
    assert tables["curves"].empty
    assert (names["turned_deg"] > 5.0).all()


def test_recorded_readings_are_read_back_unchanged_and_drive_a_tracker(names):
    faces, positions = names["faces"], names["positions"]
    written = names["recorded"][["east", "south", "west", "zenith"]]
    np.testing.assert_allclose(faces.to_numpy(), written.to_numpy())
    assert faces.index.equals(pd.DatetimeIndex(written.index.as_unit(faces.index.unit)))
    assert len(positions) == len(faces)
    assert set(positions["law"].dropna()) == {"optimal"}
    assert (positions["mode"] == "tracking").sum() > 500
    assert positions["dni_est"].notna().any()


def test_a_store_is_read_as_data_frames_and_a_missing_store_is_an_error(names, tmp_path):
    store = Store(tmp_path, 60.0, 400, ORIGIN, SystemClock(), print)
    store.keep(replace(scan(0), time_utc_s=NOON_UTC_S))
    store.keep(replace(scan(1), time_utc_s=NOON_UTC_S + 86400.0))
    store.close()
    ghi, poses = names["day_of_a_rig"](tmp_path)
    assert ghi.index.tolist() == [pd.Timestamp("2022-10-12T12:00Z")]
    assert list(poses.columns) == ["surface_tilt", "surface_azimuth"]
    with pytest.raises(heliocube.UserError, match="none here"):
        heliocube.read_store(tmp_path / "none here")
