import asyncio
import os
import termios
import tty

import pytest

from sim_drivers.bench.pty_port import LOOK_EVERY_S, PtyPort
from tests.support import PATIENCE_S


class Rig:
    """A port and what has come in through it."""

    def __init__(self, folder):
        self.received = b""
        self.port = PtyPort(folder / "device", self._take)

    def _take(self, data):
        self.received += data

    def open(self):
        user = os.open(self.port.link, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
        tty.setraw(user)
        return user

    async def until(self, condition):
        async with asyncio.timeout(PATIENCE_S):
            while not condition():  # noqa: ASYNC110 - what is waited for is the kernel's
                await asyncio.sleep(LOOK_EVERY_S)


@pytest.fixture
def on_port(tmp_path):
    """Run a coroutine function with a plugged port."""

    def run(scene):
        async def whole():
            rig = Rig(tmp_path)
            rig.port.plug()
            try:
                await scene(rig)
            finally:
                rig.port.unplug()

        asyncio.run(whole())

    return run


def test_the_port_knows_whether_somebody_has_it_open(on_port):
    async def scene(rig):
        assert rig.port.plugged
        assert not rig.port.in_use
        user = rig.open()
        assert rig.port.in_use
        os.close(user)
        assert not rig.port.in_use

    on_port(scene)


def test_bytes_go_both_ways_and_again_for_the_next_user(on_port):
    async def scene(rig):
        for turn in (b"one", b"two"):
            await talk(rig, turn)

    async def talk(rig, turn):
        user = rig.open()
        assert rig.port.send(b"hello")
        await rig.until(lambda: _read(user) == b"hello")
        os.write(user, turn)
        await rig.until(lambda: rig.received.endswith(turn))
        os.close(user)

    on_port(scene)


def test_bytes_that_a_user_writes_just_before_closing_the_port_arrive(on_port):
    async def scene(rig):
        user = rig.open()
        os.write(user, b"stop")
        os.close(user)
        await rig.until(lambda: rig.received == b"stop")

    on_port(scene)


def test_bytes_sent_while_nobody_has_the_port_open_are_dropped(on_port):
    async def scene(rig):
        assert not rig.port.send(b"stale")
        user = rig.open()
        await rig.until(lambda: rig.port.send(b"fresh"))
        await rig.until(lambda: _read(user) == b"fresh")
        os.close(user)

    on_port(scene)


def test_bytes_that_one_user_left_unread_do_not_reach_the_next_user(on_port):
    async def scene(rig):
        first = rig.open()
        os.write(first, b"here")
        await rig.until(lambda: rig.received == b"here")
        assert rig.port.send(b"unread")
        os.close(first)
        await asyncio.sleep(5 * LOOK_EVERY_S)
        second = rig.open()
        assert rig.port.send(b"fresh")
        await rig.until(lambda: _read(second) == b"fresh")
        os.close(second)

    on_port(scene)


def test_bytes_that_find_no_room_because_the_user_does_not_read_are_lost(on_port):
    async def scene(rig):
        user = rig.open()
        while rig.port.send(b"x" * 64):
            pass
        while _read(user):
            pass
        await rig.until(lambda: rig.port.send(b"y"))
        os.close(user)

    on_port(scene)


def test_a_paused_port_takes_in_nothing_until_it_is_resumed(on_port):
    async def scene(rig):
        user = rig.open()
        rig.port.pause()
        os.write(user, b"wait")
        await asyncio.sleep(5 * LOOK_EVERY_S)
        assert rig.received == b""
        rig.port.resume()
        await rig.until(lambda: rig.received == b"wait")
        os.close(user)

    on_port(scene)


def test_a_replugged_port_echoes_again_and_forgets_the_mode_of_its_former_user(on_port):
    async def scene(rig):
        user = rig.open()
        assert not termios.tcgetattr(user)[3] & termios.ECHO
        os.close(user)
        rig.port.unplug()
        assert not rig.port.link.is_symlink()
        assert not rig.port.plugged
        rig.port.plug()
        user = os.open(rig.port.link, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
        assert rig.port.send(b"$45.6")
        await rig.until(lambda: rig.received == b"$45.6")
        os.close(user)

    on_port(scene)


def _read(descriptor):
    try:
        return os.read(descriptor, 65536)
    except BlockingIOError:
        return b""
