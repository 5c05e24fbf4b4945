"""The studies inside a notebook, whose kernel runs an event loop already."""

import asyncio
import gc
import os
import re
import signal
import threading
from datetime import UTC, date, datetime

import numpy as np
import pandas as pd
import pytest

import heliocube
from daemon.base.clock import SystemClock
from daemon.base.records import Event, Pose
from daemon.store.store import Origin, Store
from solar.laws.flat import FlatLaw

pytestmark = pytest.mark.slow


def test_a_day_can_be_simulated_inside_a_running_event_loop():
    async def cell():
        return heliocube.simulate("2022-10-14T11:00Z", days=0.02, weather="clear", seed=1)

    tables = asyncio.run(cell())
    assert tables["decisions"]["mode"].iloc[-1] == "tracking"


def test_a_replay_leaves_no_objects_frozen_for_the_garbage_collector():
    readings = heliocube.read_faces(heliocube.sample("mixed")).iloc[600:610]
    before = gc.get_freeze_count()
    heliocube.replay(readings, site=heliocube.Site(48.7176, 2.209, 156.0), law="flat")
    # Frozen objects may have been freed meanwhile.
    assert gc.get_freeze_count() <= before


def test_readings_with_a_time_or_a_face_twice_are_refused():
    readings = heliocube.read_faces(heliocube.sample("mixed")).iloc[600:610]
    site = heliocube.Site(48.7176, 2.209, 156.0)
    with pytest.raises(heliocube.UserError, match=f"have the time {re.escape(str(readings.index[3]))} twice"):
        heliocube.replay(pd.concat([readings, readings.iloc[3:4]]).sort_index(), site=site)
    with pytest.raises(heliocube.UserError, match="have two columns south; keep only the right one"):
        heliocube.replay(pd.concat([readings, readings[["south"]]], axis=1), site=site)


def test_a_number_that_no_face_can_read_is_missing_in_a_frame_as_in_a_file():
    readings = heliocube.read_faces(heliocube.sample("mixed")).iloc[600:620]
    site, bright = heliocube.Site(48.7176, 2.209, 156.0), readings > 200.0
    missing = heliocube.replay(readings.mask(bright), site=site)
    for impossible in (-9999.0, np.inf):
        pd.testing.assert_frame_equal(heliocube.replay(readings.mask(bright, impossible), site=site), missing)


def test_a_file_that_breaks_off_is_read_with_a_warning(tmp_path):
    path = tmp_path / "faces.csv"
    path.write_text("time,east,south,west,zenith\n2022-10-14T10:20Z,1,2,3,4\n2022-10-14T10:21Z,1,2,3")
    with pytest.warns(UserWarning, match=f"{path}: the last line, 3, breaks off at cell 4 of 5 and is left out"):
        readings = heliocube.read_faces(path)
    assert len(readings) == 1


def test_a_weather_file_that_does_not_fit_the_site_gives_a_warning():
    with pytest.warns(UserWarning, match="mixed.csv does not fit a site at 35 N, 139 E") as told:
        heliocube.simulate("2022-10-13T10:00Z", days=0.01, weather=heliocube.sample("mixed"), site=(35.0, 139.0, 0.0))
    assert told[0].filename == __file__


def test_readings_in_kilowatts_give_a_warning():
    readings = heliocube.read_faces(heliocube.sample("mixed")).iloc[600:610] / 1000.0
    with pytest.warns(UserWarning, match=r"the frame has at most 0\.\d+ W/m2 on any face by day") as told:
        heliocube.replay(readings, site=heliocube.Site(48.7176, 2.209, 156.0), law="flat")
    assert told[0].filename == __file__


def test_a_law_that_fails_in_a_simulation_or_a_replay_gives_a_warning(monkeypatch):
    def fails(_law, _now):
        raise ZeroDivisionError("no such sky")

    monkeypatch.setattr(FlatLaw, "aim", fails)
    readings = heliocube.read_faces(heliocube.sample("mixed")).iloc[600:620]
    for study in (
        lambda: heliocube.simulate("2022-10-13T10:00Z", days=0.01, law="flat"),
        lambda: heliocube.replay(readings, site=(48.7176, 2.209, 156.0), law="flat"),
    ):
        with pytest.warns(UserWarning, match="no such sky.* from 2022-10-13T"):
            study()


def test_readings_that_are_no_numbers_are_refused():
    readings = heliocube.read_faces(heliocube.sample("mixed")).iloc[600:610]
    with pytest.raises(heliocube.UserError, match=r"must be numbers \[W/m2\], NaN where a face has none .*'cloudy'"):
        heliocube.replay(readings.astype(object).assign(west="cloudy"), site=(48.7176, 2.209, 156.0))


def test_an_array_for_a_frame_and_a_frame_for_a_file_are_refused_with_what_is_needed():
    readings = heliocube.read_faces(heliocube.sample("mixed")).iloc[600:610]
    with pytest.raises(heliocube.UserError, match="an index of times with their zone"):
        heliocube.replay(readings.to_numpy(), site=heliocube.Site(48.7176, 2.209, 156.0))
    with pytest.raises(heliocube.UserError, match="weather: a file is needed; write the frame with to_csv"):
        heliocube.simulate("2022-10-13", weather=readings)


@pytest.mark.parametrize(("start", "days"), [("1978-12-31", 0.1), ("2099-12-31", 1.1), ("2022-10-14", 1e300)])
def test_a_simulation_outside_the_years_1979_to_2099_is_refused(start, days):
    with pytest.raises(heliocube.UserError, match="within the years 1979 to 2099"):
        heliocube.simulate(start, days=days, weather="clear")


@pytest.mark.parametrize("days", [0, -1, float("nan"), float("inf"), "1", None, [1, 2]])
def test_days_that_are_no_finite_number_above_0_are_refused(days):
    with pytest.raises(ValueError, match=re.escape(f"days must be a number above 0, not {days}")):
        heliocube.simulate("2022-10-14", days=days)


def test_an_argument_that_is_no_path_is_refused_with_the_name_of_its_parameter():
    readings = heliocube.read_faces(heliocube.sample("mixed")).iloc[600:604]
    refused = [
        (
            lambda: heliocube.read_faces(readings),
            "path: a path is needed, such as 'data/day', and not a value of the type DataFrame",
        ),
        (
            lambda: heliocube.read_store(None),
            "directory: a path is needed, such as 'data/day', and not a value of the type NoneType",
        ),
        (
            lambda: heliocube.simulate("2022-10-14", config={}),
            "config: a path is needed, such as 'data/day', and not a value of the type dict",
        ),
        (
            lambda: heliocube.replay(readings, site=None, config=3),
            "config: a path is needed, such as 'data/day', and not a value of the type int",
        ),
    ]
    for call, sentence in refused:
        with pytest.raises(heliocube.UserError, match=sentence):
            call()


@pytest.fixture(scope="module")
def store(tmp_path_factory):
    """The folder of a store with events around both ends of 2022-10-14 UTC, and a pose."""
    folder, midnight = tmp_path_factory.mktemp("store"), datetime(2022, 10, 14, tzinfo=UTC).timestamp()
    origin = Origin(midnight, "both", "0", True, "SIRTA", 48.7, 2.2, 156.0)
    kept = Store(folder, 60.0, None, origin, SystemClock(), print)
    for text, at_s in {"before": -0.001, "first": 0.0, "last": 86399.999, "after": 86400.0}.items():
        kept.keep(Event(midnight + at_s, 0.0, "test", text))
    kept.keep(Pose(midnight, 0.0, 10.0, 60.0, moving=False))
    kept.close()
    return folder


@pytest.mark.parametrize("kinds", [None, []])
def test_no_kinds_stand_for_all_kinds_of_a_store(store, kinds):
    tables = heliocube.read_store(store, kinds=kinds)
    assert sorted(tables) == ["curves", "decisions", "events", "modes", "moves", "poses", "scans"]
    assert {kind: len(table) for kind, table in tables.items() if len(table)} == {"events": 4, "poses": 1}
    assert list(heliocube.read_store(store, kinds=["poses"])) == ["poses"]


@pytest.mark.parametrize(
    ("start", "end", "found"),
    [
        (date(2022, 10, 14), None, ["first", "last", "after"]),
        (None, date(2022, 10, 15), ["before", "first", "last"]),
        (date(2022, 10, 14), date(2022, 10, 15), ["first", "last"]),
    ],
)
def test_a_date_stands_for_its_first_instant_in_utc(store, start, end, found):
    assert list(heliocube.read_store(store, start=start, end=end, kinds="events")["events"]["text"]) == found


def test_a_start_in_a_year_beyond_the_calendar_is_refused():
    with pytest.raises(heliocube.UserError, match="start: '0001-01-01' is not a date or time"):
        heliocube.simulate("0001-01-01", days=0.01)


def test_numbers_and_dates_of_numpy_give_the_same_scans_as_those_of_python():
    of_python = heliocube.simulate("2022-10-14T11:00Z", days=0.015625, weather="clear", seed=3)
    of_numpy = heliocube.simulate(
        np.datetime64("2022-10-14T11:00"), days=np.float32(0.015625), weather="clear", seed=np.int64(3)
    )
    pd.testing.assert_frame_equal(of_numpy["scans"], of_python["scans"])


def test_an_unknown_law_is_refused_inside_a_running_event_loop_too():
    async def cell():
        return heliocube.simulate("2022-10-14", law="none such")

    with pytest.raises(heliocube.UserError, match="none such"):
        asyncio.run(cell())


def test_an_interrupted_simulation_in_a_cell_ends_and_writes_nothing_to_standard_error(capfd):
    async def cell():
        return heliocube.simulate("2022-10-14", days=300, weather="clear")

    interrupt = threading.Timer(1.0, os.kill, (os.getpid(), signal.SIGINT))
    loop = asyncio.new_event_loop()
    interrupt.start()
    try:
        with pytest.raises(KeyboardInterrupt):
            loop.run_until_complete(cell())
    finally:
        interrupt.cancel()
        loop.close()
    assert capfd.readouterr().err == ""
