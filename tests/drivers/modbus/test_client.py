"""One question at a time on a line, and what a device's answer means."""

import asyncio

import pytest

from daemon.base.timeloop import VirtualTimeLoop
from drivers.errors import RefusedError, UnavailableError
from drivers.modbus.client import ModbusBus
from drivers.modbus.pdu import read_registers, write_register


class Path:
    """A way to devices that all give the same answer after a tenth of a second."""

    def __init__(self, reply):
        self.reply = bytes.fromhex(reply)
        self.asked_s = []

    async def exchange(self, _request, _within_s):
        self.asked_s.append(asyncio.get_running_loop().time())
        await asyncio.sleep(0.1)
        return self.reply


def ask(path, *requests, gap_s=0.0, writes=False):
    async def all_of_them():
        bus = ModbusBus(path, "cube", gap_s, asyncio.get_running_loop().time, writes=writes)
        return await asyncio.gather(*(bus.ask(request, 1.0) for request in requests))

    with asyncio.Runner(loop_factory=VirtualTimeLoop) as runner:
        return runner.run(all_of_them())


READ = read_registers(7, 3, 0, 1)


@pytest.mark.parametrize(
    ("reply", "error", "words"),
    [
        ("83 02", RefusedError, "address 7 has no such register"),
        ("83 04", RefusedError, "address 7 "),
        # A device that has no time now.
        ("83 05", UnavailableError, "address 7 needs longer"),
        ("83 06", UnavailableError, "address 7 is busy"),
        # A gateway without a way to the device, and one whose device keeps silent.
        ("83 0A", UnavailableError, "address 7 "),
        ("83 0B", UnavailableError, "address 7 "),
    ],
)
def test_exceptions_of_busy_or_unreachable_devices_mean_unreached_and_others_mean_refused(reply, error, words):
    with pytest.raises(error, match=words):
        ask(Path(reply), READ)


def test_a_question_waits_for_the_reply_to_the_one_before_and_the_pause_after_it():
    path = Path("03 02 00 07")
    assert ask(path, READ, READ, READ, gap_s=0.05) == [path.reply] * 3
    assert [then - path.asked_s[0] for then in path.asked_s] == pytest.approx([0.0, 0.15, 0.3])


def test_a_read_only_line_refuses_to_write():
    path = Path("06 00 01 00 02")
    with pytest.raises(ValueError, match="function 6 writes"):
        ask(path, write_register(7, 1, 2))
    assert path.asked_s == []
    assert ask(path, write_register(7, 1, 2), writes=True) == [path.reply]
