"""`heliocube setup` as a person on a roof uses it: in a terminal, with a key under the hand, on the bench."""

import os
import pty
import re
import select
import signal
import time
import tomllib

import pytest

from tests.support import PATIENCE_S, forks
from tests.system.processes import wait_until

pytestmark = pytest.mark.system

ACTIONS = "57"
COLOURS = re.compile(r"\x1b\[[0-9;?]*[A-Za-z]")


class Terminal:
    """`heliocube setup` on a pseudo-terminal of 80 columns."""

    def __init__(self, *arguments):
        self._screen, inside = pty.openpty()
        environment = os.environ | {"COLUMNS": "80", "TERM": "xterm", "NO_COLOR": "1"}
        self._process = forks.start(["setup", *arguments], inside, inside, environment, stdin=inside)
        os.close(inside)
        self.text = ""
        self._read = 0

    def until(self, words):
        """Wait for words after those found last; a line may be broken at any of their spaces."""
        wanted = re.compile(r"\s+".join(map(re.escape, words.split())))
        deadline_s = time.monotonic() + PATIENCE_S
        while (found := wanted.search(self.text, self._read)) is None:
            if time.monotonic() > deadline_s or not self._more():
                pytest.fail(f"no {words!r} in: {self.text[self._read :]}")
        self._read = found.end()

    def _more(self):
        if not select.select([self._screen], [], [], PATIENCE_S)[0]:
            return False
        try:
            self.text += COLOURS.sub("", os.read(self._screen, 65536).decode())
        except OSError:
            return False
        return True

    def say(self, text, after):
        self.until(f"{after}")
        self.press(text)

    def press(self, text):
        os.write(self._screen, text.encode())

    def hang_up(self):
        self._process.send_signal(signal.SIGHUP)

    def end(self):
        while self._more():
            pass
        os.close(self._screen)
        return self._process.wait(PATIENCE_S)


def test_setup_can_be_left_and_resumed_moves_and_stops_an_axis_and_writes_the_configuration(start_bench, tmp_path):
    bench = start_bench("--weather", "clear", "--start", "2022-06-21T12:00Z")
    file = tmp_path / "rig" / "heliocube.toml"
    first = Terminal(file)
    first.say("both\r", "[both]:")
    first.say("bench\r", "[real]:")
    first.say(f"{bench.directory}\r", "answer:")
    first.until("SIMULATED")
    first.say("Roof\r", "[SIRTA]:")
    first.say("95\r", "latitude_deg")
    first.until("! site.latitude_deg = 95.0: must be a number from -90 to 90 deg")
    first.say("48,7\r", "latitude_deg [")
    for _ in range(2):
        first.say("\r", "]:")
    first.until("the sun is in the south")
    first.say("\r", "[yes]:")
    first.until("3/7 The cube")
    for _ in range(5 + 8):
        first.say("\r", "]:")
    first.say("\r", "Enter does it, or skip]:")
    first.until("zenith")
    first.say("yes\r", "[later]:")
    for _ in range(2):
        first.say("\r", "]:")
    first.say("\r", "Enter does it, or skip]:")
    first.until("geometry of A fits")
    first.say("none\r", "]:")
    first.until("6/7 Limits and wind")
    for _ in range(7):
        first.say("\r", "]:")
    first.say("yes\r", "move, or skip]:")
    first.until("! say move, skip or back")
    assert bench.state()["positioner"]["received"] == {}, "nothing moves before it is confirmed"
    noted = file.parent / "records" / "motion.json"
    noted.parent.mkdir()
    noted.write_text('{"homing": true}')
    first.say("move\r", "move, or skip]:")
    first.until("has noted: homing was not finished")
    assert list(bench.state()["positioner"]["received"]) == [ACTIONS], "nothing but a stop is sent to what is in doubt"
    noted.unlink()
    noted.parent.rmdir()
    first.say("move\r", "move, or skip]:")
    first.until("to the west: any key stops it")
    first.hang_up()
    assert first.end() == 130
    assert "Left." in first.text
    pose = bench.state()["pose"]
    assert pose["a_deg"] < 1.9, "it has gone on to its end"
    assert not file.exists()

    second = Terminal(file)
    second.until("answers are there from before")
    assert bench.state()["pose"] == pose
    second.say("move\r", "move, or skip]:")
    second.until("PRESS ANY KEY on the way")
    at_deg = bench.state()["pose"]["a_deg"]
    wait_until(lambda: abs(bench.state()["pose"]["a_deg"] - at_deg) > 0.5, "A to move")
    second.press(" ")
    second.until("stopped by the key")
    pose = bench.state()["pose"]
    assert pose["a_deg"] < 5.0
    second.say("yes\r", "answer:")
    for _ in range(3):
        second.say("\r", "]:")
    assert second.end() == 0, second.text
    assert bench.state()["pose"] == pytest.approx(pose, abs=0.2)
    assert "THE FIRST MOVE" not in second.text
    assert "with the USB plug pulled" in second.text.partition("Not done yet")[2]

    found = tomllib.loads(file.read_text(encoding="utf-8"))
    assert (found["site"]["name"], found["site"]["latitude_deg"]) == ("Roof", 48.7)
    assert found["limits"] == {"a_min_deg": -5.0, "a_max_deg": 5.0, "b_min_deg": 80.0, "b_max_deg": 90.0}
    assert (found["instruments"]["kind"], found["instruments"]["bench"]) == ("real", True)
    assert found["store"]["directory"] == "records"
    assert 0.1 < found["instruments"]["positioner"]["slowest_deg_per_s"] < 0.5
    assert sorted(path.name for path in file.parent.iterdir()) == ["api.token", "bridge.key", "heliocube.toml"]
    assert "!" not in second.text.partition("Written:")[2], "the file that was written does not pass its own check"
