"""The store's file as a user sees it who may not read it, and as two connections of one process see it."""

import os
import subprocess
import sys
from contextlib import closing
from pathlib import Path
from tempfile import TemporaryDirectory

import pytest

from daemon.base.clock import SystemClock
from daemon.base.errors import UserError
from daemon.store.schema import FILE_NAME, open_for_reading, open_for_writing
from daemon.store.store import Origin, Store
from tests.daemon.store.test_full_disk import small_disk

__all__ = ["small_disk"]

ORIGIN = Origin(0.0, "both", "0.1.0", True, "SIRTA", 48.7, 2.2, 156.0)


@pytest.mark.parametrize("closed", [".", FILE_NAME])
def test_a_store_that_this_user_may_not_read_is_refused_in_one_sentence_with_the_remedy(closed):
    user = os.geteuid()
    with TemporaryDirectory() as folder:
        Path(folder).chmod(0o755)
        path = Path(folder) / "records" / FILE_NAME
        Store(path.parent, 60.0, 400, ORIGIN, SystemClock(), lambda event: None).close()
        (path.parent / closed).chmod(0)
        try:
            if user == 0:
                os.seteuid(65534)
            with pytest.raises(UserError, match=r"may not be read by this user.*sudo -u heliocube"):
                open_for_reading(path)
        finally:
            os.seteuid(user)
            path.parent.chmod(0o755)


def test_an_export_of_a_store_on_a_read_only_disk_is_refused_with_the_remedy(small_disk, heliocube, tmp_path):
    Store(small_disk, 60.0, 400, ORIGIN, SystemClock(), lambda event: None).close()
    subprocess.run(["mount", "-o", "remount,ro", small_disk], check=True)
    code, _, err = heliocube("export", "--store", small_disk, "--out", tmp_path / "out")
    assert code == 2
    assert f"the store {small_disk / FILE_NAME} cannot be read: unable to open database file; SQLite" in err
    assert "copy the store, with the -wal beside it if there is one, into a folder of your own" in err


def test_a_store_opened_beside_a_reader_keeps_other_processes_from_removing_its_log(tmp_path):
    path = tmp_path / FILE_NAME
    open_for_writing(path).close()
    with closing(open_for_reading(path)) as reader:
        reader.execute("SELECT count(*) FROM runs").fetchone()
        store = open_for_writing(path)
    with closing(store):
        store.execute("INSERT INTO days (day) VALUES (1)")
        # Whoever closes a store last removes its log; if no lock is held, another process believes that it is the last.
        code = "import sqlite3, sys; c = sqlite3.connect(sys.argv[1]); c.execute('PRAGMA user_version'); c.close()"
        subprocess.run([sys.executable, "-c", code, path], check=True)
        assert path.with_name(f"{FILE_NAME}-wal").exists()
