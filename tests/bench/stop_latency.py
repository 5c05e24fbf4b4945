"""How soon both axes truly stand after a person's stop, with real processes on pseudo-terminals.

Usage: python tests/bench/stop_latency.py [--runs N] [--load N] [--firmware DIR]

In each run the tracker is sent somewhere far; in mid-move the stop is given, in turn as `heliocube stop` from a shell
and as a POST to the service. The time is from just before the command's start to when the truth no longer changes.
--load keeps so many processes busy beside it; --firmware takes the maker's firmware, whose server and emulator are in
DIR, in place of the bench.
"""

import argparse
import ast
import contextlib
import http.client
import json
import os
import socket
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from sim_drivers.bench_client import request
from sim_drivers.positioner_setup import A_ACTUATOR, B_ACTUATOR

HELIOCUBE = Path(sys.executable).with_name("heliocube")
COUNTS_PER_MM = 75.0
LOOK_EVERY_S = 0.01
SAME_DEG = 0.004
STANDS_FOR_S = 0.6
TARGETS = ((-40.0, 70.0), (40.0, 60.0), (-35.0, 40.0), (30.0, 75.0))
BUSY = "import time\nend = time.monotonic() + {seconds}\nwhile time.monotonic() < end: sum(range(10000))"
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
"""
REAL = """
[instruments]
kind = "real"
[instruments.positioner]
port = "{link}"
"""


class BenchUnit:
    """The simulated unit of `heliocube bench`."""

    def __init__(self, folder, config):
        self._folder = folder / "bench"
        self._process = subprocess.Popen(
            [HELIOCUBE, "bench", "--dir", self._folder, "--config", config],
            stdout=subprocess.PIPE,
            stderr=(folder / "bench.log").open("w"),
            text=True,
        )
        if self._process.stdout.readline() != "ready\n":
            sys.exit(f"the bench did not start: {(folder / 'bench.log').read_text()}")
        self.config = self._folder / "heliocube.toml"

    def truth(self):
        pose = request(self._folder, "state", [])["pose"]
        return pose["a_deg"], pose["b_deg"]

    def close(self):
        self._process.terminate()
        self._process.wait(10)


class FirmwareUnit:
    """The maker's firmware in an emulator, on a pseudo-terminal."""

    def __init__(self, folder, config, where):
        link = folder / "positioner"
        self._process = subprocess.Popen(
            [sys.executable, where / "serve.py", "micro", link, "0", "60"],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
        )
        if self._process.stdout.readline() != "up\n":
            sys.exit("the firmware did not start")
        self.config = config
        config.write_text(config.read_text() + REAL.format(link=link))

    def truth(self):
        self._process.stdin.write("state\n")
        self._process.stdin.flush()
        axes = ast.literal_eval(self._process.stdout.readline())["axes"]
        a_mm, b_mm = (axis["true"] / COUNTS_PER_MM for axis in axes)
        return A_ACTUATOR.angle_deg(a_mm), B_ACTUATOR.angle_deg(b_mm)

    def close(self):
        self._process.stdin.close()
        self._process.wait(10)


class Tracker:
    """The service that drives the unit."""

    def __init__(self, unit, folder, port, token):
        self._port, self._token, self._config = port, token, unit.config
        self._log = (folder / "service.log").open("w")
        self._process = subprocess.Popen(
            [HELIOCUBE, "run", "--role", "tracker", "--config", unit.config], stdout=self._log, stderr=self._log
        )

    def post(self, name, **said):
        connection = http.client.HTTPConnection("127.0.0.1", self._port, timeout=15)
        with contextlib.closing(connection):
            headers = {"Authorization": f"Bearer {self._token}"}
            connection.request("POST", f"/api/{name}", json.dumps(said), headers)
            reply = connection.getresponse()
            return reply.status, json.loads(reply.read())

    def until_it_takes(self, a_deg, b_deg):
        """Send a target until the tracker has taken it."""
        deadline_s = time.monotonic() + 90
        while True:
            with contextlib.suppress(OSError):
                self.post("auto")
                status, said = self.post("goto", a_deg=a_deg, b_deg=b_deg)
                if status == 200:
                    return
            if time.monotonic() > deadline_s:
                sys.exit(f"the tracker takes no target: {said}")
            time.sleep(0.5)

    def start_shell_stop(self):
        return subprocess.Popen([HELIOCUBE, "stop", "--config", self._config], stdout=subprocess.DEVNULL)

    def close(self):
        self._process.terminate()
        self._process.wait(15)
        self._log.close()


def turned(one, other):
    return max(abs(one[0] - other[0]), abs(one[1] - other[1]))


def wait_until_it_moves(unit):
    deadline_s, before = time.monotonic() + 60, unit.truth()
    while turned(before, unit.truth()) < 3.0:
        if time.monotonic() > deadline_s:
            sys.exit("the tracker does not move")
        time.sleep(0.05)


def standstill_s(unit, begun_s):
    """Return when the truth last changed, in seconds after `begun_s`."""
    last, changed_s = unit.truth(), time.monotonic()
    while time.monotonic() - changed_s < STANDS_FOR_S:
        time.sleep(LOOK_EVERY_S)
        at = unit.truth()
        if turned(last, at) > SAME_DEG:
            last, changed_s = at, time.monotonic()
        if changed_s - begun_s > 20:
            break
    return changed_s - begun_s


def one_run(unit, tracker, turn, way):
    tracker.until_it_takes(*TARGETS[turn % len(TARGETS)])
    wait_until_it_moves(unit)
    time.sleep(0.1 * (turn % 7))
    begun_s = time.monotonic()
    if way == "shell":
        process = tracker.start_shell_stop()
        took_s = standstill_s(unit, begun_s)
        process.wait(30)
        return took_s
    raw = socket.create_connection(("127.0.0.1", tracker._port))
    with contextlib.closing(raw):
        head = (
            f"POST /api/stop HTTP/1.1\r\nHost: x\r\nAuthorization: Bearer {tracker._token}\r\nContent-Length: 0\r\n\r\n"
        )
        raw.sendall(head.encode())
        took_s = standstill_s(unit, begun_s)
        raw.settimeout(15)
        raw.recv(4096)
    return took_s


def measure(chosen, folder):
    token = "t" * 43
    (folder / "api.token").write_text(token + "\n")
    (folder / "api.token").chmod(0o600)
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    config = folder / "heliocube.toml"
    config.write_text(CONFIG.format(port=port, folder=folder))
    unit = FirmwareUnit(folder, config, chosen.firmware) if chosen.firmware else BenchUnit(folder, config)
    tracker = Tracker(unit, folder, port, token)
    busy = [
        subprocess.Popen([sys.executable, "-c", BUSY.format(seconds=60 + 25 * chosen.runs)]) for _ in range(chosen.load)
    ]
    try:
        for way in ("HTTP", "shell"):
            latencies_s = [one_run(unit, tracker, turn, way) for turn in range(chosen.runs)]
            print(
                f"{way}: {len(latencies_s)} stops in mid-move, median {statistics.median(latencies_s):.2f} s,"
                f" worst {max(latencies_s):.2f} s; load {os.getloadavg()[0]:.1f} on {os.cpu_count()} cores",
                flush=True,
            )
            print("   " + " ".join(f"{latency_s:.2f}" for latency_s in latencies_s), flush=True)
    finally:
        for process in busy:
            process.terminate()
            process.wait(10)
        tracker.close()
        unit.close()


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--runs", type=int, default=10)
    parser.add_argument("--load", type=int, default=0, help="busy processes beside it")
    parser.add_argument("--firmware", type=Path, help="directory of the firmware's server")
    chosen = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        measure(chosen, Path(folder))


if __name__ == "__main__":
    main()
