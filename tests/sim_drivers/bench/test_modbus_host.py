"""Foreign programs on our simulated sensors: mbpoll and pymodbus as clients, over TCP and a serial line."""

import asyncio
import contextlib
import gc
import shutil

import pytest
from pymodbus.client import AsyncModbusSerialClient, AsyncModbusTcpClient

from daemon.base.clock import SystemClock
from drivers.cube.pyranometers.driver import build
from drivers.cube.pyranometers.settings import PyranometersSettings
from drivers.errors import LinkLostError
from drivers.modbus.framing import TcpClient
from drivers.modbus.pdu import READ_HOLDING, read_registers
from drivers.settings import CubeSurroundings
from sim_drivers.bench.modbus_host import ModbusHost
from sim_drivers.modbus.pyranometers import SimulatedApogee, SimulatedHukseflux, SimulatedSmp

pytestmark = pytest.mark.slow

needs_mbpoll = pytest.mark.skipif(shutil.which("mbpoll") is None, reason="mbpoll is not installed")


@contextlib.asynccontextmanager
async def served(tmp_path):
    sensors = [
        SimulatedSmp(1, 101, lambda _now: -3.1),
        SimulatedSmp(2, 102, lambda _now: 410.0),
        SimulatedHukseflux(3, 103, lambda _now: 60.0),
        SimulatedApogee(4, 104, lambda _now: 470.0),
    ]
    host = ModbusHost(sensors, tmp_path / "cube", asyncio.get_running_loop().time)
    await host.start()
    task = asyncio.create_task(host.line.run())
    try:
        yield host
    finally:
        task.cancel()
        with contextlib.suppress(asyncio.CancelledError):
            await task
        await host.stop()


async def mbpoll(*arguments):
    """Return the lines with values of one poll; a question without an answer has none."""
    # The sensors miss a question that comes too soon after a reply, and mbpoll asks at once.
    await asyncio.sleep(0.1)
    process = await asyncio.create_subprocess_exec(
        "mbpoll", "-0", "-1", "-q", *map(str, arguments), stdout=asyncio.subprocess.PIPE, stderr=asyncio.subprocess.PIPE
    )
    out, _ = await process.communicate()
    return [line.split("\t")[1].split()[0] for line in out.decode().splitlines() if line.startswith("[")]


@needs_mbpoll
@pytest.mark.live
def test_mbpoll_writes_an_address_and_a_coil_of_the_simulated_sensors_over_tcp_and_a_serial_line(tmp_path):
    async def work():
        async with served(tmp_path) as host:
            ways = [("-m", "tcp", "-p", host.tcp_port), ("-m", "rtu", "-b", 19200, "-P", "none")]
            found = []
            for way, end, address in zip(ways, ("127.0.0.1", tmp_path / "cube"), (7, 8), strict=True):
                host.sensors[0].status = 8
                await mbpoll(*way, "-a", 1, "-t", "0", "-r", 10, end, 1)
                await mbpoll(*way, "-a", host.sensors[2].address, "-t", "4", "-r", 0, end, address)
                # A Hukseflux takes its new address when it is switched on.
                host.power_cycle()
                serial = await mbpoll(*way, "-a", address, "-t", "4", "-r", 40, "-c", 1, end)
                found.append((host.sensors[0].status, serial))
            return found

    assert asyncio.run(work()) == [(0, ["103"]), (0, ["103"])]


@needs_mbpoll
@pytest.mark.live
def test_mbpoll_reads_the_simulated_sensors_over_tcp_and_a_serial_line(tmp_path):
    async def work():
        async with served(tmp_path) as host:
            tcp = ("-m", "tcp", "-p", host.tcp_port)
            host.sensors[1].status = 8
            rtu = ("-m", "rtu", "-b", 19200, "-P", "none")
            return [
                await mbpoll(*tcp, "-a", 1, "-t", "3", "-r", 4, "-c", 2, "127.0.0.1"),
                await mbpoll(*tcp, "-a", 4, "-t", "4:float", "-B", "-r", 0, "-c", 1, "127.0.0.1"),
                await mbpoll(*rtu, "-a", 2, "-t", "1", "-r", 1, "-c", 5, tmp_path / "cube"),
                await mbpoll(*rtu, "-a", 3, "-t", "4", "-r", 40, "-c", 1, tmp_path / "cube"),
                await mbpoll(*rtu, "-a", 3, "-t", "4", "-r", 0, "-c", 6, "-o", "0.5", tmp_path / "cube"),
                await mbpoll(*rtu, "-a", 9, "-t", "4", "-r", 0, "-c", 1, "-o", "0.5", tmp_path / "cube"),
            ]

    night, apogee, flags, serial, six, nobody = asyncio.run(work())
    assert night[0] == "1"
    assert night[1] in ("-31", "65505")
    assert apogee == ["470"]
    assert flags == ["1", "0", "0", "0", "1"]
    assert serial == ["103"]
    assert six == [], "more than five registers are not answered"
    assert nobody == []


def test_pymodbus_reads_and_writes_the_simulated_sensors_over_tcp_and_reads_a_serial_line(tmp_path):
    async def work():
        async with served(tmp_path) as host:
            client = AsyncModbusTcpClient("127.0.0.1", port=host.tcp_port, timeout=5, retries=0)
            await client.connect()
            night = (await client.read_input_registers(5, count=1, device_id=1)).registers
            refused = await client.read_holding_registers(500, count=1, device_id=1)
            written = await client.write_register(0, 7, device_id=3)
            host.power_cycle()
            moved = (await client.read_holding_registers(40, count=1, device_id=7)).registers
            host.sensors[0].status = 8
            await client.write_coil(10, True, device_id=1)
            client.close()
            serial = AsyncModbusSerialClient(str(tmp_path / "cube"), baudrate=19200, timeout=5, retries=0)
            await serial.connect()
            line = await serial.read_holding_registers(0, count=2, device_id=4)
            serial.close()
            value = client.convert_from_registers(line.registers, client.DATATYPE.FLOAT32)
            return night, refused.exception_code, written.isError(), moved, host.sensors[0].status, value

    assert asyncio.run(work()) == ([0x10000 - 31], 2, False, [103], 0, 470.0)


def test_a_reply_that_was_sent_leaves_no_timer_behind(tmp_path):
    async def work():
        async with served(tmp_path) as host:
            host.sensors[2].delay_s = 0.01
            reader, writer = await asyncio.open_connection("127.0.0.1", host.tcp_port)
            framing, seen = TcpClient(), []
            for _ in range(60):
                writer.write(framing.begin(read_registers(3, READ_HOLDING, 40, 1)))
                while framing.feed(await reader.read(4096)) is None:
                    pass
                seen.append(sum(isinstance(each, asyncio.TimerHandle) for each in gc.get_objects()))
            writer.close()
            await writer.wait_closed()
            return seen

    seen = asyncio.run(work())
    assert max(seen) < min(seen) + 10


@pytest.mark.live
def test_the_pyranometer_driver_reads_all_faces_before_and_after_its_cable_was_pulled(tmp_path):
    keys = {"line": str(tmp_path / "cube"), "serial_form": "8N1", "answer_within_s": 5.0}
    keys |= {"west": {"make": "hukseflux", "serial": 103}, "zenith": {"make": "apogee"}}

    async def work():
        clock = SystemClock()
        cube = build(
            PyranometersSettings.model_validate(keys),
            CubeSurroundings(clock.utc, clock.monotonic, 2.0, lambda: None),
        )
        async with served(tmp_path) as host:
            try:
                await cube.open()
                before = await cube.read()
                await host.unplug()
                with pytest.raises(LinkLostError):
                    await cube.read()
                await host.replug()
                await cube.open()
                return before, await cube.read()
            finally:
                await cube.close()

    for reading in asyncio.run(work()):
        assert [face.value for face in reading.faces] == pytest.approx([-3.1, 410.0, 60.0, 470.0], abs=0.01)
