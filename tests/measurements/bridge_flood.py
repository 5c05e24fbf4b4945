"""What a flood at the bridge's port costs: true scans that get through, and processor time of the service.

Usage: ``python tests/measurements/bridge_flood.py [--rate 10000] [--seconds 20] [--repeats 3]``

A tracker as a process of its own, bound to one core, hears a cube that sends 20 signed scans a second. Meanwhile an
attacker sends RATE datagrams a second: forged ones (a right header, another key), replayed ones (500 recorded scans of
this and of earlier sessions), noise and oversized ones. In the first three rows they come from a socket of the
attacker. In the last row they come from the cube's own address and port, as from an attacker who can forge addresses:
there the kernel cannot tell the attacker from the cube. Everything stays on loopback.
"""

import argparse
import json
import os
import random
import socket
import statistics
import subprocess
import sys
import tempfile
import time
import urllib.request
from pathlib import Path
from secrets import token_hex

from daemon.base.clock import SystemClock
from daemon.base.records import FaceReading, Quality, Scan
from daemon.bridge.sender import pack
from daemon.bridge.signing import generate_key, write_key

SCANS_PER_S = 20
TICK_S = 0.005
CONFIG = """
[simulation]
speed = 1.0
[bridge]
listen = "127.0.0.1:{bridge}"
key_file = "bridge.key"
[api]
listen = "127.0.0.1:{api}"
"""


def scan(session: str, number: int, utc_s: float, steady_s: float) -> Scan:
    """Return the scan that a cube finishes at this time."""
    faces = [FaceReading(100.0 + face, Quality.OK, utc_s, steady_s) for face in range(4)]
    return Scan("cube", session, number, utc_s, steady_s, *faces)


class Tracker:
    """`heliocube run --role tracker` on one core."""

    def __init__(self, folder: Path, key: bytes, core: int) -> None:
        ports = [_free(kind) for kind in (socket.SOCK_DGRAM, socket.SOCK_STREAM)]
        self.place, self._api = ("127.0.0.1", ports[0]), ports[1]
        (folder / "heliocube.toml").write_text(CONFIG.format(bridge=ports[0], api=ports[1]))
        write_key(folder / "bridge.key", key)
        command = [Path(sys.executable).with_name("heliocube"), "run", "--role", "tracker", "--config"]
        self._log = (folder / "log").open("wb")
        self.process = subprocess.Popen(
            [*map(str, command), str(folder / "heliocube.toml")], stdout=self._log, stderr=self._log
        )
        os.sched_setaffinity(self.process.pid, {core})
        deadline_s = time.monotonic() + 60
        while self.counts() is None:
            if time.monotonic() > deadline_s or self.process.poll() is not None:
                sys.exit((folder / "log").read_text())
            time.sleep(0.2)

    def counts(self) -> dict | None:
        """Return what the bridge has counted."""
        try:
            with urllib.request.urlopen(f"http://127.0.0.1:{self._api}/api/state", timeout=20) as answer:
                return json.load(answer)["bridge"]
        except OSError:
            return None

    def cpu_s(self) -> float:
        """Return the processor time used so far."""
        fields = Path(f"/proc/{self.process.pid}/stat").read_text().rpartition(")")[2].split()
        return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")

    def end(self) -> None:
        """Stop it."""
        self.process.terminate()
        self.process.wait(30)
        self._log.close()


def hostile(kind: str, key: bytes) -> list[bytes]:
    """Return datagrams that must steer nothing: forged, replayed, noise."""
    utc_s, choice = time.time(), random.Random(1)
    old = [pack(scan(f"old-{n % 5}", n, utc_s - 25.0 + 0.01 * n, n), key) for n in range(500)]
    return {
        "forged": [pack(scan("live", 10**6 + n, utc_s, n), bytes(32)) for n in range(500)],
        "replayed": old,
        "mixed": [*old[:200], choice.randbytes(500), b"x" * 3000, b"", old[0][:300]]
        + [pack(scan("live", 10**6 + n, utc_s, n), bytes(32)) for n in range(200)],
    }[kind]


class Cube:
    """A cube that sends true scans, always from one socket."""

    def __init__(self, key: bytes, place: tuple[str, int]) -> None:
        self.socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._key, self._place, self._clock = key, place, SystemClock()
        self._session, self._number = token_hex(8), 0

    def send(self) -> bytes:
        """Send the next scan and return its datagram."""
        made = scan(self._session, self._number, self._clock.utc(), self._clock.monotonic())
        self._number += 1
        datagram = pack(made, self._key)
        self.socket.sendto(datagram, self._place)
        return datagram


def flood(tracker: Tracker, cube: Cube, recorded: list[bytes], rate: int, seconds: float, *, same_port: bool) -> dict:
    """Send true scans among hostile datagrams, and return the counts of both."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as own:
        attacker = cube.socket if same_port else own
        cube.send()
        time.sleep(1.0)
        before, cpu_s, began_s = tracker.counts(), tracker.cpu_s(), time.monotonic()
        sent = scans = 0
        while (now_s := time.monotonic() - began_s) < seconds:
            while scans < now_s * SCANS_PER_S:
                true = cube.send()
                recorded[scans % len(recorded)] = true
                scans += 1
            while sent < now_s * rate:
                attacker.sendto(recorded[sent % len(recorded)], tracker.place)
                sent += 1
            time.sleep(TICK_S)
        cpu_s, took_s = tracker.cpu_s() - cpu_s, now_s
        time.sleep(3.0)
        after = tracker.counts()
        return {
            "true": scans,
            "accepted": after["accepted"] - before["accepted"],
            "hostile_per_s": sent / took_s,
            "examined_per_s": (after["refused"] - before["refused"]) / took_s,
            "core_percent": 100.0 * cpu_s / took_s,
        }


def main() -> None:
    """Print a table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--rate", type=int, default=10_000, help="hostile datagrams a second")
    parser.add_argument("--seconds", type=float, default=20.0, help="how long each flood lasts")
    parser.add_argument("--repeats", type=int, default=3, help="how many floods a row is made of")
    arguments = parser.parse_args()
    cores = sorted(os.sched_getaffinity(0))
    os.sched_setaffinity(0, set(cores[1:] or cores))
    key = generate_key()
    with tempfile.TemporaryDirectory() as folder:
        tracker = Tracker(Path(folder), key, cores[0])
        cube = Cube(key, tracker.place)
        try:
            print("flood                        true scans  accepted  hostile/s  examined/s  % of a core")
            for kind, same_port in (("forged", False), ("replayed", False), ("mixed", False), ("mixed", True)):
                rows = [
                    flood(tracker, cube, hostile(kind, key), arguments.rate, arguments.seconds, same_port=same_port)
                    for _ in range(arguments.repeats)
                ]
                true, accepted = (sum(row[name] for row in rows) for name in ("true", "accepted"))
                name = f"{kind}, the port of the cube" if same_port else kind
                shown = [f"{name:<28}"]
                shown += [f"{true:>10}", f"{accepted:>9}"]
                for name in ("hostile_per_s", "examined_per_s", "core_percent"):
                    values = [row[name] for row in rows]
                    shown.append(f"{statistics.median(values):>10.0f} ({min(values):.0f}-{max(values):.0f})")
                print(" ".join(shown), flush=True)
        finally:
            tracker.end()
            cube.socket.close()


def _free(kind: socket.SocketKind) -> int:
    with socket.socket(socket.AF_INET, kind) as probe:
        probe.bind(("127.0.0.1", 0))
        return probe.getsockname()[1]


if __name__ == "__main__":
    main()
