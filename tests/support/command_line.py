"""The command line as a person calls it, in the test's own process."""

import functools
import signal
import sys

import pytest
import typer.main

# The commands are built from their functions, each time alike, in a fiftieth of a second: longer than most tests last.
typer.main.get_command = functools.cache(typer.main.get_command)


@pytest.fixture
def heliocube(monkeypatch, capsys):
    """Runs the command line; returns its exit code and what it wrote to either stream."""
    # The commands import much, and most tests need none of them.
    from daemon.commands.main import main  # noqa: PLC0415

    def run(*arguments):
        monkeypatch.setattr(sys, "argv", ["heliocube", *map(str, arguments)])
        with pytest.raises(SystemExit) as ended:
            main()
        written = capsys.readouterr()
        return ended.value.code, written.out, written.err

    return run


@pytest.fixture
def signal_at_once(monkeypatch):
    """Sends a signal that it is given to the process where work shows its progress first, as on a terminal."""
    # One that no command takes must not end the tests.
    safe = {signal.SIGINT: signal.default_int_handler, signal.SIGTERM: lambda *_: None}
    before = {number: signal.signal(number, handler) for number, handler in safe.items()}
    asked: list[signal.Signals] = []
    monkeypatch.setattr("rich.progress.Progress.update", lambda *_, **_more: asked and signal.raise_signal(asked.pop()))
    yield asked.append
    for number, handler in before.items():
        signal.signal(number, handler)


@pytest.fixture
def few_curves(tmp_path):
    """Names a configuration with a curve every 15 s of fourteen points: thirty every 5 s take most of the time."""
    path = tmp_path / "few_curves.toml"
    path.write_text("[load]\npoints = 14\nperiod_s = 15.0\n")
    return ("--config", path)
