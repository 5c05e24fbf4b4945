"""How soon both axes truly stand after a person's stop, with real processes on pseudo-terminals.

Usage: python tests/measurements/stop_latency.py [--runs N] [--load N] [--firmware DIR]

In each run the tracker is sent far away and stopped in mid-move: first in all runs by a POST to the service, then in
all runs by `heliocube stop` from a shell. The time runs from just before the command's start until the true pose no
longer changes. Meanwhile --load keeps that many processes busy. --firmware uses the maker's firmware, whose server is
in DIR, in place of the bench.
"""

import argparse
import os
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from tests.campaign.peers import NotThereError, unit_and_tracker

LOOK_EVERY_S = 0.01
SAME_DEG = 0.004
STANDS_FOR_S = 0.6
GIVES_UP_S = 20.0
TARGETS = ((-40.0, 70.0), (40.0, 60.0), (-35.0, 40.0), (30.0, 75.0))
BUSY = "import time\nend = time.monotonic() + {seconds}\nwhile time.monotonic() < end: sum(range(10000))"


def turned(one, other):
    return max(abs(one[0] - other[0]), abs(one[1] - other[1]))


def wait_until_it_moves(unit):
    deadline_s, before = time.monotonic() + 60, unit.truth()
    while turned(before, unit.truth()) < 3.0:
        if time.monotonic() > deadline_s:
            raise NotThereError("the tracker does not move")
        time.sleep(0.05)


def standstill_s(unit, begun_s):
    """Return when the true pose last changed [s after `begun_s`]."""
    last, changed_s = unit.truth(), time.monotonic()
    while time.monotonic() - changed_s < STANDS_FOR_S:
        if changed_s - begun_s > GIVES_UP_S:
            raise NotThereError(f"the axes still move {GIVES_UP_S:g} s after the stop was sent")
        time.sleep(LOOK_EVERY_S)
        at = unit.truth()
        if turned(last, at) > SAME_DEG:
            last, changed_s = at, time.monotonic()
    return changed_s - begun_s


def one_run(unit, tracker, turn, way):
    tracker.until_it_takes(*TARGETS[turn % len(TARGETS)])
    wait_until_it_moves(unit)
    # At another phase of the service's reads each time.
    time.sleep(0.13 * (turn % 7))
    begun_s = time.monotonic()
    if way == "shell":
        with tracker.shell("stop") as process:
            latency_s = standstill_s(unit, begun_s)
            answer = process.communicate()[0]
        carried_out = process.returncode == 0
    else:
        with tracker.send_stop() as connection:
            latency_s = standstill_s(unit, begun_s)
            answer = connection.recv(1000).decode()
        carried_out = answer.startswith("HTTP/1.1 200 ")
    if not carried_out:
        raise NotThereError(f"the stop was not carried out: {answer}")
    return latency_s


def measure(unit, tracker, runs):
    for way in ("HTTP", "shell"):
        latencies_s = [one_run(unit, tracker, turn, way) for turn in range(runs)]
        print(
            f"{way}: {runs} stops in mid-move, median {statistics.median(latencies_s):.2f} s,"
            f" worst {max(latencies_s):.2f} s; load {os.getloadavg()[0]:.1f} on {os.cpu_count()} cores",
            flush=True,
        )
        print("   " + " ".join(f"{latency_s:.2f}" for latency_s in latencies_s), flush=True)


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument(
        "--runs",
        type=int,
        default=10,
        help="how many stops are timed by POST, and as many from a shell (default: %(default)s)",
    )
    parser.add_argument("--load", type=int, default=0, help="other processes that keep the processors busy")
    parser.add_argument("--firmware", type=Path, help="directory of the firmware's server, in place of the bench")
    chosen = parser.parse_args()
    # These processes end by themselves even if this one dies.
    script = BUSY.format(seconds=60 + 25 * chosen.runs)
    busy = [subprocess.Popen([sys.executable, "-c", script]) for _ in range(chosen.load)]
    try:
        with (
            tempfile.TemporaryDirectory() as folder,
            unit_and_tracker(Path(folder), chosen.firmware) as (unit, tracker),
        ):
            measure(unit, tracker, chosen.runs)
    except NotThereError as error:
        sys.exit(str(error))
    finally:
        for process in busy:
            process.terminate()
            process.wait(10)


if __name__ == "__main__":
    main()
