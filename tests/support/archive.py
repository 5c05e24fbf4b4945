"""A database for archives, and a service's side of one: a store, a link to the broker, and the feed between them."""

import asyncio
import contextlib
import sqlite3
from contextlib import closing
from random import Random

import pytest

from daemon.base.clock import SystemClock
from daemon.base.records import Event, FaceReading, Pose, Quality, Scan
from daemon.config.links import MqttSettings
from daemon.mqtt.archive_feed import ArchiveFeed
from daemon.mqtt.link import Link
from daemon.mqtt.topics import Topics
from daemon.service.rig import Role
from daemon.store.batches import Batch
from daemon.store.schema import FILE_NAME
from daemon.store.store import Origin, Store, new_run_id
from daemon.store.tables import COLUMNS
from tests.support import forks
from tests.support.postgres import BINARIES, WITHOUT_POSTGRES, Postgres

KINDS = [name for name, _ in COLUMNS.values()]
T0 = 1665705600.0


@pytest.fixture(scope="session")
def postgres():
    """A server for all tests of a process."""
    if BINARIES is None:
        pytest.skip(WITHOUT_POSTGRES)
    server = Postgres()
    yield server
    server.close()


@pytest.fixture
def database(postgres, request):
    """The URL of an empty database of the test's own."""
    name = f"t{abs(hash(request.node.nodeid))}"
    postgres.sql(f"CREATE DATABASE {name}")
    yield postgres.url(name)
    postgres.sql(f"DROP DATABASE IF EXISTS {name} WITH (FORCE)")


@pytest.fixture
def start_archive(tmp_path, database):
    """Start `heliocube archive` as a process, with its log in the folder; returns the process."""
    started = []

    def start(port, *arguments):
        path = tmp_path / "archive.toml"
        path.write_text(f"[mqtt]\nport = {port}\nkeepalive_s = 2\n[archive]\ndatabase = '{database}'\n")
        with (tmp_path / "archive.log").open("a") as log:
            started.append(forks.start(["archive", "--config", path, *arguments], log, log))
        return started[-1]

    yield start
    for process in started:
        process.kill()
        process.wait()


def origin(**changes):
    known = {
        "started_utc_s": T0,
        "role": "both",
        "version": "0.1.0",
        "simulated": True,
        "site": "SIRTA",
        "latitude_deg": 48.7,
        "longitude_deg": 2.2,
        "altitude_m": 156.0,
        "tracker": "roof",
        "id": new_run_id(),
    }
    return Origin(**known | changes)


def pose(number, utc_s=None):
    at_s = T0 + number if utc_s is None else utc_s
    return Pose(at_s, float(number), number % 90 - 45.0, number % 70, moving=False, wind_m_s=float("nan"))


def scan(number, session="s", utc_s=None):
    at_s = T0 + number if utc_s is None else utc_s
    faces = {name: FaceReading(100.0 + number, Quality.OK, at_s, at_s) for name in ("east", "south", "west", "zenith")}
    return Scan(
        source="cube", session=session, sequence=number, time_utc_s=at_s, time_monotonic_s=at_s, simulated=True, **faces
    )


class Sender:
    """One service, as the broker and the archive see it.

    Its loop and the waits of its feed run `speed` times as fast as the clock of the machine; the broker does not.
    """

    def __init__(self, folder, port, name="roof", prefix="lab", run=None, speed=1.0, every_s=0.1, clock=None):
        self.folder = folder
        clock = clock or SystemClock()
        self.installation = f"{prefix}/{name}"
        self.origin = run or origin()
        self.store = Store(folder, 0.05, 400, self.origin, clock, lambda _: None)
        topics = Topics(prefix, name)
        mqtt = MqttSettings(enabled=True, port=port, keepalive_s=2, client_id=f"{name}-{new_run_id()[:6]}")
        self.link = Link(mqtt, topics, clock, Random(1), lambda _: None, speed)
        self.alarms = {}
        self.feed = ArchiveFeed(self.link, topics, folder, Role.BOTH, every_s, 400, clock, Random(2), 1.0)
        self.feed.set_alarm_callback(self.alarms.__setitem__)

    def keep(self, *records):
        for record in records:
            self.store.keep(record)

    def rows(self):
        """All records of the store, as a set of the run's identifier, kind and number."""
        found = set()
        with closing(sqlite3.connect(self.folder / FILE_NAME)) as store:
            for kind in KINDS:
                found |= set(store.execute(f"SELECT id, '{kind}', number FROM {kind} JOIN runs USING (run)"))
        return found

    @contextlib.asynccontextmanager
    async def sending(self):
        """Run link and feed."""
        tasks = [asyncio.create_task(self.link.run()), asyncio.create_task(self.feed.run())]
        try:
            yield self
        finally:
            for task in tasks:
                task.cancel()
            await asyncio.gather(*tasks, return_exceptions=True)


def archived_records(postgres, url, installation):
    """All records of an installation in an archive, as `Sender.rows` has them, but a list: it shows duplicates."""
    of_kind = (
        f"SELECT id, '{kind}', number FROM heliocube.{kind} JOIN heliocube.runs USING (run)"
        f" WHERE installation = '{installation}'"
        for kind in KINDS
    )
    return postgres.sql(" UNION ALL ".join(of_kind), url.rpartition("/")[2])


def event(number, text="a line"):
    return Event(T0 + number, float(number), "test", text)


def pose_row(number, utc_s=None):
    """A pose as a row of a page: its number, and the columns of its table."""
    at_s = T0 + number if utc_s is None else utc_s
    return number, at_s, float(number), 1.5, 60.0, False, "roof", None


def batch_of(run, rows):
    return Batch(run, max(row[0] for table in rows.values() for row in table), rows)
