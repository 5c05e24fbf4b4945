"""A key is replaced while cube and tracker run: by the documented steps no scan is lost, and the old key ends."""

import asyncio
import base64
import logging
from dataclasses import asdict

import pytest

from daemon.base.clock import LoopClock
from daemon.base.timeloop import VirtualTimeLoop
from daemon.bridge.key_file import READ_EVERY_S, KeyFileWatch
from daemon.bridge.receiver import BridgeReceiver
from daemon.bridge.sender import BridgeSender, pack
from daemon.bridge.signing import load_keys
from daemon.config.links import BridgeSettings
from tests.daemon.bridge.desk import SETTINGS, UTC_S, scan

OLD, NEW, STRANGE = (bytes(range(start, start + 32)) for start in (1, 50, 90))


def write(path, *keys):
    path.write_bytes(b"".join(base64.urlsafe_b64encode(key).rstrip(b"=") + b"\n" for key in keys))
    path.chmod(0o600)


class Sides:
    """A cube and a tracker with a key file each; the cube sends every 5 s of virtual time."""

    def __init__(self, folder):
        self.cube_file, self.tracker_file = folder / "cube.key", folder / "tracker.key"
        write(self.cube_file, OLD)
        write(self.tracker_file, OLD)
        self.scans, self.sent = [], 0

    async def open(self):
        self.clock = LoopClock(asyncio.get_running_loop().time, UTC_S)
        self.receiver = BridgeReceiver(SETTINGS, OLD, self.clock, self.scans.append)
        await self.receiver.open()
        self.sender = BridgeSender(BridgeSettings(send_to=(self.receiver.address,)), OLD, self.clock)
        await self.sender.open()
        watches = (
            KeyFileWatch(self.cube_file, load_keys(self.cube_file), lambda keys: self.sender.take_key(keys[0]), 1.0),
            KeyFileWatch(self.tracker_file, load_keys(self.tracker_file), self.receiver.take_keys, 1.0),
        )
        self.tasks = [asyncio.create_task(watch.run()) for watch in watches]

    async def close(self):
        for task in self.tasks:
            task.cancel()
        await asyncio.gather(*self.tasks, return_exceptions=True)
        await self.sender.close()
        await self.receiver.close()

    async def send(self, count=4):
        for _ in range(count):
            now_s = self.clock.monotonic()
            self.sender.send(scan(self.sent, time_s=self.clock.utc() - UTC_S, time_monotonic_s=70.0 + now_s))
            self.sent += 1
            await asyncio.sleep(READ_EVERY_S)

    def counts(self):
        return {name: n for name, n in asdict(self.receiver.statistics).items() if isinstance(n, int) and n}


def run(scenario, folder):
    async def main():
        sides = Sides(folder)
        await sides.open()
        try:
            await scenario(sides)
        finally:
            await sides.close()

    with asyncio.Runner(loop_factory=VirtualTimeLoop) as runner:
        runner.run(main())


def test_changing_the_key_by_the_documented_steps_loses_no_scan_and_ends_the_old_key(tmp_path):
    async def scenario(sides):
        await sides.send()
        write(sides.tracker_file, OLD, NEW)
        await sides.send()
        write(sides.cube_file, NEW)
        await sides.send()
        write(sides.tracker_file, NEW)
        await sides.send()
        assert sides.counts() == {"accepted": sides.sent} == {"accepted": 16}
        sides.receiver.datagram_received(pack(scan(sides.sent), OLD), ("127.0.0.1", 1))
        sides.receiver.datagram_received(pack(scan(sides.sent), STRANGE), ("127.0.0.1", 1))
        assert sides.counts() == {"accepted": 16, "forged": 2}

    run(scenario, tmp_path)


def test_while_two_keys_are_in_force_both_are_accepted_and_a_third_is_not(tmp_path):
    async def scenario(sides):
        write(sides.tracker_file, NEW, OLD)
        await sides.send()
        assert sides.counts() == {"accepted": 4}
        sides.receiver.datagram_received(pack(scan(sides.sent, time_s=20.0), STRANGE), ("127.0.0.1", 1))
        assert sides.counts() == {"accepted": 4, "forged": 1}
        sides.receiver.datagram_received(pack(scan(sides.sent, time_s=20.0), NEW), ("127.0.0.1", 1))
        assert sides.counts() == {"accepted": 5, "forged": 1}

    run(scenario, tmp_path)


@pytest.mark.parametrize("speed", [1.0, 10.0])
def test_new_keys_of_a_changed_key_file_are_taken_once_and_logged(tmp_path, caplog, speed):
    async def scenario():
        taken = []
        file = tmp_path / "bridge.key"
        write(file, OLD)
        watch = asyncio.create_task(KeyFileWatch(file, load_keys(file), taken.append, speed).run())
        await asyncio.sleep(3.5 * speed * 5.0)
        assert taken == []
        write(file, NEW, OLD)
        await asyncio.sleep(0.4 * speed * 5.0)
        assert taken == []
        await asyncio.sleep(2.6 * speed * 5.0)
        assert taken == [(NEW, OLD)]
        write(file, NEW)
        await asyncio.sleep(2 * speed * 5.0)
        watch.cancel()
        assert taken == [(NEW, OLD), (NEW,)]
        told = f"the bridge's key file {file} has changed: its first key signs scans"
        assert caplog.messages == [f"{told}, and a second one is accepted", told]

    with asyncio.Runner(loop_factory=VirtualTimeLoop) as runner:
        runner.run(scenario())


def test_an_unusable_key_file_is_logged_once_and_the_keys_in_force_stay(tmp_path, caplog):
    async def scenario(sides):
        with caplog.at_level(logging.WARNING, "heliocube.bridge"):
            sides.tracker_file.write_text("half a ke")
            await sides.send()
            sides.tracker_file.unlink()
            await sides.send()
            write(sides.tracker_file, OLD)
            await sides.send()
            sides.tracker_file.unlink()
            await sides.send()
        assert sides.counts() == {"accepted": 16}
        told = [line.getMessage() for line in caplog.records]
        assert len(told) == 3
        assert told[1] == told[2]
        assert all(line.endswith("the keys that were read before stay in force") for line in told)

    run(scenario, tmp_path)
