"""As many trackers as a process may have, and what their unit lets it have."""

import os
import pty
import re
import subprocess
import sys
import time
from pathlib import Path

import pytest

from daemon.config.file import _MOST_TRACKERS
from tests.support import ROOT

pytestmark = pytest.mark.system

FILE = """
[instruments]
kind = "real"
[bridge]
listen = "127.0.0.1:0"
insecure = true
[api]
enabled = false
[store]
directory = "records"
"""
# Threads of a tracker: two for its positioner, and one each for its load, the name of its broker and its files.
THREADS, OF_THE_PROCESS = 5, 16


@pytest.mark.skipif(sys.platform != "linux", reason="the threads of a process are seen in /proc")
def test_the_units_limit_of_tasks_allows_all_threads_of_a_process_with_the_most_trackers(tmp_path):
    ends = [pty.openpty() for _ in range(_MOST_TRACKERS)]
    config, tables = tmp_path / "tracker.toml", []
    for number, (_, silent) in enumerate(ends):
        port = tmp_path / f"port{number}"
        port.symlink_to(os.ttyname(silent))
        tables.append(f"[[tracker]]\nname = 't{number}'\npositioner.port = '{port}'\n")
    config.write_text(FILE + "".join(tables))
    command = [sys.executable, "-c", "from daemon.entry import main; main()"]
    most = 0
    with (
        (tmp_path / "log").open("wb") as log,
        subprocess.Popen(
            [*command, "run", "--role", "tracker", "--config", str(config)],
            stdout=subprocess.DEVNULL,
            stderr=log,
        ) as service,
    ):
        give_up_s = time.monotonic() + 120.0
        while service.poll() is None and most <= 2 * _MOST_TRACKERS and time.monotonic() < give_up_s:
            found = re.search(r"^Threads:\s+(\d+)", Path(f"/proc/{service.pid}/status").read_text(), re.MULTILINE)
            most = max(most, int(found[1]) if found else 0)
            time.sleep(0.1)
        service.terminate()
    for end in (end for pair in ends for end in pair):
        os.close(end)
    assert (service.returncode, b"Traceback" in (tmp_path / "log").read_bytes()) == (0, False)
    unit = (ROOT / "deploy" / "heliocube-tracker.service").read_text()
    allowed = int(re.findall(r"^TasksMax=(\d+)$", unit, re.MULTILINE)[0])
    # Nothing answers here, so each tracker has only the threads of its positioner.
    assert 2 * _MOST_TRACKERS < most < allowed
    assert allowed >= THREADS * _MOST_TRACKERS + OF_THE_PROCESS
