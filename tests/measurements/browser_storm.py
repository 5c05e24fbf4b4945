"""How late the event loop runs while the voltmeter never answers and many browsers ask for everything.

Usage: python -m tests.measurements.browser_storm [--minutes N] [--browsers N] [--seed N]

`heliocube bench` and the service that drives it are separate processes, in real time. The voltmeter hangs from the
second minute on. Each browser keeps six connections, as browsers do: one reads the events, and now and then closes;
five fetch pages one after the other, each as soon as the last has come, with pauses. The lateness is the service's own
measurement, ten times a second; it is read every minute.
"""

import argparse
import asyncio
import contextlib
import json
import os
import random
import re
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from sim_drivers.bench.client import request
from tests.measurements.api_attack import HELIOCUBE, Attack, Service, configured, free_port, get

LATE_S = 0.05
WORST_S = 0.25


class Browsers(Attack):
    async def page(self):
        """One of five connections that fetch pages: each connection is kept for some pages."""
        while True:
            with contextlib.suppress(OSError, asyncio.IncompleteReadError):
                reader, writer = await asyncio.open_connection("127.0.0.1", self._port)
                try:
                    for _ in range(self._random.randrange(1, 60)):
                        writer.write(get(self._random.choice(("/api/state", "/api/scans", "/metrics")), keep=True))
                        head = await reader.readuntil(b"\r\n\r\n")
                        await reader.readexactly(int(re.search(rb"content-length: (\d+)", head)[1]))
                        self.done += 1
                finally:
                    writer.close()
            await asyncio.sleep(self._random.random())

    async def events(self):
        while True:
            with contextlib.suppress(OSError, TimeoutError):
                reader, writer = await asyncio.open_connection("127.0.0.1", self._port)
                try:
                    writer.write(get("/api/events", keep=True))
                    async with asyncio.timeout(self._random.uniform(1, 60)):
                        while await reader.read(65536):
                            pass
                finally:
                    writer.close()
            await asyncio.sleep(self._random.random())

    async def storm(self, browsers, seconds):
        tasks = [asyncio.create_task(self.page()) for _ in range(5 * browsers)]
        tasks += [asyncio.create_task(self.events()) for _ in range(browsers)]
        await asyncio.wait(tasks, timeout=seconds)
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)
        print(json.dumps({"pages": self.done}), flush=True)


class OnBench(Service):
    """The service that drives a bench."""

    def __init__(self, folder):
        port = free_port()
        basis = configured(folder, port, 1)
        self.folder = folder / "bench"
        with (folder / "bench.log").open("w") as log:
            self._bench = subprocess.Popen(
                [HELIOCUBE, "bench", "--dir", self.folder, "--config", basis],
                stdout=subprocess.PIPE,
                stderr=log,
                text=True,
            )
        if self._bench.stdout.readline() != "ready\n":
            sys.exit(f"the bench did not start: {(folder / 'bench.log').read_text()}")
        super().__init__(folder, port, self.folder / "heliocube.toml")

    def close(self):
        super().close()
        self._bench.terminate()
        self._bench.wait(30)
        self._bench.stdout.close()


def lateness(service):
    """Return how many measurements were within each bound, by bound, and the worst of the last minutes [s]."""
    text = service.ask("GET", "/metrics")[1]
    counts = dict(re.findall(r'^heliocube_loop_late_seconds_bucket{le="(\S+)"} (\S+)$', text, re.MULTILINE))
    worst = re.search(r"^heliocube_loop_late_worst_seconds (\S+)$", text, re.MULTILINE)
    return {bound: float(count) for bound, count in counts.items()}, float(worst[1])


def measure(service, chosen):
    time.sleep(30)
    request(service.folder, "freeze", ["voltmeter"])
    time.sleep(30)
    before, _ = lateness(service)
    cpu_s, begun_s, worst_s, after = service.cpu_s(), time.monotonic(), 0.0, before
    arguments = ["--storm", "--port", str(service.port), "--browsers", str(chosen.browsers), "--seed", str(chosen.seed)]
    command = [sys.executable, "-m", "tests.measurements.browser_storm", *arguments, "--minutes", str(chosen.minutes)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as storm:
        while storm.poll() is None:
            time.sleep(50)
            with contextlib.suppress(OSError):
                after, latest_s = lateness(service)
                worst_s = max(worst_s, latest_s)
        said = storm.stdout.read()
    took_s = time.monotonic() - begun_s
    found = {bound: after[bound] - before[bound] for bound in after}
    whole = found["+Inf"]
    print(f"{took_s / 60:.1f} min, {chosen.browsers} browsers, {said.strip()}; {os.cpu_count()} cores,")
    print(f"   load {os.getloadavg()[0]:.1f}, service {(service.cpu_s() - cpu_s) / took_s * 100:.0f} % of a core")
    for bound, count in found.items():
        print(f"   late by at most {bound} s: {count:.0f} of {whole:.0f} measurements ({count / whole * 100:.3f} %)")
    verdict = found[f"{LATE_S:g}"] >= 0.999 * whole and worst_s < WORST_S
    print(f"   worst {worst_s * 1e3:.0f} ms; 99.9 % within {LATE_S * 1e3:.0f} ms and all within 250 ms: {verdict}")


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--minutes", type=float, default=60.0, help="how long the storm lasts (default: %(default)g)")
    parser.add_argument(
        "--browsers", type=int, default=12, help="how many browsers, of six connections each (default: %(default)s)"
    )
    parser.add_argument(
        "--seed",
        type=int,
        default=random.randrange(2**32),
        help="seed of what they ask for (default: drawn and printed)",
    )
    parser.add_argument("--storm", action="store_true", help=argparse.SUPPRESS)
    parser.add_argument("--port", type=int, help=argparse.SUPPRESS)
    chosen = parser.parse_args()
    if chosen.storm:
        asyncio.run(Browsers(chosen.port, chosen.seed).storm(chosen.browsers, chosen.minutes * 60))
        return
    print(f"seed {chosen.seed}", flush=True)
    with tempfile.TemporaryDirectory() as folder:
        service = OnBench(Path(folder))
        try:
            measure(service, chosen)
        finally:
            service.close()


if __name__ == "__main__":
    main()
