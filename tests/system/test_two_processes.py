"""Cube and tracker as two processes with UDP between them, killed and restarted in any order."""

import re
import signal
import time
from datetime import UTC, datetime

import pytest

from daemon.bridge.signing import generate_key, write_key
from tests.support import PATIENCE_S, forks

pytestmark = pytest.mark.system


CONFIG = """
[simulation]
weather = "clear"
start_utc = 2022-06-21T10:00:00Z
anchor_utc = {anchor}
speed = 20.0
[windows]
mean_s = 30.0
decide_every_s = 60.0
[safety]
scan_stale_s = 15.0
fallback_after_s = 20.0
[motion]
minimum_interval_s = 10.0
[bridge]
listen = "127.0.0.1:{port}"
send_to = ["127.0.0.1:{port}"]
key_file = "bridge.key"
"""


class Process:
    """One role of the service, its output on file."""

    def __init__(self, folder, role):
        self.log = folder / f"{role}-{time.monotonic_ns()}.log"
        self._file = self.log.open("wb")
        words = ["run", "--role", role, "--config", folder / "heliocube.toml"]
        self.process = forks.start(words, self._file, self._file)

    def text(self):
        return self.log.read_text()

    def wait_for(self, pattern, after=0):
        """Wait until a line matches; return the end of the match."""
        deadline = time.monotonic() + PATIENCE_S
        while time.monotonic() < deadline:
            match = re.compile(pattern).search(self.text(), after)
            if match:
                return match.end()
            assert self.process.poll() is None, self.text()
            time.sleep(0.05)
        raise AssertionError(f"no line matched {pattern!r} within {PATIENCE_S} s:\n{self.text()}")

    def end(self, number):
        self.process.send_signal(number)
        code = self.process.wait(timeout=PATIENCE_S)
        self._file.close()
        return code


@pytest.fixture
def start(tmp_path, free_udp_port):
    (tmp_path / "heliocube.toml").write_text(
        CONFIG.format(anchor=datetime.now(UTC).isoformat(timespec="seconds"), port=free_udp_port)
    )
    write_key(tmp_path / "bridge.key", generate_key())
    started = []

    def begin(role):
        process = Process(tmp_path, role)
        started.append(process)
        return process

    yield begin
    for process in started:
        if process.process.poll() is None:
            process.end(signal.SIGKILL)


def test_the_tracker_falls_back_without_the_cube_and_tracks_again_after_a_kill_of_either_process(start):
    tracker = start("tracker")
    seen = tracker.wait_for(r"starting -> fallback")
    cube = start("cube")
    seen = tracker.wait_for(r"fallback -> tracking", seen)
    tracker.wait_for(r"moving .*law=mu-prime", seen)

    cube.end(signal.SIGKILL)
    seen = tracker.wait_for(r"tracking -> fallback: no good scan", seen)
    cube = start("cube")
    seen = tracker.wait_for(r"fallback -> tracking", seen)

    tracker.end(signal.SIGKILL)
    tracker = start("tracker")
    tracker.wait_for(r"-> tracking")

    assert tracker.end(signal.SIGTERM) == 0
    assert cube.end(signal.SIGTERM) == 0
    for process in (tracker, cube):
        assert "Traceback" not in process.text()
        assert "SIMULATED" in process.text()


def test_a_cube_with_another_key_is_reported_and_does_not_steer_the_tracker(start, tmp_path):
    tracker = start("tracker")
    tracker.wait_for(r"starting -> fallback")
    (tmp_path / "bridge.key").unlink()
    write_key(tmp_path / "bridge.key", generate_key())
    start("cube")
    tracker.wait_for(r"(?i)forged|signature|key")
    assert "-> tracking" not in tracker.text()
