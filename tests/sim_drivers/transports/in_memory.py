"""Instruments in memory under virtual time, for the tests in this folder."""

import asyncio

import numpy as np

from daemon.base.timeloop import VirtualTimeLoop
from drivers.meters.keithley2000 import Keithley2000
from drivers.switches.ni_usb6008 import NiMultiplexer
from sim_drivers.multiplexer import MultiplexerCore
from sim_drivers.transports import InMemoryLine, InMemoryPort
from sim_drivers.voltmeter.core import VoltmeterCore

VOLTS = (0.010, 0.020, 0.030, 0.040)


def virtually(scene):
    """Run a coroutine function, given the loop's time, in virtual time."""
    with asyncio.Runner(loop_factory=VirtualTimeLoop) as runner:
        return runner.run(scene(runner.get_loop().time))


class Cube:
    def __init__(self, now, inputs=lambda channel, _now: VOLTS[channel] if channel < 4 else None, **options):
        self.switch = MultiplexerCore(inputs)
        self.meter = VoltmeterCore(self.switch.output_voltage, np.random.default_rng(3))
        self.port = InMemoryPort(self.switch, now)
        self.line = InMemoryLine("voltmeter", self.meter, now)
        self.multiplexer = NiMultiplexer(self.port)
        self.voltmeter = Keithley2000(self.line, **options)

    async def open(self):
        return await self.multiplexer.open(), await self.voltmeter.open()

    async def read(self, channel):
        await self.multiplexer.select(channel)
        await asyncio.sleep(0.3)
        return await self.voltmeter.read_voltage()
