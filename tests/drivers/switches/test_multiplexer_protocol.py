import asyncio
import contextlib
import threading

import grpc
import nidaqmx
import pytest
from nidaqmx.constants import LineGrouping

from drivers.errors import ConnectError, DriverMissingError, LinkLostError, RefusedError
from drivers.switches.ni_port import NiPort
from drivers.switches.ni_usb6008 import NiMultiplexer
from sim_drivers.bench.ni_server import NiServer
from sim_drivers.multiplexer import MultiplexerCore

pytestmark = pytest.mark.slow


@contextlib.asynccontextmanager
async def ni_server(**options):
    now = asyncio.get_running_loop().time
    server = NiServer(MultiplexerCore(lambda channel, _now: 0.01 * channel, latency_s=0.0, **options), now)
    await server.start()
    try:
        yield server
    finally:
        await server.stop()


def multiplexer_at(server, *, digital_port="Dev1/port0", deadline_s=5.0, **options):
    port = NiPort(digital_port, server=f"127.0.0.1:{server.port}", deadline_s=deadline_s)
    return NiMultiplexer(port, **options)


def selected(server):
    return server.core.selected(server._now())


def test_the_multiplexer_driver_selects_each_input_by_one_write_as_in_the_transcript(transcript):
    pieces = transcript("multiplexer")

    async def scene():
        async with ni_server() as server:
            written = []
            multiplexer = multiplexer_at(server, tap=lambda direction, data: written.append((direction, data)))
            assert "USB-6008" in await multiplexer.open()
            assert server.writes == 0
            for channel in range(8):
                await multiplexer.select(channel)
                assert (selected(server), server.writes) == (channel, channel + 1)
            await multiplexer.close()
            assert written == [(piece.direction, piece.data) for piece in pieces]

    asyncio.run(scene())


def test_the_simulated_multiplexer_selects_each_input_by_the_values_of_the_transcript(transcript):
    core = MultiplexerCore(lambda channel, _now: float(channel), latency_s=0.0)
    for channel, piece in enumerate(transcript("multiplexer")):
        core.write(int(piece.data), piece.time_s)
        assert core.selected(piece.time_s) == channel


@pytest.mark.parametrize(("enable", "level"), [("active-low", False), ("active-high", True)])
def test_the_address_wiring_and_the_enable_line_can_be_configured(enable, level):
    async def scene():
        async with ni_server(enable=enable, address_lines=(2, 1, 0)) as server:
            addresses = (0, 4, 2, 6, 1, 5, 3, 7)
            multiplexer = multiplexer_at(server, addresses=addresses, enable_line=3, enable_level=level)
            await multiplexer.open()
            for channel in range(8):
                await multiplexer.select(channel)
                assert selected(server) == channel
            with pytest.raises(RefusedError, match="inputs 0 to 7, not 8"):
                await multiplexer.select(8)
            await multiplexer.close()

    asyncio.run(scene())


def test_an_unplugged_multiplexer_is_a_lost_link_and_works_again_after_reopening():
    async def scene():
        async with ni_server() as server:
            multiplexer = multiplexer_at(server)
            await multiplexer.open()
            await multiplexer.select(2)
            server.unplug()
            assert selected(server) == 7
            with pytest.raises(LinkLostError, match=r"did not take the address.*-88705"):
                await multiplexer.select(3)
            with pytest.raises(LinkLostError, match="opened first"):
                await multiplexer.select(3)
            with pytest.raises(ConnectError, match=r"no device for Dev1/port0.*NI MAX"):
                await multiplexer.open()
            server.plug()
            await multiplexer.open()
            await multiplexer.select(3)
            assert selected(server) == 3
            await multiplexer.close()

    asyncio.run(scene())


@pytest.mark.live
def test_an_ni_server_that_ends_or_hangs_is_a_lost_link_within_the_deadline():
    async def scene():
        async with ni_server() as server:
            multiplexer = multiplexer_at(server, deadline_s=1.5)
            await multiplexer.open()
            server.freeze()
            with pytest.raises(LinkLostError, match="did not return"):
                await multiplexer.select(1)
            server.thaw()
            await multiplexer.open()
            await multiplexer.select(1)
            port = server.port
            await server.stop()
            with pytest.raises(LinkLostError, match="did not take the address"):
                await multiplexer.select(2)
            with pytest.raises(ConnectError, match="no NI gRPC Device Server answers"):
                await multiplexer.open()
            await server.start(port)
            await multiplexer.open()
            await multiplexer.select(2)
            assert selected(server) == 2
            await multiplexer.close()

    asyncio.run(scene())


def test_the_session_of_a_program_that_died_is_taken_over():
    async def scene():
        async with ni_server() as server:
            dead = multiplexer_at(server)
            await dead.open()
            dead._port._session._channel.close()
            successor = multiplexer_at(server)
            await successor.open()
            await successor.select(5)
            assert selected(server) == 5
            await successor.close()
            await dead.close()

    asyncio.run(scene())


def test_digital_lines_held_by_another_program_are_refused_by_name_until_they_are_released():
    async def scene():
        async with ni_server() as server:
            other = multiplexer_at(server, addresses=(0, 1))
            held, let_go = asyncio.Event(), threading.Event()
            loop = asyncio.get_running_loop()

            def hold():
                with grpc.insecure_channel(f"127.0.0.1:{server.port}") as channel:
                    options = nidaqmx.GrpcSessionOptions(channel, "somebody else")
                    with nidaqmx.Task("somebody else", grpc_options=options) as task:
                        task.do_channels.add_do_chan(
                            "Dev1/port0/line0:2", line_grouping=LineGrouping.CHAN_FOR_ALL_LINES
                        )
                        task.start()
                        loop.call_soon_threadsafe(held.set)
                        let_go.wait(30)

            holding = asyncio.create_task(asyncio.to_thread(hold))
            await held.wait()
            with pytest.raises(ConnectError, match=r"Dev1/port0/line0 at .* is held by another program"):
                await other.open()
            let_go.set()
            await holding
            await other.open()
            await other.close()

    asyncio.run(scene())


def test_the_mock_ni_server_refuses_a_value_for_a_stopped_task_and_two_values_at_once():
    def write(server, value, *, start):
        with grpc.insecure_channel(f"127.0.0.1:{server.port}") as channel:
            options = nidaqmx.GrpcSessionOptions(channel, "hasty")
            with nidaqmx.Task("hasty", grpc_options=options) as task:
                task.do_channels.add_do_chan("Dev1/port0/line0:2", line_grouping=LineGrouping.CHAN_FOR_ALL_LINES)
                if start:
                    task.start()
                task.write(value, auto_start=False)

    async def scene():
        async with ni_server() as server:
            await asyncio.to_thread(write, server, 5, start=True)
            assert selected(server) == 5
            for value, start in ((3, False), ([3, 4], True)):
                with pytest.raises(nidaqmx.errors.DaqError) as caught:
                    await asyncio.to_thread(write, server, value, start=start)
                assert caught.value.error_code == -200846
            assert selected(server) == 5

    asyncio.run(scene())


def test_a_wrong_port_name_and_a_missing_ni_driver_are_each_refused_in_one_sentence():
    async def scene():
        async with ni_server() as server:
            with pytest.raises(ConnectError, match="no device for Dev9/port0/line0:2"):
                await multiplexer_at(server, digital_port="Dev9/port0").open()
        with pytest.raises(DriverMissingError, match=r"NI-DAQmx is not installed on this PC.*instruments.multiplexer"):
            await NiMultiplexer(NiPort()).open()

    asyncio.run(scene())
