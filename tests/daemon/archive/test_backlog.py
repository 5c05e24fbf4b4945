"""What the archive's process holds in memory when everybody sends at once, as after an hour without it."""

import asyncio
import sys
from pathlib import Path

import pytest

from daemon.store.batches import encoded
from tests.daemon.archive.test_ingest import running
from tests.support.archive import batch_of, origin, pose_row
from tests.support.mqtt import needs_mosquitto, observer, until

pytestmark = [needs_mosquitto, pytest.mark.skipif(sys.platform != "linux", reason="its memory is read in /proc")]
_SENDERS = 40


def most_mb(pid):
    """Return the most memory that a process has had [MB]."""
    lines = Path(f"/proc/{pid}/status").read_text().splitlines()
    return next(int(line.split()[1]) for line in lines if line.startswith("VmHWM")) / 1024


def test_pages_of_forty_senders_at_once_cost_the_archive_less_than_50_mb_of_memory(
    postgres, database, broker, start_archive
):
    """Read, they are four times as large: a thousand of them would take more memory than the unit allows."""

    async def scenario():
        archive = start_archive(broker.port)
        async with observer(broker.port) as lab:
            page = encoded(batch_of(origin(), {"poses": [pose_row(0)]}))
            while not lab.messages_on("lab/first/records/kept"):
                await lab.publish("lab/first/records", page)
                await asyncio.sleep(1.0)
            before_mb = most_mb(archive.pid)
            page = encoded(batch_of(origin(), {"poses": [pose_row(number) for number in range(5000)]}))
            async with asyncio.TaskGroup() as group:
                for sender in range(_SENDERS):
                    group.create_task(lab.publish(f"lab/{sender}/records", page))
            for sender in range(_SENDERS):
                await until(lambda sender=sender: lab.messages_on(f"lab/{sender}/records/kept"), "a page that is kept")
            assert postgres.sql("SELECT count(*) FROM heliocube.poses", database.rpartition("/")[2])[0][0] > 190_000
            assert most_mb(archive.pid) - before_mb < 50

    running(scenario)
