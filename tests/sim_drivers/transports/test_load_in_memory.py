"""A load on a line in memory: however a sweep ends, its input is off."""

import asyncio

import numpy as np
import pytest

from drivers.errors import LinkLostError
from drivers.load.chroma63600 import Chroma63600
from drivers.load.sweep import SweepSettings
from sim_drivers.load.core import LoadCore
from sim_drivers.transports import InMemoryLine
from tests.sim_drivers.transports.in_memory import virtually
from tests.support.ports import Module


def test_a_sweep_that_is_cancelled_leaves_the_input_off_and_the_line_closed():
    async def scene(now):
        core = LoadCore(Module(), np.random.default_rng(3))
        load = Chroma63600(InMemoryLine("load", core, now), 1, SweepSettings())
        await load.open()
        for moment_s in (0.061, 0.1, 0.113):
            sweep = asyncio.create_task(load.sweep(lambda _open_circuit_v: [30.0] * 50, lambda: None))
            await asyncio.sleep(moment_s)
            assert core.on
            sweep.cancel()
            with pytest.raises(asyncio.CancelledError):
                await sweep
            assert not core.on
            await load.open()

    virtually(scene)


def test_a_load_that_is_unplugged_during_a_sweep_is_switched_off_by_the_next_opening():
    async def scene(now):
        core = LoadCore(Module(), np.random.default_rng(3))
        line = InMemoryLine("load", core, now)
        load = Chroma63600(line, 1, SweepSettings())
        await load.open()
        asyncio.get_running_loop().call_later(0.5, setattr, line, "link_up", False)
        with pytest.raises(LinkLostError, match="is unplugged"):
            await load.sweep(lambda _open_circuit_v: [30.0] * 50, lambda: None)
        assert core.on
        line.link_up = True
        await load.open()
        assert not core.on

    virtually(scene)
