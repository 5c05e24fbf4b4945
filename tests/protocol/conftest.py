"""Fixtures of the protocol tier: real drivers on real transports, in one process, in real time."""

import asyncio
import contextlib
from pathlib import Path

import numpy as np
import pytest

from drivers.transcript import parse
from sim_drivers.hosts.positioner_host import PositionerHost
from sim_drivers.hosts.voltmeter_host import VoltmeterHost
from sim_drivers.positioner_core import PositionerCore
from sim_drivers.positioner_setup import Drive, Setup
from sim_drivers.voltmeter_core import VoltmeterCore

HERE = Path(__file__).parent


@pytest.fixture
def transcript():
    """Read one of the transcripts beside the tests: the pieces in order."""
    return lambda name: parse((HERE / f"{name}.transcript").read_text(encoding="utf-8").splitlines())


@pytest.fixture
def positioner_host(tmp_path):
    """Return a context in which a simulated positioner is on the port ``positioner`` of the test's folder."""

    @contextlib.asynccontextmanager
    async def served(setup=None):
        now = asyncio.get_running_loop().time
        core = PositionerCore(now(), setup or Setup(drive=Drive(speed_mm_s=40.0, acceleration_mm_s2=400.0)))
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
