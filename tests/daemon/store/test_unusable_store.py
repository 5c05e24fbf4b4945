"""A store that cannot be used does not keep a service from starting: it is moved aside, and a new one is begun."""

import os
import random
import re
import shutil
import sqlite3
import subprocess
import sys
import tempfile
import time
from contextlib import closing
from pathlib import Path

import pytest

from daemon.base.clock import SystemClock
from daemon.base.errors import UserError
from daemon.base.records import Event
from daemon.store.export import export
from daemon.store.schema import FILE_NAME, VERSION, open_for_reading
from daemon.store.store import Store
from daemon.store.unusable_store import aside_text, find_moved_aside, move_aside
from tests.daemon.store.test_store import ORIGIN, keep
from tests.daemon.store.test_tables import T0, scan
from tests.support import PATIENCE_S, ROOT

__all__ = ["keep"]
PAGE = 4096


def until(condition):
    """Wait for another thread."""
    deadline_s = time.monotonic() + PATIENCE_S
    while not condition():
        assert time.monotonic() < deadline_s, "not in time"
        time.sleep(0.005)


def opened(folder, alarms, batch_s=60.0, clock=None):
    return Store(folder, batch_s, 400, ORIGIN, clock or SystemClock(), lambda event: None, alarms.__setitem__)


def truncated(path):
    os.truncate(path, path.stat().st_size // 2)


def nearly_nothing(path):
    path.write_bytes(path.read_bytes()[:100])


def without_first_page(path):
    path.write_bytes(random.Random(1).randbytes(PAGE) + path.read_bytes()[PAGE:])


def with_rubbish_pages(path):
    """Leave only the first page whole."""
    path.write_bytes(path.read_bytes()[:PAGE] + random.Random(1).randbytes(path.stat().st_size - PAGE))


def spoil_in_place(path):
    with path.open("r+b") as file:
        size = file.seek(0, os.SEEK_END)
        file.seek(PAGE)
        file.write(random.Random(2).randbytes(size - PAGE))


def newer(path):
    with closing(sqlite3.connect(path)) as connection:
        connection.execute(f"PRAGMA user_version = {VERSION + 1}")


def without_a_table(path):
    with closing(sqlite3.connect(path)) as connection:
        connection.execute("DROP TABLE days")


def notes(path):
    path.write_text("my notes, long enough to be taken for a header of a database" * 20)


def of_another_program(path):
    path.unlink()
    with closing(sqlite3.connect(path)) as connection:
        connection.execute("CREATE TABLE mine (x)")


def folder_in_its_place(path):
    path.unlink()
    path.mkdir()
    (path / "mine").write_text("notes")


def pipe_in_its_place(path):
    path.unlink()
    os.mkfifo(path)


def link_to_itself(path):
    path.unlink()
    path.symlink_to(path)


def content(path):
    if path.is_symlink():
        return path.readlink()
    if path.is_fifo():
        return "a pipe"
    return {one.name: one.read_bytes() for one in path.iterdir()} if path.is_dir() else path.read_bytes()


@pytest.mark.parametrize(
    ("spoil", "kind", "says"),
    [
        (truncated, "damaged", "a damaged store"),
        (nearly_nothing, "damaged", "a damaged store"),
        (without_first_page, "foreign", "a file that is no store of heliocube, or one with a damaged beginning,"),
        (with_rubbish_pages, "damaged", "a damaged store"),
        (without_a_table, "damaged", "a damaged store"),
        (newer, "newer", "a store that was written by a newer heliocube"),
        (notes, "foreign", "a file that is no store of heliocube, or one with a damaged beginning,"),
        (of_another_program, "foreign", "a file that is no store of heliocube, or one with a damaged beginning,"),
        (folder_in_its_place, "folder", "a folder in the store's place"),
        (pipe_in_its_place, "device", "a pipe or a device in the store's place"),
        (link_to_itself, "link", "a link in the store's place that leads back to itself"),
    ],
)
def test_an_unusable_store_is_moved_aside_with_an_alarm_and_logged_once(keep, tmp_path, caplog, spoil, kind, says):
    folder = keep(*[scan(n) for n in range(500)])
    path, alarms = folder / FILE_NAME, {}
    spoil(path)
    before = content(path)
    store = opened(folder, alarms)
    store.keep(Event(T0, 1.0, "test", "new"))
    store.close()
    (aside,) = find_moved_aside(path)
    assert aside.name.split(".")[0::2] == ["heliocube", kind]
    # In these two the damage shows only at the first writing, after the beginning of a run was written.
    assert content(aside) == before or spoil in (with_rubbish_pages, without_a_table)
    assert alarms["store-aside"].startswith(f"{says} was moved aside as {aside}, and a new store was begun: ")
    assert alarms.get("store-down") is None
    assert [record.levelname for record in caplog.records] == ["ERROR"]
    assert export(folder, tmp_path / "out", "csv", None, None, ()).rows["events"] == 1

    # The alarm outlives a restart, and ends when a person has taken the file away.
    again = {}
    opened(folder, again).close()
    assert again["store-aside"] == alarms["store-aside"]
    shutil.move(aside, tmp_path / "elsewhere")
    opened(folder, alarms).close()
    assert len(caplog.records) == 1
    last = {}
    opened(folder, last).close()
    assert last.get("store-aside") is None


def test_the_wal_and_shm_files_of_an_unusable_store_are_moved_aside_with_it(keep):
    folder = keep(scan(0))
    path = folder / FILE_NAME
    notes(path)
    for suffix in ("-wal", "-shm"):
        Path(f"{path}{suffix}").write_text(suffix)
    opened(folder, {}).close()
    (aside,) = find_moved_aside(path)
    assert Path(f"{aside}-wal").read_text() == "-wal"
    assert Path(f"{aside}-shm").read_text() == "-shm"


def test_things_in_the_place_of_sqlite_side_files_are_moved_aside_alone_and_the_store_goes_on(keep, caplog):
    folder, alarms = keep(scan(0)), {}
    path = folder / FILE_NAME
    Path(f"{path}-wal").mkdir()
    Path(f"{path}-journal").mkdir()
    Path(f"{path}-shm").symlink_to(folder / "nowhere")
    store = opened(folder, alarms)
    store.keep(scan(1))
    store.close()
    aside = find_moved_aside(path)
    assert [one.name.split(".")[-2] for one in aside] == ["beside"] * 3
    says = f"what was in the place of a file that SQLite keeps beside the store was moved aside as {aside[-1]}, and 2"
    assert alarms["store-aside"].startswith(f"{says} before it, and the store goes on: this alarm ends when")
    assert alarms.get("store-down") is None
    assert [record.levelname for record in caplog.records] == ["ERROR"]
    with closing(open_for_reading(path)) as connection:
        assert connection.execute("SELECT count(*) FROM scans").fetchone() == (2,)


def test_damage_of_the_store_found_while_writing_loses_no_later_record(keep, tmp_path):
    """The store is open and its pages are in memory when the file under it becomes rubbish."""
    folder = keep(*[scan(n) for n in range(2000)])
    path, alarms = folder / FILE_NAME, {}
    store = opened(folder, alarms, 0.05)
    store.keep(scan(2000))
    until(lambda: store.status.written == 1)
    spoil_in_place(path)
    for n in range(20_000):
        store.keep(scan(3000 + n))
    until(lambda: store.status.waiting == 0)
    store.close()
    (aside,) = find_moved_aside(path)
    assert "damaged" in aside.name
    assert str(aside) in alarms["store-aside"]
    assert store.status.lost == 0
    # Records that the damaged file took before this was seen are left to a salvage; the new file has all later ones.
    with closing(open_for_reading(path)) as connection:
        kept = [row[0] for row in connection.execute("SELECT sequence FROM scans ORDER BY sequence")]
    assert kept == list(range(kept[0], 23_000))
    assert kept[0] > 2000


def test_on_a_disk_that_damages_one_store_after_another_only_one_is_moved_aside(keep):
    folder = keep(scan(0))
    path, alarms = folder / FILE_NAME, {}
    with_rubbish_pages(path)
    store = opened(folder, alarms, 0.05)
    store.keep(scan(1))
    until(lambda: find_moved_aside(path))
    until(lambda: store.status.written == 1)
    for n in range(2000):
        store.keep(scan(2 + n))
    until(lambda: store.status.waiting == 0)
    with closing(sqlite3.connect(path)) as connection:
        # Move the records from the log into the file, which is going to be damaged.
        connection.execute("PRAGMA wal_checkpoint(TRUNCATE)")
    spoil_in_place(path)
    for n in range(20_000):
        store.keep(scan(3000 + n))
    until(lambda: store.status.down_why)
    assert len(find_moved_aside(path)) == 1
    assert "records wait in memory" in alarms["store-down"]
    path.unlink()
    until(lambda: store.status.waiting == 0)
    store.close()
    assert alarms["store-down"] is None


def test_an_impossible_store_folder_raises_an_alarm_and_records_are_written_once_it_is_possible(tmp_path):
    (tmp_path / "file").write_text("")
    alarms = {}
    store = opened(tmp_path / "file" / "x", alarms, 0.05)
    store.keep(scan(0))
    until(lambda: "store-down" in alarms)
    assert "Not a directory" in alarms["store-down"]
    (tmp_path / "file").unlink()
    until(lambda: store.status.written == 1)
    store.close()
    assert alarms["store-down"] is None


def test_a_store_linked_to_a_disk_that_is_not_mounted_says_so_and_waits_for_the_disk(tmp_path):
    (tmp_path / "store").mkdir()
    (tmp_path / "store" / FILE_NAME).symlink_to(tmp_path / "disk" / "x.sqlite")
    alarms, says = {}, f"is a link to {tmp_path}/disk/x.sqlite, whose folder is not there: mount its disk, or"
    store = opened(tmp_path / "store", alarms, 0.05)
    store.keep(scan(0))
    until(lambda: "store-down" in alarms)
    assert says in alarms["store-down"]
    with pytest.raises(UserError, match=re.escape(says)):
        open_for_reading(tmp_path / "store" / FILE_NAME)
    (tmp_path / "disk").mkdir()
    until(lambda: store.status.written == 1)
    store.close()
    assert alarms["store-down"] is None


AS_NOBODY = """
import os, sys
import urllib.parse  # pathlib of 3.13 asks for it late, when a Python in somebody's home can be read no more
from pathlib import Path
from daemon.base.clock import SystemClock
from daemon.base.records import Event
from daemon.store.store import Origin, Store
alarms = {}
os.setgroups([]); os.setresgid(65534, 65534, 65534); os.setresuid(65534, 65534, 65534)
store = Store(Path(sys.argv[1]), 0.05, 400, Origin(1.0, "both", "0", True, "x", 1.0, 1.0, 1.0), SystemClock(),
              lambda event: None, alarms.__setitem__)
store.keep(Event(1.0, 1.0, "test", "x"))
while not store.status.written and "store-down" not in alarms:
    pass
print(alarms)
store.close()
"""


@pytest.mark.skipif(os.geteuid() != 0, reason="only root can become another user")
@pytest.mark.parametrize("own_folder", [True, False])
def test_a_store_file_of_another_user_is_moved_aside_only_if_the_folder_can_be_written(keep, own_folder):
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name) / "records"
        keep(scan(0), folder=folder)
        for path, mode in ((Path(name), 0o755), (folder, 0o777 if own_folder else 0o755), (folder / FILE_NAME, 0o600)):
            path.chmod(mode)
        found = subprocess.run(
            [sys.executable, "-c", AS_NOBODY, folder], capture_output=True, text=True, cwd=ROOT, timeout=PATIENCE_S
        )
        assert found.returncode == 0, found.stderr
        if own_folder:
            assert "may not be written by this user" in found.stdout
            assert [one.name.split(".")[-2] for one in find_moved_aside(folder / FILE_NAME)] == ["locked"]
        else:
            assert "the store cannot write: " in found.stdout
            assert not find_moved_aside(folder / FILE_NAME)


def test_the_salvage_command_named_in_the_alarm_works_as_it_is_written(keep, heliocube):
    path = keep(*[scan(n) for n in range(5)]) / FILE_NAME
    move_aside(path, "damaged", T0)
    command = re.search(r"'heliocube (store salvage .*)' gets what", aside_text(path))[1]
    code, out, err = heliocube(*command.split())
    assert (code, err) == (0, "")
    assert "5 of them are new" in out


def test_an_export_of_a_damaged_store_says_how_to_salvage_it(keep, tmp_path):
    folder = keep(*[scan(n) for n in range(2000)])
    with_rubbish_pages(folder / FILE_NAME)
    with pytest.raises(UserError, match=r"'heliocube store salvage .* --into FOLDER' gets what can be read from it"):
        export(folder, tmp_path / "out", "csv", None, None, ())
