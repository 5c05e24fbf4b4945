"""What a service says while no archive takes its records, in virtual time."""

import asyncio

from daemon.base.clock import LoopClock
from daemon.base.timeloop import VirtualTimeLoop
from tests.support.archive import T0, Sender, pose


def test_an_hour_without_an_archive_is_an_alarm_and_the_records_wait_where_they_are(tmp_path, free_udp_port):
    async def scenario():
        clock = LoopClock(asyncio.get_running_loop().time, T0)
        # Nothing listens there.
        sender = Sender(tmp_path, free_udp_port, clock=clock)
        sender.keep(*(pose(n) for n in range(3)))
        sender.store.close()
        async with sender.sending():
            await asyncio.sleep(3500.0)
            assert sender.alarms == {}
            await asyncio.sleep(300.0)
            waits = "they wait in the store, which keeps 400 days"
            text = f"no archive has confirmed records of lab/roof/records for 1 h: {waits}"
            assert sender.alarms == {"archive-behind": text}
        assert len(sender.rows()) == 3

    with asyncio.Runner(loop_factory=VirtualTimeLoop) as runner:
        runner.run(scenario())
