"""What a store keeps: each record once, and as many days as the newest leave room for."""

import queue
import time
from contextlib import closing

import pytest

from daemon.base.clock import SystemClock
from daemon.base.records import Event
from daemon.store.schema import FILE_NAME, open_for_reading
from daemon.store.store import Origin, Store
from tests.daemon.store.test_tables import T0, scan
from tests.support import PATIENCE_S

ORIGIN = Origin(T0, "both", "0.1.0", True, "SIRTA", 48.7, 2.2, 156.0)
DAY_S = 86400.0


@pytest.fixture
def keep(tmp_path):
    """Keep records in a store and close it; returns its folder."""

    def run(*records, folder=tmp_path / "store", keep_days=400, origin=ORIGIN):
        store = Store(folder, 60.0, keep_days, origin, SystemClock(), lambda event: None)
        for record in records:
            store.keep(record)
        store.close()
        assert store.status.waiting == 0
        return folder

    return run


def count(folder, table):
    with closing(open_for_reading(folder / FILE_NAME)) as connection:
        return connection.execute(f"SELECT count(*) FROM {table}").fetchone()[0]


def test_a_scan_that_comes_twice_is_kept_once(keep):
    keep(scan(0), scan(1), scan(1))
    assert count(keep(scan(1), scan(2)), "scans") == 3


def test_the_oldest_days_are_removed_when_more_days_are_stored_than_are_to_be_kept(keep):
    records = [Event(T0 + n * DAY_S, n, "test", str(n)) for n in range(5)]
    folder = keep(*records, keep_days=3)
    folder = keep(Event(T0 + 4 * DAY_S, 0, "test", "again"), keep_days=3)
    with closing(open_for_reading(folder / FILE_NAME)) as connection:
        assert connection.execute("SELECT text FROM events ORDER BY time").fetchall() == [
            ("2",),
            ("3",),
            ("4",),
            ("again",),
        ]


def test_a_record_from_a_clock_set_far_ahead_removes_one_day_and_not_all(keep):
    records = [Event(T0 + n * DAY_S, n, "test", str(n)) for n in range(3)]
    folder = keep(*records, Event(T0 + 9000 * DAY_S, 3, "test", "wrong clock"), keep_days=3)
    assert count(folder, "events") == 3


def test_after_one_record_from_the_future_the_oldest_days_still_give_way(tmp_path):
    store = Store(tmp_path, 0.01, 3, ORIGIN, SystemClock(), print)
    for number, day in enumerate((0, 9000, 1, 2, 3, 4)):
        store.keep(Event(T0 + day * DAY_S, number, "test", str(day)))
        deadline_s = time.monotonic() + PATIENCE_S
        while store.status.waiting:
            assert time.monotonic() < deadline_s
            time.sleep(0.005)
    store.close()
    # One of the three days is in the future.
    assert count(tmp_path, "events") == 3


def written(store, number):
    deadline_s = time.monotonic() + PATIENCE_S
    while store.status.written < number:
        assert time.monotonic() < deadline_s
        time.sleep(0.005)


@pytest.mark.parametrize("moved", [False, True])
def test_a_store_file_removed_or_moved_while_in_use_loses_none_of_the_later_records(tmp_path, moved):
    told, (store_folder, other) = [], (tmp_path / "store", tmp_path / "moved")
    other.mkdir()
    store = Store(store_folder, 0.01, 3, ORIGIN, SystemClock(), lambda event: told.append(event.text))
    store.keep(scan(0))
    written(store, 1)
    if moved:
        (store_folder / FILE_NAME).rename(other / FILE_NAME)
    else:
        for path in store_folder.iterdir():
            path.unlink()
    store.keep(scan(1))
    written(store, 2)
    store.keep(scan(2))
    store.close()
    assert count(store_folder, "scans") == 2
    assert count(store_folder, "runs") == 1
    assert told[0].endswith("heliocube.sqlite was removed or replaced while it was in use; records wait in memory")
    assert told[1:] == ["writes again; nothing was lost"]
    if moved:
        assert count(other, "scans") == 1


def test_a_store_folder_that_cannot_even_be_looked_up_raises_an_alarm_until_a_retry_succeeds(tmp_path):
    # As with a folder that the service may not enter, or a disk that fails: nobody can say what is there.
    told, folder = queue.Queue(), tmp_path / "store"
    folder.symlink_to("x" * 300)
    store = Store(folder, 0.01, 3, ORIGIN, SystemClock(), print, lambda *alarm: told.put(alarm))
    store.keep(scan(0))
    name, text = told.get(timeout=PATIENCE_S)
    assert (name, "File name too long; records wait in memory" in text) == ("store-down", True)
    assert store.status.down_why.endswith("File name too long")
    folder.unlink()
    while (name, text) != ("store-down", None):
        name, text = told.get(timeout=PATIENCE_S)
    store.close()
    assert store.status.down_why is None
    assert count(folder, "scans") == 1
