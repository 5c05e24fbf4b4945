"""The command line as a person uses it, in the test's own process."""

import functools
import signal
import sys

import pytest
import typer.main

# Typer builds the commands from their functions at every call, always alike, in 1/50 s: longer than most tests last.
typer.main.get_command = functools.cache(typer.main.get_command)


@pytest.fixture
def heliocube(monkeypatch, capsys):
    """Runs the command line; returns its exit code and what it wrote to both streams."""
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
def signal_at_first_progress(monkeypatch):
    """Returns a function that takes a signal: this process gets it when work first shows progress on a terminal."""
    # A signal that the command does not handle must not end the tests.
    safe = {signal.SIGINT: signal.default_int_handler, signal.SIGTERM: lambda *_: None}
    before = {number: signal.signal(number, handler) for number, handler in safe.items()}
    asked: list[signal.Signals] = []
    monkeypatch.setattr("rich.progress.Progress.update", lambda *_, **_more: asked and signal.raise_signal(asked.pop()))
    yield asked.append
    for number, handler in before.items():
        signal.signal(number, handler)


@pytest.fixture
def few_curves(tmp_path):
    """Arguments for a configuration with a curve of 14 points every 15 s: 30 points every 5 s take most of the time."""
    path = tmp_path / "few_curves.toml"
    path.write_text("[load]\npoints = 14\nperiod_s = 15.0\n")
    return ("--config", path)
