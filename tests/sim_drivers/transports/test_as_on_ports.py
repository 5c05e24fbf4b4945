"""A line in memory carries the same bytes that were recorded on the real port."""

import re

import numpy as np
import pytest

from drivers.load.agilent6063b import Agilent6063B
from drivers.load.chroma63600 import Chroma63600
from drivers.load.sweep import SweepSettings
from drivers.meters.keithley2000 import Keithley2000
from sim_drivers.load.core import LoadCore
from sim_drivers.transports import InMemoryLine
from sim_drivers.voltmeter.core import VoltmeterCore
from solar.pv_module import Q_PEAK_G4_1_305, curve
from tests.sim_drivers.transports.in_memory import Cube, virtually
from tests.support.ports import Module

NUMBER = re.compile(rb"[+-]?\d+\.\d+(E[+-]\d\d)?")


class Recorded:
    """A core, and the bytes on its line."""

    def __init__(self, core):
        self._core = core
        self.sent, self.answered = [], []

    def __getattr__(self, name):
        return getattr(self._core, name)

    def feed(self, data, now):
        self.sent.append(data)
        replies = self._core.feed(data, now)
        self.answered += [reply for _, reply in replies]
        return replies


def assert_same(core, pieces):
    assert core.sent == [piece.data for piece in pieces if piece.direction == ">"]
    expected = [piece.data for piece in pieces if piece.direction == "<"]
    assert [NUMBER.sub(b"#", reply) for reply in core.answered] == [NUMBER.sub(b"#", reply) for reply in expected]


def test_the_voltmeter_line_in_memory_carries_the_bytes_recorded_on_its_port(transcript):
    async def scene(now):
        core = Recorded(VoltmeterCore(lambda _now: 0.0123, np.random.default_rng(3)))
        meter = Keithley2000(InMemoryLine("voltmeter", core, now))
        await meter.open()
        assert [await meter.read_voltage() for _ in range(2)] == pytest.approx([0.0123, 0.0123], abs=5e-6)
        await meter.close()
        assert_same(core, transcript("voltmeter"))

    virtually(scene)


@pytest.mark.parametrize("make", ["chroma63600", "agilent6063b"])
def test_the_load_line_in_memory_carries_the_bytes_recorded_on_its_port(transcript, make):
    async def scene(now):
        channel = 3 if make == "chroma63600" else 1
        core = Recorded(LoadCore(Module(), np.random.default_rng(3), make=make, channel=channel))
        core.scpi.clear()
        line, how = InMemoryLine("load", core, now), SweepSettings(0.02)
        load = Chroma63600(line, 3, how) if make == "chroma63600" else Agilent6063B(line, how)
        await load.open()
        swept = await load.sweep(lambda _open_circuit_v: (36.0, 31.5, 10.0), lambda: None)
        await load.close()
        truth = curve(Q_PEAK_G4_1_305, 800.0, 40.0, np.array(swept.voltage_v))
        assert swept.current_a == pytest.approx(truth, abs=0.04)
        assert_same(core, transcript(f"load_{make}"))

    virtually(scene)


def test_the_multiplexer_port_in_memory_takes_the_values_recorded_on_the_real_port(transcript):
    async def scene(now):
        cube = Cube(now)
        await cube.open()
        written, write = [], cube.switch.write
        cube.switch.write = lambda value, at: (written.append(value), write(value, at))
        for channel in range(8):
            await cube.multiplexer.select(channel)
        assert written == [int(piece.data) for piece in transcript("multiplexer")]

    virtually(scene)
