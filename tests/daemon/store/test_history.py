import gzip
import json
import math
import sqlite3
from contextlib import closing
from dataclasses import replace

import numpy as np
import pytest

from daemon.base.clock import SystemClock
from daemon.base.errors import UserError
from daemon.base.records import Event, Pose
from daemon.store import history
from daemon.store.history import lines_of, packed_numbers, stored_days
from daemon.store.schema import FILE_NAME
from daemon.store.store import Origin, Store
from tests.daemon.store.test_tables import ALL, T0, scan

ORIGIN = Origin(T0, "both", "0.1.0", True, "SIRTA", 48.7, 2.2, 156.0)
DAY_S = 86400.0


@pytest.fixture
def store_of(tmp_path):
    """Keep records in a store and return its file."""

    def run(*records):
        store = Store(tmp_path, 60.0, 400, ORIGIN, SystemClock(), lambda event: None)
        for record in records:
            store.keep(record)
        store.close()
        return tmp_path / FILE_NAME

    return run


def unpacked(content):
    head, _, body = gzip.decompress(content).partition(b"\n")
    said = json.loads(head)
    columns = np.frombuffer(body, "<f4").reshape(len(said["columns"]), said["rows"])
    return said, dict(zip(said["columns"], columns.tolist(), strict=True))


def test_good_readings_are_packed_as_numbers_and_others_as_nan(store_of):
    said, found = unpacked(packed_numbers(store_of(*ALL), "scans", T0, T0 + 60, "east"))
    assert (said["rows"], said["start"], said["more"]) == (2, T0, False)
    assert found["time_s"] == [1.25, 6.25]
    assert found["east_w_m2"] == [101.5, 101.5]
    assert all(math.isnan(value) for value in found["south_w_m2"])


def test_the_start_of_a_span_of_history_is_included_and_its_end_is_not(store_of):
    path = store_of(*(scan(n) for n in range(10)))
    _, found = unpacked(packed_numbers(path, "scans", T0 + 6.25, T0 + 16.25, ""))
    assert found["time_s"] == [0.0, 5.0]
    _, none = unpacked(packed_numbers(path, "scans", T0 - 60, T0, ""))
    assert none["time_s"] == []


def test_each_tracker_gets_its_own_records_and_those_of_no_tracker(store_of):
    pose = Pose(T0, 1.0, -3.0, 60.0, moving=False)
    records = [replace(pose, tracker="east"), replace(pose, tracker="west", a_deg=4.0)]
    told = [Event(T0, 1.0, "cube", "ours"), replace(Event(T0, 1.0, "x", "theirs"), tracker="west")]
    path = store_of(*records, *told)
    assert unpacked(packed_numbers(path, "poses", T0, T0 + 1, "east"))[1]["a_deg"] == [-3.0]
    assert unpacked(packed_numbers(path, "poses", T0, T0 + 1, "west"))[1]["a_deg"] == [4.0]
    assert [row["text"] for row in lines_of(path, "events", T0, T0 + 1, "east")["rows"]] == ["ours"]
    assert [row["text"] for row in lines_of(path, "events", T0, T0 + 1, "west")["rows"]] == ["ours", "theirs"]


@pytest.mark.parametrize("kind", history.KINDS_OF_NUMBERS)
def test_every_kind_of_numbers_has_one_value_for_each_row_and_column(store_of, kind):
    said, found = unpacked(packed_numbers(store_of(*ALL), kind, T0 - 60, T0 + 60, ""))
    assert said["rows"] >= 1
    assert {len(values) for values in found.values()} == {said["rows"]}


@pytest.mark.parametrize("kind", history.KINDS_OF_LINES)
def test_every_kind_of_text_records_has_a_time_and_further_fields(store_of, kind):
    rows = lines_of(store_of(*ALL), kind, T0 - 60, T0 + 60, "")["rows"]
    assert rows[0]["time"].startswith("2022-10-14T")
    assert len(rows[0]) > 2


def test_a_page_of_history_is_limited_in_length_and_says_that_there_is_more(store_of, monkeypatch):
    monkeypatch.setattr(history, "MOST_ROWS", 3)
    monkeypatch.setattr(history, "MOST_LINES", 2)
    path = store_of(*(scan(n) for n in range(5)), *(Event(T0 + n, 1.0, "x", str(n)) for n in range(3)))
    said, found = unpacked(packed_numbers(path, "scans", T0, T0 + 60, ""))
    assert (said["more"], found["time_s"]) == (True, [1.25, 6.25, 11.25])
    found = lines_of(path, "events", T0, T0 + 60, "")
    assert (found["more"], [row["text"] for row in found["rows"]]) == (True, ["0", "1"])


@pytest.mark.parametrize(
    ("hours", "longitude_deg", "days"),
    [
        ((0, 48), 0.0, ["2022-10-14", "2022-10-16"]),
        ((13, 15), 150.0, ["2022-10-14", "2022-10-15"]),
        ((15,), 150.0, ["2022-10-15"]),
        ((6, 9), -120.0, ["2022-10-13", "2022-10-14"]),
        ((6,), -120.0, ["2022-10-13"]),
    ],
)
def test_the_stored_days_are_the_solar_days_at_the_site_that_have_records(store_of, hours, longitude_deg, days):
    midnight_s = T0 - T0 % DAY_S
    path = store_of(*(Event(midnight_s + 3600.0 * hour, 1.0, "x", "") for hour in reversed(hours)))
    assert stored_days(path, longitude_deg) == days


def test_a_store_of_an_earlier_version_lists_its_days_without_the_kinds_that_it_lacks(store_of):
    path = store_of(Event(T0, 1.0, "x", ""))
    with closing(sqlite3.connect(path)) as connection:
        connection.execute("DROP TABLE curves")
    assert stored_days(path, 0.0) == ["2022-10-14"]


def test_listing_the_days_without_a_store_is_refused_with_a_sentence_that_says_so(tmp_path):
    with pytest.raises(UserError, match="there is no store"):
        stored_days(tmp_path / FILE_NAME, 0.0)
