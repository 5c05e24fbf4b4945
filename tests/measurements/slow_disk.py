"""How long a stop takes while the disk is slow: the service under strace, which holds back every fsync.

Usage: python tests/measurements/slow_disk.py [--runs N] [--fsync-s S]

A service on the simulated rig at real speed keeps its state in a folder. In each run the tracker is sent somewhere and
stopped over HTTP in mid-move, right after a hold: the stop might have to wait until the hold is written. The time ends
with the stop's answer, which comes when telemetry shows both axes standing.
"""

import argparse
import http
import json
import os
import re
import signal
import statistics
import subprocess
import sys
import tempfile
import time
import urllib.error
import urllib.request
from pathlib import Path

from daemon.api.token import generate_token, write_token

PROGRAM = [sys.executable, "-c", "from daemon.entry import main; main()"]
STARTS_WITHIN_S = 120.0


class Served:
    def __init__(self, folder, fsync_s):
        config, token = folder / "heliocube.toml", generate_token()
        config.write_text(
            "[bridge]\nlisten = '127.0.0.1:0'\n[store]\ndirectory = 'records'\n"
            "[api]\nlisten = '127.0.0.1:0'\ntoken_file = 'api.token'\n"
        )
        write_token(folder / "api.token", token)
        held = f"fsync,fdatasync:delay_enter={int(fsync_s * 1e6)}"
        strace = ["strace", "-f", "--seccomp-bpf", "-o", str(folder / "trace"), "-e", "trace=fsync,fdatasync"]
        traced = [*strace, "-e", f"inject={held}"] if fsync_s else []
        self.traced = bool(traced)
        run = [*traced, *PROGRAM, "run", "--config", str(config), "--speed", "1"]
        self.process = subprocess.Popen(run, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True)
        self.url = re.match(r"local interface at (\S+);", self.process.stdout.readline())[1]
        self.headers = {"Authorization": f"Bearer {token}", "Content-Type": "application/json"}

    def end(self):
        """End the service itself: strace ends with what it traces."""
        children = Path(f"/proc/{self.process.pid}/task/{self.process.pid}/children").read_text().split()
        os.kill(int(children[0]) if self.traced else self.process.pid, signal.SIGTERM)

    def post(self, name, **body):
        asked = urllib.request.Request(f"{self.url}/api/{name}", json.dumps(body).encode(), self.headers)
        with urllib.request.urlopen(asked, timeout=60) as answer:
            return json.load(answer)


def until_it_takes(served, a_deg, b_deg):
    """Send a target until the tracker has taken it: after a start it first waits for readings."""
    deadline_s = time.monotonic() + STARTS_WITHIN_S
    while True:
        served.post("auto")
        try:
            served.post("goto", a_deg=a_deg, b_deg=b_deg)
        except urllib.error.HTTPError as refusal:
            if refusal.code != http.HTTPStatus.CONFLICT or time.monotonic() > deadline_s:
                raise SystemExit(f"the tracker takes no target: {refusal.read().decode()}") from None
        else:
            return
        time.sleep(1.0)


def one_run(served, turn):
    until_it_takes(served, (-30.0, 30.0)[turn % 2], 60.0)
    time.sleep(1.0)
    served.post("hold")
    begun_s = time.monotonic()
    text = served.post("stop")["text"]
    return time.monotonic() - begun_s, "not kept yet" in text


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--runs", type=int, default=10, help="how many stops are timed (default: %(default)s)")
    parser.add_argument("--fsync-s", type=float, default=3.0, help="how long each fsync is held back")
    asked = parser.parse_args()
    for fsync_s in (0.0, asked.fsync_s):
        with tempfile.TemporaryDirectory() as name:
            served = Served(Path(name), fsync_s)
            try:
                found = [one_run(served, turn) for turn in range(asked.runs)]
            finally:
                served.end()
                served.process.wait()
                served.process.stdout.close()
        times_s = [taken_s for taken_s, _ in found]
        print(
            f"fsync held for {fsync_s:g} s: {asked.runs} stops, median {statistics.median(times_s):.2f} s, worst"
            f" {max(times_s):.2f} s; {sum(unsaved for _, unsaved in found)} answers say that it is not kept yet;"
            f" load {os.getloadavg()[0]:.1f} on {os.cpu_count()} cores",
            flush=True,
        )


if __name__ == "__main__":
    main()
