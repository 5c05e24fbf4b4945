"""The port of a positioner, on a simulated unit: how it is opened and held, and what counts as a lost link."""

import asyncio
import contextlib
import fcntl
import os
import socket
import struct
import subprocess
import sys
import termios
import threading
import time

import pytest

from drivers.errors import ConnectError, LinkLostError
from drivers.positioners.pozsol.link import SerialLine, open_port
from drivers.positioners.pozsol.positioner import PozsolPositioner
from drivers.positioners.pozsol.wire import Field
from sim_drivers.bench.positioner_host import BANNER
from tests.drivers.positioners.pozsol.test_positioner_protocol import A, B, it_is, positioner_on, until
from tests.firmware.live import move


async def _lost(positioner, why):
    try:
        await positioner.read_telemetry()
    except LinkLostError as error:
        return why in str(error)
    return False


def test_opening_a_missing_held_or_non_serial_port_is_refused_in_one_sentence(positioner_host, tmp_path):
    async def scene():
        with pytest.raises(ConnectError, match=r"there is no .*nowhere"):
            await positioner_on(tmp_path / "nowhere").open()
        (tmp_path / "file").write_text("")
        with pytest.raises(ConnectError, match="is not a serial port"):
            await positioner_on(tmp_path / "file").open()
        async with positioner_host() as host:
            here, there = socket.socketpair()
            code = f"""
import serial, sys, os
port = serial.Serial({str(host.port.link)!r}, exclusive=True)
os.write({there.fileno()}, b"held")
sys.stdin.read()
"""
            holder = await asyncio.to_thread(
                subprocess.Popen, [sys.executable, "-c", code], stdin=subprocess.PIPE, pass_fds=[there.fileno()]
            )
            try:
                await asyncio.to_thread(here.recv, 4)
                with pytest.raises(ConnectError, match=rf"held by another program \(python.*, process {holder.pid}\)"):
                    await positioner_on(host.port.link).open()
            finally:
                holder.communicate()
                here.close()
                there.close()

    asyncio.run(scene())


def test_the_terminal_mode_of_a_port_held_by_another_program_is_left_alone(positioner_host):
    async def scene():
        async with positioner_host() as host:
            holder = os.open(host.port.link, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
            try:
                fcntl.flock(holder, fcntl.LOCK_EX)
                before = termios.tcgetattr(holder)
                with pytest.raises(ConnectError, match="held by another program"):
                    await positioner_on(host.port.link).open()
                assert termios.tcgetattr(holder) == before
            finally:
                os.close(holder)

    asyncio.run(scene())


@pytest.mark.parametrize(("dtr", "rts"), [(True, True), (False, True), (True, False), (False, False)])
def test_the_modem_lines_are_set_as_configured_when_the_port_is_opened(positioner_host, monkeypatch, dtr, rts):
    """A pseudo-terminal has no modem lines, so a stand-in gives the operating system's answer."""
    lines, system = {termios.TIOCM_DTR: True, termios.TIOCM_RTS: True}, fcntl.ioctl

    def ioctl(descriptor, request, argument=0, *rest):
        if request in (termios.TIOCMBIS, termios.TIOCMBIC):
            lines[struct.unpack("I", argument)[0]] = request == termios.TIOCMBIS
            return argument
        if request == termios.TIOCMGET:
            return struct.pack("I", 0)
        return system(descriptor, request, argument, *rest)

    async def scene():
        async with positioner_host() as host:
            monkeypatch.setattr(fcntl, "ioctl", ioctl)
            port = open_port(str(host.port.link), dtr=dtr, rts=rts)
            assert port.has_modem_lines()
            assert lines == {termios.TIOCM_DTR: dtr, termios.TIOCM_RTS: rts}
            port.close()
            assert not port.has_modem_lines()

    asyncio.run(scene())


def test_a_port_without_modem_lines_is_used_and_reported_to_have_none(positioner_host):
    async def scene():
        async with positioner_host() as host:
            line = SerialLine(lambda: open_port(str(host.port.link), dtr=False, rts=False), time.monotonic)
            positioner = PozsolPositioner(line, time.monotonic, A, B)
            assert (await positioner.open()).board == "36A1"
            assert positioner.has_modem_lines() is False
            await positioner.close()

    asyncio.run(scene())


def test_a_port_left_with_echo_sends_the_telemetry_back_to_the_unit(positioner_host):
    async def scene():
        async with positioner_host() as host:
            victim = os.open(host.port.link, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
            try:
                await until(lambda: it_is(host.received[Field.BOARD] + host.received[Field.A_ANGLE] > 0))
            finally:
                os.close(victim)

    asyncio.run(scene())


def test_the_driver_opens_the_port_without_echo_and_reports_an_echo_that_is_switched_on(positioner_host):
    async def scene():
        async with positioner_host() as host:
            positioner = positioner_on(host.port.link)
            await positioner.open()
            await positioner.move_to(5.0, 80.0)
            received = set(host.received)
            port = positioner._line._reader.port._port.fileno()
            mode = termios.tcgetattr(port)
            mode[3] |= termios.ECHO
            termios.tcsetattr(port, termios.TCSANOW, mode)
            await until(lambda: _lost(positioner, "echo"))
            await positioner.close()
            assert received == {Field.ACTION, Field.A_DESTINATION, Field.B_DESTINATION}

    asyncio.run(scene())


def test_a_board_that_restarts_when_its_port_is_opened_is_waited_for_and_shows_its_reset_mark(positioner_host):
    async def scene():
        async with positioner_host() as host:
            host.boots_at_open_s = 3.0
            with pytest.raises(ConnectError, match="no telemetry"):
                await positioner_on(host.port.link, stale_s=2.0).open()
            positioner = positioner_on(host.port.link, boot_s=4.0, banner=BANNER.decode().strip())
            assert (await positioner.open()).board == "36A1"
            assert (await positioner.read_telemetry()).was_reset
            await positioner.clear_faults()
            assert not (await positioner.read_telemetry()).was_reset
            await move(positioner, 5.0, 80.0)
            await positioner.close()

    asyncio.run(scene())


def test_a_banner_during_operation_counts_as_a_restart_that_loses_link_and_reference(positioner_host):
    async def scene():
        async with positioner_host() as host:
            positioner = positioner_on(host.port.link, banner=BANNER.decode().strip())
            await positioner.open()
            await positioner.move_to(5.0, 80.0)
            # Only the banner: the reset mark of the status comes up to three seconds later, or never.
            host.port.send(BANNER)
            await until(lambda: _lost(positioner, "has restarted: it prints its banner"))
            await positioner.stop()
            await positioner.open()
            assert (await positioner.read_telemetry()).reference_doubt == "the positioner has restarted"
            await positioner.clear_faults()
            assert not (await positioner.read_telemetry()).reference_doubt
            await positioner.close()

    asyncio.run(scene())


def test_a_pulled_cable_is_a_lost_link_and_the_same_port_name_works_after_replugging(positioner_host):
    async def scene():
        async with positioner_host() as host:
            positioner = positioner_on(host.port.link)
            await positioner.open()
            host.port.unplug()
            await until(lambda: _lost(positioner, "has it been unplugged"))
            with pytest.raises(LinkLostError):
                await positioner.stop()
            await positioner.close()
            host.port.plug()
            await positioner.open()
            await positioner.read_telemetry()
            await positioner.close()

    asyncio.run(scene())


def test_silence_is_a_lost_link(positioner_host):
    async def scene():
        async with positioner_host() as host:
            positioner = positioner_on(host.port.link, stale_s=0.4)
            await positioner.open()
            host.freeze()
            await until(lambda: _lost(positioner, "has been silent for"))
            await positioner.close()
            host.thaw()

    asyncio.run(scene())


def test_garbled_and_lost_screens_neither_lose_the_link_nor_the_reference(positioner_host):
    async def scene():
        async with positioner_host() as host:
            positioner = positioner_on(host.port.link)
            await positioner.open()
            for _ in range(10):
                host.corrupt_next(5)
                host.drop_next(3)
                await asyncio.sleep(0.2)
                seen = await positioner.read_telemetry()
                assert (seen.a_deg, seen.b_deg, seen.was_reset) == (0.0, 90.0, False)
            await positioner.close()

    asyncio.run(scene())


def test_a_unit_that_takes_no_data_any_more_is_a_lost_link_within_the_deadline(positioner_host):
    async def scene():
        async with positioner_host() as host:
            positioner = positioner_on(host.port.link, stale_s=60.0)
            await positioner.open()
            host.freeze()
            filler = os.open(host.port.link, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
            try:
                # The kernel frees some room by itself a few times before the port is truly full.
                for _ in range(20):
                    for size in (4096, 1):
                        with contextlib.suppress(BlockingIOError):
                            while True:
                                os.write(filler, b"x" * size)
                    await asyncio.sleep(0.02)
                async with asyncio.timeout(10.0):
                    with pytest.raises(LinkLostError, match="takes no data"):
                        await positioner.stop()
                    with pytest.raises(LinkLostError, match="takes no data"):
                        await positioner.move_to(1.0, 80.0)
            finally:
                os.close(filler)
                await positioner.close()

    asyncio.run(scene())


def test_the_port_is_closed_again_when_no_reader_thread_can_be_started():
    class Opened:
        closed = False

        def close(self):
            self.closed = True

    port = Opened()

    def connect():
        # The thread that opens runs already; for the one that reads, no machine has room for such a stack.
        threading.stack_size(1 << 40)
        return port

    try:
        with pytest.raises(ConnectError, match="no room for a thread"):
            asyncio.run(SerialLine(connect, time.monotonic).open())
    finally:
        threading.stack_size(0)
    assert port.closed
