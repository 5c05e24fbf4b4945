"""The worked example of docs/develop/add-positioner.md, installed as a package of somebody else."""

import asyncio
import math
import re

import numpy as np
import pytest

import heliocube
from daemon.base.clock import LoopClock, SystemClock
from daemon.base.errors import UserError
from daemon.base.timeloop import VirtualTimeLoop
from daemon.config.file import load_settings
from daemon.rigs.real import build_positioner
from daemon.rigs.simulated import build_simulated_positioner
from tests.support import DOCS
from tests.support.packages import install

PAGE = (DOCS / "develop" / "add-positioner.md").read_text()
(CODE,) = re.findall(r"```python\n(.*?)```", PAGE, re.DOTALL)
PYPROJECT, CONFIG = re.findall(r"```toml\n(.*?)```", PAGE, re.DOTALL)


@pytest.fixture
def file(tmp_path, monkeypatch):
    """A configuration that takes the example, which lies in a folder on the path as an installer leaves it."""
    points = PYPROJECT.replace('[project.entry-points."heliocube.positioner"]', "[heliocube.positioner]")
    install(monkeypatch, tmp_path / "site", points.replace('"', ""), {"gimbal": CODE})
    config = tmp_path / "heliocube.toml"
    config.write_text(CONFIG)
    return config


def test_a_simulated_rig_tracks_with_the_example_positioner(file):
    tables = heliocube.simulate("2022-10-14T10:00Z", days=0.5 / 24, weather="clear", config=file, seed=3)
    moves, decisions = tables["moves"], tables["decisions"]
    assert set(moves["outcome"]) == {"arrived"}
    assert decisions["mode"].iloc[-1] == "tracking"
    ends, targets = moves[["end_a_deg", "end_b_deg"]], moves[["target_a_deg", "target_b_deg"]]
    np.testing.assert_allclose(ends.to_numpy(), targets.to_numpy(), atol=0.01)


def in_virtual_time(file, act):
    with asyncio.Runner(loop_factory=VirtualTimeLoop) as runner:
        clock = LoopClock(runner.get_loop().time, 1665576000.0)
        truth, positioner = build_simulated_positioner(load_settings(file), clock)
        runner.run(act(positioner, lambda: truth(clock.monotonic())))


@pytest.mark.parametrize("target", [(51.0, 45.0), (0.0, 14.0), (math.nan, 45.0), (0.0, math.inf)])
def test_the_example_positioner_refuses_targets_outside_its_limits_and_does_not_move(file, target):
    async def act(positioner, truth):
        await positioner.open()
        with pytest.raises(ValueError, match="outside the limits"):
            await positioner.move_to(*target)
        await asyncio.sleep(5.0)
        assert truth() == (0.0, 90.0)

    in_virtual_time(file, act)


def test_telemetry_of_the_example_positioner_has_its_own_state_as_a_named_detail(file):
    async def act(positioner, truth):
        await positioner.open()
        await positioner.home("a")
        seen = await positioner.read_telemetry()
        assert (seen.homing, dict(seen.details)) == (True, {"state": "homing"})

    in_virtual_time(file, act)


def test_a_halt_stops_the_example_positioner_where_it_is(file):
    async def act(positioner, truth):
        await positioner.open()
        await positioner.move_to(30.0, 60.0)
        await asyncio.sleep(2.0)
        await positioner.halt()
        stands = truth()
        await asyncio.sleep(60.0)
        assert truth() == stands
        assert 5.0 < stands[0] < 10.0

    in_virtual_time(file, act)


def test_a_reference_run_shows_in_the_telemetry_and_ends_at_its_end_switch(file):
    async def act(positioner, truth):
        await positioner.open()
        await positioner.home("a")
        await asyncio.sleep(1.0)
        assert (await positioner.read_telemetry()).homing
        await asyncio.sleep(60.0)
        assert not (await positioner.read_telemetry()).homing
        assert truth() == (-52.0, 90.0)

    in_virtual_time(file, act)


def test_a_real_rig_without_a_positioner_port_is_refused_naming_the_missing_key(file):
    file.write_text(CONFIG + '[instruments]\nkind = "real"\n')
    with pytest.raises(UserError, match=r"instruments\.positioner\.resource is missing"):
        build_positioner(load_settings(file), SystemClock())
