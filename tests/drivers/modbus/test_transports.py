"""Where a line's name leads, and what TCP connections report of a device that is late, silent, noisy or gone."""

import asyncio

import pytest
from pydantic import TypeAdapter

from drivers.errors import ConnectError, DeadlineError, LinkLostError
from drivers.modbus.framing import TcpServer
from drivers.modbus.pdu import read_registers
from drivers.modbus.transports import Endpoint, ModbusLine, SerialTransport, TcpTransport, endpoint
from tests.support import PATIENCE_S

READ = read_registers(7, 3, 0, 1)
REPLY = bytes.fromhex("03 02 0007")
# Long enough for a reply that comes; a reply that does not come is waited for so long.
MISSED_S = 0.05


@pytest.mark.parametrize(
    ("line", "where"),
    [
        ("tcp:192.168.1.40:502", Endpoint("tcp", "192.168.1.40", 502)),
        ("rtu-over-tcp:gate-way.lan:65535", Endpoint("rtu-over-tcp", "gate-way.lan", 65535)),
        ("tcp:[fe80::1]:1", Endpoint("tcp", "fe80::1", 1)),
        ("/dev/serial/by-id/usb-line", None),
    ],
)
def test_the_name_of_a_line_gives_its_network_endpoint_or_none_for_a_serial_port(line, where):
    assert endpoint(line) == where


LONG = "x" * 64


@pytest.mark.parametrize(
    "line", ["tcp:host:0", "tcp:host:65536", "tcp:host", "udp:host:502", "tcp:a..b:502", f"tcp:{LONG}:502"]
)
def test_a_line_name_that_is_neither_a_serial_port_nor_a_network_endpoint_is_refused(line):
    with pytest.raises(ValueError, match=r"."):
        endpoint(line)
    with pytest.raises(ValueError, match=r"."):
        TypeAdapter(ModbusLine).validate_python(line)


class Device:
    """Answers each question with the next of its answers: bytes, nothing, or the end of the connection."""

    def __init__(self, *answers):
        self.answers = list(answers)
        self.asked = asyncio.Semaphore(0)
        self.writer = None

    async def serve(self, reader, writer):
        self.writer, framing = writer, TcpServer()
        while data := await reader.read(1000):
            for asked in framing.feed(data, 0.0):
                self.late = framing.reply(asked, REPLY)
                match self.answers.pop(0):
                    case "reply":
                        writer.write(self.late)
                    case "end":
                        writer.close()
                    case said:
                        writer.write(said)
                self.asked.release()
        writer.close()


def exchange_with(*answers):
    """Return a decorator that runs a test on a path to such a device."""

    def around(test):
        async def both():
            device, failed = Device(*answers), []
            asyncio.get_running_loop().set_exception_handler(lambda _loop, context: failed.append(context))
            server = await asyncio.start_server(device.serve, "127.0.0.1", 0)
            path = TcpTransport("cube", Endpoint("tcp", "127.0.0.1", server.sockets[0].getsockname()[1]))
            async with server:
                await path.open(PATIENCE_S)
                try:
                    await test(path, device)
                finally:
                    await path.close()
                    await device.writer.wait_closed()
            assert failed == []

        asyncio.run(both())

    return around


@pytest.mark.parametrize("late_s", [0.0, 0.05])
def test_a_late_answer_spoils_neither_the_connection_nor_the_next_question(late_s):
    @exchange_with(b"", "reply")
    async def _(path, device):
        with pytest.raises(DeadlineError):
            await path.exchange(READ, MISSED_S)
        device.writer.write(device.late)
        await asyncio.sleep(late_s)
        assert await path.exchange(READ, PATIENCE_S) == REPLY


def test_silence_and_noise_are_distinguished_for_each_question_by_itself():
    noise = bytes.fromhex("FFFF 0000 0002 01 83")

    @exchange_with(noise, b"")
    async def _(path, device):
        waiting = asyncio.create_task(path.exchange(READ, 1.0))
        await device.asked.acquire()
        with pytest.raises(DeadlineError, match="sent something that is not an answer"):
            await waiting
        with pytest.raises(DeadlineError) as silent:
            await path.exchange(READ, MISSED_S)
        assert "sent" not in str(silent.value)


def test_a_connection_that_ends_is_a_lost_link_for_this_question_and_the_next():
    @exchange_with("end")
    async def _(path, device):
        for _ in range(2):
            with pytest.raises(LinkLostError, match=r"the connection to 127\.0\.0\.1 is gone"):
                await path.exchange(READ, PATIENCE_S)


def test_data_that_is_not_modbus_ends_the_connection():
    @exchange_with(b"HTTP/1.1 400 Bad Request\r\n")
    async def _(path, device):
        with pytest.raises(LinkLostError):
            await path.exchange(READ, PATIENCE_S)


def test_a_closed_path_has_to_be_opened_first():
    @exchange_with()
    async def _(path, device):
        await path.close()
        with pytest.raises(LinkLostError):
            await path.exchange(READ, PATIENCE_S)


def test_a_serial_line_has_to_be_opened_first():
    path = SerialTransport("cube", "/dev/none", 19200, "8E1", lambda: 0.0)
    with pytest.raises(LinkLostError, match="cube: has to be opened first"):
        asyncio.run(path.exchange(READ, PATIENCE_S))


def test_a_refused_connection_is_reported_with_its_port_and_the_reason():
    async def refused():
        server = await asyncio.start_server(lambda *_: None, "127.0.0.1", 0)
        port = server.sockets[0].getsockname()[1]
        server.close()
        await server.wait_closed()
        with pytest.raises(ConnectError, match=rf"port {port} takes no connection \(Connection refused\); is it on"):
            await TcpTransport("cube", Endpoint("tcp", "127.0.0.1", port)).open(PATIENCE_S)

    asyncio.run(refused())
