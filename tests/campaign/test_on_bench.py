"""A person's stop on real processes, from the shell, against every other command and the death of the service."""

import contextlib
import time

import pytest

from tests.campaign.peers import unit_and_tracker
from tests.support import PATIENCE_S, forks

MOVED_DEG = 0.05
IN_THE_SHELL = (("goto", "10", "60"), ("stow", "--why", "two\nlines"), ("stow", "--why", "x" * 300), ("clear",))
OVER_HTTP = ("hold", "home", "snow", "maintenance")
WRONG = (("goto", "nan", "60"), ("goto", "0", "14.9"))


def says(tracker, *words):
    """Give a command in the shell and return its exit code and what it printed."""
    done = forks.run(*words, "--config", tracker.config)
    return done.returncode, " ".join((done.stdout + done.stderr).split())


def turned(one, other):
    return max(abs(one[0] - other[0]), abs(one[1] - other[1]))


def until_it_moves(unit):
    deadline_s, before = time.monotonic() + PATIENCE_S, unit.truth()
    while turned(before, unit.truth()) < 2.0:
        assert time.monotonic() < deadline_s, "the tracker does not move"
        time.sleep(0.05)


def until_connected(tracker):
    """Wait until the service has the positioner again and return its mode."""
    deadline_s = time.monotonic() + PATIENCE_S
    while time.monotonic() < deadline_s:
        with contextlib.suppress(OSError):
            mode = tracker.state()["mode"]
            if mode["name"] != "starting":
                return mode
        time.sleep(0.2)
    raise AssertionError("the service does not come back")


@pytest.mark.system
def test_a_stop_from_the_shell_survives_other_commands_and_a_kill_of_the_service(tmp_path):
    with unit_and_tracker(tmp_path) as (unit, tracker):
        tracker.until_it_takes(-45, 30)
        until_it_moves(unit)
        code, text = says(tracker, "stop", "--why", "a hand near the actuator")
        stood = unit.truth()
        assert code == 0, text
        assert "standing at" in text
        for words in IN_THE_SHELL:
            code, text = says(tracker, *words)
            assert code == 6, text
            assert "a hand near the actuator" in text
            assert "heliocube auto" in text
            assert "Traceback" not in text
        for name in OVER_HTTP:
            status, said = tracker.post(name)
            assert status == 409
            assert "a hand near the actuator" in said["error"]
        for words in WRONG:
            code, text = says(tracker, *words)
            assert code == 2, (words, code, text)
            assert "Traceback" not in text
        assert turned(stood, unit.truth()) < MOVED_DEG
        tracker.kill()
        tracker.start()
        mode = until_connected(tracker)
        assert mode["name"] == "hold"
        assert "a hand near the actuator" in mode["why"]
        assert turned(stood, unit.truth()) < MOVED_DEG
        assert says(tracker, "auto")[0] == 0
        with tracker.send_stop() as connection:
            assert connection.recv(1000).startswith(b"HTTP/1.1 200 ")
        assert tracker.end() == 0
        assert "Traceback" not in tracker.log()
