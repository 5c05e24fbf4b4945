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
import tty
from itertools import pairwise

import pytest

from drivers.errors import ConnectError, IdentityError, LinkLostError, RefusedError
from drivers.positioners.pozsol import wire
from drivers.positioners.pozsol.geometry import AxisSetup, Proportional, Triangle
from drivers.positioners.pozsol.link import SerialLine, open_port
from drivers.positioners.pozsol.positioner import PozsolPositioner
from drivers.positioners.pozsol.wire import Field, TokenStream
from drivers.transcript import no_tap
from sim_drivers.bench.positioner_host import BANNER
from sim_drivers.pozsol.core import PositionerCore
from sim_drivers.pozsol.setup import AxisDrive, Setup
from solar.frames import Angles

# Four times as fast as the ports' other units: a reference run is through all of its travel.
HURRIED = Setup(drive=AxisDrive(speed_mm_s=160.0, acceleration_mm_s2=1600.0, run_out_s=0.002))
A = AxisSetup(Triangle(300.0, 300.0, 90.0, -52.0), -50.0, 50.0)
B = AxisSetup(Triangle(300.0, 300.0, 37.5, 13.0), 15.0, 90.0)


def positioner_on(link, a=A, b=B, **options):
    tap = options.pop("tap", no_tap)
    line = SerialLine(
        lambda: open_port(str(link), tap),
        time.monotonic,
        boot_s=options.pop("boot_s", 0.0),
        banner=options.pop("banner", None),
        write_s=10.0,
    )
    # What a busy machine holds up for seconds is no lost link.
    return PozsolPositioner(line, time.monotonic, a, b, **{"stale_s": 10.0} | options)


async def until(condition, within_s=60.0):
    """Wait for what must come; the limit is for a broken program."""
    async with asyncio.timeout(within_s):
        done = await condition()
        while not done:
            await asyncio.sleep(0.05)
            done = await condition()


class Player(threading.Thread):
    """Streams the telemetry of a transcript until each command comes, and notes what it was sent."""

    def __init__(self, pieces, link):
        super().__init__(daemon=True)
        self._master, self._slave = os.openpty()
        tty.setraw(self._slave)
        os.set_blocking(self._master, False)
        link.symlink_to(os.ttyname(self._slave))
        self._pieces = pieces
        self.received = []
        self.start()

    def run(self):
        stream, over = [], threading.Event()
        for piece in [*self._pieces, None]:
            if piece is not None and piece.direction == "<":
                stream = [*stream, piece.data] if stream and stream[-1] != "sent" else [piece.data]
                continue
            screens = [data for data in stream if data != "sent"]
            data = b""
            for _ in range(1500 if piece is not None else 5):
                for screen in screens:
                    os.write(self._master, screen)
                over.wait(0.02)
                try:
                    data += os.read(self._master, 64)
                except BlockingIOError:
                    continue
                if piece is not None and len(data) >= len(piece.data):
                    break
            if data:
                self.received.append(data)
            stream = [*screens, "sent"]

    def end(self):
        self.join(60.0)
        os.close(self._slave)
        os.close(self._master)


def test_the_driver_sends_these_bytes_and_believes_this_telemetry(transcript, tmp_path):
    pieces = transcript("positioner")
    player = Player(pieces, tmp_path / "positioner")

    async def scene():
        positioner = positioner_on(tmp_path / "positioner")
        identity = await positioner.open()
        await positioner.stop()
        await positioner.move_to(10.0, 70.0)
        telemetry = await positioner.read_telemetry()
        await positioner.stop()
        await asyncio.to_thread(player.end)
        await positioner.close()
        return identity, telemetry

    identity, telemetry = asyncio.run(scene())
    assert player.received == [piece.data for piece in pieces if piece.direction == ">"]
    assert (identity.board, identity.firmware, identity.simulated) == ("36A1", "1.402 (B1.100)", False)
    assert (telemetry.destination_a, telemetry.destination_b) == (264.0, 228.0)
    assert (telemetry.a_deg, telemetry.position_a, telemetry.supply_v) == (0.1, 229.1333, 24.0)


def test_the_simulated_unit_shows_the_same_telemetry_after_the_same_bytes(transcript):
    core, shown = PositionerCore(0.0, Setup()), {}
    for piece in transcript("positioner"):
        if piece.direction == ">":
            core.feed(piece.data, piece.time_s)
            continue
        shown.update(TokenStream().feed(piece.data + b"$"))
        simulated = dict(TokenStream().feed(core.screens(piece.time_s) + b"$"))
        for field in (Field.BOARD, Field.VERSION, Field.SERIAL, Field.A_DESTINATION, Field.B_DESTINATION, Field.MODE):
            assert simulated[field] == shown.get(field, simulated[field])
    assert shown[Field.A_DESTINATION] == b"264.0000"


def test_listening_identifies_and_a_move_is_confirmed_followed_and_stopped(positioner_host):
    async def scene():
        async with positioner_host() as host:
            positioner = positioner_on(host.port.link)
            identity = await positioner.open()
            assert identity.board == "36A1"
            assert not host.received
            await positioner.disable_autonomy()
            assert not host.received
            await positioner.move_to(-20.0, 60.0)

            async def arrived():
                seen = await positioner.read_telemetry()
                return abs(seen.a_deg + 20.0) < 0.5 and abs(seen.b_deg - 60.0) < 0.5

            await until(arrived)
            assert host.core.truth(host._now()).a_deg == pytest.approx(-20.0, abs=0.5)
            assert set(host.received) == {Field.ACTION, Field.A_DESTINATION, Field.B_DESTINATION}
            await positioner.close()

    asyncio.run(scene())


def test_a_port_with_echo_does_harm_and_the_driver_avoids_it(positioner_host):
    async def scene():
        async with positioner_host() as host:
            victim = os.open(host.port.link, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
            await until(lambda: _true(host.received[Field.BOARD] + host.received[Field.A_ANGLE] > 0))
            os.close(victim)
            await until(lambda: _true(not host.port.in_use))
            await until(lambda: _true(not host.port._reading))
            # What the victim's echo has left behind is taken in; the port keeps its mode for whoever comes next.
            await asyncio.sleep(0.1)
            host.received.clear()
            positioner = positioner_on(host.port.link)
            await positioner.open()
            await positioner.move_to(5.0, 80.0)
            assert set(host.received) == {Field.ACTION, Field.A_DESTINATION, Field.B_DESTINATION}
            mode = termios.tcgetattr(positioner._line._reader.port._port.fileno())
            mode[3] |= termios.ECHO
            termios.tcsetattr(positioner._line._reader.port._port.fileno(), termios.TCSANOW, mode)
            await until(lambda: _lost(positioner, "echo"))
            await positioner.close()

    asyncio.run(scene())


async def _true(value):
    return value


async def _lost(positioner, why):
    try:
        await positioner.read_telemetry()
    except LinkLostError as error:
        return why in str(error)
    return False


def test_a_stop_goes_out_at_once_and_a_move_that_was_being_sent_goes_no_further(positioner_host):
    async def scene():
        async with positioner_host() as host:
            positioner = positioner_on(host.port.link)
            await positioner.open()
            move = asyncio.create_task(positioner.move_to(-30.0, 50.0))
            await until(lambda: _true(host.received[Field.A_DESTINATION] == 1))
            # One stop was spent on the first packet of the connection, which is lost.
            assert host.received[Field.ACTION] == 1
            await positioner.stop()
            with pytest.raises(RefusedError, match="a stop came in between"):
                await move
            await until(lambda: _true(host.received[Field.ACTION] == 2))
            assert host.received[Field.B_DESTINATION] == 0

            async def still():
                before = await positioner.read_telemetry()
                await asyncio.sleep(0.3)
                after = await positioner.read_telemetry()
                return (before.position_a, before.position_b) == (after.position_a, after.position_b)

            await until(still)
            assert abs(host.core.truth(host._now()).a_deg) < 10.0
            await positioner.close()

    asyncio.run(scene())


def test_commands_keep_their_distance(positioner_host):
    async def scene():
        times = []
        async with positioner_host() as host:
            # Where they leave: a busy machine takes in late what came in time.
            tap = lambda direction, _data: times.append(time.monotonic()) if direction == ">" else None  # noqa: E731
            positioner = positioner_on(host.port.link, tap=tap)
            await positioner.open()
            await positioner.move_to(-5.0, 80.0)
            await positioner.stop()
            await positioner.move_to(5.0, 80.0)
            await positioner.close()
        # A stop first: the first packet of a connection is lost.
        assert len(times) == 6
        gaps = [after - before for before, after in pairwise(times)]
        # The stop alone goes out at once.
        assert min(gap for index, gap in enumerate(gaps) if index != 2) > wire.COMMAND_SPACING_S

    asyncio.run(scene())


@pytest.mark.parametrize("target", [(60.0, 45.0), (0.0, 10.0), (float("nan"), 45.0), (0.0, float("inf"))])
def test_a_target_outside_the_limits_is_never_sent(positioner_host, target):
    async def scene():
        async with positioner_host() as host:
            positioner = positioner_on(host.port.link)
            await positioner.open()
            with pytest.raises(ValueError, match="outside the limits"):
                await positioner.move_to(*target)
            assert not host.received
            await positioner.close()

    asyncio.run(scene())


def test_another_board_a_silent_unit_and_a_foreign_stream_are_refused_and_nothing_is_sent(positioner_host):
    async def scene():
        async with positioner_host() as host:
            host.core.parameters[Field.BOARD] = "29C3"
            positioner = positioner_on(host.port.link)
            with pytest.raises(IdentityError, match="board '29C3', not 36A1: nothing is sent to it"):
                await positioner.open()
            with pytest.raises(LinkLostError, match="opened first"):
                await positioner.stop()
            other = positioner_on(host.port.link, boards=("36A1", "29C3"))
            assert (await other.open()).board == "29C3"
            await other.close()
            host.freeze()
            with pytest.raises(ConnectError, match="no telemetry: it is in its bootloader"):
                await positioner.open()
            host.thaw()
            assert not host.received

    asyncio.run(scene())


def test_a_port_that_is_away_held_or_no_port_is_one_sentence(positioner_host, tmp_path):
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


def test_a_pulled_cable_is_a_lost_link_and_the_same_name_works_again(positioner_host):
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


@pytest.mark.parametrize("b_out_bit", [None, wire.B_OUT_BIT_STM])
def test_a_reference_run_begins_is_on_and_ends(positioner_host, b_out_bit):
    async def scene():
        async with positioner_host(HURRIED) as host:
            positioner = positioner_on(host.port.link, b_out_bit=b_out_bit)
            await positioner.open()
            for axis, low_deg in (("a", -52.0), ("b", 13.0)):
                await positioner.home(axis)
                assert (await positioner.read_telemetry()).homing

                async def over():
                    return not (await positioner.read_telemetry()).homing

                await until(over)
                truth = host.core.truth(host._now())
                assert (truth.a_deg if axis == "a" else truth.b_deg) == pytest.approx(low_deg, abs=0.1)
            assert not (await positioner.read_telemetry()).reference_doubt
            await positioner.close()

    asyncio.run(scene())


@pytest.mark.parametrize("b_out_bit", [None, wire.B_OUT_BIT_STM])
def test_a_lost_count_is_a_lost_reference_until_it_is_cleared_and_homing_finds_the_switch(positioner_host, b_out_bit):
    async def scene():
        async with positioner_host(HURRIED) as host:
            positioner = positioner_on(host.port.link, b_out_bit=b_out_bit)
            await positioner.open()
            host.core.inject("reset_position_lost", host._now())

            async def doubtful():
                return "count has jumped" in (await positioner.read_telemetry()).reference_doubt

            await until(doubtful)
            assert "count has jumped" in (await positioner.clear_faults()).reference_doubt
            assert not (await positioner.read_telemetry()).reference_doubt
            # The count says 0, the axis stands elsewhere: that is not home.
            await positioner.home("b")

            async def over():
                return not (await positioner.read_telemetry()).homing

            await until(over)
            assert host.core.truth(host._now()).b_deg == pytest.approx(13.0, abs=0.1)
            seen = await positioner.read_telemetry()
            assert "axis B met its end switch where its count was -" in seen.reference_doubt
            await positioner.close()

    asyncio.run(scene())


def test_a_reference_run_that_the_unit_does_not_begin_is_refused(positioner_host):
    async def scene():
        async with positioner_host() as host:
            positioner = positioner_on(host.port.link)
            await positioner.open()
            host.core.inject("undervoltage", host._now())
            with pytest.raises(RefusedError, match=r"home axis B: its motor supply is 15 V"):
                await positioner.home("b")
            assert not (await positioner.read_telemetry()).homing
            await positioner.close()

    asyncio.run(scene())


def test_the_mode_of_a_port_that_somebody_holds_is_left_alone(positioner_host):
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


def test_own_tracking_is_switched_off_and_a_refusal_names_its_likely_cause(positioner_host):
    async def scene():
        async with positioner_host(Setup(own_target=lambda _now: Angles(0.0, 90.0))) as host:
            positioner = positioner_on(host.port.link)
            host.core.inject("own_tracking", host._now())
            await positioner.open()
            assert (await positioner.read_telemetry()).autonomous
            with pytest.raises(RefusedError, match="its own mode is on"):
                await positioner.move_to(10.0, 70.0)
            await positioner.disable_autonomy()
            assert not (await positioner.read_telemetry()).autonomous
            host.core.inject("a_overcurrent", host._now())

            async def faulty():
                return "a_overcurrent" in (await positioner.read_telemetry()).faults

            await until(faulty)
            with pytest.raises(RefusedError, match="it reports a_overcurrent"):
                await positioner.move_to(10.0, 70.0)
            await positioner.clear_faults()
            assert not (await positioner.read_telemetry()).faults
            await positioner.close()

    asyncio.run(scene())


def test_settings_that_may_move_the_axes_some_day_are_named(positioner_host):
    async def scene():
        async with positioner_host() as host:
            positioner = positioner_on(host.port.link)
            await positioner.open()
            await asyncio.sleep(3.5)
            assert (await positioner.read_telemetry()).own_moves == ()
            host.core.parameters.update({108: "-50.0", 117: "7"})

            async def named():
                return len((await positioner.read_telemetry()).own_moves) == 2

            await until(named)
            night, reference = (await positioner.read_telemetry()).own_moves
            assert night == "a night position (108=-50.0, 109=off)"
            assert reference.startswith("a reference run every few days (117=7")
            await positioner.close()

    asyncio.run(scene())


def test_a_geometry_that_is_not_the_units_is_told_and_no_move_passes_for_taken(positioner_host):
    async def scene():
        async with positioner_host() as host:
            wrong = AxisSetup(Proportional(59.5, -52.0), -50.0, 50.0)
            positioner = positioner_on(host.port.link, a=wrong)
            await positioner.open()
            with pytest.raises(RefusedError, match=r"a_axis makes 3094.0 of that angle; is the geometry"):
                await positioner.move_to(10.0, 70.0)
            assert not host.received
            await positioner.stop()
            await positioner.close()

    asyncio.run(scene())


@pytest.mark.parametrize(("dtr", "rts"), [(True, True), (False, True), (True, False), (False, False)])
def test_the_modem_lines_are_put_as_configured_at_open(positioner_host, monkeypatch, dtr, rts):
    """A pseudo-terminal has no modem lines, so the operating system's answer is stood in for."""
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
            assert port.has_lines()
            assert lines == {termios.TIOCM_DTR: dtr, termios.TIOCM_RTS: rts}
            port.close()
            assert not port.has_lines()

    asyncio.run(scene())


def test_a_port_without_modem_lines_is_used_and_said_to_have_none(positioner_host):
    async def scene():
        async with positioner_host() as host:
            line = SerialLine(lambda: open_port(str(host.port.link), dtr=False, rts=False), time.monotonic)
            positioner = PozsolPositioner(line, time.monotonic, A, B)
            assert (await positioner.open()).board == "36A1"
            assert positioner.has_lines() is False
            await positioner.close()

    asyncio.run(scene())


def test_a_board_that_restarts_when_its_port_is_opened_is_waited_for_and_its_reference_is_in_doubt(positioner_host):
    async def scene():
        async with positioner_host() as host:
            host.boots_at_open_s = 3.0
            with pytest.raises(ConnectError, match="no telemetry"):
                await positioner_on(host.port.link).open()
            positioner = positioner_on(host.port.link, boot_s=4.0, banner=BANNER.decode().strip())
            assert (await positioner.open()).board == "36A1"
            assert (await positioner.read_telemetry()).was_reset
            await positioner.clear_faults()
            assert not (await positioner.read_telemetry()).was_reset
            await positioner.move_to(5.0, 80.0)
            await positioner.close()

    asyncio.run(scene())


def test_a_banner_in_mid_run_is_a_restart_that_loses_link_and_reference(positioner_host):
    async def scene():
        async with positioner_host() as host:
            positioner = positioner_on(host.port.link, banner=BANNER.decode().strip())
            await positioner.open()
            await positioner.move_to(5.0, 80.0)
            # The banner alone: the reset mark of the status comes up to three seconds later, or never.
            host.port.send(BANNER)
            await until(lambda: _lost(positioner, "has restarted: it prints its banner"))
            await positioner.stop()
            await positioner.open()
            assert (await positioner.read_telemetry()).reference_doubt == "the positioner has restarted"
            await positioner.clear_faults()
            assert not (await positioner.read_telemetry()).reference_doubt
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
                # The kernel makes room by itself a few times before the port is truly full.
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
