"""A salvage that is interrupted: by Ctrl-C, or by the loss of the terminal's connection."""

import signal
import sqlite3
import sys
from contextlib import closing

import pytest

from daemon.store.schema import FILE_NAME, open_for_writing
from tests.daemon.store.test_store import keep
from tests.daemon.store.test_tables import scan
from tests.daemon.store.test_unusable_store import until
from tests.support import PATIENCE_S, forks

pytestmark = pytest.mark.slow

__all__ = ["keep"]


@pytest.mark.skipif(sys.platform == "win32", reason="Windows has no such signals")
@pytest.mark.parametrize("by", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_an_interrupted_salvage_removes_its_copy_of_the_store(keep, tmp_path, by):
    into = tmp_path / "into"
    into.mkdir()
    open_for_writing(into / FILE_NAME).close()
    with (tmp_path / "said").open("w") as said, closing(sqlite3.connect(into / FILE_NAME)) as service:
        # The salvage waits for another process's writing, and its copy exists meanwhile.
        service.execute("BEGIN IMMEDIATE")
        command = ["store", "salvage", keep(scan()) / FILE_NAME, "--into", into]
        salvaging = forks.start(command, stdout=said, stderr=said)
        until(lambda: list(into.glob(".salvage-*/copy.sqlite-shm")))
        salvaging.send_signal(by)
        service.rollback()
    assert salvaging.wait(PATIENCE_S) == 130
    assert list(into.glob(".salvage-*")) == []
    told = f"interrupted: what was read so far is in {into}; give the command again for the rest"
    assert told in (tmp_path / "said").read_text()
