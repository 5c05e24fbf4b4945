"""The copy that is kept before a store is changed, and how it ends."""

import asyncio
import sqlite3
from contextlib import closing

import pytest

from daemon.base.clock import LoopClock, SystemClock
from daemon.base.state import StateFolder
from daemon.base.timeloop import VirtualTimeLoop
from daemon.store.copies import copies_of, copy_path
from daemon.store.release_kept import FILE_NAME as RELEASE_NAME
from daemon.store.release_kept import ReleaseWatch
from daemon.store.schema import FILE_NAME, VERSION, open_for_reading
from daemon.store.store import Store
from tests.daemon.store.test_full_disk import small_disk
from tests.daemon.store.test_store import ORIGIN, count, keep
from tests.daemon.store.test_tables import scan

__all__ = ["keep", "small_disk"]

OLDER = VERSION - 1
DAY_S = 86400.0


def made_older(folder):
    """Turn a store into one of the version before: without a table, and without a column of another."""
    with closing(sqlite3.connect(folder / FILE_NAME)) as connection:
        connection.execute("DROP TABLE curves")
        connection.execute("ALTER TABLE runs DROP COLUMN tracker")
        connection.execute(f"PRAGMA user_version = {OLDER}")
        connection.commit()


def opened(folder, origin=ORIGIN):
    return Store(folder, 60.0, 400, origin, SystemClock(), lambda event: None)


def version(path):
    with closing(open_for_reading(path)) as connection:
        return connection.execute("PRAGMA user_version").fetchone()[0]


def test_an_older_store_is_copied_whole_before_it_is_changed(keep, caplog):
    folder = keep(*[scan(n) for n in range(50)])
    made_older(folder)
    store = opened(folder)
    store.keep(scan(50))
    store.close()
    copy = copy_path(folder / FILE_NAME, OLDER)
    assert copies_of(folder) == [copy]
    assert (version(copy), version(folder / FILE_NAME)) == (OLDER, VERSION)
    assert count(folder, "scans") == 51
    with closing(open_for_reading(copy)) as connection:
        assert connection.execute("SELECT count(*) FROM scans").fetchone()[0] == 50
        assert connection.execute("PRAGMA integrity_check").fetchone()[0] == "ok"
    assert any("a copy is kept as" in message for message in caplog.messages)


def test_neither_an_up_to_date_store_nor_a_new_one_is_copied(keep):
    folder = keep(scan(0))
    opened(folder).close()
    assert copies_of(folder) == []


def test_without_room_for_a_copy_the_older_store_is_still_upgraded_and_that_is_logged(small_disk, keep, caplog):
    keep(*[scan(n) for n in range(5)], folder=small_disk)
    made_older(small_disk)
    opened(small_disk).close()
    assert copies_of(small_disk) == []
    assert sorted(path.name for path in small_disk.glob("*.part")) == []
    assert version(small_disk / FILE_NAME) == VERSION
    (told,) = [message for message in caplog.messages if "WITHOUT a copy" in message]
    assert "a copy needs 67 MB and 0 MB are free" in told


@pytest.fixture
def release(tmp_path):
    """Start a release and let it run for some days; returns what the start found, and the events."""

    def run(name, days, kept=lambda: True):
        told = []
        with asyncio.Runner(loop_factory=VirtualTimeLoop) as runner:
            clock = LoopClock(runner.get_loop().time, 1.7e9)
            releases = ReleaseWatch(StateFolder(tmp_path), RELEASE_NAME, name, clock, told.append)

            async def scenario():
                running = asyncio.create_task(releases.run(kept))
                await asyncio.sleep(days * DAY_S)
                running.cancel()

            runner.run(scenario())
        return releases.before, [event.text for event in told]

    return run


def test_the_copy_of_the_store_is_removed_once_the_new_release_has_run_for_a_day_in_total(release, tmp_path):
    release("0.1.0", 3.0)
    copy = copy_path(tmp_path / FILE_NAME, OLDER)
    copy.write_text("records")
    assert release("0.2.0", 0.6) == ("0.1.0", ["changed from 0.1.0 to 0.2.0"])
    assert copy.exists()
    before, told = release("0.2.0", 0.6)
    assert before is None
    assert told == [f"0.2.0 has run for a day: {copy}, the store as it was before, is removed"]
    assert not copy.exists()


def test_going_back_to_the_older_release_counts_the_day_until_the_copy_is_removed_anew(release, tmp_path):
    release("0.2.0", 0.1)
    copy = copy_path(tmp_path / FILE_NAME, OLDER)
    copy.write_text("records")
    release("0.2.0", 0.9)
    assert release("0.1.0", 0.9)[0] == "0.2.0"
    assert copy.exists()


def test_a_change_of_release_is_found_at_each_start_until_the_hold_is_saved(release):
    assert release("0.1.0", 0.0)[0] is None
    assert release("0.2.0", 0.1, lambda: False)[0] == "0.1.0"
    assert release("0.2.0", 0.1)[0] == "0.1.0"
    assert release("0.2.0", 0.1)[0] is None


@pytest.mark.parametrize("left", [FILE_NAME, "configuration.json"])
def test_an_earlier_release_that_saved_no_name_is_recognised_by_the_files_it_left(release, tmp_path, left):
    (tmp_path / left).write_text("")
    assert release("0.2.0", 0.0)[0] == "an earlier release"


def test_an_unreadable_release_file_counts_as_a_change_of_release(release, tmp_path):
    (tmp_path / RELEASE_NAME).write_text("{")
    assert release("0.2.0", 0.0)[0] == "an earlier release"
