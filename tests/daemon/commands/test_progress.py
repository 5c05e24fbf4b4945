"""How far a long command is, on a terminal and elsewhere."""

import io
import sys
import threading

from rich.console import Console

from daemon.commands.progress import progress_bar
from tests.system.processes import wait_until


def test_the_progress_bar_shows_the_time_left_when_each_step_takes_over_half_a_minute():
    now_s, shown = [0.0], io.StringIO()
    with progress_bar(Console(file=shown, force_terminal=True, get_time=lambda: now_s[0]), "repeating") as progress:
        for number in range(1, 4):
            now_s[0] = 40.0 * number
            progress(0.1 * number)
        now_s[0] += 1.0
    assert "0:04:40" in shown.getvalue()


def test_without_a_terminal_a_progress_line_is_printed_now_and_then(capsys):
    now_s, told = [0.0], ""

    def line(after):
        def found():
            nonlocal told
            told += capsys.readouterr().err
            return next((each for each in told.splitlines() if f"after {after}" in each), None)

        return wait_until(found, f"a line after {after}")

    console = Console(stderr=True, force_terminal=False, get_time=lambda: now_s[0])
    with progress_bar(console, "repeating", line_every_s=0.001) as progress:
        now_s[0] = 60.0
        assert line("1 min") == "repeating: 0 % done after 1 min"
        progress(0.04)
        now_s[0] = 300.0
        progress(0.1)
        assert line("5 min, about") == "repeating: 10 % done after 5 min, about 45 min left"
        now_s[0] = 3900.0
        assert line("1 h") == "repeating: 10 % done after 1 h 05 min, about 45 min left", "within a step"
    assert "progress" not in {thread.name for thread in threading.enumerate()}


def test_work_continues_when_its_progress_output_is_a_broken_pipe(monkeypatch):
    class Gone(io.StringIO):
        asked = 0

        def write(self, _text):
            self.asked += 1
            raise BrokenPipeError

    gone = Gone()
    monkeypatch.setattr(sys, "stderr", gone)
    with progress_bar(Console(stderr=True, force_terminal=False), line_every_s=0.001):
        wait_until(lambda: gone.asked > 1, "a second line")
