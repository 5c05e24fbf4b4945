"""The positioner's driver and its unit on a port, byte by byte: what is sent, confirmed, refused and stopped."""

import asyncio
import contextlib
import os
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
from sim_drivers.pozsol.core import PositionerCore
from sim_drivers.pozsol.setup import Setup
from solar.frames import Angles
from tests.support import PATIENCE_S

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
    # A pause of seconds on a busy machine is not a lost link.
    return PozsolPositioner(line, time.monotonic, a, b, **{"stale_s": 10.0} | options)


async def until(condition):
    """Wait for a condition that must come true; the limit is for a broken program."""
    async with asyncio.timeout(PATIENCE_S):
        done = await condition()
        while not done:
            await asyncio.sleep(0.05)
            done = await condition()


async def it_is(value):
    return value


class Player(threading.Thread):
    """Streams the telemetry of a transcript until each command comes, and notes the commands that it receives."""

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
                    # A busy machine delivers late, and together, commands that were sent in good time.
                    data += os.read(self._master, 64 if piece is None else len(piece.data) - len(data))
                except BlockingIOError:
                    continue
                if piece is not None and len(data) >= len(piece.data):
                    break
            if data:
                self.received.append(data)
            stream = [*screens, "sent"]

    def end(self):
        self.join(PATIENCE_S)
        os.close(self._slave)
        os.close(self._master)


@pytest.mark.live
@pytest.mark.usefixtures("patience")
def test_the_driver_sends_the_recorded_bytes_and_reads_the_recorded_telemetry(transcript, tmp_path):
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


def test_the_simulated_unit_shows_the_recorded_telemetry_after_the_recorded_bytes(transcript):
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


def test_the_driver_identifies_the_unit_by_listening_and_follows_a_move_to_its_target(positioner_host):
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


@pytest.mark.parametrize("together", [True, False])
def test_the_simulated_unit_loses_no_command_when_a_busy_machine_holds_it_up(positioner_host, together):
    async def scene():
        async with positioner_host() as host:
            positioner = positioner_on(host.port.link)
            await positioner.open()
            await positioner.stop()
            await asyncio.sleep(0.2)
            other = os.open(host.port.link, os.O_WRONLY | os.O_NOCTTY)
            for field, place in ((Field.A_DESTINATION, 150), (Field.B_DESTINATION, 200)):
                os.write(other, wire.encode_command(field, place))
                if together:
                    # The unit lives in this process, so this holds it up too.
                    time.sleep(0.1)  # noqa: ASYNC251
                else:
                    await asyncio.sleep(0.003)
            os.close(other)

            async def taken():
                seen = await positioner.read_telemetry()
                return (seen.destination_a, seen.destination_b) == pytest.approx((150.0, 200.0), abs=1.0)

            await until(taken)
            await positioner.close()

    asyncio.run(scene())


@pytest.mark.parametrize("how", ["stop", "halt"])
def test_stop_and_halt_go_out_at_once_and_an_interrupted_move_sends_no_further_target(positioner_host, how):
    async def scene():
        a_is_sent, loop = asyncio.Event(), asyncio.get_running_loop()

        def tap(direction, data):
            if direction == ">" and data[1] == Field.A_DESTINATION:
                loop.call_soon_threadsafe(a_is_sent.set)

        async with positioner_host() as host:
            positioner = positioner_on(host.port.link, tap=tap)
            await positioner.open()
            move = asyncio.create_task(positioner.move_to(-30.0, 50.0))
            # Wait only for the sending: by the time A arrives, B would have been sent too on a busy machine.
            await a_is_sent.wait()
            await getattr(positioner, how)()
            with pytest.raises(RefusedError, match="a stop came in between"):
                await move
            # One stop was spent on the first packet of the connection, which is lost.
            await until(lambda: it_is(host.received[Field.ACTION] >= 2))
            assert (host.received[Field.A_DESTINATION], host.received[Field.B_DESTINATION]) == (1, 0)

            async def still():
                before = await positioner.read_telemetry()
                await asyncio.sleep(0.3)
                after = await positioner.read_telemetry()
                return (before.position_a, before.position_b) == (after.position_a, after.position_b)

            await until(still)
            assert abs(host.core.truth(host._now()).a_deg) < 10.0
            await positioner.close()

    asyncio.run(scene())


def test_commands_leave_the_port_at_least_the_required_spacing_apart_except_for_a_stop(positioner_host):
    async def scene():
        times = []
        async with positioner_host() as host:
            # Times are taken where commands leave: a busy machine delivers late what was sent in time.
            tap = lambda direction, _data: times.append(time.monotonic()) if direction == ">" else None  # noqa: E731
            positioner = positioner_on(host.port.link, tap=tap)
            await positioner.open()
            await positioner.move_to(-5.0, 80.0)
            await positioner.stop()
            # On a busy machine the axis may be fast by now, still turn when its target comes, and refuse it.
            with contextlib.suppress(RefusedError):
                await positioner.move_to(5.0, 80.0)
            await positioner.close()
        # First a stop, since the first packet of a connection is lost; one more if the last target was refused.
        assert len(times) in {6, 7}
        gaps = [after - before for before, after in pairwise(times[:6])]
        # Only the stop goes out at once.
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


def test_another_board_and_a_silent_unit_are_refused_at_opening_and_nothing_is_sent_to_them(positioner_host):
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
            with pytest.raises(ConnectError, match="no telemetry: it hangs"):
                await positioner.open()
            host.thaw()
            assert not host.received

    asyncio.run(scene())


@pytest.mark.live
@pytest.mark.parametrize(("says", "error", "sentence"), [
    (b"$GPGGA,101530,4843.05,N,00212.54,E,1,08,0.9,156.0,M,,M,,*47\r\n", IdentityError, "sends something, but not"),
    (b"+0412.6 W/m2\r\n", ConnectError, "sends no telemetry: it hangs, is in its bootloader, or is another device"),
])  # fmt: skip
def test_a_device_that_streams_something_else_is_refused_at_opening_and_nothing_is_sent_to_it(says, error, sentence):
    device, port = os.openpty()
    tty.setraw(port)
    os.set_blocking(device, False)
    heard = []
    # The driver listens for up to 8 s of its time, which passes by what it hears: a busy machine may hold it up.
    now = lambda: float(len(heard))  # noqa: E731
    line = SerialLine(lambda: open_port(os.ttyname(port), lambda *piece: heard.append(piece)), now)

    async def stream():
        while True:
            with contextlib.suppress(BlockingIOError):
                os.write(device, 5 * says)
            await asyncio.sleep(0.05)

    async def scene():
        positioner = PozsolPositioner(line, now, A, B)
        task = asyncio.create_task(stream())
        with pytest.raises(error, match=sentence):
            await positioner.open()
        with pytest.raises(LinkLostError, match="opened first"):
            await positioner.stop()
        task.cancel()
        with pytest.raises(BlockingIOError):
            os.read(device, 64)

    try:
        asyncio.run(scene())
    finally:
        os.close(device)
        os.close(port)


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


def test_telemetry_names_the_unit_settings_that_may_move_its_axes_unasked(positioner_host):
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


def test_a_move_is_refused_and_not_sent_when_the_configured_geometry_does_not_fit_the_unit(positioner_host):
    async def scene():
        async with positioner_host() as host:
            wrong = AxisSetup(Proportional(59.5, -52.0), -50.0, 50.0)
            positioner = positioner_on(host.port.link, a=wrong)
            await positioner.open()
            with pytest.raises(RefusedError, match=r"a_axis that angle is position 3094.0; is the geometry"):
                await positioner.move_to(10.0, 70.0)
            assert not host.received
            await positioner.stop()
            await positioner.close()

    asyncio.run(scene())
