"""How soon a stop is answered while the local interface is attacked, and what the attack costs the service.

Usage: python tests/measurements/api_attack.py [--clients N] [--idle N] [--stops N] [--processes N] [--only KIND ...]
       [--fill SECONDS] [--seed N]

The script starts `heliocube run` on the simulated rig, lets the service fill its memory with scans, and attacks it
from other processes over loopback, by one kind of attack after the other. During each of them, N clients (--clients)
fetch all pages one after the other without a pause, and N connections (--idle) send nothing or half of a request.
Meanwhile stops are given, as POSTs and as `heliocube stop` from a shell. A stop is answered when telemetry has shown
the axes standing.
"""

import argparse
import asyncio
import collections
import contextlib
import http.client
import json
import logging
import os
import random
import re
import socket
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path

HELIOCUBE = Path(sys.executable).with_name("heliocube")
TOKEN = "t" * 43
CONFIG = """
[api]
listen = "127.0.0.1:{port}"
token_file = "{folder}/api.token"
[bridge]
listen = "127.0.0.1:0"
send_to = []
[simulation]
speed = {speed}
"""
PAGES = ("/api/state", "/api/scans", "/metrics", "/healthz", "/api/nothing", "/api/scans?since=2022-10-14T06:05:00Z")
HOST = "localhost"
FROM_EVERYWHERE = ("knock_spread", "halves_spread")
HELD = 300


def get(path, *, keep=False, host=HOST, more=""):
    last = "" if keep else "Connection: close\r\n"
    return f"GET {path} HTTP/1.1\r\nHost: {host}\r\n{last}{more}\r\n".encode()


class Attack:
    """Clients of one port; each kind of attack is a method that uses one connection."""

    def __init__(self, port, seed):
        self._port = port
        self._random = random.Random(seed)
        self.done = self.refused = 0
        self._held = collections.deque()

    def _own_address(self, once):
        """Return the address to call from: one of this machine's sixteen million, if the kind of attack says so."""
        if once.__name__ not in FROM_EVERYWHERE:
            return None
        return f"127.{self._random.randrange(256)}.{self._random.randrange(256)}.{self._random.randrange(1, 255)}", 0

    async def forever(self, once):
        while True:
            try:
                own = self._own_address(once)
                reader, writer = await asyncio.open_connection("127.0.0.1", self._port, local_addr=own)
            except OSError:
                self.refused += 1
                await asyncio.sleep(0.01)
                continue
            try:
                await once(reader, writer)
                self.done += 1
            except (OSError, asyncio.IncompleteReadError, asyncio.LimitOverrunError):
                self.refused += 1
            finally:
                writer.close()
                with contextlib.suppress(OSError):
                    await writer.wait_closed()

    async def pages(self, reader, writer):
        writer.write(get(self._random.choice(PAGES)))
        while await reader.read(65536):
            pass

    async def kept(self, reader, writer):
        """Ask for pages over one connection, as a browser does."""
        while True:
            writer.write(get(self._random.choice(PAGES), keep=True))
            head = await reader.readuntil(b"\r\n\r\n")
            length = re.search(rb"content-length: (\d+)", head)
            await reader.readexactly(int(length[1]))
            self.done += 1

    async def idle(self, reader, writer):
        writer.write(
            self._random.choice((b"", b"GET /api/state HTTP/1.1\r\nHost: loc", b"POST /api/stop HTTP/1.1\r\n"))
        )
        await reader.read()

    async def slowly(self, reader, writer):
        for byte in get("/api/state", more="X: " + "y" * 2000 + "\r\n"):
            writer.write(bytes([byte]))
            await asyncio.sleep(0.2)

    async def slow_body(self, reader, writer):
        writer.write(b"POST /api/stop HTTP/1.1\r\nHost: localhost\r\nContent-Length: 4000\r\n\r\n")
        while not reader.at_eof():
            writer.write(b" ")
            await writer.drain()
            await asyncio.sleep(0.2)
            if reader._buffer:
                break

    async def garbage(self, reader, writer):
        writer.write(self._random.randbytes(200))
        await reader.read()

    async def wrong_host(self, reader, writer):
        writer.write(get("/api/state", host="rebound.example"))
        await reader.read()

    async def wrong_token(self, reader, writer):
        body = b'{"why": "a", "why": "b"}'
        writer.write(
            b"POST /api/stop HTTP/1.1\r\nHost: localhost\r\nAuthorization: Bearer wrong\r\nConnection: close\r\n"
            b"Content-Length: %d\r\n\r\n%s" % (len(body), body)
        )
        await reader.read()

    async def huge(self, reader, writer):
        writer.write(b"POST /api/stop HTTP/1.1\r\nHost: localhost\r\nContent-Length: 100000000\r\n\r\n")
        for _ in range(100):
            writer.write(b"x" * 1_000_000)
            await writer.drain()
        await reader.read()

    async def pipelined(self, reader, writer):
        writer.write(get("/api/state", keep=True) * 200 + get("/healthz"))
        while await reader.read(65536):
            pass

    async def upgrade(self, reader, writer):
        writer.write(get("/api/events", more="Upgrade: websocket\r\nSec-WebSocket-Version: 13\r\n", keep=True))
        await reader.read(4096)

    async def deaf(self, reader, writer):
        """Ask for streams and the longest pages, and never read."""
        writer.transport.pause_reading()
        writer.write(get(self._random.choice(("/api/events", "/api/scans", "/api/scans")), keep=True) * 20)
        await asyncio.sleep(30)

    async def knock(self, reader, writer):
        """Connect and close."""

    async def knock_spread(self, reader, writer):
        """Connect and close, from another address each time."""

    async def halves_spread(self, reader, writer):
        """Send half of a head, from another address each time, and keep the connection while opening the next."""
        writer.write(b"POST /api/stop HTTP/1.1\r\nHost: loc")
        self._held.append(writer.transport.get_extra_info("socket").dup())
        if len(self._held) > HELD:
            self._held.popleft().close()

    async def reset(self, reader, writer):
        """Begin a command, and tear the connection down."""
        writer.write(b"POST /api/stop HTTP/1.1\r\nHost: localhost\r\n")
        writer.transport.abort()

    async def run(self, kind, clients, idle, seconds):
        tasks = [asyncio.create_task(self.forever(self.pages)) for _ in range(clients)]
        tasks += [asyncio.create_task(self.forever(self.idle)) for _ in range(idle)]
        if kind == "knock_hard":
            tasks.append(asyncio.create_task(asyncio.to_thread(knock_hard, self._port, seconds)))
        elif kind != "pages":
            tasks += [asyncio.create_task(self.forever(getattr(self, kind))) for _ in range(clients)]
        await asyncio.wait(tasks, timeout=seconds)
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)
        print(json.dumps({"done": self.done, "refused": self.refused}))


def knock_hard(port, seconds):
    """Connect and close as fast as one process can."""
    ends_s = time.monotonic() + seconds
    while time.monotonic() < ends_s:
        with socket.socket() as knocking:
            # From another address each time: one address has only some 28,000 ports.
            knocking.bind((f"127.{random.randrange(256)}.{random.randrange(256)}.1", 0))
            knocking.setblocking(False)
            knocking.connect_ex(("127.0.0.1", port))


KINDS = (
    "pages", "kept", "slowly", "slow_body", "garbage", "wrong_host", "wrong_token", "huge", "pipelined", "upgrade",
    "deaf", "knock", "knock_spread", "halves_spread", "reset", "knock_hard",
)  # fmt: skip


def free_port():
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        return free.getsockname()[1]


def configured(folder, port, speed):
    """Write a configuration and its token, and return its path."""
    (folder / "api.token").write_text(TOKEN)
    (folder / "api.token").chmod(0o600)
    path = folder / "heliocube.toml"
    path.write_text(CONFIG.format(port=port, folder=folder, speed=speed))
    return path


class Service:
    def __init__(self, folder, port, config):
        self.port = port
        self.config = config
        self.log = folder / "log"
        with self.log.open("w") as log:
            self._process = subprocess.Popen(
                [HELIOCUBE, "run", "--config", self.config],
                stdout=log,
                stderr=log,
                env=os.environ | {"JOURNAL_STREAM": "1:1"},
            )
        deadline_s = time.monotonic() + 60
        while time.monotonic() < deadline_s:
            with contextlib.suppress(OSError), socket.create_connection(("127.0.0.1", self.port)):
                return
            time.sleep(0.1)
        sys.exit(f"the service did not start: {self.log.read_text()}")

    def ask(self, method, path, body=""):
        connection = http.client.HTTPConnection("127.0.0.1", self.port, timeout=30)
        connection.request(method, path, body, {"Authorization": f"Bearer {TOKEN}"})
        reply = connection.getresponse()
        content = reply.read()
        connection.close()
        return reply.status, content.decode()

    def metric(self, name):
        found = re.search(rf"^heliocube_{name}(?:{{.*}})? (\S+)$", self.ask("GET", "/metrics")[1], re.MULTILINE)
        return float(found[1]) if found else float("nan")

    def cpu_s(self):
        fields = Path(f"/proc/{self._process.pid}/stat").read_text().rpartition(")")[2].split()
        return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")

    def memory_mb(self):
        return int(Path(f"/proc/{self._process.pid}/statm").read_text().split()[1]) * os.sysconf("SC_PAGESIZE") / 1e6

    def close(self):
        self._process.terminate()
        self._process.wait(30)


def stop_by_post(service):
    begun_s = time.monotonic()
    try:
        status, content = service.ask("POST", "/api/stop", '{"why": "under attack"}')
    except OSError as error:
        return time.monotonic() - begun_s, f"{error!r}"
    return time.monotonic() - begun_s, "" if status == 200 else f"{status} {content[:80]}"


def stop_by_shell(service):
    begun_s = time.monotonic()
    done = subprocess.run(
        [HELIOCUBE, "stop", "--config", service.config], capture_output=True, text=True, timeout=60, check=False
    )
    return time.monotonic() - begun_s, "" if done.returncode == 0 else done.stderr[:80]


def stops(service, number):
    found = {}
    for name, stop in (("POST", stop_by_post), ("shell", stop_by_shell)):
        runs = []
        for turn in range(number):
            time.sleep(0.05 + 0.03 * (turn % 7))
            runs.append(stop(service))
        latencies_s = [latency_s for latency_s, _ in runs]
        failures = [why for _, why in runs if why]
        text = f"median {statistics.median(latencies_s) * 1e3:.0f} ms, worst {max(latencies_s) * 1e3:.0f} ms"
        found[name] = text + (f", {len(failures)} FAILED: {failures[0]}" if failures else "")
    return found


def measure(service, kinds, chosen):
    print("nobody else:", stops(service, chosen.stops), flush=True)
    for kind in kinds:
        lines, cpu_s, begun_s = service.log.read_text().count("\n"), service.cpu_s(), time.monotonic()
        arguments = [sys.executable, __file__, "--attack", kind, "--port", str(service.port)]
        arguments += ["--clients", str(chosen.clients), "--idle", str(chosen.idle), "--seconds", "600"]
        attacks = [
            subprocess.Popen([*arguments, "--seed", str(chosen.seed + number)], stdout=subprocess.DEVNULL)
            for number in range(chosen.processes)
        ]
        time.sleep(1.5)
        found = stops(service, chosen.stops)
        for attack in attacks:
            attack.terminate()
            attack.wait()
        # Requests that were accepted before are served first.
        time.sleep(0.5)
        late_s = service.metric("loop_late_worst_seconds")
        took_s = time.monotonic() - begun_s
        print(
            f"{kind}: POST {found['POST']}; shell {found['shell']}; loop late at worst {late_s * 1e3:.0f} ms;"
            f" {(service.cpu_s() - cpu_s) / took_s * 100:.0f} % of a core; {service.memory_mb():.0f} MB;"
            f" {(service.log.read_text().count(chr(10)) - lines)} lines of the log in {took_s:.0f} s",
            flush=True,
        )


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--clients", type=int, default=40, help="how many clients fetch pages (default: %(default)s)")
    parser.add_argument(
        "--idle",
        type=int,
        default=64,
        help="how many connections send nothing, or half of a request (default: %(default)s)",
    )
    parser.add_argument("--processes", type=int, default=1, help="attacking processes, each with that many clients")
    parser.add_argument(
        "--stops",
        type=int,
        default=20,
        help="how many stops are timed under each kind of attack (default: %(default)s)",
    )
    parser.add_argument("--fill", type=float, default=180.0, help="seconds at 60 times real speed before the attack")
    parser.add_argument(
        "--seed", type=int, default=random.randrange(2**32), help="seed of the attack (default: drawn and printed)"
    )
    parser.add_argument(
        "--only", nargs="*", choices=KINDS, default=KINDS, help="these kinds of attack only (default: all)"
    )
    parser.add_argument("--attack", choices=KINDS, help=argparse.SUPPRESS)
    parser.add_argument("--port", type=int, help=argparse.SUPPRESS)
    parser.add_argument("--seconds", type=float, help=argparse.SUPPRESS)
    chosen = parser.parse_args()
    if chosen.attack:
        logging.getLogger("asyncio").setLevel(logging.CRITICAL)
        attack = Attack(chosen.port, chosen.seed)
        asyncio.run(attack.run(chosen.attack, chosen.clients, chosen.idle, chosen.seconds))
        return
    print(f"seed {chosen.seed}; {os.cpu_count()} cores, load {os.getloadavg()[0]:.1f}", flush=True)
    with tempfile.TemporaryDirectory() as folder:
        port = free_port()
        service = Service(Path(folder), port, configured(Path(folder), port, 60))
        try:
            time.sleep(chosen.fill)
            measure(service, chosen.only, chosen)
        finally:
            service.close()


if __name__ == "__main__":
    main()
