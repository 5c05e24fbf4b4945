"""How many rows a second an archive takes, how many bytes a row needs, and whether kills lose or double records.

    python -m tests.measurements.archive rate [--rounds 20]
    python -m tests.measurements.archive kill --trackers 50 --minutes 10
    python -m tests.measurements.archive hour --trackers 50

`rate` writes pages of 1,000 installations, as they come from a broker, into a PostgreSQL of its own at full speed, and
then one day of them to Parquet. From the bytes of a row and one tracker's rows a day it computes the sizes of plants.
`kill` runs a broker, a PostgreSQL, two processes `heliocube archive`, and a store with its feed for each tracker, at a
fixed pace (a scan each 5 s, a pose each 10 s, a decision each 5 min, one event a minute). It kills broker and database
with SIGKILL twice each and one of the archive's processes once, and then counts the records. `hour` runs the same
processes and imitates an hour without a database: while the database is down, the stores take in an hour's records
within half a minute.
"""

import argparse
import asyncio
import contextlib
import json
import logging
import os
import platform
import signal
import subprocess
import sys
import tempfile
import time
from datetime import UTC, datetime
from pathlib import Path

from daemon.archive.address import parse_archive
from daemon.archive.parquet import write_days
from daemon.archive.writer import ArchiveWriter, SentPage
from daemon.base.records import NO_ESTIMATE, Decision, Irradiances, Mode, Target
from daemon.store.batches import decoded, encoded
from tests.support.archive import T0, Sender, archived_records, batch_of, event, origin, pose, pose_row, scan
from tests.support.broker import Broker
from tests.support.postgres import Postgres

# Of one tracker with its own cube: a scan each 5 s, a pose each 5 s at rest and each 0.5 s under way, a decision each
# 5 min by day; counted by `heliocube simulate --start 2022-10-14 --weather variable`.
ROWS_A_DAY = {"scans": 17_280, "poses": 21_285, "decisions": 128, "moves": 82, "modes": 3, "events": 2}
PLANTS = (10, 1_000, 100_000)
INSTALLATIONS = 1_000
DAY_S = 86_400
SCANS_AN_HOUR = 720


def machine():
    load = ", ".join(f"{value:.1f}" for value in os.getloadavg())
    return f"{os.cpu_count()} cores, {platform.machine()}, Python {platform.python_version()}, load {load}"


def scan_row(number, at_s):
    face = (812.25 + number % 7, "ok", at_s)
    return number, at_s, at_s, "cube", "f3a9c2d1", number, True, *face, *face, *face, *face, "2026-05-sirta"


def pages(round_number, runs):
    """One round: a page of each installation with 32 scans and 18 poses."""
    for place, run in enumerate(runs):
        first = round_number * 50
        start_s = T0 + round_number * 160.0 + place * 0.001
        rows = {
            "scans": [scan_row(first + n, start_s + 5.0 * n) for n in range(32)],
            "poses": [pose_row(first + 32 + n, start_s + 10.0 * n) for n in range(18)],
        }
        yield f"plant/t{place}", batch_of(run, rows)


def rate(rounds):
    server = Postgres(durable=True)
    try:
        writer = ArchiveWriter(parse_archive(server.url()))
        writer.prepare()
        runs = [origin(site="SIRTA", tracker=f"t{place}") for place in range(INSTALLATIONS)]
        own_s = time.process_time()
        rows, figures = 0, {"write": 0.0, "read": 0.0}
        for number in range(rounds):
            messages = [(name, encoded(batch)) for name, batch in pages(number, runs)]
            for first in range(0, len(messages), 200):
                began = time.perf_counter()
                part = [SentPage(name, decoded(payload)) for name, payload in messages[first : first + 200]]
                read = time.perf_counter()
                rows += writer.write(part).added
                figures["read"] += read - began
                figures["write"] += time.perf_counter() - read
        database_s = server_cpu_s(server)
        writer.close()
        seconds, own_s = sum(figures.values()), time.process_time() - own_s
        print(f"{machine()}; PostgreSQL with fsync on the same cores")
        print(
            f"{rows} rows in {seconds:.1f} s: {rows / seconds:.0f} rows/s; reading JSON {figures['read']:.1f} s of it;",
            f"CPU of this process {own_s:.1f} s: {rows / own_s:.0f} rows per CPU s;",
            f"of the database's own for it {database_s:.1f} s: {rows / database_s:.0f} rows per CPU s",
        )
        bytes_a_row = sizes(server)
        with tempfile.TemporaryDirectory() as folder:
            began = time.perf_counter()
            written = list(write_days(parse_archive(server.url()), Path(folder), datetime.now(UTC).date()))
            took = time.perf_counter() - began
            cold = {one.kind: one.path.stat().st_size / one.rows for one in written}
            print(f"Parquet: {sum(one.rows for one in written) / took:.0f} rows/s")
        for kind, size in bytes_a_row.items():
            print(f"{kind}: {size:.0f} B/row in PostgreSQL with its key, {cold.get(kind, 0):.1f} B/row in Parquet")
        plants(bytes_a_row, cold, rows / seconds)
    finally:
        server.close()


def server_cpu_s(server):
    """Return the CPU time of the database's processes, which serve this one writer only."""
    ticks = 0
    for path in Path("/proc").glob("[0-9]*/stat"):
        with contextlib.suppress(OSError):
            # All of the database's processes run in its data folder.
            if (path.parent / "cwd").readlink() == server.folder / "data":
                ticks += sum(map(int, path.read_text().rpartition(")")[2].split()[11:13]))
    return ticks / os.sysconf("SC_CLK_TCK")


def sizes(server):
    found = {}
    for kind in ("scans", "poses"):
        parts = f"SELECT inhrelid FROM pg_inherits WHERE inhparent = 'heliocube.{kind}'::regclass"
        size = server.sql(f"SELECT sum(pg_total_relation_size(inhrelid)) FROM ({parts}) AS parts")[0][0]
        found[kind] = float(size) / server.sql(f"SELECT count(*) FROM heliocube.{kind}")[0][0]
    return found


def plants(hot, cold, sustained):
    """Print what a day of plants would take, computed from the rows of one tracker."""
    print("computed, one cube and store for each tracker:")
    print("| trackers | rows/s | share of the measured rate | PostgreSQL GB/day | Parquet GB/day |")
    for count in PLANTS:
        a_second = count * sum(ROWS_A_DAY.values()) / DAY_S
        # The other records are as large as a pose, or rare.
        large = [
            count * sum(rows * size["scans" if kind == "scans" else "poses"] for kind, rows in ROWS_A_DAY.items()) / 1e9
            for size in (hot, cold)
        ]
        print(f"| {count:,} | {a_second:,.1f} | {a_second / sustained:.2%} | {large[0]:,.3f} | {large[1]:,.4f} |")


def decision(at_s):
    return Decision(
        time_utc_s=at_s,
        time_monotonic_s=at_s,
        mode=Mode.TRACKING,
        law="mu-prime",
        irradiances=Irradiances(100.0, 200.0, 300.0, 400.0, 1.0),
        direction_azimuth_deg=1.0,
        direction_elevation_deg=2.0,
        sun_azimuth_deg=3.0,
        sun_elevation_deg=4.0,
        target=Target(1.0, 2.0, "a target inside the limits"),
        moved=True,
        estimate=NO_ESTIMATE,
    )


def keep_one(sender, count, utc_s):
    """Keep a scan, a pose with every second scan, and the rarer records when due."""
    sender.keep(scan(count, session=sender.origin.id, utc_s=utc_s))
    if count % 2 == 0:
        sender.keep(pose(count, utc_s))
    if count % 12 == 0:
        sender.keep(event(count, "a minute is over"))
    if count % 60 == 0:
        sender.keep(decision(utc_s))


async def pace(sender, place, end_s):
    """Keep records at the pace of the scans; trackers start spread over one interval."""
    await asyncio.sleep(5.0 * (place % 50) / 50)
    count = 0
    while time.monotonic() < end_s:
        keep_one(sender, count, time.time())
        count += 1
        await asyncio.sleep(5.0)


class Plant:
    """A broker, a PostgreSQL, two archive processes, and stores with their feeds."""

    def __init__(self, trackers, folder):
        self.folder = folder
        self.server, self.broker = Postgres(durable=True), Broker(folder).start()
        config = f"[mqtt]\nport = {self.broker.port}\n[archive]\ndatabase = '{self.server.url()}'\n"
        (folder / "archive.toml").write_text(config)
        self.archives = []
        names = [f"t{n}" for n in range(trackers)]
        self.senders = [Sender(folder / name, self.broker.port, name, prefix="plant", every_s=10.0) for name in names]

    def start_archive(self):
        command = [sys.executable, "-m", "daemon.commands.main", "archive", "--config", self.folder / "archive.toml"]
        with (self.folder / "archive.log").open("a") as log:
            self.archives.append(subprocess.Popen(command, stdout=log, stderr=log))

    @contextlib.asynccontextmanager
    async def at_work(self):
        try:
            self.start_archive()
            self.start_archive()
            async with contextlib.AsyncExitStack() as stack:
                for sender in self.senders:
                    await stack.enter_async_context(sender.sending())
                yield
        finally:
            for process in self.archives:
                process.kill()
                process.wait()
            for sender in self.senders:
                sender.store.close()
            self.broker.close()
            self.server.close()

    async def catch_up(self):
        """Wait until the database has all; return how long it took [s]."""
        began = time.monotonic()
        while not all_there(self.server, self.senders) and time.monotonic() - began < 600:  # noqa: ASYNC110 - by looking
            await asyncio.sleep(2.0)
        return time.monotonic() - began


async def kill(trackers, minutes, folder):
    plant = Plant(trackers, folder)
    whole_s = minutes * 60.0
    end_s = time.monotonic() + whole_s
    down_s = min(20.0, whole_s / 15)
    async with plant.at_work():
        tasks = [asyncio.create_task(pace(sender, place, end_s)) for place, sender in enumerate(plant.senders)]
        for what in ("broker", "database", "archive", "broker", "database"):
            await asyncio.sleep(whole_s / 6 - down_s)
            print(f"{datetime.now(UTC):%H:%M:%S} kill -9 of the {what}, away for {down_s:.0f} s", flush=True)
            if what == "archive":
                plant.archives[0].send_signal(signal.SIGKILL)
                await asyncio.sleep(down_s)
                plant.start_archive()
            else:
                peer = plant.broker if what == "broker" else plant.server
                peer.kill()
                await asyncio.sleep(down_s)
                await asyncio.to_thread(peer.start)
        await asyncio.gather(*tasks)
        caught_up_s = await plant.catch_up()
        return report(plant.server, plant.senders, caught_up_s)


async def hour(trackers, folder):
    """Let the stores take in an hour of records while the database is away, in half a minute."""
    plant = Plant(trackers, folder)
    async with plant.at_work():
        for sender in plant.senders:
            sender.keep(event(0, "before"))
        await asyncio.sleep(10.0)
        await plant.catch_up()
        plant.server.kill()
        away_s, began = time.time(), time.monotonic()
        for count in range(SCANS_AN_HOUR):
            for sender in plant.senders:
                keep_one(sender, count, away_s + 5.0 * count)
            await asyncio.sleep(0.01)
        await asyncio.sleep(max(0.0, 30.0 - (time.monotonic() - began)))
        print(f"an hour of records in {time.monotonic() - began:.0f} s without a database", flush=True)
        await asyncio.to_thread(plant.server.start)
        caught_up_s = await plant.catch_up()
        return report(plant.server, plant.senders, caught_up_s)


def all_there(server, senders):
    wanted = sum(len(sender.rows()) for sender in senders)
    found = sum(server.sql(f"SELECT count(*) FROM heliocube.{kind}")[0][0] for kind in ROWS_A_DAY)
    return found >= wanted


def report(server, senders, caught_up_s):
    lost = twice = count = 0
    for sender in senders:
        wanted, found = sender.rows(), archived_records(server, server.url(), sender.installation)
        count += len(wanted)
        lost += len(wanted - set(found))
        twice += len(found) - len(set(found)) + len(set(found) - wanted)
    print(f"{machine()}")
    print(json.dumps({"records": count, "lost": lost, "twice": twice, "caught_up_s": round(caught_up_s, 1)}))
    return lost + twice


def main():
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument(
        "what",
        choices=("rate", "kill", "hour"),
        help="rate: rows a second; kill: records after kills; hour: an hour without a database",
    )
    parser.add_argument(
        "--trackers", type=int, default=50, help="how many trackers write, with kill and hour (default: %(default)s)"
    )
    parser.add_argument(
        "--minutes", type=float, default=10.0, help="how long they write, with kill (default: %(default)g)"
    )
    parser.add_argument("--rounds", type=int, default=20, help="how many times 50,000 rows are written")
    asked = parser.parse_args()
    if asked.what == "rate":
        rate(asked.rounds)
        return 0
    with tempfile.TemporaryDirectory(prefix="heliocube-archive-") as folder:
        logging.getLogger("heliocube").setLevel(logging.ERROR)
        work = (
            kill(asked.trackers, asked.minutes, Path(folder))
            if asked.what == "kill"
            else hour(asked.trackers, Path(folder))
        )
        return 1 if asyncio.run(work) else 0


if __name__ == "__main__":
    sys.exit(main())
