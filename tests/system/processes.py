"""Processes for the system tier: a bench, and a service that drives it."""

import os
import select
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from sim_drivers.bench.client import request
from tests.support import PATIENCE_S, forks

HELIOCUBE = Path(sys.executable).with_name("heliocube")


def wait_until(condition, what):
    """Look until `condition()` is true and return it."""
    deadline_s = time.monotonic() + PATIENCE_S
    while True:
        found = condition()
        if found:
            return found
        if time.monotonic() > deadline_s:
            pytest.fail(f"not within {PATIENCE_S:g} s: {what() if callable(what) else what}")
        time.sleep(0.1)


class Process:
    """A process of ours, with its output in a file."""

    def __init__(self, arguments, output, stdout=None):
        self.output = output
        with output.open("ab") as stream:
            self._process = forks.start(arguments, stdout, stream, os.environ | {"COLUMNS": "200"})
        self.pid = self._process.pid

    def log(self):
        return self.output.read_text(encoding="utf-8", errors="replace")

    @property
    def exit_code(self):
        return self._process.poll()

    def wait(self):
        return self._process.wait(PATIENCE_S)

    def ask_to_stop(self):
        self._process.send_signal(signal.SIGTERM)

    def cpu_s(self):
        """Return the processor time used so far by the process and its threads."""
        fields = Path(f"/proc/{self.pid}/stat").read_text().rpartition(")")[2].split()
        return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")

    def stop(self, number=signal.SIGTERM):
        """End it, and return its exit code."""
        if self._process.poll() is None:
            self._process.send_signal(number)
        try:
            return self._process.wait(PATIENCE_S)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
            raise


class BenchProcess(Process):
    """`heliocube bench`, up and ready."""

    def __init__(self, directory, *options):
        self.directory = directory
        directory.mkdir(exist_ok=True)
        told, tells = os.pipe()
        # It stays open: the bench may say more.
        self._said = os.fdopen(told, encoding="utf-8")
        with os.fdopen(tells, "wb") as stream:
            super().__init__(["bench", "--dir", directory, *options], directory / "bench.log", stream)
        readable, _, _ = select.select([self._said], [], [], PATIENCE_S)
        line = self._said.readline() if readable else ""
        if line != "ready\n":
            self.stop()
            pytest.fail(f"the bench said {line!r} and logged: {self.log()}")

    def stop(self, number=signal.SIGTERM):
        self._said.close()
        return super().stop(number)

    @property
    def config(self):
        return self.directory / "heliocube.toml"

    def ask(self, verb, *arguments):
        return request(self.directory, verb, [str(argument) for argument in arguments])

    def state(self):
        return self.ask("state")
