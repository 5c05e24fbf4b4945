"""Real processes to attack: the bench or the maker's firmware on pseudo-terminals, and the service that drives it."""

import ast
import contextlib
import http.client
import json
import os
import socket
import subprocess
import sys
import threading
import time
from pathlib import Path

from sim_drivers.bench.client import request
from sim_drivers.pozsol.setup import A_ACTUATOR, B_ACTUATOR
from tests.firmware.live import command
from tests.support import PATIENCE_S, forks
from tests.support.addresses import free_port

HELIOCUBE = Path(sys.executable).with_name("heliocube")
TOKEN = "t" * 43
COUNTS_PER_MM = 75.0
LOW_V, FULL_V = 15, 24
CONFIG = """
[api]
listen = "127.0.0.1:{port}"
token_file = "{folder}/api.token"
[bridge]
listen = "127.0.0.1:0"
send_to = []
insecure = true
[store]
directory = "{folder}/records"
[safety]
fallback_after_s = 5.0
"""
"""No cube sends scans: the tracker follows the sun by the clock as soon as `fallback_after_s` has passed."""
REAL = """
[instruments]
kind = "real"
[instruments.positioner]
port = "{link}"
"""

# The bench's commands that begin and end each disturbance.
BENCH_DISTURBANCES = {
    "unplugged": ("unplug positioner", "replug positioner"),
    "undervoltage": ("inject undervoltage", "repair undervoltage"),
    "a_hall_loss": ("hall-loss a on", "hall-loss a off"),
    "b_hall_loss": ("hall-loss b on", "hall-loss b off"),
    "deaf": ("inject deaf", "repair deaf"),
    "own_tracking": ("inject own_tracking", "repair own_tracking"),
    "re_reference": ("inject re_reference", ""),
    "overcurrent": ("overcurrent a", ""),
    "hangs": ("freeze positioner", "thaw positioner"),
    "garbled": ("corrupt positioner 20", ""),
    "reset": ("power-cycle positioner kept", ""),
    "reset_lost": ("power-cycle positioner lost", ""),
}
FIRMWARE_DISTURBANCES = {
    "unplugged": ("unplug", "plug"),
    "replugged": ("replug", ""),
    "undervoltage": (f"supply {LOW_V}", f"supply {FULL_V}"),
    "a_hall_loss": ("freeze 0 1", "freeze 0 0"),
    "b_hall_loss": ("freeze 1 1", "freeze 1 0"),
    # Targets that nobody ordered, as from another program on this port, or from an echo.
    "stranger_a": ("usb 242c33302e30300d", ""),
    "stranger_b": ("usb 243033352e30300d", ""),
    "stranger_homes": ("usb 2439350d", ""),
    "buttons": ("buttons 1", "buttons 0"),
}


class NotThereError(Exception):
    """A process did not start, in one sentence."""


class SimulatedUnit:
    """The simulated unit of `heliocube bench`."""

    disturbances = BENCH_DISTURBANCES

    def __init__(self, folder, config):
        self._folder = folder / "bench"
        with (folder / "bench.log").open("w") as log:
            told, tells = os.pipe()
            # It stays open: the bench may say more.
            self._said = os.fdopen(told, encoding="utf-8")
            with os.fdopen(tells, "wb") as stream:
                self._process = forks.start(["bench", "--dir", self._folder, "--config", config], stream, log)
        if self._said.readline() != "ready\n":
            raise NotThereError(f"the bench did not start: {(folder / 'bench.log').read_text()}")
        self.config = self._folder / "heliocube.toml"

    def truth(self):
        pose = request(self._folder, "state", [])["pose"]
        return pose["a_deg"], pose["b_deg"]

    def disturb(self, name, *, on):
        words = self.disturbances[name][0 if on else 1].split()
        if words:
            request(self._folder, words[0], words[1:])

    def close(self):
        self._said.close()
        self._process.terminate()
        self._process.wait(PATIENCE_S)


class FirmwareUnit:
    """The maker's firmware in an emulator, on a pseudo-terminal."""

    disturbances = FIRMWARE_DISTURBANCES

    def __init__(self, folder, config, where, build="micro"):
        link = folder / "positioner"
        self._process = subprocess.Popen(
            command(link, 0.0, 60.0, where=where, build=build),
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
        )
        if self._process.stdout.readline() != "up\n":
            raise NotThereError("the firmware did not start")
        self._turn = threading.Lock()
        self.config = config
        config.write_text(config.read_text() + REAL.format(link=link))

    def truth(self):
        a_mm, b_mm = (axis["true"] / COUNTS_PER_MM for axis in self._ask("state")["axes"])
        return A_ACTUATOR.angle_deg(a_mm), B_ACTUATOR.angle_deg(b_mm)

    def disturb(self, name, *, on):
        line = self.disturbances[name][0 if on else 1]
        if line:
            self._ask(line)

    def _ask(self, line):
        with self._turn:
            self._process.stdin.write(line + "\n")
            self._process.stdin.flush()
            said = self._process.stdout.readline().strip()
        return ast.literal_eval(said) if said else None

    def close(self):
        self._process.stdin.close()
        self._process.wait(PATIENCE_S)
        self._process.stdout.close()


class Tracker:
    """The service in the tracker's role, with access by HTTP and from the shell."""

    def __init__(self, config, port, log):
        self._port, self.config, self._log = port, config, log
        self._process = None
        self.start()

    def start(self):
        with self._log.open("a") as log:
            self._process = forks.start(["run", "--role", "tracker", "--config", self.config], stdout=log, stderr=log)

    def kill(self):
        self._process.kill()
        self._process.wait(PATIENCE_S)

    def end(self):
        """Ask it to end and return its exit code."""
        self._process.terminate()
        return self._process.wait(PATIENCE_S)

    @property
    def exit_code(self):
        return self._process.poll()

    def log(self):
        return self._log.read_text()

    def ask(self, method, path, said=None):
        """Return the status and the content of a reply; `OSError` where nobody answers."""
        connection = http.client.HTTPConnection("127.0.0.1", self._port, timeout=PATIENCE_S)
        with contextlib.closing(connection):
            body = None if said is None else json.dumps(said)
            connection.request(method, path, body, {"Authorization": f"Bearer {TOKEN}"})
            reply = connection.getresponse()
            return reply.status, json.loads(reply.read())

    def post(self, name, **said):
        return self.ask("POST", f"/api/{name}", said)

    def state(self):
        return self.ask("GET", "/api/state")[1]

    def send_stop(self):
        """Send a stop and return the connection, on which the answer will come."""
        connection = socket.create_connection(("127.0.0.1", self._port))
        connection.settimeout(PATIENCE_S)
        head = ("POST /api/stop HTTP/1.1", "Host: localhost", f"Authorization: Bearer {TOKEN}", "Content-Length: 0")
        connection.sendall("\r\n".join([*head, "", ""]).encode())
        return connection

    def shell(self, *words):
        """Start a command of the command line."""
        arguments = [HELIOCUBE, *words, "--config", self.config]
        return subprocess.Popen(arguments, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)

    def until_it_takes(self, a_deg, b_deg):
        """Send a target until the tracker has taken it."""
        deadline_s, said = time.monotonic() + PATIENCE_S, ""
        while time.monotonic() < deadline_s:
            with contextlib.suppress(OSError):
                self.post("auto")
                status, said = self.post("goto", a_deg=a_deg, b_deg=b_deg)
                if status == 200:
                    return
            time.sleep(0.5)
        raise NotThereError(f"the tracker takes no target: {said}")


@contextlib.contextmanager
def unit_and_tracker(folder, firmware=None, build="micro"):
    """Start a unit and a service on it in a folder; both end afterwards.

    `firmware` is the directory of the firmware's server, or None for the bench.
    """
    (folder / "api.token").write_text(TOKEN + "\n")
    (folder / "api.token").chmod(0o600)
    port = free_port()
    config = folder / "config.toml"
    config.write_text(CONFIG.format(port=port, folder=folder))
    unit = FirmwareUnit(folder, config, firmware, build) if firmware else SimulatedUnit(folder, config)
    try:
        tracker = Tracker(unit.config, port, folder / "service.log")
        try:
            yield unit, tracker
        finally:
            tracker.end()
    finally:
        unit.close()
