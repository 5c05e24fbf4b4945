"""A scanning meter on a network socket: a real connection, and the simulated meter behind it."""

import asyncio
import contextlib
import time

import numpy as np
import pytest

from drivers.cube.scanning.driver import ScanningMeterSettings, build
from drivers.errors import ConnectError, LinkLostError
from drivers.settings import CubeSurroundings
from sim_drivers.scanner.core import ScannerCore

pytestmark = pytest.mark.protocol


class Meter:
    """A simulated DAQ6510 that listens on loopback."""

    def __init__(self):
        self.core = ScannerCore("daq6510", lambda channel, _now: channel / 10_000, np.random.default_rng(1))
        self.server = None
        self.port = 0
        self.writers = set()

    async def plug(self):
        self.server = await asyncio.start_server(self.serve, "127.0.0.1", self.port)
        self.port = self.server.sockets[0].getsockname()[1]

    async def unplug(self):
        self.server.close()
        for writer in list(self.writers):
            writer.transport.abort()
        while self.writers:  # noqa: ASYNC110 - each leaves when its connection has ended
            await asyncio.sleep(0.01)

    async def serve(self, reader, writer):
        self.writers.add(writer)
        now = asyncio.get_running_loop().time
        with contextlib.suppress(ConnectionError):
            while data := await reader.read(1000):
                for due_s, reply in self.core.feed(data, now()):
                    await asyncio.sleep(max(due_s - now(), 0.0))
                    writer.write(reply)
        self.writers.discard(writer)
        writer.close()


def cube_of(port, host="127.0.0.1"):
    around = CubeSurroundings(utc_s=time.time, monotonic_s=time.monotonic, deadline_s=5.0, switched_meter=None)
    resource = f"TCPIP::{host}::{port}::SOCKET"
    return build(ScanningMeterSettings(driver="scanning-meter", meter="daq6510", resource=resource), around)


def test_a_scanning_meter_is_read_over_its_socket_and_again_after_its_cable_was_unplugged():
    async def act():
        meter = Meter()
        await meter.plug()
        cube = cube_of(meter.port)
        try:
            assert (await cube.open()).startswith("KEITHLEY INSTRUMENTS,MODEL DAQ6510")
            first = await cube.read()
            await meter.unplug()
            with pytest.raises(LinkLostError):
                await lose(cube)
            with pytest.raises(ConnectError):
                await cube.open()
            await meter.plug()
            await cube.open()
            return first, await cube.read()
        finally:
            await cube.close()
            await meter.unplug()

    for reading in asyncio.run(act()):
        assert [face.value for face in reading.faces] == pytest.approx([0.0101, 0.0102, 0.0103, 0.0104], abs=3e-6)


async def lose(cube):
    async with asyncio.timeout(60):
        while True:
            await cube.read()


@pytest.mark.parametrize(
    ("host", "port", "sentence"),
    [
        ("127.0.0.1", 1, "127.0.0.1:1 cannot be reached: Connect"),
        ("no-such-host.invalid", 5025, "there is no host no-such-host.invalid: is the name right?"),
    ],
)
def test_a_meter_that_cannot_be_reached_is_reported_in_one_sentence(host, port, sentence):
    async def act():
        with pytest.raises(ConnectError) as caught:
            await cube_of(port, host).open()
        return caught.value.message

    assert asyncio.run(act()).startswith(sentence)


def test_a_gpib_bus_that_cannot_be_opened_is_reported_with_the_setting_that_helps():
    around = CubeSurroundings(utc_s=time.time, monotonic_s=time.monotonic, deadline_s=1.0, switched_meter=None)
    cube = build(ScanningMeterSettings(resource="GPIB0::9::INSTR"), around)
    with pytest.raises(ConnectError, match=r'it needs linux-gpib, or instruments\.cube\.visa = "ni"$'):
        asyncio.run(cube.open())
