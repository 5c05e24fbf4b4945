"""What many trackers in one process cost: processor time, memory, late decisions, a late loop, the time of a stop.

Usage: python tests/measurements/fleet.py [--seconds S] [--trackers N ...] [--law LAW ...] [--virtual] [--profile]

Each line is measured in a process of its own, on a morning of broken clouds, in real time: one simulated cube, N
simulated positioners on in-memory lines, the bridge over UDP on loopback, every interval as in the configuration, and a
scrape of /metrics every 15 s as Prometheus does it. The figures are taken after the start, which has its own column. A
decision's lateness runs from when it was due, or from the scan that it waited for, until its order has been given. At
the end one command stows all trackers, and another stops them while they move. The time of each runs from the command
to the packet on the wire of the last tracker.

In virtual time every figure is CPU time, including that of the thread that writes /metrics.
"""

import argparse
import asyncio
import cProfile
import gc
import json
import logging
import math
import os
import platform
import pstats
import statistics
import subprocess
import sys
import time
from functools import partial
from pathlib import Path
from random import Random

import numpy as np

from daemon.api.app import Api
from daemon.base.clock import LoopClock
from daemon.base.process import SystemdNotifier, freeze_startup_objects
from daemon.base.records import Bus, Decision, Move
from daemon.base.timeloop import VirtualTimeLoop
from daemon.config.settings import Settings
from daemon.rigs.simulated import build_simulated_rig, build_weather
from daemon.service.operator_commands import Operators, parse
from daemon.service.recent import RecentRecords
from daemon.service.rig import Role
from daemon.service.service import Service
from daemon.service.snapshot import snapshot
from daemon.tracker.control import Control
from sim_drivers.transports import InMemoryStream

NUMBERS = (1, 10, 50, 100, 200, 500)
LAWS = ("mu-prime", "optimal")
MORNING_UTC_S = 1665741600.0
STARTS_WITHIN_S = 40.0
LOOK_EVERY_S = 0.01
SCRAPE_EVERY_S = 15.0
UNDER_WAY_S = 3.0
HEADS = (
    "Law",
    "Trackers",
    "Load before",
    "CPU of a core",
    "per tracker",
    "Memory",
    "Decisions",
    "late p50 / p99 / max",
    "computing",
    "Loop late p50 / p99 / max",
    "Scrape",
    "Loop at the start",
    "Stow on all wires",
    "Stop",
)


watch = time.monotonic


class Lateness:
    """How late the decisions of all trackers were: wraps the tick of `Control`."""

    def __init__(self):
        self.late_s, self.busy_s = [], []
        self._due_s = {}
        self._scan_s = -math.inf
        tick, receive = Control.tick, Control.receive

        def timed(control):
            due_s, before = self._due_s.get(control, -math.inf), control.state.decision
            begun_s = watch()
            tick(control)
            ended_s = watch()
            self._due_s[control] = control.next_tick_s
            if control.state.decision is not before:
                self.busy_s.append(ended_s - begun_s)
                # A decision that begins before it is due was woken by the scan that it waited for.
                self.late_s.append(ended_s - (due_s if begun_s >= due_s else self._scan_s))

        def noted(control, scan, utc_s):
            self._scan_s = watch()
            receive(control, scan, utc_s)

        Control.tick, Control.receive = timed, noted

    def clear(self):
        self.late_s.clear()
        self.busy_s.clear()


class Wires:
    """The time of the first packet on the wire of each positioner."""

    def __init__(self):
        self.first_s = {}
        send = InMemoryStream.send

        async def noted(stream, packet):
            await send(stream, packet)
            self.first_s.setdefault(id(stream), watch())

        InMemoryStream.send = noted

    async def all_sent(self, number):
        for _ in range(1000):
            if len(self.first_s) == number:
                return
            await asyncio.sleep(0.01)


async def look(late_s):
    """Measure how late the loop is."""
    while True:
        due_s = watch() + LOOK_EVERY_S
        await asyncio.sleep(LOOK_EVERY_S)
        late_s.append(max(watch() - due_s, 0.0))


async def scrape(api, took_s):
    async def receive():
        return {"type": "http.request", "body": b"", "more_body": False}

    size = 0

    async def send(message):
        nonlocal size
        assert message.get("status", 200) == 200, message
        size += len(message.get("body", b""))

    scope = {
        "type": "http",
        "method": "GET",
        "path": "/metrics",
        "query_string": b"",
        "headers": [(b"host", b"localhost")],
        "client": ("127.0.0.1", 1),
    }
    begun_s = watch()
    await api.app(scope, receive, send)
    took_s.append((watch() - begun_s, size))


def settings_of(trackers, law):
    tables = [{"name": f"t{number:03}"} for number in range(1, trackers + 1)]
    return Settings.model_validate(
        {
            "tracker": tables if trackers > 1 else [],
            "law": {"driver": law},
            "simulation": {"weather": "broken"},
            "bridge": {"listen": "127.0.0.1:0", "send_to": (), "insecure": True},
        }
    )


def of(values, *shares):
    return [float(value) for value in np.quantile(values, shares)] if len(values) else [math.nan] * len(shares)


def resident_mb():
    return int(Path("/proc/self/statm").read_text().split()[1]) * os.sysconf("SC_PAGESIZE") / 1e6


async def work(service, seconds, api, meter, wires, decisions):
    """Return the figures of one process."""
    loop_s, scrapes, found = [], [], {}
    watching = asyncio.create_task(look(loop_s))
    loop = asyncio.get_running_loop()
    begun_s = loop.time()
    while any(not tracker.control.state.decision for tracker in service.trackers):
        assert loop.time() < begun_s + STARTS_WITHIN_S, "not all have decided"
        await asyncio.sleep(0.05)
    found["start"] = {"late_s": of(meter.late_s, 1.0)[0], "loop_s": max(loop_s)}
    # The second decisions begin half an interval after the first.
    await asyncio.sleep(0.5 * service.trackers[0].control.pointing.law.decide_every_s)
    meter.clear()
    loop_s.clear()
    decisions[:] = []
    gc.collect()
    from_s, cpu_s = loop.time(), time.process_time()
    while (left_s := from_s + seconds - loop.time()) > 0.0:
        await asyncio.sleep(min(left_s, SCRAPE_EVERY_S))
        await scrape(api, scrapes)
    passed_s = loop.time() - from_s
    found |= {
        "cpu": (time.process_time() - cpu_s) / passed_s,
        "resident_mb": resident_mb(),
        "late_s": of(meter.late_s, 0.5, 0.99, 1.0),
        "busy_s": of(meter.busy_s, 0.5, 0.99, 1.0),
        "loop_s": of(loop_s, 0.5, 0.99, 1.0),
        "decisions": len(meter.late_s),
        "scrape_s": statistics.median(took for took, _ in scrapes),
        "scrape_bytes": scrapes[-1][1],
    }
    operators = Operators(service.trackers, 1.0, service.cube_alarms)
    for name, wait_s in (("stow", UNDER_WAY_S), ("stop", 0.0)):
        wires.first_s.clear()
        sent_s = watch()
        task = asyncio.create_task(operators.carry_out(parse(name, b'{"why": "measured"}', "HTTP")))
        await wires.all_sent(len(service.trackers))
        # A tracker that already lies flat gets no order to stow, and no stop either, since it is not under way.
        found[f"{name}_s"] = max(wires.first_s.values(), default=math.nan) - sent_s
        found[f"{name}_wires"] = len(wires.first_s)
        if wait_s:
            await asyncio.sleep(wait_s)
        answer = await task
        found[f"{name}_answer"] = f"{answer['state']}: {answer['text'][:60]}"
    watching.cancel()
    return found


def child(trackers, law, given):
    if given.virtual:
        # In virtual time, lateness is CPU time computed without a pause.
        globals()["watch"] = time.process_time
    # Otherwise each of 500 trackers would log that a stop holds it in the storm.
    logging.disable()
    meter, wires = Lateness(), Wires()
    settings = settings_of(trackers, law)
    decisions = []
    with asyncio.Runner(loop_factory=VirtualTimeLoop if given.virtual else None) as runner:
        loop = runner.get_loop()
        clock = LoopClock(loop.time, MORNING_UTC_S)
        bus, recent = Bus(), RecentRecords(several=trackers > 1)
        bus.subscribe(recent.note)
        bus.subscribe(lambda record: decisions.append(record) if isinstance(record, Decision | Move) else None)
        weather, _ = build_weather(settings, MORNING_UTC_S, MORNING_UTC_S + 3600.0)
        rig = build_simulated_rig(settings, Role.BOTH, clock, weather)
        service = Service(settings, Role.BOTH, rig, clock, Random(1), bus, None, SystemdNotifier({}, 0))

        def see(glance=False):
            return snapshot(service, recent, 1.0, None, {}, glance=glance)

        operators = Operators(service.trackers, 1.0, service.cube_alarms)
        api = Api(see, recent, operators, "token", clock, 1.0, glance=partial(see, glance=True))

        async def both():
            stop = asyncio.Event()
            serving = asyncio.create_task(service.run(stop, service.loop_watch.run()))
            try:
                return await work(service, given.seconds, api, meter, wires, decisions)
            finally:
                stop.set()
                await serving

        freeze_startup_objects()
        if given.profile:
            profile = cProfile.Profile()
            profile.enable()
            found = runner.run(both())
            profile.disable()
            pstats.Stats(profile, stream=sys.stderr).sort_stats("tottime").print_stats(45)
        else:
            found = runner.run(both())
    print(json.dumps(found))


def ms(seconds):
    return " / ".join(f"{1000.0 * value:.1f}" for value in seconds)


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument(
        "--seconds", type=float, default=60.0, help="how long each line is measured (default: %(default)g)"
    )
    parser.add_argument(
        "--trackers",
        type=int,
        nargs="+",
        default=NUMBERS,
        help="numbers of trackers, a line for each (default: %(default)s)",
    )
    parser.add_argument("--law", nargs="+", default=LAWS, help="laws, a line for each (default: %(default)s)")
    parser.add_argument("--virtual", action="store_true", help="virtual time, for a busy machine")
    parser.add_argument("--profile", action="store_true", help="print which functions took the time")
    parser.add_argument("--child", nargs=2, help=argparse.SUPPRESS)
    given = parser.parse_args()
    if given.child:
        child(int(given.child[0]), given.child[1], given)
        return
    machine = f"{platform.machine()}, {os.cpu_count()} cores, Python {platform.python_version()}"
    print(f"{machine}, {given.seconds:g} s each\n\n| {' | '.join(HEADS)} |\n|---|{'---:|' * (len(HEADS) - 1)}")
    for law in given.law:
        for trackers in given.trackers:
            load = os.getloadavg()[0]
            command = [sys.executable, __file__, "--seconds", str(given.seconds), "--child", str(trackers), law]
            command += [f"--{name}" for name in ("virtual", "profile") if getattr(given, name)]
            done = subprocess.run(command, stdout=subprocess.PIPE, check=True, text=True)
            found = json.loads(done.stdout.splitlines()[-1])
            cells = [
                f"`{law}`",
                trackers,
                f"{load:.1f}",
                f"{100.0 * found['cpu']:.1f} %",
                f"{1000.0 * found['cpu'] / trackers:.2f} ms/s",
                f"{found['resident_mb']:.0f} MB",
                found["decisions"],
                "" if given.virtual else f"{ms(found['late_s'])} ms",
                f"{ms(found['busy_s'])} ms",
                f"{ms(found['loop_s'])} ms",
                f"{ms([found['scrape_s']])} ms",
                f"{ms([found['start']['loop_s']])} ms",
                f"{found['stow_s']:.2f} s",
                f"{found['stop_s']:.2f} s",
            ]
            print(f"| {' | '.join(map(str, cells))} |", flush=True)


if __name__ == "__main__":
    main()
