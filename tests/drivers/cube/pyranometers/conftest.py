"""A cube of simulated sensors in virtual time."""

import asyncio

import pytest

from daemon.base.clock import LoopClock
from daemon.base.timeloop import VirtualTimeLoop
from daemon.rigs.simulated_modbus import build_pyranometers
from drivers.cube.pyranometers.driver import build
from drivers.cube.pyranometers.settings import FACE_NAMES, PyranometersSettings
from drivers.settings import CubeSurroundings
from sim_drivers.modbus.line import DeviceLineCore
from sim_drivers.transports import InMemoryModbus

VOLT_PER_W_M2 = 1e-4
LIGHT = (300.0, 410.0, 60.0, 470.0)


class Rig:
    """The cube, its sensors in the order of the faces, and its lines by name."""

    def __init__(self, clock, **keys):
        self.clock = clock
        self.settings = PyranometersSettings.model_validate(keys)
        self.light = list(LIGHT)
        self.sensors = build_pyranometers(self.settings, lambda face, _now: self.light[face] * VOLT_PER_W_M2)
        self.cores, self.lines = {}, {}
        surroundings = CubeSurroundings(clock.utc, clock.monotonic, 2.0, lambda: None)
        self.cube = build(self.settings, surroundings, self._path)

    def _path(self, line):
        there = [
            sensor
            for name, sensor in zip(FACE_NAMES, self.sensors, strict=True)
            if (self.settings.line_of(name) or "") == line
        ]
        self.cores[line] = DeviceLineCore(there)
        self.lines[line] = InMemoryModbus("cube", self.cores[line], self.clock.monotonic)
        return self.lines[line]

    async def scans(self, count=1, every_s=5.0):
        """Make some scans; return the last one, and how long it took [s]."""
        for _ in range(count):
            await asyncio.sleep(every_s)
            begun_s = self.clock.monotonic()
            reading = await self.cube.read()
            took_s = self.clock.monotonic() - begun_s
        return reading, took_s


@pytest.fixture
def on_rig():
    """Return a function that runs `work` on an opened rig with these settings in virtual time, and gives its result."""

    def run(work, **keys):
        with asyncio.Runner(loop_factory=VirtualTimeLoop) as runner:
            rig = Rig(LoopClock(runner.get_loop().time, 1.7e9), **keys)

            async def opened():
                await rig.cube.open()
                try:
                    return await work(rig)
                finally:
                    await rig.cube.close()

            return runner.run(opened())

    return run
