"""What the tracker does while its records cannot be written: the same as ever."""

import asyncio
import queue
import subprocess

from daemon.base.clock import SystemClock
from daemon.base.records import Decision, Mode, Scan
from daemon.store.store import Store
from tests.daemon.store.test_store import ORIGIN, count, fill, small_disk
from tests.support.phases import tracking

__all__ = ["small_disk"]


def test_a_full_disk_does_not_stop_control_and_no_record_is_lost(run_rig, small_disk):
    told = queue.Queue()
    store = Store(small_disk, 0.1, 400, ORIGIN, SystemClock(), told.put)
    fill(small_disk / "filler")

    async def scenario(rig):
        rig.bus.subscribe(store.keep)
        await tracking(rig)
        await asyncio.sleep(3600)
        assert rig.mode is Mode.TRACKING

    rig = run_rig(scenario)
    assert len(rig.of(Decision)) >= 12
    assert told.get(timeout=20).text == f"cannot write: the disk of {small_disk} is full; records wait in memory"
    (small_disk / "filler").unlink()
    subprocess.run(["mount", "-o", "remount,size=8m", small_disk], check=True)
    store.close()
    assert told.get(timeout=20).text == "writes again; nothing was lost"
    assert told.empty()
    assert count(small_disk, "scans") == len(rig.of(Scan))
