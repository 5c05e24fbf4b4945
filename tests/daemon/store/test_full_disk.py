"""Records that cannot be written wait, and the tracker goes on as ever."""

import asyncio
import hashlib
import logging
import queue
import subprocess
import threading

import pytest

from daemon.base.clock import SystemClock
from daemon.base.records import Decision, Event, Mode, Scan
from daemon.store.export import export
from daemon.store.store import Store
from daemon.store.tables import TableError, TableWriter
from tests.daemon.store.test_store import ORIGIN, count
from tests.daemon.store.test_tables import scan
from tests.support import PATIENCE_S
from tests.support.phases import wait_for_tracking


@pytest.fixture
def small_disk(tmp_path):
    """A file system of 512 kB."""
    disk = tmp_path / "disk"
    disk.mkdir()
    made = subprocess.run(["mount", "-t", "tmpfs", "-o", "size=512k", "tmpfs", disk], capture_output=True)
    if made.returncode:
        pytest.skip("mounting a small file system needs root")
    yield disk
    subprocess.run(["umount", "--lazy", disk], check=True)


class CountedClock(SystemClock):
    """Sets `enough` when it has been asked so many times: the store asks it at each failure."""

    def __init__(self, enough):
        self.left, self.enough = enough, threading.Event()

    def monotonic(self):
        self.left -= 1
        if self.left <= 0:
            self.enough.set()
        return super().monotonic()


def fill(path):
    with path.open("wb", buffering=0) as file:
        try:
            while True:
                file.write(bytes(4096))
        except OSError:
            pass


def test_a_full_disk_is_reported_once_loses_no_record_and_ends_by_itself(small_disk, caplog, tmp_path):
    caplog.set_level(logging.INFO)
    told, clock = queue.Queue(), CountedClock(5)
    store = Store(small_disk, 0.1, 400, ORIGIN, clock, told.put)
    store.keep(scan(0))
    filler = small_disk / "filler"
    fill(filler)
    for n in range(1, 3000):
        store.keep(scan(n))
    assert clock.enough.wait(PATIENCE_S)
    event = told.get(timeout=PATIENCE_S)
    full = f"the disk of {small_disk} is full"
    assert (event.subject, event.text) == ("store", f"cannot write: {full}; records wait in memory")
    assert store.status.down_why == full
    filler.unlink()
    # The disk is still too small for everything: what fits is written, the rest waits.
    subprocess.run(["mount", "-o", "remount,size=8m", small_disk], check=True)
    assert told.get(timeout=PATIENCE_S).text == "writes again; nothing was lost"
    store.close()
    assert told.empty()
    assert store.status.written == 3000
    assert store.status.lost == 0
    assert [record.message for record in caplog.records] == [
        f"the store is down: {full}",
        "the store is back",
    ]
    assert export(small_disk, tmp_path / "out", "csv", None, None, ["scans"]).rows == {"scans": 3000}


def test_a_store_begun_on_a_full_disk_writes_when_there_is_room(small_disk, tmp_path):
    filler = small_disk / "filler"
    fill(filler)
    told = queue.Queue()
    store = Store(small_disk, 0.1, 400, ORIGIN, SystemClock(), told.put)
    store.keep(scan(0))
    assert "cannot write" in told.get(timeout=PATIENCE_S).text
    filler.unlink()
    assert told.get(timeout=PATIENCE_S).text == "writes again; nothing was lost"
    store.close()
    assert count(small_disk, "scans") == 1


def test_a_full_disk_does_not_stop_control_and_no_record_is_lost(run_rig, small_disk):
    told = queue.Queue()
    store = Store(small_disk, 0.1, 400, ORIGIN, SystemClock(), told.put)
    fill(small_disk / "filler")

    async def scenario(rig):
        rig.bus.subscribe(store.keep)
        await wait_for_tracking(rig)
        await asyncio.sleep(1800)
        assert rig.mode is Mode.TRACKING

    rig = run_rig(scenario)
    assert len(rig.records_of(Decision)) >= 6
    assert (
        told.get(timeout=PATIENCE_S).text == f"cannot write: the disk of {small_disk} is full; records wait in memory"
    )
    (small_disk / "filler").unlink()
    subprocess.run(["mount", "-o", "remount,size=8m", small_disk], check=True)
    store.close()
    assert told.get(timeout=PATIENCE_S).text == "writes again; nothing was lost"
    assert told.empty()
    assert count(small_disk, "scans") == len(rig.records_of(Scan))


@pytest.mark.parametrize("form", ["csv", "parquet"])
def test_tables_that_do_not_fit_on_the_disk_are_refused_in_one_sentence_and_leave_no_file(small_disk, form):
    def write():
        with TableWriter(small_disk / "out", form) as tables:
            # Random text, which Parquet cannot compress.
            for number in range(100_000):
                tables.write(Event(number, 0.0, "test", hashlib.sha256(b"%d" % number).hexdigest()))

    with pytest.raises(TableError, match=r"/out cannot take the results: "):
        write()
    assert list(small_disk.iterdir()) == []


def test_a_simulation_whose_tables_do_not_fit_on_the_disk_ends_with_one_sentence(small_disk, heliocube):
    # The room that is left is full after minutes and not after hours.
    filler = small_disk / "filler"
    filler.write_bytes(bytes(400 * 1024))
    code, _, err = heliocube("simulate", "--start", "2022-10-12T10:00", "--days", "0.3", "--out", small_disk / "out")
    sentence = f"heliocube: {small_disk / 'out'} cannot take the results: No space left on device\n"
    assert (code, err) == (2, sentence)
    assert list(small_disk.iterdir()) == [filler]
