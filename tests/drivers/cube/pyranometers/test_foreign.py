"""Our driver on a server that is not ours: pymodbus, with the maps of several makes, over TCP, RTU over TCP, a line."""

import asyncio
import contextlib
import os
import tty

import pytest
from pymodbus import FramerType
from pymodbus.server import ModbusSerialServer, ModbusTcpServer
from pymodbus.simulator import DataType, SimData, SimDevice

from daemon.base.clock import SystemClock
from drivers.cube.pyranometers.driver import build
from drivers.cube.pyranometers.settings import PyranometersSettings
from drivers.errors import LinkLostError
from drivers.settings import CubeSurroundings

SMP = [SimData(0, values=[603, 107, 1, 0, 1, 4103, 4103, 0, 250, 240], datatype=DataType.REGISTERS)]
SMP += [SimData(41, values=[2023, 180102, 108, 5, 2], datatype=DataType.REGISTERS)]
SMP[1].values[1] = 18010
HUKSEFLUX = [
    SimData(0, values=[3, 5, 0, 6000, 0, 6000, 2225, 1234, 100, 100], datatype=DataType.REGISTERS),
    SimData(32, values=[0x5253, 0x3032, 0x442D, 0x2032, 0x2020, 0, 0, 0, 4321, 0, 0], datatype=DataType.REGISTERS),
]
APOGEE = [SimData(0, values=[300.5, 7.5], datatype=DataType.FLOAT32)]
LOGGER = [SimData(100, values=[-25, 4700], datatype=DataType.INT16)]
MAPS = {
    "east": {"make": "apogee", "address": 1},
    "south": {"make": "smp", "address": 2, "serial": 18010},
    "west": {"make": "hukseflux", "address": 3},
    "zenith": {"address": 4, "register_number": 101, "function": 3, "number_type": "int16", "scale": 0.1},
}
WANTED = [300.5, 410.3, 60.0, 470.0]


def devices():
    return [SimDevice(id=number, simdata=data) for number, data in enumerate((APOGEE, SMP, HUKSEFLUX, LOGGER), 1)]


def cube_on(line, **keys):
    clock = SystemClock()
    settings = PyranometersSettings.model_validate(
        {"make": "map", "line": line, "serial_form": "8N1", "gap_s": 0.0, "answer_within_s": 5.0} | MAPS | keys
    )
    return build(settings, CubeSurroundings(clock.utc, clock.monotonic, 2.0, lambda: None))


@contextlib.asynccontextmanager
async def tcp_server(framer=FramerType.SOCKET, port=0):
    server = ModbusTcpServer(devices(), framer=framer, address=("127.0.0.1", port))
    await server.listen()
    try:
        yield server, server.transport.sockets[0].getsockname()[1]
    finally:
        await server.shutdown()


async def read(line, **keys):
    cube = cube_on(line, **keys)
    identity = await cube.open()
    try:
        return identity, await cube.read()
    finally:
        await cube.close()


@pytest.mark.parametrize(("kind", "framer"), [("tcp", FramerType.SOCKET), ("rtu-over-tcp", FramerType.RTU)])
def test_four_register_maps_are_read_over_the_network(kind, framer):
    async def work():
        async with tcp_server(framer) as (_, port):
            return await read(f"{kind}:127.0.0.1:{port}")

    identity, reading = asyncio.run(work())
    assert [face.value for face in reading.faces] == pytest.approx(WANTED)
    assert identity == "Apogee SP-500, SMP11 no. 18010 of 2023, software 108, SR20-D2 no. 4321, without a name"


def test_a_sensor_with_another_serial_number_than_pinned_is_missing_with_a_note():
    async def work():
        async with tcp_server() as (_, port):
            return await read(f"tcp:127.0.0.1:{port}", south={"make": "smp", "address": 2, "serial": 5})

    _, reading = asyncio.run(work())
    assert [face.flaw for face in reading.faces] == [None, "missing", None, None]
    assert "the serial number 18010, but 5 is configured" in reading.notes[0]


def test_losing_the_server_is_a_lost_link_and_the_cube_reads_again_when_it_is_back():
    async def work():
        async with tcp_server() as (_, port):
            cube = cube_on(f"tcp:127.0.0.1:{port}", answer_within_s=0.5)
            await cube.open()
        try:
            with pytest.raises(LinkLostError):
                await cube.read()
            async with tcp_server(port=port):
                await cube.open()
                return await cube.read()
        finally:
            await cube.close()

    assert [face.value for face in asyncio.run(work()).faces] == pytest.approx(WANTED)


def test_four_register_maps_are_read_over_a_serial_line(tmp_path):
    """Two pseudo-terminals, back to back: pymodbus has one end and the driver the other."""

    async def work():
        ours, theirs = os.openpty(), os.openpty()
        link = tmp_path / "sensors"
        link.symlink_to(os.ttyname(ours[1]))
        for _, slave in (ours, theirs):
            tty.setraw(slave)
        loop = asyncio.get_running_loop()
        loop.add_reader(ours[0], lambda: os.write(theirs[0], os.read(ours[0], 4096)))
        loop.add_reader(theirs[0], lambda: os.write(ours[0], os.read(theirs[0], 4096)))
        server = ModbusSerialServer(devices(), port=os.ttyname(theirs[1]), baudrate=19200)
        await server.listen()
        try:
            return await read(str(link))
        finally:
            await server.shutdown()
            for master, slave in (ours, theirs):
                loop.remove_reader(master)
                os.close(slave)
                os.close(master)

    _, reading = asyncio.run(work())
    assert [face.value for face in reading.faces] == pytest.approx(WANTED)
