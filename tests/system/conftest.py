"""Fixtures that start real processes: as systemd does, with its end of the notification socket, and on a bench."""

import os
import shutil
import signal
import socket
import time

import pytest

from daemon.bridge.signing import generate_key, write_key
from tests.support import PATIENCE_S, ROOT, forks
from tests.support.addresses import free_port
from tests.system.processes import BenchProcess, Process
from tests.system.rig import HIGH_SUN, Rig, brisk


class Unit:
    """One process of the service under a stand-in for the service manager."""

    def __init__(self, folder, name, arguments, watchdog_s):
        self.messages = []
        self._receiver = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
        self._receiver.bind(str(folder / f"{name}.notify"))
        environment = {
            **os.environ,
            "NOTIFY_SOCKET": str(folder / f"{name}.notify"),
            "WATCHDOG_USEC": str(int(watchdog_s * 1e6)),
        }
        self.log = folder / f"{name}.log"
        with self.log.open("w") as log:
            self.process = forks.start(arguments, log, log, environment)

    def wait_for(self, message, within_s):
        """Take messages in until one begins with `message`; return it and the seconds that it took."""
        began = time.monotonic()
        found = self.listen(within_s, until=message)
        assert found is not None, f"no {message} in {within_s} s; log:\n{self.log.read_text()}"
        return found, time.monotonic() - began

    def listen(self, for_s, until=None):
        """Take messages in for a while, or until one begins with `until`; return that one."""
        deadline = time.monotonic() + for_s
        while (left := deadline - time.monotonic()) > 0:
            self._receiver.settimeout(left)
            try:
                message = self._receiver.recv(4096).decode()
            except TimeoutError:
                break
            self.messages.append(message)
            if until is not None and message.startswith(until):
                return message
        return None

    def end(self, number):
        """Send a signal and return the exit status."""
        self.process.send_signal(number)
        self.process.send_signal(signal.SIGCONT)
        return self.process.wait(PATIENCE_S)

    def close(self):
        if self.process.poll() is None:
            self.process.kill()
            self.process.wait()
        self._receiver.close()


@pytest.fixture
def start_unit(tmp_path):
    """Start the program in a role: ``start_unit(role, watchdog_s)``, configured as deploy/examples has it."""
    write_key(tmp_path / "bridge.key", generate_key())
    (tmp_path / "api.token").write_text("t" * 40 + "\n")
    (tmp_path / "api.token").chmod(0o600)
    port = free_port(socket.SOCK_DGRAM)
    units = []

    def start(role, watchdog_s):
        text = (ROOT / "deploy" / "examples" / f"{role}.toml").read_text()
        for old, new in {
            "127.0.0.1:20571": f"127.0.0.1:{port}",
            {"cube": "127.0.0.1:20573", "tracker": "127.0.0.1:20572"}[role]: (f"127.0.0.1:{free_port()}"),
            f"/var/lib/heliocube/{role}": str(tmp_path / role),
        }.items():
            assert old in text
            text = text.replace(old, new)
        config = tmp_path / f"{role}.toml"
        config.write_text(text)
        units.append(Unit(tmp_path, role, ["run", "--role", role, "--config", str(config)], watchdog_s))
        return units[-1]

    yield start
    for unit in units:
        unit.close()


@pytest.fixture
def checkout(tmp_path):
    """A copy of what the installation needs, which nobody changes meanwhile."""
    copy = tmp_path / "checkout"
    for name in ("solar", "drivers", "sim_drivers", "daemon", "heliocube", "deploy"):
        shutil.copytree(ROOT / name, copy / name, ignore=shutil.ignore_patterns("__pycache__"))
    for name in ("pyproject.toml", "README.md", "LICENSE"):
        shutil.copy(ROOT / name, copy / name)
    return copy


@pytest.fixture
def start_bench(tmp_path):
    """Start a bench with the options of the command line; it ends with the test, in order."""
    started = []

    def start(*options, directory=None):
        started.append(BenchProcess(directory or tmp_path / "bench", *options))
        return started[-1]

    yield start
    for bench in started:
        assert bench.stop() == 0, bench.log()


@pytest.fixture
def start_service(tmp_path):
    """Start `heliocube run` on a configuration file; it ends with the test, in order and without a traceback."""
    started = []

    def start(config, *options):
        output = tmp_path / f"service{len(started)}.log"
        with output.open("ab") as stream:
            started.append(Process(["run", "--config", config, *options], output, stdout=stream))
        return started[-1]

    yield start
    for service in started:
        assert service.stop() == 0, service.log()
        assert "Traceback" not in service.log()


@pytest.fixture
def start_rig(tmp_path, start_bench, start_service):
    def start():
        bench = start_bench("--config", brisk(tmp_path), *HIGH_SUN)
        return Rig(bench, start_service(bench.config))

    return start


@pytest.fixture(scope="module")
def browser():
    """One chromium for all tests of a module."""
    from tests.system import browser as browsers  # noqa: PLC0415 - it needs playwright

    with browsers.chromium() as found:
        yield found
