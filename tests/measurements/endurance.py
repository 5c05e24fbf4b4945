"""Whether memory stays flat and the store grows no larger than documented, over weeks without a restart.

Usage: python tests/measurements/endurance.py [--days N]

One service in one process on simulated instruments under virtual time, with its store on disk. Every ten minutes the
pages of the local interface are fetched; a client listens to its events; an operator gives each command once a day.
At every midnight the script prints the resident memory after a garbage collection and the store's size, and at the end
how much the memory has grown since the end of day 2.
"""

import argparse
import asyncio
import contextlib
import ctypes
import gc
import os
import tempfile
import time
from datetime import datetime, timedelta
from pathlib import Path

from daemon.api.app import Api
from daemon.base.timeloop import VirtualTimeLoop
from daemon.config.settings import Settings
from daemon.motion.polling import OFTEN, Polling
from daemon.service.operator import CommandError
from daemon.service.operator_commands import Operators, parse
from daemon.service.recent import RecentRecords
from daemon.service.rig import Role
from daemon.store.store import Origin, Store
from sim_drivers.weather import GeneratedWeather
from tests.support.rig import SITE, ServiceRig

START = datetime.fromisoformat("2022-09-01T00:00+00:00")
PAGES = ("/api/state", "/api/scans", "/metrics", "/healthz")
COMMANDS = ("hold", "auto", "stow", "auto", "stop", "auto", "snow", "auto", "maintenance", "auto", "relearn", "clear")
PAGES_EVERY_S = 600.0
DAY_S = 86400.0


def memory_mb():
    gc.collect()
    ctypes.CDLL(None).malloc_trim(0)
    return int(Path("/proc/self/statm").read_text().split()[1]) * os.sysconf("SC_PAGESIZE") / 1e6


def size_mb(folder):
    return sum(file.stat().st_size for file in folder.rglob("*") if file.is_file()) / 1e6


async def page(api, path):
    """Ask for a page as a server would."""

    async def receive():
        return {"type": "http.request", "body": b"", "more_body": False}

    async def send(message):
        assert message.get("status", 200) == 200, message

    scope = {
        "type": "http", "method": "GET", "path": path, "query_string": b"", "headers": [(b"host", b"localhost")],
        "http_version": "1.1", "scheme": "http",
    }  # fmt: skip
    await api.app(scope, receive, send)


async def listener(feed):
    with feed.listening() as events:
        while True:
            await events.get()


async def operator(rig):
    """Give each command once a day; some are refused."""
    operators, turn = Operators(rig.service.trackers, 1.0), 0
    while True:
        await asyncio.sleep(DAY_S / len(COMMANDS))
        with contextlib.suppress(CommandError):
            await operators.carry_out(parse(COMMANDS[turn % len(COMMANDS)], b"", "endurance"))
        turn += 1


async def reader(api):
    while True:
        await asyncio.sleep(PAGES_EVERY_S)
        for path in PAGES:
            await page(api, path)


async def run(days, folder, loop):
    settings = Settings.model_validate(
        {"bridge": {"listen": "127.0.0.1:0", "send_to": ()}, "store": {"directory": str(folder)}}
    )
    weather = GeneratedWeather("variable", SITE, 1)
    rig = ServiceRig(loop, settings, START, weather, Role.BOTH, None, Polling(idle_s=OFTEN.idle_s))
    recent = RecentRecords()
    rig.bus.subscribe(recent.note)
    origin = Origin(
        started_utc_s=rig.clock.utc(), role="both", version="0", simulated=True, site="here", latitude_deg=48.7,
        longitude_deg=2.2, altitude_m=156.0, tracker="",
    )  # fmt: skip
    store = Store(folder, settings.store.batch_s, settings.store.keep_days, origin, rig.clock, lambda _event: None)
    rig.bus.subscribe(store.keep)
    operators = Operators(rig.service.trackers, 1.0)
    api = Api(lambda: rig.take_snapshot(recent, store.status), recent, operators, "t" * 43, rig.clock, 1.0)
    stop, found = asyncio.Event(), []
    others = [
        asyncio.create_task(rig.service.run(stop)),
        asyncio.create_task(listener(api._feed)),
        asyncio.create_task(operator(rig)),
        asyncio.create_task(reader(api)),
    ]
    begun_s = time.monotonic()
    for day in range(1, days + 1):
        await asyncio.sleep(DAY_S)
        rig.records.clear()
        found.append((memory_mb(), size_mb(folder)))
        print(
            f"{(START + timedelta(days=day)).date()} day {day:2d}: {found[-1][0]:7.1f} MB resident,"
            f" store {found[-1][1]:6.1f} MB, {recent.scans} scans,"
            f" {time.monotonic() - begun_s:.0f} s of the machine",
            flush=True,
        )
    stop.set()
    await others[0]
    for other in others[1:]:
        other.cancel()
    await asyncio.gather(*others[1:], return_exceptions=True)
    store.close()
    return found


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--days", type=int, default=30, help="virtual days (default: %(default)s)")
    chosen = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder, asyncio.Runner(loop_factory=VirtualTimeLoop) as runner:
        found = runner.run(run(chosen.days, Path(folder), runner.get_loop()))
    if len(found) > 2:
        grown_mb = max(memory for memory, _ in found[2:]) - found[1][0]
        at_last_mb = found[-1][0] - found[1][0]
        print(f"memory since the end of day 2: {grown_mb:+.1f} MB at most, {at_last_mb:+.1f} MB at last")
        print(f"store: {(found[-1][1] - found[1][1]) / (len(found) - 2):.2f} MB a day")


if __name__ == "__main__":
    main()
