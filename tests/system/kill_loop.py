"""Start the service, kill it, look at its store; again and again. Run by test_operation.py.

Every other service is killed at some moment of its start, however far it has come. The others are killed at some moment
after their first records are in the store, however long that took.

Each service is forked from this process, which has loaded the libraries already: so 50 starts take seconds.
"""

import contextlib
import gc
import os
import random
import signal
import sqlite3
import sys
import time
from contextlib import closing
from datetime import UTC, datetime, timedelta
from io import StringIO
from pathlib import Path

from rich.console import Console

import daemon.rigs.simulated  # noqa: F401 - loaded here once, and not by each copy
from daemon.commands.run import run_service
from daemon.config.settings import Settings
from daemon.service.rig import Role
from daemon.store.schema import FILE_NAME, StoreError, open_for_reading, open_for_writing
from daemon.store.tables import COLUMNS
from tests.support import PATIENCE_S

SPEED = 200.0
BATCH_S = 0.2
START = datetime(2022, 10, 12, 9, 25, tzinfo=UTC)
# What a slow disk may add between a record and its batch's commit; less than the default of a batch, 5 s.
MARGIN_S = 4.0


def main(folder, restarts, seed):
    anchor = datetime.now(UTC)
    settings = Settings.model_validate(
        {
            "bridge": {"listen": "127.0.0.1:0", "send_to": []},
            "api": {"listen": "127.0.0.1:0"},
            "store": {"directory": folder, "batch_s": BATCH_S},
            # One simulated clock for all runs, so that a record's time tells when it was made.
            "simulation": {"speed": SPEED, "start_utc": START, "anchor_utc": anchor},
        }
    )
    chance, lost_s = random.Random(seed), []
    # The libraries are not garbage. A child whose collector went through them would copy all their memory.
    gc.freeze()
    for turn in range(restarts):
        child = os.fork()
        if not child:
            serve(settings)
        try:
            if turn % 2:
                wait_for_records(folder / FILE_NAME)
            last = turn == restarts - 1
            # The last service lives long enough to show if a batch is not written in time.
            time.sleep(BATCH_S + MARGIN_S + 0.5 if last else chance.uniform(0.0, 0.5))
            waited_s = waited_for_processor_s(child)
        finally:
            os.kill(child, signal.SIGKILL)
        killed_utc = START + (datetime.now(UTC) - anchor) * SPEED
        assert os.WIFSIGNALED(os.waitpid(child, 0)[1]), "the service ended by itself"
        # A busy machine keeps a service from making records and from writing them.
        lost_s += [missing_s - waited_s for missing_s in inspect(folder / FILE_NAME, killed_utc)]
    print(f"{restarts} restarts, {len(lost_s)} with records, the most that was lost: {max(lost_s):.2f} s")
    assert len(lost_s) >= restarts // 2
    assert max(lost_s) <= BATCH_S + MARGIN_S


def serve(settings):
    devnull = os.open(os.devnull, os.O_WRONLY)
    os.dup2(devnull, 1)
    try:
        run_service(settings, Role.BOTH, None, Console(file=StringIO()))
    finally:
        os._exit(1)


def waited_for_processor_s(pid):
    """Return how long the threads of a process were ready to run and waited for a processor."""
    waited_ns = 0
    for path in Path(f"/proc/{pid}/task").glob("*/schedstat"):
        # A thread may end meanwhile.
        with contextlib.suppress(FileNotFoundError, ProcessLookupError):
            waited_ns += int(path.read_text().split()[1])
    return waited_ns / 1e9


inspected = {"run": 0}


def wait_for_records(path):
    deadline_s = time.monotonic() + PATIENCE_S
    while True:
        # The store may not exist yet, or be opened just now.
        with contextlib.suppress(StoreError, sqlite3.Error), closing(open_for_reading(path)) as connection:
            if connection.execute("SELECT 1 FROM scans WHERE run > ? LIMIT 1", (inspected["run"],)).fetchone():
                return
        assert time.monotonic() < deadline_s, f"no scan in the store within {PATIENCE_S:g} s"
        time.sleep(0.02)


def inspect(path, killed_utc):
    """Open the store after a kill; return how much wall time of a new run is missing."""
    if not path.exists():
        return []
    with closing(open_for_writing(path)) as connection:
        assert connection.execute("PRAGMA quick_check").fetchall() == [("ok",)]
    with closing(open_for_reading(path)) as connection:
        found = connection.execute("SELECT max(run) FROM runs").fetchone()[0] or 0
        if found == inspected["run"]:
            return []
        inspected["run"] = found
        numbers, newest = [], 0.0
        for name, _ in COLUMNS.values():
            rows = connection.execute(f"SELECT number, time FROM {name} WHERE run = ?", (found,)).fetchall()
            numbers += [number for number, _ in rows]
            newest = max(newest, *[time_s for _, time_s in rows], 0.0)
        if not numbers:
            return []
        assert sorted(numbers) == list(range(len(numbers))), f"run {found} has a gap or a duplicate"
        return [(killed_utc - datetime.fromtimestamp(newest, UTC)) / timedelta(seconds=SPEED)]


if __name__ == "__main__":
    main(Path(sys.argv[1]), int(sys.argv[2]), int(sys.argv[3]))
