"""The device on a real port: garbage, a port that is taken, and clients that come and go."""

import asyncio
import contextlib
import re
import socket

import pytest

from daemon.base.records import Event
from daemon.service.operator_commands import Operators
from daemon.sunspec.models import BASE
from daemon.sunspec.server import SunSpecServer
from drivers.modbus.framing import TcpClient
from drivers.modbus.pdu import ModbusRequest, read_registers, registers_of, write_register
from tests.support.addresses import SocketWithoutIpv6, free_port


@pytest.fixture
def serve(run_rig):
    """Run a scenario beside a rig and its SunSpec device on a free port."""

    def run(scenario, host="127.0.0.1"):
        async def beside(rig):
            port = free_port()
            settings = rig.service.settings
            own = settings.sunspec.model_copy(update={"enabled": True, "listen": f"{host}:{port}"})
            server = SunSpecServer(
                settings.model_copy(update={"sunspec": own}),
                rig.take_snapshot,
                Operators(rig.service.trackers, 1.0),
                rig.clock,
                rig.service.cube_alarms.set,
                1.0,
            )
            try:
                await scenario(rig, server, port)
            finally:
                await server._end(None)

        return run_rig(beside)

    return run


async def running(rig, server):
    task = asyncio.create_task(server.run())
    await rig.until(lambda: server.port, 30, "the device to be served")
    return task


async def ended(task):
    task.cancel()
    await asyncio.wait((task,))


async def asked(port, data):
    """Return the first reply, or what comes before the device closes."""
    reader, writer = await asyncio.open_connection("127.0.0.1", port)
    try:
        writer.write(data)
        await writer.drain()
        return await reader.read(300)
    except ConnectionResetError:
        return b""
    finally:
        writer.close()


QUESTION = read_registers(1, 3, BASE, 2)


def test_garbage_closes_only_the_connection_on_which_it_came(serve):
    async def scenario(rig, server, port):
        task = await running(rig, server)
        framing = TcpClient()
        reader, writer = await asyncio.open_connection("127.0.0.1", port)
        for garbage in (b"GET / HTTP/1.1\r\nHost: x\r\n\r\n", b"\xff" * 600):
            assert await asked(port, garbage) == b""
        frame = framing.begin(QUESTION)
        writer.write(frame[:5])
        await writer.drain()
        writer.write(frame[5:])
        assert registers_of(framing.feed(await reader.read(300))) == (0x5375, 0x6E53)
        writer.close()
        await ended(task)

    serve(scenario)


def test_a_seventeenth_client_is_refused_until_another_client_has_been_silent_for_10_seconds(serve):
    async def scenario(rig, server, port):
        task = await running(rig, server)
        others = [await asyncio.open_connection("127.0.0.1", port) for _ in range(16)]
        await rig.until(lambda: len(server._asked_s) == 16, 9, "sixteen clients")
        assert await asked(port, TcpClient().begin(QUESTION)) == b""
        framing = TcpClient()
        reader, writer = others[0]
        for _ in range(2):
            await asyncio.sleep(6)
            writer.write(framing.begin(QUESTION))
            assert framing.feed(await reader.read(300)) is not None
        # Each newcomer replaces a silent connection, and none replaces the one that asks.
        newcomers = [await asyncio.open_connection("127.0.0.1", port) for _ in range(15)]
        for silent, _ in others[1:]:
            assert await silent.read() == b""
        assert await asked(port, TcpClient().begin(QUESTION)) == b""
        writer.write(framing.begin(QUESTION))
        assert framing.feed(await reader.read(300)) is not None
        for _, writer in (*others, *newcomers):
            writer.close()
        await ended(task)

    serve(scenario)


def test_after_a_flood_of_refused_writes_the_log_gives_the_number_of_those_not_logged(serve, caplog):
    async def scenario(rig, server, port):
        task = await running(rig, server)
        reader, writer = await asyncio.open_connection("127.0.0.1", port)
        framing = TcpClient()
        for _ in range(12):
            writer.write(framing.begin(write_register(1, BASE, 0)))
            assert framing.feed(await reader.read(300)) is not None
        writer.close()
        await asyncio.sleep(3600)
        lines = [line.getMessage() for line in caplog.records if line.name == "heliocube.sunspec"]
        assert lines[1] == "a write over SunSpec is refused: 127.0.0.1, register 40000: sunspec.manual is false"
        assert re.fullmatch(r"writes over SunSpec that were refused: 6 more, the last 3\d min ago", lines[-1])
        await ended(task)

    serve(scenario)


def test_a_refused_request_that_is_not_a_write_is_not_logged_as_a_refused_write(serve, caplog):
    async def scenario(rig, server, port):
        task = await running(rig, server)
        identify = ModbusRequest(1, bytes((0x2B, 0x0E, 1, 0)))
        assert (await asked(port, TcpClient().begin(identify)))[-2:] == bytes((0xAB, 1))
        assert not [line for line in caplog.records if "write" in line.getMessage() and line.levelname == "WARNING"]
        await ended(task)

    serve(scenario)


def test_a_port_that_is_taken_raises_an_alarm_until_the_server_gets_it(serve):
    async def scenario(rig, server, port):
        with socket.socket() as taken:
            taken.bind(("127.0.0.1", port))
            taken.listen()
            task = asyncio.create_task(server.run())
            await asyncio.sleep(35)
            assert server.port == 0
        await rig.until(lambda: server.port == port, 30, "the port")
        text = (
            f"the SunSpec device cannot listen on 127.0.0.1:{port}: Address already in use: no control room can read or"
            " command"
        )
        told = [event.text for event in rig.records_of(Event) if event.subject == "alarm"]
        assert told == [f"raised sunspec-down: {text}", f"cleared sunspec-down: {text}"]
        await ended(task)

    serve(scenario)


def test_an_ipv6_address_on_a_system_without_ipv6_raises_an_alarm_and_does_not_end_the_server(serve, monkeypatch):
    async def scenario(rig, server, _):
        monkeypatch.setattr(socket, "socket", SocketWithoutIpv6)
        task = asyncio.create_task(server.run())
        await asyncio.sleep(35)
        (alarm,) = rig.service.cube_alarms.active
        assert alarm.name == "sunspec-down"
        assert alarm.text.startswith("the SunSpec device cannot listen on [::1]:")
        assert not task.done()
        await ended(task)

    serve(scenario, host="[::1]")


def test_ending_the_server_while_clients_are_connected_logs_no_asyncio_error(serve, caplog):
    async def scenario(rig, server, port):
        task = await running(rig, server)
        connections = [await asyncio.open_connection("127.0.0.1", port) for _ in range(2)]
        await rig.until(lambda: len(server._asked_s) == 2, 9, "two clients")
        await ended(task)
        for reader, writer in connections:
            with contextlib.suppress(ConnectionResetError):
                assert await reader.read() == b""
            writer.close()
        assert [line.name for line in caplog.records if line.name == "asyncio"] == []

    serve(scenario)
