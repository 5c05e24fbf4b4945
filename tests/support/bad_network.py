"""Cube and tracker as real processes, each in its network namespace, with a bad link between them."""

import json
import os
import shutil
import signal
import subprocess
import sys
import time
from contextlib import ExitStack
from datetime import UTC, datetime
from pathlib import Path

from daemon.bridge.signing import generate_key, write_key
from tests.support import PATIENCE_S

SPEED = 20.0
_LINK = Path(__file__).with_name("bad_link.py")
_CONFIG = """
[simulation]
weather = "clear"
start_utc = 2022-06-21T10:00:00Z
anchor_utc = {anchor}
speed = {speed}
[cube]
scan_every_s = 2.5
[windows]
mean_s = 30.0
decide_every_s = 60.0
# What a busy machine holds up for seconds is 20 times as long here: no outage of cube or positioner, and no late scan.
[safety]
scan_stale_s = 120.0
fallback_after_s = 240.0
[bridge]
clock_skew_s = 120.0
late_after_s = 120.0
listen = "0.0.0.0:20571"
send_to = ["10.77.0.2:20571"]
accept_from = ["10.77.0.1"]
key_file = "bridge.key"
[api]
listen = "0.0.0.0:20572"
[instruments.positioner]
telemetry_stale_s = 60.0
"""
# Answers each line with one line.
_ASK = """
import sys
from urllib.request import urlopen
for url in sys.stdin:
    try:
        answer = urlopen(url.strip(), timeout=9).read().decode()
    except OSError:
        answer = ""
    print(answer.replace("\\n", " "), flush=True)
"""
_MANY_CONNECTIONS = """
import socket, sys

held = [socket.create_connection(("10.77.0.2", 20572), 9) for _ in range(int(sys.argv[1]))]
still = 0
for one in held:
    one.settimeout(0.1)
    try:
        still += one.recv(1) != b""
    except TimeoutError:
        still += 1
    except ConnectionError:
        pass
print(still)
"""


def why_no_namespaces() -> str:
    """Return why no network namespaces can be made here, or nothing."""
    if sys.platform != "linux" or not hasattr(os, "geteuid") or os.geteuid() != 0:
        return "the test of a bad network is left out: network namespaces are for root on Linux"
    if shutil.which("ip") is None:
        return "the test of a bad network is left out: there is no program ip (iproute2)"
    name = f"hc-try-{os.getpid()}"
    made = subprocess.run(["ip", "netns", "add", name], capture_output=True, text=True, check=False)
    if made.returncode:
        return f"the test of a bad network is left out: no network namespace can be made: {made.stderr.strip()}"
    _ip("netns", "del", name)
    return ""


class BadNetwork:
    """Three namespaces, for the cube, the tracker and the link between them; a context manager.

    Parameters
    ----------
    folder
        For configuration, key and logs.
    seed
        For what the link loses.
    """

    def __init__(self, folder: Path, seed: int) -> None:
        self._folder = folder
        self._names = {end: f"hc-{end}-{os.getpid()}" for end in ("cube", "link", "tracker")}
        self._seed = seed
        self._stack = ExitStack()
        self._processes = {}

    def __enter__(self) -> "BadNetwork":
        try:
            self._build()
        except BaseException:
            self._stack.close()
            raise
        return self

    def __exit__(self, *_: object) -> None:
        self._stack.close()

    def _build(self) -> None:
        for name in self._names.values():
            _ip("netns", "add", name)
            self._stack.callback(_ip, "netns", "del", name)
        for number, end in enumerate(("cube", "tracker"), 1):
            own, far = self._names[end], self._names["link"]
            _ip("link", "add", "out", "netns", own, "type", "veth", "peer", "name", end, "netns", far)
            _ip("-n", own, "addr", "add", f"10.77.0.{number}/24", "dev", "out")
            for where, what in ((own, "lo"), (own, "out"), (far, end)):
                _ip("-n", where, "link", "set", what, "up")
        self._link = self._begin("link", _LINK, "cube", "tracker", self._seed)
        self._await_link()
        self._asker = self._begin("tracker", "-c", _ASK)
        config = _CONFIG.format(anchor=datetime.now(UTC).isoformat(timespec="seconds"), speed=SPEED)
        (self._folder / "heliocube.toml").write_text(config)
        write_key(self._folder / "bridge.key", generate_key())

    def start(self, role: str) -> None:
        """Start cube or tracker in its namespace."""
        command = self._within(role, sys.executable, "-m", "daemon.commands.main", "run", "--role", role, "--config")
        with self._log(role).open("wb") as log:
            self._processes[role] = process = subprocess.Popen(
                [*command, str(self._folder / "heliocube.toml")], stdout=log, stderr=log
            )
        self._stack.callback(self._end, process)

    def change(self, **how: object) -> None:
        """Change the link; properties that are not named stay as they were."""
        self._link.stdin.write(json.dumps(how) + "\n")
        self._link.stdin.flush()
        self._await_link()

    def log(self, role: str) -> str:
        """Return what a process has printed."""
        return self._log(role).read_text(errors="replace")

    def state(self) -> dict:
        """Return the tracker's state; `OSError` where it does not answer."""
        self._asker.stdin.write("http://127.0.0.1:20572/api/state\n")
        self._asker.stdin.flush()
        if not (answer := self._asker.stdout.readline().strip()):
            raise OSError("the tracker's interface does not answer")
        return json.loads(answer)

    def connections_kept(self, asked: int) -> int:
        """Return how many of so many connections from the cube to the tracker's API stay open."""
        command = self._within("cube", sys.executable, "-c", _MANY_CONNECTIONS, asked)
        return int(subprocess.run(command, capture_output=True, text=True, check=True).stdout)

    def until_mode(self, mode: str) -> float:
        """Wait until the tracker is in a mode; return how long that took [s]."""
        began_s = time.monotonic()
        while True:
            try:
                if self.state()["mode"]["name"] == mode:
                    return time.monotonic() - began_s
            except OSError:
                pass
            waited_s = time.monotonic() - began_s
            assert waited_s < PATIENCE_S, (
                f"not {mode} within {PATIENCE_S:g} s:\n{self.log('tracker')}\n{self.log('cube')}"
            )
            time.sleep(0.2)

    def stop(self) -> dict[str, int]:
        """End both processes as systemd does; return their exit codes."""
        for process in self._processes.values():
            process.send_signal(signal.SIGTERM)
        return {role: process.wait(PATIENCE_S) for role, process in self._processes.items()}

    def _log(self, role: str) -> Path:
        return self._folder / f"{role}.log"

    def _within(self, end: str, *command: object) -> list[str]:
        return ["ip", "netns", "exec", self._names[end], *map(str, command)]

    def _await_link(self) -> None:
        assert self._link.stdout.readline() == "ready\n", "the link has ended"

    def _begin(self, end: str, *words: object) -> subprocess.Popen:
        """Start a Python program that ends when its input does."""
        begun = subprocess.Popen(
            self._within(end, sys.executable, *words), stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
        )
        self._stack.callback(begun.stdout.close)
        self._stack.callback(begun.wait, 60)
        self._stack.callback(begun.stdin.close)
        return begun

    def _end(self, process: subprocess.Popen) -> None:
        if process.poll() is None:
            process.kill()
        process.wait()


def _ip(*words: str) -> None:
    subprocess.run(["ip", *words], check=True, capture_output=True, text=True)
