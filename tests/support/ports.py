"""Fixtures of the protocol tier: real drivers on real transports, in one process, in real time."""

import asyncio
import contextlib
import os
import threading
import tty

import numpy as np
import pytest

from drivers.transcript import parse
from sim_drivers.bench.line_host import LineHost, VoltmeterHost
from sim_drivers.bench.positioner_host import PositionerHost
from sim_drivers.load.core import LoadCore
from sim_drivers.pozsol.core import PositionerCore
from sim_drivers.pozsol.setup import AxisDrive, Setup
from sim_drivers.pv_source import SourceLight
from sim_drivers.voltmeter.core import VoltmeterCore
from solar.pv_module import Q_PEAK_G4_1_305, single_diode
from tests.support import PATIENCE_S, ROOT
from tests.support.rotctld import LEFT_OUT, ROTCTLD, Rotctld

TRANSCRIPTS = ROOT / "tests" / "drivers" / "transcripts"


@pytest.fixture
def transcript():
    """Returns the pieces of one of the transcripts beside the tests, in order."""
    return lambda name: parse((TRANSCRIPTS / f"{name}.transcript").read_text(encoding="utf-8").splitlines())


class TranscriptPlayer(threading.Thread):
    """Plays the instrument's part of a transcript on a port, and notes what it receives, up to the first difference."""

    def __init__(self, pieces, link):
        super().__init__(daemon=True)
        self._pieces = pieces
        self._master, self._slave = os.openpty()
        tty.setraw(self._slave)
        link.symlink_to(os.ttyname(self._slave))
        self.received = []
        self.start()

    def run(self):
        for piece in self._pieces:
            if piece.direction == "<":
                os.write(self._master, piece.data)
                continue
            data = b""
            while len(data) < len(piece.data):
                data += os.read(self._master, len(piece.data) - len(data))
            self.received.append(data)
            if data != piece.data:
                return

    def end(self):
        self.join(PATIENCE_S)
        os.close(self._slave)
        os.close(self._master)


@pytest.fixture
def play():
    """Return the class that plays the instrument's part of a transcript."""
    return TranscriptPlayer


class Module:
    """A module in a light that a test sets."""

    def __init__(self):
        self.now = SourceLight(800.0, 40.0)

    def light(self, _now):
        return self.now

    def current(self, light, voltage_v):
        return single_diode(Q_PEAK_G4_1_305, *light).current(voltage_v)

    def voltage(self, light, current_a):
        return single_diode(Q_PEAK_G4_1_305, *light).voltage(current_a)


@pytest.fixture
def load_host(tmp_path):
    """Return a context in which a simulated electronic load is on the port ``load`` of the test's folder."""

    @contextlib.asynccontextmanager
    async def served(make="chroma63600", **options):
        now = asyncio.get_running_loop().time
        core = LoadCore(Module(), np.random.default_rng(3), make=make, now=now(), **options)
        host = LineHost(core, tmp_path / "load", now, 2e-4)
        async with _running(host):
            yield host

    return served


@pytest.fixture
def patience(monkeypatch):
    """Give the unit 10 s to show a target: on a busy machine, data that came in time is read late."""
    monkeypatch.setattr("drivers.positioners.pozsol.positioner._TARGET_SHOWS_S", 10.0)


@pytest.fixture
def positioner_host(tmp_path, patience):
    """Return a context in which a simulated positioner is on the port ``positioner`` of the test's folder."""

    @contextlib.asynccontextmanager
    async def served(setup=None):
        now = asyncio.get_running_loop().time
        core = PositionerCore(
            now(), setup or Setup(drive=AxisDrive(speed_mm_s=40.0, acceleration_mm_s2=400.0, run_out_s=0.01))
        )
        host = PositionerHost(core, tmp_path / "positioner", now, np.random.default_rng(1))
        async with _running(host):
            yield host

    return served


@pytest.fixture
def voltmeter_host(tmp_path):
    """Return a context in which a simulated voltmeter is on the port ``voltmeter`` of the test's folder."""

    @contextlib.asynccontextmanager
    async def served(volts=0.0123, **options):
        now = asyncio.get_running_loop().time
        core = VoltmeterCore(lambda _now: volts, np.random.default_rng(3), now=now(), **options)
        host = VoltmeterHost(core, tmp_path / "voltmeter", now, 19200)
        async with _running(host):
            yield host

    return served


@contextlib.asynccontextmanager
async def _running(host):
    host.port.plug()
    task = asyncio.create_task(host.run())
    try:
        yield
    finally:
        task.cancel()
        with contextlib.suppress(asyncio.CancelledError):
            await task
        host.port.unplug()


@pytest.fixture
def start_rotctld():
    """Start a rotctld with options of its own; it ends with the test."""
    if ROTCTLD is None:
        pytest.skip(LEFT_OUT)
    started = []

    def start(*options):
        server = Rotctld(*options)
        started.append(server)
        server.start()
        return server

    yield start
    for server in started:
        server.kill()
